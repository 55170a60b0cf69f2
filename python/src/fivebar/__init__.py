"""The planar five-bar: its unit FiveBar.fmu, runs of scenes, pictures, kinematics, workspace, and a live twin.

>>> import fivebar
>>> fall = fivebar.run("fall_90_120", method="automatic")
>>> fall["tip.x"][-1], fall.units["tip.x"]
>>> fall.plot("tip.x", "tip.y").savefig("tip.png")
>>> fall.animate()
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fivebar.errors import FiveBarError, StepFailed, UnitError
    from fivebar.instance import State, Unit
    from fivebar.own_unit import Naming
    from fivebar.result import Result
    from fivebar.scene import Scene
    from fivebar.variables import Value

    __version__: str

__all__ = ["FiveBarError", "State", "StepFailed", "Unit", "UnitError", "run", "scenes", "unit"]

# The packages that compute and draw are loaded by what needs them: the command line answers at once.
_MODULES = {
    "FiveBarError": "errors",
    "State": "instance",
    "StepFailed": "errors",
    "Unit": "instance",
    "UnitError": "errors",
}
"""Modules of the names that are loaded when they are asked for."""


def __getattr__(name: str) -> Any:
    """A name of `_MODULES`; or `__version__`, from the metadata of the installed package."""
    from importlib import import_module, metadata

    if name == "__version__":
        return metadata.version("fivebar")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"fivebar.{_MODULES[name]}"), name)


def unit(
    scene: "str | Path | Scene | None" = None,
    name: str | None = None,
    naming: "Naming" = "structured",
    folder: str | Path | None = None,
) -> Path:
    """The path of the shipped .fmu, for any FMI 2.0 master; in a checkout that which `cargo xtask package` has packed.

    With a scene, a name or `naming="flat"` the path of a unit that is written for them, to `folder` or the current one: its start values,
    experiment and description are the scene's.

    >>> fivebar.unit("my_machine.json", name="MyMachine", folder="units")

    Raises FiveBarError, a ValueError, if there is none, or what is given is refused.
    """
    from fivebar import shipped

    if scene is None and name is None and naming == "structured" and folder is None:
        return shipped.unit()
    from fivebar import own_unit
    from fivebar.scene import Scene, read

    known = scene if scene is None or isinstance(scene, Scene) else read(scene)
    return own_unit.write_unit(Path(folder or ""), known, name, naming=naming).file


def scenes() -> dict[str, str]:
    """The shipped scenes: name to description."""
    from fivebar import shipped

    return shipped.descriptions()


def run(
    scene: "str | Path | Scene", method: str | None = None, outputs: "Iterable[str]" = (), **values: "Value | str"
) -> "Result":
    """Runs a scene and returns what the unit computes at every communication point.

    `scene` is the name of a shipped scene, a file, or a `fivebar.scene.Scene`; `method` an item of `solver.method` in the place of the
    scene's own; `outputs` what tables have, by names or how these begin, such as `("tip", "energy.error")`, all unless told; to read
    all takes several times as long as the steps; `values` are start values by variable, in the variable's unit, enumerations by the names of their items:
    `run("swing", **{"link[1].mass": 0.02, "viscous.enabled": True})`.

    A step that fails ends the run, and `Result.failure` says why. Raises FiveBarError, a ValueError of one sentence, if the scene, the method
    or a value is refused.
    """
    from fivebar import simulate

    return simulate.run(scene, method, values, outputs=outputs)
