"""Runs a scene through FMPy: `run`, and its `Result` with columns, units, pictures, page and tables."""

import re
import shutil
import tempfile
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fmpy
import numpy as np

from fivebar import scene as scenes
from fivebar import scene_file, shipped, singularities, summary, table
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.singularities import Event
from fivebar.slave import computed
from fivebar.variables import chosen, groups, of_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANIMATION = "animation.svg"
"""Name of the picture that moves."""

READ = (
    "tip.x", "tip.y", "theta", "passive.theta", "elbow", "energy", "singular", "solver", "servo.torque", "contact",
)  # fmt: skip
"""How the names begin of what summary, singularities, pictures and page are made from: all runs read these."""

SHOWN = ("tip.x", "tip.y", "theta[1]", "theta[2]", "omega[1]", "omega[2]")
"""Variables that `plot` shows if none is named."""


@dataclass(frozen=True)
class Result:
    """Result of a run: a column for what was asked for and for what pictures show, a row at each communication point.

    `result["tip.x"]` is a column, (n,); `result.units["tip.x"]` its unit; iteration, `len` and `in` are over the names of columns.
    """

    scene: Scene
    runs: list[Run]
    """The scene's own run, then those of its overlays, if they were asked for."""

    refused: list[str]
    """Why overlays did not start."""

    outputs: list[str]
    """Names of the columns that tables have; the first is `time`."""

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.own.columns:
            raise KeyError(f"{name}: there is no such column; `names` has all")
        return self.own[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.own.columns)

    def __len__(self) -> int:
        return len(self.own.columns)

    def __contains__(self, name: object) -> bool:
        return name in self.own.columns

    @property
    def own(self) -> Run:
        """The scene's own run, with its parameters, times of calls, and warnings of the unit."""
        return self.runs[0]

    @property
    def names(self) -> list[str]:
        """Names of all columns; the first is `time`."""
        return list(self.own.columns)

    @property
    def units(self) -> dict[str, str]:
        """Units by name, "1" where there is none."""
        return self.own.units

    @property
    def time(self) -> np.ndarray:
        """Communication points, s: (n,)."""
        return self.own.time

    @property
    def failure(self) -> str | None:
        """The unit's sentence if the run ended before its time."""
        return self.own.failure

    @cached_property
    def singularities(self) -> list[Event]:
        """The singularities that the run met."""
        return self._events[0]

    @cached_property
    def _events(self) -> list[list[Event]]:
        return [singularities.find(run) for run in self.runs]

    def summary(self) -> str:
        """Summary that the command prints: end of the tip, steps, times, errors, singularities."""
        blocks = ["\n".join([f"{self.scene.name}: {self.scene.description}", *summary.stop_note(self.scene)])]
        for i, run in enumerate(self.runs):
            values = next(variant.values for variant in self.scene.variants if variant.label == run.label)
            lines = [run.label, *summary.lines(run, self._events[i]), *summary.servo_note(run, values)]
            blocks.append("\n".join(lines + ([summary.difference(self.own, run)] if i > 0 else [])))
        return "\n\n".join(blocks + self.refused)

    def plot(self, *names: str) -> "Figure":
        """Columns over time, those of one unit in one picture; without names tip, motor angles and rates."""
        from fivebar import pictures

        shown = names or SHOWN
        for name in shown:
            if name not in self.own.columns:
                raise FiveBarError(f"there is no column {name!r}; `names` has all")
        return pictures.curves(self.own, shown)

    def animate(self, file: str | Path | None = None) -> Path:
        """Writes a page that animates the mechanism in any browser; without a file into the temporary folder, and opens it."""
        from fivebar import animated_page

        path = Path(tempfile.mkdtemp(prefix="fivebar-")) / f"{self.scene.name}.html" if file is None else Path(file)
        animated_page.write(path, self.scene, self.runs, self.singularities)
        if file is None:
            webbrowser.open(path.as_uri())
        return path

    def to_csv(self, file: str | Path) -> Path:
        """Writes the columns `outputs`, one row per communication point, in full precision; `units` has their units."""
        self._write(Path(file), self.own)
        return Path(file)

    def _write(self, file: Path, run: Run) -> None:
        table.write_columns(file, {name: run[name] for name in self.outputs})

    def columns(self) -> str:
        """Sentence about the columns of the table: how their names begin, which are inputs."""
        inputs = [name for name in self.outputs if name in self.scene.signals]
        computed = groups(name for name in self.outputs[1:] if name not in inputs)
        parts = ["time", *(f"{group} ({count})" for group, count in computed.items())]
        return f"Columns: {', '.join(parts)}" + (f"; inputs: {', '.join(inputs)}" if inputs else "")

    def save(
        self,
        folder: str | Path,
        draw: bool = True,
        show: bool = False,
        progress: Callable[[str], None] = lambda _text: None,
    ) -> list[Path]:
        """Writes page, tables and, if told to draw, pictures to a folder, and removes what an earlier run of the scene has left there.

        The page is first, for the others take longer; `show` opens it in the browser as soon as it is there. Returns the files written; each
        is named to `progress` before.
        """
        from fivebar import moving_picture, pictures

        out, name = Path(folder), self.scene.name
        out.mkdir(parents=True, exist_ok=True)
        _remove_earlier(out, name)
        files: list[Path] = []

        def begin(file: str) -> Path:
            progress(f"{name}: writing {file}")
            files.append(out / file)
            return files[-1]

        page = self.animate(begin(f"{name}.html"))
        if show:
            webbrowser.open(page.resolve().as_uri())
        for i, run in enumerate(self.runs):
            self._write(begin(f"{name}.csv" if i == 0 else f"{name}.{_slug(run.label)}.csv"), run)
        singularities.write(begin("singularities.csv"), self.singularities)
        if draw:
            pictures.draw_all(begin, self.scene, self.runs, self.singularities)
            if moving_picture.wanted(self.own):
                moving_picture.write(begin(ANIMATION), self.scene, self.own, self.singularities)
        return files


