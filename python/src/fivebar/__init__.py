"""The planar five-bar: its unit FiveBar.fmu, runs of scenes, pictures, kinematics, workspace, and a live twin.

Examples
--------
>>> import fivebar
>>> fall = fivebar.run("fall_90_120", method="automatic")
>>> fall
<fivebar.Result of fall_90_120 by automatic: ... columns at 2001 communication points, 0 to 2 s>
>>> fall["tip.x"].shape, fall.units["tip.x"]
((2001,), 'm')
>>> fall.plot("tip.x", "tip.y").savefig("tip.png")
>>> page = fall.animate("fall.html")
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from fivebar.errors import FiveBarError, StepFailed, UnitError
    from fivebar.inputs import Inputs
    from fivebar.instance import State, Unit
    from fivebar.kinematics import Machine
    from fivebar.many import Given, Reduce
    from fivebar.own_unit import Naming
    from fivebar.result import Result
    from fivebar.scene import Scene
    from fivebar.simulate import OnFailure
    from fivebar.twin.calibrate.calibration import Calibration
    from fivebar.twin.calibrate.motion import Between

    __version__: str

__all__ = [
    "FiveBarError",
    "Machine",
    "Result",
    "Scene",
    "State",
    "StepFailed",
    "Unit",
    "UnitError",
    "calibrate",
    "run",
    "run_many",
    "scenes",
    "unit",
]

# Packages that compute or draw are imported at first use, so that the command line answers at once.
_MODULES = {
    "FiveBarError": "errors",
    "Machine": "kinematics",
    "Result": "result",
    "Scene": "scene",
    "State": "instance",
    "StepFailed": "errors",
    "Unit": "instance",
    "UnitError": "errors",
}
"""Modules of the names that are imported at first use."""


def __getattr__(name: str) -> Any:
    """A name of `_MODULES`; or `__version__`, from the metadata of the installed package."""
    from importlib import import_module, metadata

    if name == "__version__":
        return metadata.version("fivebar")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"fivebar.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Names that notebooks complete."""
    return sorted({*globals(), *__all__})


def unit(
    scene: "str | Path | Mapping[str, Any] | Scene | None" = None,
    name: str | None = None,
    naming: "Naming" = "structured",
    folder: str | Path | None = None,
) -> Path:
    """The path of the shipped .fmu, for any FMI 2.0 master; in a checkout, of the .fmu from `cargo xtask package`.

    With an argument, a unit with these properties is written, and its path returned.

    Parameters
    ----------
    scene
        Start values, experiment and description of the unit: a scene as `run` takes it.
    name
        Name of the unit. The default is FiveBar, or the scene's name in CamelCase.
    naming
        `"flat"` for masters that make buses of `tip.x` and `tau[1]`.
    folder
        Folder of the written unit. The default is the current folder.

    Returns
    -------
    pathlib.Path
        The .fmu.

    Raises
    ------
    FiveBarError
        If there is no unit, or an argument is refused.

    Examples
    --------
    >>> import fivebar
    >>> fivebar.unit().name
    'FiveBar.fmu'
    >>> fivebar.unit("swing", folder="units").name
    'Swing.fmu'
    """
    from fivebar import shipped

    if scene is None and name is None and naming == "structured" and folder is None:
        return shipped.unit()
    from fivebar import own_unit
    from fivebar.scene import read

    known = None if scene is None else read(scene)
    return own_unit.write_unit(Path("" if folder is None else folder), known, name, naming=naming).file


def scenes() -> dict[str, str]:
    """The shipped scenes.

    Returns
    -------
    dict of str to str
        The description of each scene by its name.

    Examples
    --------
    >>> import fivebar
    >>> fivebar.scenes()["fall_90_120"]
    'Free fall from an asymmetric start, ...'
    """
    from fivebar import shipped

    return shipped.descriptions()


