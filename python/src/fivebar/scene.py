"""Scenes: start values by name, time-varying inputs, overlays to compare with. docs/scenes.md describes the files of scenes/.

This module reads, checks and resolves a file, using names, types, bounds and start values of the unit's model description.
"""

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar import arguments, links, scene_file, shipped, tip_scenes
from fivebar.errors import FiveBarError, warn
from fivebar.inputs import Inputs, sampled
from fivebar.kinematics import Working
from fivebar.signals import STEPS, TIP, Signal, written
from fivebar.variables import Value, Values, Variable, Variables, meant, of_unit, shown

METHOD, ADAPTIVE = "solver.method", "solver.adaptive"

MOST_POINTS = 1_000_000
"""Largest number of communication points of a run: each has a row of some 150 numbers."""


@dataclass(frozen=True)
class Variant:
    """One run of a scene: a label for the pictures and the start values (enumerations as integers)."""

    label: str
    values: Values


@dataclass(frozen=True)
class Scene:
    """A scene: start values, time-varying inputs, and overlays to compare with.

    `variants[0]` is the scene itself, the others are its overlays. `signals` has the values of time-varying inputs by name at the
    communication points: (n,), in the unit of the variable.

    Examples
    --------
    >>> from fivebar import Scene
    >>> scene = Scene.read("pick_and_place")
    >>> scene.stop_time, scene["payload.mass"], sorted(scene.signals)[0]
    (1.6, 0.05, 'servo.omega[1]')
    """

    name: str
    description: str
    stop_time: float
    """Stop time, s."""

    step_size: float
    """Communication step, s."""

    variants: list[Variant]
    signals: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    variables: Variables = field(default_factory=of_unit, repr=False, compare=False)
    """Variables of the scene's unit."""

    offsets: Mapping[str, float] = field(default_factory=dict)
    """Encoder offsets that are not 0, rad, by key. The unit does not know them; the source of its samples applies them."""

    tip: tip_scenes.Tip | None = field(default=None, repr=False)
    """Part of the scene's file in the tip's coordinates."""

    assumed: Mapping[str, str] = field(default_factory=dict, repr=False, compare=False)
    """Notes on assumed settings: `stop time`, `method`."""

    knots: Mapping[str, Signal] = field(default_factory=dict, repr=False, compare=False)
    """Signals of the scene's file by name, for sampling at other communication points."""

    @property
    def start(self) -> Mapping[str, Value]:
        """The unit's start values."""
        return self.variables.start

    @classmethod
    def read(cls, given: "str | Path | Mapping[str, Any] | Scene") -> "Scene":
        """Reads a scene.

        Parameters
        ----------
        given : str, pathlib.Path, mapping or Scene
            The name of a shipped scene, the file of a scene, or the content of such a file.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        FiveBarError
            If there is no such scene, or it is refused.

        Examples
        --------
        >>> from fivebar import Scene
        >>> Scene.read("swing").replace({"link[1].mass": 0.02})["link[1].mass"]
        0.02
        """
        return read(given)

    @property
    def values(self) -> Values:
        """Start values of the scene's own run that differ from the unit's."""
        return self.variants[0].values

    def __getitem__(self, name: str) -> Any:
        """The scene's value of a variable, or else the unit's start value.

        An enumeration is the name of its item; an array by its name without index has the shape (n,).

        Raises FiveBarError if the unit has no such start value.
        """
        if name in self.variables.arrays:
            return np.array([self[variable.name] for variable in self.variables.arrays[name]])
        variable = self.variables.settable(name)
        return variable.given(self.values.get(name, self.start[name]))

    @property
    def time(self) -> NDArray[np.float64]:
        """Communication points, s: (n,), 0, H, 2H, ... and the stop time."""
        return communication_points(self.stop_time, self.step_size)

    def coarser(self, step_size: float, stop_time: float = math.inf) -> "Scene":
        """The scene with longer communication steps: the smallest multiple of its own step that is at least `step_size`.

        Parameters
        ----------
        step_size : float
            Least length of a step, s.
        stop_time : float, optional
            Stop time, s, if earlier than the scene's.

        Returns
        -------
        Scene
            The scene.

        Raises
        ------
        FiveBarError
            If a time is not positive.

        Examples
        --------
        >>> from fivebar import Scene
        >>> Scene.read("swing").coarser(0.01).step_size
        0.01
        """
        step_size, stop_time = scene_file.seconds("step_size", step_size), scene_file.seconds("stop_time", stop_time)
        stride = max(1, math.ceil(step_size / self.step_size - 1e-9))
        short = replace(self, stop_time=min(self.stop_time, stop_time), step_size=stride * self.step_size)
        rows = stride * np.arange(len(short.time))
        return replace(
            short, signals={name: values[np.minimum(rows, len(values) - 1)] for name, values in self.signals.items()}
        )

    def replace(
        self,
        values: Mapping[str, Any] | None = None,
        /,
        *,
        method: str | None = None,
        stop_time: float | None = None,
        step_size: float | None = None,
        inputs: Inputs | None = None,
        name: str | None = None,
        description: str | None = None,
        **more: Any,
    ) -> "Scene":
        """The scene with another method, stop time, step, inputs, name, description or start values, all checked as in a file.

        Parameters
        ----------
        values, **more
            Start values by the variable's name, as a dict or as `**{"link[1].mass": 0.02}`; enumerations by the names of their items, arrays
            without their index as a sequence. Overlays keep their own changes.
        method
            An item of `solver.method`.
        stop_time, step_size
            Stop time and communication step, s.
        inputs
            Inputs as for `fivebar.run`; they replace the scene's signals and values of these inputs.
        name, description
            Name and description in summary, page and files.

        Returns
        -------
        Scene
            The changed scene; this one is unchanged.

        Raises
        ------
        FiveBarError
            If a name or value is refused.

        Warns
        -----
        MachineWarning
            If a value is hardly meant: an impossible link, degrees, millimetres, milliseconds, or a parameter of an effect that is off.

        Examples
        --------
        >>> from fivebar.scene import read
        >>> short = read("swing").replace({"link[1].mass": 0.02}, stop_time=0.5, inputs={"tau[1]": 0.01})
        >>> short["link[1].mass"], short.stop_time, short.signals["tau[1]"][:2].tolist()
        (0.02, 0.5, [0.01, 0.01])
        """
        given = {**({} if values is None else arguments.values("values", values)), **more}
        given |= {} if method is None else {METHOD: method}
        given = self.variables.flat(given)
        changed = self._changed(given, stop_time, step_size, inputs, name, description)
        warn_of(self.name, self.variables, [run.values for run in changed.variants], self.values, given)
        return changed

    def _changed(
        self,
        given: Mapping[str, Any],
        stop_time: float | None = None,
        step_size: float | None = None,
        inputs: Inputs | None = None,
        name: str | None = None,
        description: str | None = None,
    ) -> "Scene":
        """The scene as by `replace`, with start values by the names of variables, without warnings."""
        new = {each: scene_file.settable(each, self.variables).value(value) for each, value in given.items()}
        stop = self.stop_time if stop_time is None else scene_file.seconds("stop_time", stop_time)
        step = self.step_size if step_size is None else scene_file.seconds("step_size", step_size)
        points = communication_points(stop, step)
        moved = sampled(inputs, points, self.variables)
        before = self._unplaced(self.values)
        own = {each: value for each, value in before.items() if each not in moved} | new
        runs = [(scene_file.method(own, self.variables), own)]
        for overlay in self.variants[1:]:
            kept = {each: value for each, value in self._unplaced(overlay.values).items() if before.get(each) != value}
            runs.append((overlay.label, own | {each: value for each, value in kept.items() if each not in moved}))
        scene_file.check_labels([label for label, _ in runs])
        variants, commands = _resolved(runs, self.tip, self.start, points)
        kept_signals = [each for each in self.signals if each not in moved and each not in commands]
        signals = commands | moved | {each: self._signal(each, points) for each in kept_signals}
        scene_file.check_signals([each for _, each in runs], signals)
        return replace(
            self,
            name=self.name if name is None else scene_file.name(name),
            description=self.description if description is None else scene_file.described(description),
            stop_time=stop,
            step_size=step,
            variants=variants,
            signals=signals,
            # Given references of the servos replace the tip's signals; references that are not given stay as they are.
            tip=self.tip.without_signals() if self.tip and moved.keys() & {*self.tip.follows} else self.tip,
            knots={each: signal for each, signal in self.knots.items() if each not in moved},
            assumed={
                what: note
                for what, note in self.assumed.items()
                if not (what == "stop time" and stop_time is not None or what == "method" and METHOD in new)
            },
        )

    def with_method(self) -> "Scene":
        """The scene with the method `automatic`, unless it chooses another one.

        A scene chooses a method by its name, by `solver.adaptive` (which only `i3alp` reads), or by an overlay with the method `automatic`; a
        unit of one's own chooses it by its start value.

        Returns
        -------
        Scene
            The scene.

        Examples
        --------
        >>> from fivebar import Scene
        >>> Scene.read("swing").with_method().assumed["method"]
        "automatic: it has no 'solver.method'"
        """
        asks = METHOD in self.values or any(ADAPTIVE in run.values or run.label == "automatic" for run in self.variants)
        if asks or self.start[METHOD] != self.variables[METHOD].items["i3alp"]:
            return self
        note = f"automatic: it has no '{METHOD}'"
        return replace(self.replace(method="automatic"), assumed={**self.assumed, "method": note})

    def _signal(self, name: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """A signal at other communication points; without knots it is constant between samples. Refuses points after the last sample."""
        if np.array_equal(points, self.time):
            return self.signals[name]
        if name in self.knots:
            return np.array([self.knots[name].at(time) for time in points.tolist()])
        known = self.signals[name]
        if points[-1] > self.stop_time * (1 + 1e-9) and np.any(known != known[0]):
            raise FiveBarError(
                f"the input '{name}' is known up to {self.stop_time:g} s: a run of {points[-1]:g} s needs `inputs` again"
            )
        rows = np.searchsorted(self.time, points + 1e-9 * self.step_size, side="right") - 1
        return known[rows]

    def _unplaced(self, values: Values) -> Values:
        """The values of a run without initial angles that follow from the tip's place."""
        if self.tip is None:
            return values
        free = {name: value for name, value in values.items() if name not in tip_scenes.START}
        return free if self.tip.placed(free, self.start) == values else values

    def write(self, file: str | Path) -> Path:
        """Writes the scene as a file, which `fivebar run`, `fivebar unit --scene` and `Scene.read` take.

        Inputs given in Python are written as steps, one for each change of the value.

        Parameters
        ----------
        file : str or pathlib.Path
            The file; it ends in .json, and its name is the scene's name when it is read.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        FiveBarError
            If the file does not end in .json, or a file cannot have the scene: it would be too large, a number is infinite, or initial angles
            are given although the tip's place at the start is needed for a coordinate without signal.

        Examples
        --------
        >>> from fivebar import Scene
        >>> file = Scene.read("swing").replace(**{"link[1].mass": 0.02}).write("heavy.json")
        >>> Scene.read(file)["link[1].mass"]
        0.02
        """
        if (path := Path(file)).suffix != ".json":
            raise FiveBarError(f"'file' must end in .json, not {shown(str(file))}")
        write_content(path, self._content())
        return path

    def _content(self) -> dict[str, Any]:
        """The content of the scene's file."""
        own, *others = (self._unplaced(variant.values) for variant in self.variants)
        tip = self.tip
        if tip is not None and (kept := [name for name in tip_scenes.START if name in own]):
            tip = tip.without_start(kept[0])
            others = [variant.values for variant in self.variants[1:]]
        found: dict[str, Any] = {
            scene_file.DESCRIPTION: self.description,
            scene_file.EXPERIMENT: {"stopTime": self.stop_time, "stepSize": self.step_size},
            **self._written(own),
            **self.offsets,
            **(tip.content() if tip else {}),
        }
        signals = written({**self.knots, **(tip.signals if tip else {})})
        follows = tip.follows if tip else ()
        for name, values in self.signals.items():
            if name not in signals and name not in follows:
                rows = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values) - 1]
                signals[name] = {STEPS: [[float(self.time[row]), float(values[row])] for row in dict.fromkeys(rows)]}
        if signals:
            found[scene_file.SIGNALS] = signals
        if others:
            changes = ({name: value for name, value in run.items() if own.get(name) != value} for run in others)
            found[scene_file.OVERLAY] = [
                {scene_file.LABEL: variant.label, **self._written(run)}
                for variant, run in zip(self.variants[1:], changes, strict=True)
            ]
        return found

    def _written(self, values: Values) -> dict[str, Value | str]:
        """Values as in a file."""
        return {name: self.variables[name].given(value) for name, value in values.items()}

    def resolved(self) -> dict[str, Any]:
        """The completely resolved scene, as values for JSON.

        Returns
        -------
        dict
            `name`, `description`, `stopTime`, `stepSize`, `variants` with values for calls, and `signals` at every communication point.

        Examples
        --------
        >>> from fivebar import Scene
        >>> list(Scene.read("swing").resolved())
        ['name', 'description', 'stopTime', 'stepSize', 'variants', 'signals']
        """
        return {
            "name": self.name,
            "description": self.description,
            "stopTime": self.stop_time,
            "stepSize": self.step_size,
            "variants": [{"label": variant.label, "values": variant.values} for variant in self.variants],
            "signals": {name: values.tolist() for name, values in self.signals.items()},
        }