def run(
    scene: str | Path | Scene,
    method: str | None = None,
    values: Mapping[str, Any] | None = None,
    fmu: Path | None = None,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: Iterable[str] = (),
) -> Result:
    """Runs a scene, by another method or with other start values if they are given; `progress` makes a line for a label and a stop time, s.

    `outputs` are the columns of the tables, by their names or how these begin; without them there are all.
    Raises FiveBarError if the scene, the method, a value or an output is refused.
    """
    unit = shipped.unit() if fmu is None else fmu
    variables = of_unit(unit)
    for name in values or {}:
        if name.replace("_", "").lower() in (key.lower() for key in scene_file.SECONDS):
            raise FiveBarError(
                f"{name!r} is no variable: stopTime and stepSize, s, stand in the key 'experiment' of a scene's file"
            )
    ready = scene if isinstance(scene, Scene) else scenes.read(scene, variables)
    given = dict(values or {}) | ({} if method is None else {"solver.method": method})
    if given:
        ready = ready.changed(given, variables)
    directory = fmpy.extract(str(unit))
    runs: list[Run] = []
    refused = []
    try:
        model = fmpy.read_model_description(directory, validate=False)
        known = ["time", *(v.name for v in computed(model)), *ready.signals]
        wanted = [outputs] if isinstance(outputs, str) else list(outputs)
        written = {"time", *chosen(wanted, known)} if wanted else set(known)
        read = written.union(chosen(READ, known))
        for variant in ready.variants if overlays else ready.variants[:1]:
            line = progress(f"{ready.name} ({variant.label})", ready.stop_time) if progress else None
            try:
                runs.append(drive(model, directory, ready, variant, line, read))
            except StartRefused as sentence:
                if not runs:
                    raise
                refused.append(f"{variant.label} did not start: {sentence}")
    finally:
        shutil.rmtree(directory, ignore_errors=True)
    return Result(ready, runs, refused, [name for name in runs[0].columns if name in written])


def _remove_earlier(out: Path, name: str) -> None:
    """Removes the files that an earlier run of the scene `name` wrote to `out`, and nothing else."""
    from fivebar import pictures

    own_table = re.compile(re.escape(name) + r"(\.[a-z0-9-]*)?\.csv")
    fixed = {"singularities.csv", f"{name}.html", ANIMATION, *pictures.FILES}
    for file in out.iterdir():
        if file.is_file() and (file.name in fixed or own_table.fullmatch(file.name)):
            file.unlink()


def _slug(label: str) -> str:
    """`label` as a part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-")