def run(
    scene: "str | Path | Mapping[str, Any] | Scene",
    method: str | None = None,
    stop_time: float | None = None,
    step_size: float | None = None,
    outputs: "str | Iterable[str] | None" = None,
    inputs: "Inputs | None" = None,
    on_failure: "OnFailure" = "raise",
    **values: Any,
) -> "Result":
    """Runs a scene and returns the computed variables at every communication point.

    Parameters
    ----------
    scene
        The name of a shipped scene, a file that ends in .json, the content of such a file as a dict, or a `fivebar.Scene`.
    method
        An item of `solver.method` instead of the scene's.
    stop_time, step_size
        Stop time and time between communication points, s, instead of the scene's.
    outputs
        Columns of the tables by names or prefixes, such as `("tip", "energy.error")`. The default is all, and reading all takes several
        times as long as the steps.
    inputs
        Time-varying inputs, constant during each step: a dict from name to a number, values at the communication points, or a pair (times,
        values) for linear interpolation; a pandas frame with a column or index `time`; or a function of time that returns a dict. An array
        without its index, such as `tau`, has a number for each element, or rows of them.
    on_failure
        `"raise"`: a failed step raises `StepFailed`, and its `result` has the run up to the failure. `"return"`: the incomplete result is
        returned, and its `failure` has the reason.
    **values
        Start values by variable, in the variable's unit, enumerations by the names of their items, arrays without their index as a sequence.

    Returns
    -------
    Result
        Columns by name, shape (n,), one row for each communication point.

    Raises
    ------
    FiveBarError
        If the scene, the method, an input or a value is refused: a ValueError with one sentence. `StepFailed` is a subclass.

    Examples
    --------
    >>> import fivebar
    >>> heavy = fivebar.run("swing", stop_time=0.5, **{"link[1].mass": 0.02, "viscous.enabled": True})
    >>> heavy.own.parameters["link[1].mass"], float(heavy.time[-1])
    (0.02, 0.5)
    >>> pushed = fivebar.run("flat_table", stop_time=1, inputs={"tau[2]": ([0, 1], [0, 0.01])})
    >>> float(pushed["tau[2]"][500])
    0.005
    """
    from fivebar import scene as scenes
    from fivebar import simulate

    ready = scenes.read(scene).replace(values, method=method, stop_time=stop_time, step_size=step_size, inputs=inputs)
    return simulate.run(ready, outputs=() if outputs is None else outputs, on_failure=on_failure)


def run_many(
    scene: "Given | Iterable[Given]",
    values: "Sequence[Mapping[str, Any]] | Any | None" = None,
    *,
    method: str | None = None,
    stop_time: float | None = None,
    step_size: float | None = None,
    outputs: "str | Iterable[str] | None" = None,
    inputs: "Inputs | None" = None,
    on_failure: "OnFailure" = "raise",
    reduce: "Reduce | None" = None,
    processes: int | None = None,
    progress: bool = True,
) -> list[Any]:
    """Runs a scene with many start values, or many scenes, on the processors of this machine, and returns a list of results in their order.

    A script must call it below `if __name__ == "__main__":`, because each process imports the script.

    Parameters
    ----------
    scene
        A scene as `run` takes it, or a list of scenes.
    values
        A dict of start values for each run, or a frame of pandas with a row for each run; with a list of scenes, one for each scene.
    method, stop_time, step_size, outputs, inputs
        As for `run`, the same for all runs. Set different inputs in the scenes: `scene.replace(inputs=...)`.
    on_failure
        `"raise"`: the first failed run ends all, with its `StepFailed` or the FiveBarError of a refused start. `"return"`: the list has this
        error in place of the result.
    reduce
        A function of a result, called in the process of the run; the list has its return values. Processes import it by name, so a lambda or
        a nested function needs `processes=1`.
    processes
        Number of processes. The default is the number of processors; with 1 all runs are in this process.
    progress
        Whether to show the number of finished runs on standard error.

    Returns
    -------
    list of Result
        One result for each run, or the return value of `reduce`, or with `on_failure="return"` the error of a failed run.

    Raises
    ------
    FiveBarError
        If a scene, a value or an argument is refused; `StepFailed` if a run ends early.

    Examples
    --------
    >>> import fivebar
    >>> masses = [{"link[1].mass": mass} for mass in (0.01, 0.02)]
    >>> light, heavy = fivebar.run_many("swing", masses, stop_time=0.1, processes=1, progress=False)
    >>> heavy.own.parameters["link[1].mass"]
    0.02
    """
    from fivebar import many

    changes = {"method": method, "stop_time": stop_time, "step_size": step_size, "inputs": inputs}
    return many.run_many(
        scene, values, changes, () if outputs is None else outputs, reduce, on_failure, processes, progress
    )