def communication_points(stop_time: float, step_size: float) -> NDArray[np.float64]:
    """Communication points 0, H, 2H, ... and the stop time, s: (n,); a remainder within rounding does not add a step."""
    steps = stop_time / step_size - 1e-9
    if not steps < MOST_POINTS:
        raise FiveBarError(
            f"{stop_time} s in steps of {step_size} s are too many: up to {MOST_POINTS} communication points are allowed"
        )
    points: NDArray[np.float64] = step_size * np.arange(max(1, math.ceil(steps)) + 1, dtype=np.float64)
    points[-1] = stop_time
    return points


def read(given: "str | Path | Mapping[str, Any] | Scene", variables: Variables | None = None) -> Scene:
    """A scene for a unit with the variables `known`, from the name of a shipped scene, a file that ends in .json, or the content of such a
    file, possibly without description and with arrays by their names without index. A `Scene` is returned as it is.
    """
    if isinstance(given, Scene):
        return given
    if isinstance(given, Mapping):
        variables = variables or of_unit()
        content = {scene_file.DESCRIPTION: "A scene given in Python."} | variables.flat(given)
        if isinstance(runs := content.get(scene_file.OVERLAY), list):
            content[scene_file.OVERLAY] = [variables.flat(run) if isinstance(run, Mapping) else run for run in runs]
        return parse("scene", json.dumps(content, default=_plain), variables)
    return of_file(found(given), variables)


