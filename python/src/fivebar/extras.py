"""Extras of the package. Their requirements come from the package's metadata, which pyproject.toml defines."""

from importlib.metadata import PackageNotFoundError, requires, version

from packaging.requirements import Requirement

from fivebar.errors import FiveBarError


def need(extra: str, *packages: str) -> None:
    """Raises FiveBarError if packages of an extra are missing or too old.

    `packages` restricts the check to some packages of the extra; by default all are checked.
    """
    needed = [
        (requirement, _installed(requirement.name))
        for requirement in requirements(extra)
        if not packages or requirement.name in packages
    ]
    wrong = []
    if missing := [requirement.name for requirement, found in needed if found is None]:
        verb = "is" if len(missing) == 1 else "are"
        wrong.append(f"{_listed(missing)} {verb} needed and not installed")
    for requirement, found in needed:
        if found is not None and not requirement.specifier.contains(found, prereleases=True):
            wrong.append(
                f"{requirement.name} {found} is installed, but {str(requirement.specifier).replace('>=', '>= ')} is needed"
            )
    if wrong:
        raise FiveBarError(f"{'; '.join(wrong)}: pip install 'fivebar[{extra}]' installs what is needed")


def requirements(extra: str) -> list[Requirement]:
    """Requirements that an extra adds to the package on this machine."""
    found = [Requirement(text) for text in requires("fivebar") or ()]
    return [
        r
        for r in found
        if r.marker is not None and r.marker.evaluate({"extra": extra}) and not r.marker.evaluate({"extra": ""})
    ]


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _installed(name: str) -> str | None:
    """The installed version of a package, or None."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None
