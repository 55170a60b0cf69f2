"""`Result` of a run: columns by name, with units, tables, pictures and page."""

import base64
import html
import os
import re
import tempfile
import webbrowser
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from fivebar import arguments, events, extras, singularities, summary, table
from fivebar.drive import Run
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.singularities import Event
from fivebar.variables import INDEX, chosen, groups, shown, similar

if TYPE_CHECKING:
    import pandas
    import xarray

    from fivebar.plot import Plot

ANIMATION = "animation.svg"
"""File name of the animated picture."""

SINGULARITIES = "singularities.csv"
"""File name of the table of singularities."""

WROTE = re.compile(r"^<!-- fivebar wrote (.+) -->$", re.MULTILINE)
"""Line at the end of a page for each other file of the run."""

LONGEST_LIST = 65_536
"""Maximum length of these lines, bytes."""

TITLE = re.compile(r"<title>.* · five-bar</title>")
"""Title of every page of a run."""

HEAD = 4096
"""The title is within so many first bytes of a page."""

READ = (
    "tip.x", "tip.y", "tip.v", "theta", "omega", "passive", "elbow", "energy", "singular", "solver", "servo.torque", "contact",
)  # fmt: skip
"""Prefixes of the variables for summary, events, pictures and page; every run reads them."""

SHOWN = ("tip.x", "tip.y", "theta[1]", "theta[2]", "omega[1]", "omega[2]")
"""Variables that `plot` shows by default."""