def _plain(given: Any) -> Any:
    """Converts numbers of NumPy for JSON."""
    if not isinstance(given, (np.generic, np.ndarray)):
        raise FiveBarError(f"a scene has numbers, texts, lists and dicts, not {shown(given)}")
    return given.tolist()


def found(name: str | Path) -> Path:
    """The file of a scene."""
    if not isinstance(name, (str, Path)):
        raise FiveBarError(
            f"a scene is a name, a file that ends in .json, the content of one as a dict, or a fivebar.Scene, not {shown(name)}"
        )
    path = Path(name)
    if path.suffix == ".json":
        return path
    files = shipped.scene_files()
    if str(name) not in files:
        others = f"; there are {', '.join(files)}, and files that end in .json"
        raise FiveBarError(f"there is no scene {str(name)!r:.80}{_meant(path) or others}")
    return files[str(name)]


def _meant(path: Path) -> str:
    """The end of a sentence about an unknown scene: similar names of shipped scenes and of files in its folder."""
    beside = {file.stem: str(file) for file in sorted(path.parent.glob("*.json"))}
    return meant(path.stem, beside | {name: name for name in shipped.scene_files()})


def of_file(file: Path, variables: Variables | None = None) -> Scene:
    """The scene in a file; the file's name is the scene's name."""
    try:
        if not file.stem.strip(". "):
            raise FiveBarError("a scene has the name of its file, which must not consist of dots only")
        return parse(file.stem, scene_file.text(file), variables)
    except FiveBarError as error:
        raise FiveBarError(f"{file}: {error}{'' if file.exists() else _meant(file)}") from None


