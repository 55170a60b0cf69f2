"""The extras of the package: what they need stands in pyproject.toml, from where the package's metadata have it."""

from importlib.metadata import PackageNotFoundError, requires, version

from packaging.requirements import Requirement

from fivebar.errors import FiveBarError


def need(extra: str) -> None:
    """Refuses with one sentence if packages are missing that an extra needs."""
    missing = [name for name in packages(extra) if not _is_installed(name)]
    if missing:
        names = " and ".join([", ".join(missing[:-1]), missing[-1]] if len(missing) > 1 else missing)
        verb = "is" if len(missing) == 1 else "are"
        raise FiveBarError(f"{names} {verb} needed and not installed: pip install 'fivebar[{extra}]' installs what is missing")


def packages(extra: str) -> list[str]:
    """Names of the packages that an extra needs on this machine."""
    found = [Requirement(text) for text in requires("fivebar") or ()]
    return [r.name for r in found if r.marker is not None and r.marker.evaluate({"extra": extra}) and not r.marker.evaluate({"extra": ""})]


def _is_installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True