def calibrate(
    record: "str | Path | Mapping[str, Any] | Any",
    scene: "str | Path | Mapping[str, Any] | Scene | None" = None,
    parameters: "Sequence[str]" = (),
    *,
    begin: float = 0.0,
    seconds: float = 10.0,
    longest: float = 10.0,
    commands: "Between" = "rate",
    patience: float = 120.0,
    unit: str = "",
    fmu: str | Path | None = None,
) -> "Calibration":
    """Finds masses, friction, lengths and offsets of a machine from a record, each with an error bar; docs/calibration.md describes how.

    Needs the packages of the extra `calibrate`.

    Parameters
    ----------
    record
        A record of the twin or a table as a file, or columns as a dict, a `Result` or a frame of pandas: `time` (s, dates or
        durations), `measured.theta[1]` and `measured.theta[2]` (or `theta[1]` and `theta[2]`), rad, and the commands of the drives, such as
        `servo.theta[1]` and `tau[1]`.
    scene
        The assumed machine: a scene as `run` takes it. The default is the scene of a record of the twin, or else the unit's start values.
    parameters
        Names of the unknowns, or groups such as `link[1,4].mass`. The default is the usual unknowns.
    begin, seconds
        Used part of the record: begin, s after its first sample, and length, s; `math.inf` for all.
    longest
        Series longer than this, s, are cut.
    commands
        Commands of the drives between samples: `"rate"` (extrapolated by the rate), `"linear"` or `"hold"` (constant, as the inputs of `run`).
    patience
        CPU time, s, after which the fit is abandoned.
    unit
        Name of the machine, if a record of the twin has several.
    fmu
        Another unit than the shipped one.

    Returns
    -------
    Calibration
        `values`, `bars`, `units`, `correlations`, `not_identified` and `warning`; `summary()`, `pictures(folder)` and `scene()`, the calibrated
        machine. Unknowns that are not identified have no value. Steps of the fit go to the logger `fivebar` at level `INFO`.

    Raises
    ------
    FiveBarError
        If the record, the scene or a name is refused, or the fit is abandoned.

    Examples
    --------
    >>> import fivebar
    >>> run = fivebar.run("pick_and_place", stop_time=1.5, **{"payload.mass": 0.06})
    >>> found = fivebar.calibrate(run, "pick_and_place", ["payload.mass"], commands="hold")
    >>> round(found.values["payload.mass"], 5), found.bars["payload.mass"] < 1e-4, found.units["payload.mass"]
    (0.06, True, 'kg')
    >>> found.scene()["payload.mass"] == found.values["payload.mass"]
    True
    """
    from fivebar import arguments, extras

    extras.need("calibrate")
    from fivebar.twin.calibrate import calibration

    return calibration.calibrate(
        record,
        scene,
        parameters,
        begin=arguments.number("begin", begin),
        seconds=arguments.number("seconds", seconds),
        longest=arguments.number("longest", longest),
        commands=commands,
        patience=arguments.number("patience", patience),
        unit=unit,
        fmu=fmu,
    )
