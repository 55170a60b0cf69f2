"""The build hook of `cargo xtask wheel` adds to the package, in a checkout, the unit, the scenes, the live page, the site and the licences, and
to the sdist also the examples. The metadata hook makes the description of the package from README.md.

Files of `fivebar/shipped/` are read by `fivebar.shipped`. A wheel whose unit has one library is for this machine's kind; with several it is
for all of them.
"""

import os
import re
import sysconfig
import zipfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

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
            site = checkout / "target" / "site"
            files |= {file: f"site/{file.relative_to(site).as_posix()}" for file in site.rglob("*")}
            # Without the unit, the page or the site, the package says how to make them.
            build_data["force_include"] |= {
                str(file): f"{prefix}/{name}" for file, name in sorted(files.items()) if file.is_file()
            }
            if self.target_name == "sdist":
                build_data["force_include"] |= {
                    str(file): f"examples/{file.name}"
                    for file in sorted((checkout / "examples").iterdir())
                    if file.is_file()
                }
        if self.target_name == "wheel" and unit.is_file():
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{'any' if len(libraries(unit)) > 1 else platform()}"


class Description(MetadataHookInterface):
    """README.md as an index of packages shows it: without pictures, and without links into the repository, which lead nowhere there.

    An sdist has the result in its own metadata, where hatchling finds it.
    """

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Called before each build."""
        text = (Path(self.root).parent / "README.md").read_text(encoding="utf-8")
        text = re.sub(r"^!\[.*?\]\((?!https?:).*?\)\n\n", "", text, flags=re.MULTILINE)
        text = re.sub(r"\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", text)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def libraries(unit: Path) -> set[str]:
    """The platforms that an .fmu has a library for."""
    with zipfile.ZipFile(unit) as archive:
        return {
            name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/") and not name.endswith("/")
        }


def platform() -> str:
    """The kind of the building machine, in the words of wheel tags."""
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")
