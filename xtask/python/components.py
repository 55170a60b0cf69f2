"""Prints the Python packages required by `fivebar`, directly or indirectly, as CycloneDX components; `cargo xtask release` puts them into
its bill of materials. Versions come from the environment that runs this, the environment of the tests."""

import json
import re
from importlib import metadata

from packaging.requirements import Requirement

EXTRAS = ("twin", "calibrate", "ensemble", "cluster")


def closure(extras: tuple[str, ...]) -> dict[str, metadata.Distribution]:
    """Installed distributions by normalised name: everything that `fivebar` with these extras needs on this machine, except itself."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [("fivebar", extras)]
    done = set()
    while waiting:
        name, asked = waiting.pop()
        if (name, asked) in done:
            continue
        done.add((name, asked))
        distribution = metadata.distribution(name)
        if name != "fivebar":
            found[name] = distribution
        for text in distribution.requires or ():
            requirement = Requirement(text)
            environments = [{"extra": extra} for extra in asked] or [{"extra": ""}]
            if requirement.marker is None or any(
                requirement.marker.evaluate(environment) for environment in environments
            ):
                waiting.append((normal(requirement.name), tuple(sorted(requirement.extras))))
    return found


def normal(name: str) -> str:
    """Normalised name, as in the index."""
    return re.sub(r"[-_.]+", "-", name).lower()


def component(name: str, distribution: metadata.Distribution, optional: bool) -> dict[str, object]:
    """One package; optional if only an extra requires it."""
    purl = f"pkg:pypi/{name}@{distribution.version}"
    made: dict[str, object] = {
        "type": "library",
        "bom-ref": purl,
        "purl": purl,
        "name": name,
        "version": distribution.version,
    }
    made["scope"] = "optional" if optional else "required"
    if expression := distribution.metadata.get("License-Expression"):
        made["licenses"] = [{"expression": expression}]
    elif classifiers := [
        c.rpartition(" :: ")[2] for c in distribution.metadata.get_all("Classifier", []) if c.startswith("License :: ")
    ]:
        made["licenses"] = [{"license": {"name": classifier}} for classifier in classifiers]
    elif text := distribution.metadata.get("License"):
        made["licenses"] = [{"license": {"name": text.splitlines()[0]}}]
    elif files := distribution.metadata.get_all("License-File"):
        # The package names no licence but contains its text.
        made["licenses"] = [
            {"license": {"name": file, "text": {"content": distribution.read_text(f"licenses/{file}")}}}
            for file in files
        ]
    return made


def main() -> None:
    """Prints the components, sorted by name."""
    core, all_of_it = closure(()), closure(EXTRAS)
    print(json.dumps([component(name, all_of_it[name], name not in core) for name in sorted(all_of_it)]))


if __name__ == "__main__":
    main()