@dataclass(frozen=True, eq=False, repr=False)
class Result(dict[str, np.ndarray]):
    """Result of a run: a dictionary of columns with one row per communication point.

    It has the requested columns and the columns for pictures. `result["tip.x"]` is a column, shape (n,), and `result["theta"]` has the
    columns of an array, shape (n, 2); `pandas.DataFrame(result)` and `dict(result)` have all columns. A column of one's own, such as
    `result["tip.r"] = ...`, is in plots and tables too; `result.units["tip.r"] = "m"` gives its unit. Two results are equal only if they
    are the same object.

    Examples
    --------
    >>> import fivebar
    >>> fall = fivebar.run("end_stops", stop_time=0.5)
    >>> fall["tip.x"].shape, fall.units["tip.x"], fall.descriptions["tip.x"]
    ((501,), 'm', 'Position of the tip, x')
    >>> import pandas
    >>> float(pandas.DataFrame(fall)["time"].max())
    0.5
    """

    scene: Scene
    runs: list[Run]
    """The scene's own run, followed by the runs of its overlays if requested."""

    refused: list[str]
    """Sentences on overlays that did not start."""

    outputs: list[str]
    """Names of the columns in tables; the first is `time`."""

    def __post_init__(self) -> None:
        # A part or a copy of a result gets columns of its own.
        runs = [
            replace(run, columns=dict(run.columns), units=dict(run.units), descriptions=dict(run.descriptions))
            for run in self.runs
        ]
        object.__setattr__(self, "runs", runs)
        object.__setattr__(self, "outputs", list(self.outputs))
        super().update(self.own.columns)

    def __getitem__(self, name: str) -> np.ndarray:
        _check_name(name)
        return super().__getitem__(name)

    def __missing__(self, name: str) -> np.ndarray:
        if elements := [each for each in self if INDEX.sub("", each) == name]:
            return np.column_stack([self[each] for each in elements])
        raise KeyError(f"there is no column {name!r}{similar(name, self)}")

    def __setitem__(self, name: str, column: Any) -> None:
        _check_name(name)
        values = np.asarray(column)
        if values.shape != self.time.shape or values.dtype.kind not in "biuf":
            raise FiveBarError(
                f"the column {name!r} must have {len(self.time)} numbers, one for each communication point, not {shown(column)}"
            )
        super().__setitem__(name, values)
        self.own.columns[name] = values
        self.units.setdefault(name, "1")
        self.descriptions.setdefault(name, "")
        if name not in self.outputs:
            self.outputs.append(name)

    def update(self, *given: Any, **columns: Any) -> None:
        """Sets several columns of one's own.

        Parameters
        ----------
        *given, **columns
            Columns by name, as for a dictionary.

        Raises
        ------
        FiveBarError
            If a column does not have a number for each communication point.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1)
        >>> swing.update({"tip.r": (swing["tip.x"] ** 2 + swing["tip.y"] ** 2) ** 0.5})
        >>> swing.names[-1]
        'tip.r'
        """
        for name, column in dict(*given, **columns).items():
            self[name] = column

    def __ior__(self, columns: Any) -> Self:  # type: ignore[override,misc]  # columns may be lists
        self.update(columns)
        return self

    def setdefault(self, name: str, column: Any = None) -> np.ndarray:
        """A column; it is set if there is none.

        Parameters
        ----------
        name : str
            Name of the column.
        column : array-like
            A number for each communication point.

        Returns
        -------
        numpy.ndarray
            The column, (n,).

        Raises
        ------
        FiveBarError
            If a column is set and does not have a number for each communication point.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1)
        >>> swing.setdefault("load", swing["time"] * 0.0).shape
        (101,)
        """
        if name not in self:
            self[name] = column
        return self[name]

    def __reduce__(self) -> tuple[Any, ...]:
        return Result, (self.scene, self.runs, self.refused, self.outputs)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __ne__(self, other: object) -> bool:
        return self is not other

    def __hash__(self) -> int:  # type: ignore[override]  # a dictionary has none
        return id(self)

    def __repr__(self) -> str:
        end = f", ended early of {self.own.stop_time:g} s" if self.failure else ""
        return (
            f"<fivebar.Result of {self.scene.name} by {self.own.label}: {len(self)} columns at {len(self.time)} communication points, "
            f"{self.time[0]:g} to {self.time[-1]:g} s{end}>"
        )

    def _repr_html_(self) -> str:
        """Summary and path of the tip, for a notebook."""
        from fivebar import pictures

        picture = pictures.path(self.scene, self.runs, self.singularities)._repr_png_()
        return (
            f'<pre>{html.escape(self.summary())}</pre><img style="max-width:100%" alt="Poses, and the path of the tip" '
            f'src="data:image/png;base64,{base64.b64encode(picture).decode("ascii")}">'
        )

    @property
    def own(self) -> Run:
        """The scene's own run, with its parameters, call times and warnings of the unit."""
        return self.runs[0]

    @property
    def names(self) -> list[str]:
        """Names of all columns; the first is `time`."""
        return list(self.own.columns)

    @property
    def units(self) -> dict[str, str]:
        """Units by name; "1" if a column has no unit."""
        return self.own.units

    @property
    def descriptions(self) -> dict[str, str]:
        """Descriptions of the variables by name."""
        return self.own.descriptions

    @property
    def time(self) -> np.ndarray:
        """Communication points, s: (n,)."""
        return self.own.time

    @property
    def failure(self) -> str | None:
        """The unit's error message if the run ended early, otherwise None."""
        return self.own.failure

    @cached_property
    def singularities(self) -> list[Event]:
        """The singularities that the run met."""
        return self._events[0]

    @cached_property
    def _events(self) -> list[list[Event]]:
        return [singularities.find(run) for run in self.runs]

    @cached_property
    def events(self) -> list[events.Row]:
        """Table of events with `time`, `event` and `where`: singularities, stops, contact with the plane, stick and slip.

        Examples
        --------
        >>> import fivebar, pandas
        >>> fall = fivebar.run("end_stops", stop_time=0.35)
        >>> for row in fall.events:
        ...     print(f"{row.time:.3f} s: {row.event}, {row.where}")
        0.170 s: direct, crossed: distal links stretched
        0.339 s: stop reached, right motor, stop.upper[2]
        0.346 s: stop reached, left motor, stop.lower[1]
        >>> list(pandas.DataFrame(fall.events).columns)
        ['time', 'event', 'where']
        """
        return events.find(self.own, self.singularities)

    def between(self, begin: float, end: float) -> "Result":
        """The rows between two times, both included.

        Parameters
        ----------
        begin, end : float
            Times, s.

        Returns
        -------
        Result
            The part of the run.

        Raises
        ------
        FiveBarError
            If a time is no number, or there is no communication point between them.

        Examples
        --------
        >>> import fivebar
        >>> fivebar.run("swing", stop_time=0.5).between(0.1, 0.2).time[[0, -1]].tolist()
        [0.1, 0.2]
        """
        # Tolerance for round-off: times are multiples of the step, the arguments need not be.
        begin, end = arguments.number("begin", begin), arguments.number("end", end)
        margin = 1e-9 * self.own.step_size
        runs = []
        for run in self.runs:
            first, last = np.searchsorted(run.time, (begin - margin, end + margin))
            if last > first:
                runs.append(run.part(slice(int(first), int(last))))
            elif run is self.own:
                raise FiveBarError(
                    f"no communication point is between {begin:g} and {end:g} s: the run goes from {run.time[0]:g} to {run.time[-1]:g} s"
                )
        return replace(self, runs=runs)

    def summary(self) -> str:
        """The summary that the command prints.

        Returns
        -------
        str
            Tracking, torques and stops of the motors; final tip position, steps, times, errors and singularities.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> print(swing.summary())
        swing: ...
          tip at the end ...
        """
        blocks = ["\n".join([f"{self.scene.name}: {self.scene.description}", *summary.assumed(self.scene)])]
        for i, run in enumerate(self.runs):
            values = next(variant.values for variant in self.scene.variants if variant.label == run.label)
            lines = [
                run.label,
                *summary.motor_lines(run, {**self.scene.start, **values}, self.scene.tip),
                *summary.lines(run, self._events[i]),
                *summary.servo_note(run, values),
            ]
            blocks.append("\n".join(lines + ([summary.difference(self.own, run)] if i > 0 else [])))
        return "\n\n".join(blocks + self.refused)

    def plot(self, *names: str | Iterable[str]) -> "Plot":
        """Plots columns over time; columns with the same unit share axes.

        A notebook shows the figure. Elsewhere `result.plot().show()` opens a window, and `.savefig(file)` writes a file.

        Parameters
        ----------
        *names : str or iterable of str
            Columns by names or prefixes; the default are tip, motor angles and rates.

        Returns
        -------
        Plot
            The figure of matplotlib.

        Raises
        ------
        FiveBarError
            If there is no such column.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> figure = swing.plot("tip.x", "tip.y")
        >>> figure.savefig("tip.svg")
        """
        from fivebar import pictures

        given = [name for each in names or (SHOWN,) for name in arguments.names("names", each)]
        known = list(self)[1:]
        # Columns are shown in the given order.
        wanted = dict.fromkeys(column for name in given for column in chosen([name], known))
        return pictures.curves(self.own, list(wanted))

    def animate(self, file: str | Path | None = None) -> Path:
        """Writes a page that animates the mechanism in a browser.

        Parameters
        ----------
        file : str or pathlib.Path, optional
            The page. Without it, it is written to the temporary folder and opened.

        Returns
        -------
        pathlib.Path
            The page.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> swing.animate("swing.html").name
        'swing.html'
        """
        from fivebar import animated_page

        path = Path(tempfile.mkdtemp(prefix="fivebar-")) / f"{self.scene.name}.html" if file is None else Path(file)
        _, others = _origin(path)
        animated_page.write(path, self.scene, self.runs, self.singularities)
        _list(path, *others)
        if file is None:
            webbrowser.open(path.as_uri())
        return path

    def to_dataframe(self) -> "pandas.DataFrame":
        """The columns `outputs` as a frame. Needs pandas (extra `data`).

        Returns
        -------
        pandas.DataFrame
            The index is the time, s; `attrs` has `units` and `descriptions` by name.

        Raises
        ------
        FiveBarError
            If pandas is not installed.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> frame = swing.to_dataframe()
        >>> frame.shape, frame.index.name, frame.attrs["units"]["tip.x"]
        ((101, 2), 'time', 'm')
        """
        extras.need("data", "pandas")
        import pandas

        names = self.outputs[1:]
        frame = pandas.DataFrame(
            {name: self.own[name] for name in names}, index=pandas.Index(self.time, name=self.outputs[0])
        )
        frame.attrs["units"] = {name: self.units[name] for name in self.outputs}
        frame.attrs["descriptions"] = {name: self.descriptions[name] for name in self.outputs}
        return frame

    def to_xarray(self) -> "xarray.Dataset":
        """The columns `outputs` over time. Needs xarray (extra `data`).

        Returns
        -------
        xarray.Dataset
            Variables have attributes `units` and `description`; enumerations also CF flag attributes.

        Raises
        ------
        FiveBarError
            If xarray is not installed.

        Examples
        --------
        >>> import fivebar
        >>> data = fivebar.run("swing", stop_time=0.1).to_xarray()
        >>> data["tip.x"].attrs
        {'units': 'm', 'description': 'Position of the tip, x'}
        """
        extras.need("data", "xarray")
        import xarray

        time, *names = self.outputs
        return xarray.Dataset(
            {name: (time, self.own[name], self._attributes(name)) for name in names},
            coords={time: (time, self.time, self._attributes(time))},
            attrs={"title": self.scene.name, "description": self.scene.description},
        )

    def _attributes(self, name: str) -> dict[str, Any]:
        """Attributes of a variable. Units and items of enumerations follow the CF conventions (1.11, sections 3.1 and 3.5)."""
        items = self.own.items.get(name, {})
        flags = {"flag_values": list(items), "flag_meanings": " ".join(items.values())} if items else {}
        return {"units": self.units[name], "description": self.descriptions[name], **flags}

    def to_csv(self, file: str | Path) -> Path:
        """Writes the columns `outputs`, one row per communication point, in full precision. The units are in `units`.

        Parameters
        ----------
        file : str or pathlib.Path
            The table.

        Returns
        -------
        pathlib.Path
            The table.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> swing.to_csv("swing.csv").read_text().splitlines()[0]
        'time,tip.x,tip.y'
        """
        self._write(Path(file), self.own)
        return Path(file)

    def to_parquet(self, file: str | Path) -> Path:
        """Writes the columns `outputs`; each field has unit and description as metadata. Needs pyarrow (extra `data`).

        Parameters
        ----------
        file : str or pathlib.Path
            The table.

        Returns
        -------
        pathlib.Path
            The table.

        Raises
        ------
        FiveBarError
            If pyarrow is not installed.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> swing.to_parquet("swing.parquet").name
        'swing.parquet'
        """
        extras.need("data", "pyarrow")
        import pyarrow
        from pyarrow import parquet

        columns = [pyarrow.array(self.own[name]) for name in self.outputs]
        fields = [
            pyarrow.field(
                name, column.type, metadata={"unit": self.units[name], "description": self.descriptions[name]}
            )
            for name, column in zip(self.outputs, columns)
        ]
        parquet.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields)), file)
        return Path(file)

    def _write(self, file: Path, run: Run) -> None:
        table.write_columns(file, {name: run[name] for name in self.outputs if name in run.columns})

    def columns(self) -> str:
        """A sentence on the columns of the table.

        Returns
        -------
        str
            Number of columns by prefix, and the inputs.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> swing.columns()
        'Columns: time, tip (2)'
        """
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
        """Writes page, tables and pictures to a folder; removes files of an earlier run of the scene there.

        The page is written first, since the other files take longer. It lists all written files at its end, so that a later run
        removes and replaces these files only.

        Parameters
        ----------
        folder : str or pathlib.Path
            Created if needed.
        draw : bool, optional
            Whether to draw pictures.
        show : bool, optional
            Whether to open the page in the browser at once.
        progress : callable, optional
            Gets a text before each file.

        Returns
        -------
        list of pathlib.Path
            The files.

        Raises
        ------
        FiveBarError
            If the folder has a file of such a name that no earlier run wrote. Nothing is written then.

        Examples
        --------
        >>> import fivebar
        >>> swing = fivebar.run("swing", stop_time=0.1, outputs=("tip.x", "tip.y"))
        >>> [file.name for file in swing.save("files", draw=False)]
        ['swing.html', 'swing.csv', 'singularities.csv']
        """
        from fivebar import moving_picture, pictures

        out, name = Path(folder), self.scene.name
        out.mkdir(parents=True, exist_ok=True)
        labels = [run.label for run in self.runs]
        check_foreign(out, name, labels, draw)
        for earlier in _wrote(out / f"{name}.html"):
            earlier.unlink(missing_ok=True)
        files: list[Path] = []

        def begin(file: str) -> Path:
            progress(f"{name}: writing {file}")
            files.append(out / file)
            if len(files) > 1:
                _list(page, file)
            return files[-1]

        page = self.animate(begin(f"{name}.html"))
        if show:
            webbrowser.open(page.resolve().as_uri())
        for file, run in zip(_tables(name, labels), self.runs, strict=True):
            self._write(begin(file), run)
        singularities.write(begin(SINGULARITIES), self.singularities)
        if draw:
            pictures.draw_all(begin, self.scene, self.runs, self.singularities)
            if moving_picture.wanted(self.own):
                moving_picture.write(begin(ANIMATION), self.scene, self.own, self.singularities)
        return files