def parse(name: str, text: str, variables: Variables | None = None) -> Scene:
    """A scene from the text of its file; warns with MachineWarning if a value is hardly meant."""
    variables = variables or of_unit()
    content = scene_file.Content(scene_file.parse(text), variables)
    courses, points = {}, np.zeros(0)
    if content.signals:
        points = communication_points(content.stop_time, content.step_size)
        own = [signal for signal in content.signals if signal.variable.name not in TIP]
        courses = {signal.variable.name: np.array([signal.at(time) for time in points.tolist()]) for signal in own}
    runs = [(scene_file.method(content.values, variables), content.values), *content.overlays]
    variants, commands = _resolved(runs, content.tip, variables.start, points)
    warn_of(name, variables, [content.values])
    return Scene(
        name=name,
        description=content.description,
        stop_time=content.stop_time,
        step_size=content.step_size,
        variants=variants,
        signals=courses | commands,
        variables=variables,
        offsets={name: offset for name, offset in content.offsets.items() if offset != 0.0},
        tip=content.tip,
        assumed=content.assumed,
        knots={signal.variable.name: signal for signal in content.signals if signal.variable.name not in TIP},
    )


def warn_of(
    name: str,
    variables: Variables,
    runs: Sequence[Values],
    before: Values | None = None,
    given: Collection[str] = (),
) -> None:
    """Gives MachineWarnings about the values of a scene, of which `runs[0]` is its own run.

    With `before` only about what has changed since. An effect whose switch is among the `given` names is off on purpose.
    """
    values = {**variables.start, **runs[0]}
    if before is None:
        sentences = _doubts(values)
    else:
        known = {**variables.start, **before}
        changed = [variables[each] for each, value in values.items() if value != known[each]]
        active = {
            effect for effect in variables.effects for run in runs if {**variables.start, **run}[f"{effect}.enabled"]
        }
        meant_off = {effect for effect in variables.effects if f"{effect}.enabled" in given}
        sentences = _idle(values, changed, variables.effects - active - meant_off)
        if any(each.type == "Real" for each in changed):
            sentences += [each for each in _doubts(values) if each not in _doubts(known)]
    for sentence in sentences:
        warn(f"{name}: {sentence}")


