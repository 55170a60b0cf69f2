"""Colours of the mechanism's parts and of singularities. `colours.css` defines them for pictures and pages."""

import re
from pathlib import Path
from typing import Final

STYLE_SHEET: Final = Path(__file__).with_name("colours.css")
COLOURS: Final = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", STYLE_SHEET.read_text(encoding="utf-8")))
LEFT, RIGHT, TIP = (COLOURS[part] for part in ("left", "right", "tip"))
KIND_COLOURS: Final = {kind: COLOURS[kind] for kind in ("direct", "inverse", "combined", "constraint")}