def _check_name(name: object) -> None:
    if not isinstance(name, str):
        raise TypeError(f"a column is chosen by its name, not by {shown(name)}")


def check_foreign(folder: Path, name: str, labels: Sequence[str], draw: bool) -> None:
    """Raises FiveBarError if `folder` has a file that runs of the scene `name` with these labels would replace, and no earlier run wrote it."""
    from fivebar import pictures

    earlier = {file for page in folder.glob("*.html") for file in _wrote(page)}
    written = [f"{name}.html", *_tables(name, labels), SINGULARITIES, *((*pictures.FILES, ANIMATION) if draw else ())]
    for file in map(folder.joinpath, written):
        if file.exists() and file not in earlier:
            raise FiveBarError(
                f"{file} is no file of an earlier run, and this run would replace it; another folder is needed"
            )


def _wrote(page: Path) -> set[Path]:
    """The page of an earlier run and the files that it lists; none for a page of another origin."""
    is_own, listed = _origin(page)
    names = {page.name, *listed} if is_own else set()
    return {file for file in page.parent.iterdir() if file.name in names and file.is_file()}


def _origin(page: Path) -> tuple[bool, list[str]]:
    """Whether FiveBar wrote the page, and the names of other files that the page lists. A page without its list is recognised by its title."""
    if not page.is_file():
        return False, []
    with page.open("rb") as stream:
        head = stream.read(HEAD).decode("utf-8", "replace")
        stream.seek(-min(page.stat().st_size, LONGEST_LIST), os.SEEK_END)
        listed = WROTE.findall(stream.read().decode("utf-8", "replace"))
    return bool(listed or TITLE.search(head)), listed


def _list(page: Path, *files: str) -> None:
    """Adds files to the list at the end of the page."""
    with page.open("a", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"<!-- fivebar wrote {file} -->\n" for file in files)


def _tables(name: str, labels: Sequence[str]) -> list[str]:
    """Names of the tables of runs with these labels."""
    return [f"{name}.csv", *(f"{name}.{_slug(label)}.csv" for label in labels[1:])]


def _slug(label: str) -> str:
    """The label as part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-")