def _idle(values: Values, changed: Iterable[Variable], off: Collection[str]) -> list[str]:
    """A sentence for each effect that is `off` although a parameter of it has changed. The unit itself warns of its inputs."""
    found: dict[str, str] = {}
    for variable in changed:
        effect, value = variable.name.partition(".")[0], values[variable.name]
        if effect in off and variable.causality == "parameter" and variable.type != "Boolean":
            given = variable.given(value) if variable.type == "Enumeration" else f"{value:g}"
            found.setdefault(
                effect, f"{variable.name} is {given}, but no active effect reads it: {effect}.enabled is false"
            )
    return list(found.values())


def _doubts(values: Mapping[str, Value]) -> list[str]:
    return [*links.doubts(values), *links.mistaken_units(values)]


def _resolved(
    runs: list[tuple[str, Values]], tip: tip_scenes.Tip | None, unit: Mapping[str, Value], points: NDArray[np.float64]
) -> tuple[list[Variant], dict[str, NDArray[np.float64]]]:
    """For a scene in the tip's coordinates: runs with their starts, and references of the servos at communication points."""
    if tip is None:
        return [Variant(label, values) for label, values in runs], {}
    variants = [Variant(label, tip.placed(values, unit)) for label, values in runs]
    return variants, tip.commands(variants[0].values, unit, points)


def content(
    text: str,
    values: Mapping[str, Value],
    stop_time: float,
    step_size: float,
    variables: Variables,
    signals: Mapping[str, Any] | None = None,
    working: Working | None = None,
) -> dict[str, Any]:
    """Content of a scene's file, with every value that differs from the unit's start value.

    `text` is the description; the values include encoder offsets; `signals` are as in files; `working` is the working mode for signals of the tip.
    """
    found: dict[str, Any] = {"description": text, "experiment": {"stopTime": stop_time, "stepSize": step_size}}
    for name, value in values.items():
        if name in scene_file.OFFSETS:
            if value != 0.0:
                found[name] = value
            continue
        variable = variables.settable(name)
        if value != variable.start:
            found[name] = variable.given(value)
    if working is not None:
        found[tip_scenes.WORKING] = list(working)
    if signals:
        found["signals"] = signals
    return found


def write_content(file: Path, content: Mapping[str, Any]) -> None:
    """Writes a scene, given as the content of its file."""
    for run in (content, *content.get(scene_file.OVERLAY, ())):
        for name, value in run.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise FiveBarError(f"{file}: '{name}' is {value}, but a scene's file has finite numbers only")
    written = _lines(content)
    if len(written) > scene_file.LARGEST:
        raise FiveBarError(f"{file}: the scene would have {len(written)} bytes: up to {scene_file.LARGEST} are allowed")
    file.write_text(written, encoding="utf-8")


def _lines(content: Mapping[str, Any]) -> str:
    """JSON with a line for each key and each signal."""
    entries = []
    for key, value in content.items():
        text = json.dumps(value, ensure_ascii=False)
        if key == scene_file.SIGNALS:
            text = (
                "{\n    "
                + ",\n    ".join(f"{json.dumps(name)}: {json.dumps(signal)}" for name, signal in value.items())
                + "\n  }"
            )
        entries.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(entries) + "\n}\n"
