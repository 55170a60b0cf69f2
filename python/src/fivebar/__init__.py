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
    from fivebar.variables import Value

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

# The packages that compute and draw are loaded by what needs them: the command line answers at once.
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
"""Modules of the names that are loaded when they are asked for."""


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
    """The path of the shipped .fmu, for any FMI 2.0 master; in a checkout that which `cargo xtask package` has packed.

    With an argument it is the path of a unit that is written for it.

    Parameters
    ----------
    scene
        Start values, experiment and description of the unit: a scene as `run` takes it.
    name
        Name of the unit; unless given FiveBar, or that of the scene in CamelCase.
    naming
        `"flat"` for masters that make buses of `tip.x` and `tau[1]`.
    folder
        Where it is written, the current folder unless given.

    Returns
    -------
    pathlib.Path
        The .fmu.

    Raises
    ------
    FiveBarError
        If there is none, or what is given is refused.

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
    **values: "Value | str",
) -> "Result":
    """Runs a scene and returns what the unit computes at every communication point.

    Parameters
    ----------
    scene
        The name of a shipped scene, a file that ends in .json, the content of such a file as a dict, or a `fivebar.Scene`.
    method
        An item of `solver.method` in the place of the scene's own.
    stop_time, step_size
        How long the scene is followed, and from one communication point to the next, s; the scene's own unless given.
    outputs
        Columns of the tables, by names or how these begin, such as `("tip", "energy.error")`; all unless given. To read all takes several
        times as long as the steps.
    inputs
        Inputs that change, each held over the step that follows: a dict of name and number, values at the communication points, or a pair
        (times, values) that straight lines join; a frame of pandas with a column or index `time`; or a function of time that returns a dict.
    on_failure
        `"raise"`: a step that fails raises `StepFailed`, whose `result` is that of the run up to then. `"return"`: this short result is
        returned, and its `failure` says why.
    **values
        Start values by variable, in the variable's unit, enumerations by the names of their items.

    Returns
    -------
    Result
        Columns by name, shape (n,), one row for each communication point.

    Raises
    ------
    FiveBarError
        A ValueError of one sentence, if the scene, the method, an input or a value is refused; `StepFailed` is one.

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
    values: "Sequence[Mapping[str, Any]] | None" = None,
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

    A script calls it below `if __name__ == "__main__":`, for each process imports the script.

    Parameters
    ----------
    scene
        A scene as `run` takes it, or a list of scenes.
    values
        A dict of start values for each run; with a list of scenes as many.
    method, stop_time, step_size, outputs, inputs
        As for `run`, the same for all runs. Inputs that differ go into the scenes: `scene.replace(inputs=...)`.
    on_failure
        `"raise"`: the first run that fails ends all, with its `StepFailed` or the FiveBarError of a start that is refused. `"return"`: the list has this
        error in the place of the result.
    reduce
        A function called with each result in the process that has it; the list has what it returns. Processes import it by its name: a lambda, or a
        function inside another one, needs `processes=1`.
    processes
        How many processes, as many as there are processors unless given; with 1 all runs are in this process.
    progress
        Whether a line on standard error says how many runs are done.

    Returns
    -------
    list of Result
        One result for each run; or what `reduce` returns, or with `on_failure="return"` the error of a run that failed.

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
        A record of the twin or a table as a file, or columns as a dict, a `Result` or a frame of pandas: `time`, s, `measured.theta[1]` and
        `measured.theta[2]` (or `theta[1]` and `theta[2]`), rad, and the commands of the drives, such as `servo.theta[1]` and `tau[1]`.
    scene
        What the machine is taken for before, as `run` takes it; the scene of a record of the twin, or else the unit's own values, unless given.
    parameters
        Names of what is sought, groups as `link[1,4].mass`; what is usual unless given.
    begin, seconds
        Part of the record that is used, s, from its first sample on.
    longest
        Series longer than this, s, are cut.
    commands
        What drives do between samples: `"rate"`, `"linear"` or `"hold"`, as for the inputs of `run`.
    patience
        Seconds of CPU after which the fit is given up.
    unit
        Which machine, if a record of the twin has several.
    fmu
        Another unit than the shipped one.

    Returns
    -------
    Calibration
        `values`, `bars`, `units`, `correlations`, `not_identified` and `warning`; `summary()`, `pictures(folder)` and `scene()`, the calibrated
        machine. What the record does not tell has no value. Steps of the fit go to the logger `fivebar` at level `INFO`.

    Raises
    ------
    FiveBarError
        If the record, the scene or a name is refused, or the fit is given up.

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
