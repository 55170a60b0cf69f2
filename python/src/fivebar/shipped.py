"""The unit, the scenes, the live page and the site of the package: from its folder `shipped/` in a wheel, or from the places in a checkout."""

import json
import os
import platform
import sys
from pathlib import Path

from fivebar.errors import FiveBarError

FOLDER = Path(__file__).with_name("shipped")
CHECKOUT = Path(__file__).resolve().parents[3]
"""The root of the checkout, if the package is in one."""


MACHINES = {
    "linux x86_64": ("linux64", ".so"),
    "linux aarch64": ("aarch64-linux", ".so"),
    "win amd64": ("win64", ".dll"),
    "darwin x86_64": ("darwin64", ".dylib"),
    "darwin arm64": ("darwin64", ".dylib"),
}
"""Folders of libraries in an .fmu, and file endings, by kind of machine."""


def unit() -> Path:
    """The .fmu: from the environment variable `FIVEBAR_FMU`, or the shipped one, or the one packed in the checkout.

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


def descriptions() -> dict[str, str]:
    """The descriptions of the shipped scenes, by name."""
    return {name: json.loads(file.read_text(encoding="utf-8"))["description"] for name, file in scene_files().items()}


def page() -> Path | None:
    """The live page, or None if the package has none."""
    return _found("fivebar.html", "target/page/fivebar.html")


def site() -> Path | None:
    """The first page of the documentation, or None if the package has none."""
    return _found("site/index.html", "target/site/index.html")


def _found(name: str, in_checkout: str) -> Path | None:
    places = [FOLDER / name]
    # Any other folder is not a checkout of this package.
    if (CHECKOUT / "modelDescription" / "modelDescription.xml").is_file():
        places.append(CHECKOUT / in_checkout)
    return next((place for place in places if place.exists()), None)


def library(directory: str | Path, identifier: str) -> str:
    """The library for this machine in an extracted .fmu.

    Raises FiveBarError if there is none.
    """
    kind = f"{sys.platform.rstrip('0123456789')} {platform.machine().lower()}"
    folder, ending = MACHINES.get(kind, (kind, ""))
    file = Path(directory, "binaries", folder, identifier + ending)
    if not file.is_file():
        there = ", ".join(sorted(path.name for path in Path(directory, "binaries").glob("*"))) or "none at all"
        raise FiveBarError(f"{identifier} has no library for this machine, {folder}; it has {there}")
    return str(file)
