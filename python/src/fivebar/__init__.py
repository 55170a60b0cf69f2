"""The planar five-bar: its unit FiveBar.fmu, runs of scenes, pictures, kinematics, workspace, and a live twin.

>>> import fivebar
>>> fall = fivebar.run("fall_90_120", method="automatic")
>>> fall["tip.x"][-1], fall.units["tip.x"]
>>> fall.plot("tip.x", "tip.y").savefig("tip.png")
>>> fall.animate()
"""

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fivebar.scene import Scene
    from fivebar.simulate import Result
    from fivebar.variables import Value

__version__ = version("fivebar")
__all__ = ["run", "scenes", "unit"]

# The packages that compute and draw are loaded by what needs them: the command line answers at once.


def unit() -> Path:
    """The path of the shipped .fmu, for any FMI 2.0 master; in a checkout that which `cargo xtask package` has packed.

    Raises FiveBarError, a ValueError, if there is none.
    """
    from fivebar import shipped

    return shipped.unit()


def scenes() -> dict[str, str]:
    """The shipped scenes: name to description."""
    from fivebar import scene, shipped

    return {name: scene.description(file) for name, file in shipped.scene_files().items()}


def run(scene: "str | Path | Scene", method: str | None = None, **values: "Value | str") -> "Result":
    """Runs a scene and returns all that the unit computes at every communication point.

    `scene` is the name of a shipped scene, a file, or a `fivebar.scene.Scene`; `method` an item of `solver.method` in the place of the
    scene's own; `values` are start values by variable, in the variable's unit, enumerations by the names of their items:
    `run("swing", **{"link[1].mass": 0.02, "viscous.enabled": True})`.

    A step that fails ends the run, and `Result.failure` says why. Raises FiveBarError, a ValueError of one sentence, if the scene, the method
    or a value is refused.
    """
    from fivebar import simulate

    return simulate.run(scene, method, values)
