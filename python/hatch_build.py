"""The build hook of `cargo xtask wheel` adds to the package, in a checkout, the unit, the scenes, the live page and the licences.

Files of `fivebar/shipped/` are read by `fivebar.shipped`. A wheel whose unit has one library is for this machine's kind; with several it is
for all of them.
"""

import os
import sysconfig
import zipfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHIPPED = "fivebar/shipped"


class ShippedFiles(BuildHookInterface):
    """Puts the files where the package looks for them."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before a build; an editable one finds everything in the checkout."""
        if version == "editable":
            return
        checkout = Path(self.root).parent
        prefix = SHIPPED if self.target_name == "wheel" else f"src/{SHIPPED}"
        unit = Path(self.root, "src", SHIPPED, "FiveBar.fmu")
        if (checkout / "modelDescription" / "modelDescription.xml").is_file():
            unit = Path(os.environ.get("FIVEBAR_FMU", checkout / "target" / "fmu" / "FiveBar.fmu"))
            files = {unit: unit.name, checkout / "target" / "page" / "fivebar.html": "fivebar.html"}
            files |= {checkout / name: name for name in ("LICENSE-MIT", "LICENSE-APACHE")}
            files |= {file: f"scenes/{file.name}" for file in (checkout / "scenes").glob("*.json")}
            # Without the unit, or the page, the package says how to make them.
            build_data["force_include"] |= {
                str(file): f"{prefix}/{name}" for file, name in sorted(files.items()) if file.is_file()
            }
        if self.target_name == "wheel" and unit.is_file():
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{'any' if len(libraries(unit)) > 1 else platform()}"


def libraries(unit: Path) -> set[str]:
    """The platforms that an .fmu has a library for."""
    with zipfile.ZipFile(unit) as archive:
        return {
            name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/") and not name.endswith("/")
        }


def platform() -> str:
    """The kind of the building machine, in the words of wheel tags."""
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")
