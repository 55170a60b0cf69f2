"""The unit, the scenes and the live page that come with the package: in its folder `shipped/`, as the wheel has them, or where the
checkout that the package lies in has them.
"""

import os
import zipfile
from pathlib import Path

from fivebar.errors import FiveBarError

FOLDER = Path(__file__).with_name("shipped")
CHECKOUT = Path(__file__).resolve().parents[3]
"""The root of the checkout, if the package lies in one."""


def unit() -> Path:
    """The .fmu: that of the environment's `FIVEBAR_FMU`, the shipped one, or the one that the checkout has packed.

    Raises FiveBarError if there is none.
    """
    if given := os.environ.get("FIVEBAR_FMU"):
        if not Path(given).is_file():
            raise FiveBarError(f"FIVEBAR_FMU is {given!r}, where there is no file")
        return Path(given)
    file = _found("FiveBar.fmu", "target/fmu/FiveBar.fmu")
    if file is None:
        raise FiveBarError("this package comes without its unit; in a checkout `cargo xtask package` packs it")
    return file


def scene_files() -> dict[str, Path]:
    """The files of the shipped scenes, by name."""
    folder = _found("scenes", "scenes")
    return {file.stem: file for file in sorted(folder.glob("*.json"))} if folder else {}


def page() -> Path | None:
    """The live page, or None where the package comes without."""
    return _found("fivebar.html", "target/page/fivebar.html")


def _found(name: str, in_checkout: str) -> Path | None:
    places = [FOLDER / name]
    # Any other folder that a package lies in is none of its own.
    if (CHECKOUT / "modelDescription" / "modelDescription.xml").is_file():
        places.append(CHECKOUT / in_checkout)
    return next((place for place in places if place.exists()), None)


def platforms(fmu: Path) -> list[str]:
    """The machines that an .fmu has a library for, by FMI's names of platforms."""
    with zipfile.ZipFile(fmu) as archive:
        return sorted({name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/") and name.count("/") == 2})
