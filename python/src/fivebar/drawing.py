"""Common parts of pictures: colours, style, axes and the obstacles around the mechanism."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fivebar.drive import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

    from fivebar.plot import Plot

# matplotlib is imported only if needed: the import takes longer than most runs, and page and moving picture do without it.

RUN_COLOURS = ("#1864ab", "#e8590c", "#2b8a3e", "#862e9c", "#c2255c")
INK, FAINT, BARRIER = "#212529", "#adb5bd", "#f1f3f5"
WRONG = "#c2255c"

ABOVE: Final[dict[str, Any]] = {"loc": "lower right", "bbox_to_anchor": (1, 1.0), "borderaxespad": 0.2}
"""Arguments for a legend above its axes."""

STYLE: Final["dict[RcKeyType, Any]"] = {
    "figure.dpi": 120,
    "figure.constrained_layout.use": True,
    # The tight layout starts from these values: they are near its result, so that the ticks fit.
    "figure.subplot.left": 0.08,
    "figure.subplot.right": 0.98,
    "figure.subplot.bottom": 0.08,
    "figure.subplot.top": 0.95,
    "figure.subplot.hspace": 0.1,
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#868e96",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "xtick.color": "#495057",
    "ytick.color": "#495057",
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "svg.hashsalt": "fivebar",  # the same run gives the same file
}


def panels(rows: int, columns: int = 1, *, figsize: tuple[float, float], **shared: Any) -> tuple["Plot", Any]:
    """A figure with a grid of panels; pyplot keeps no reference to it."""
    from fivebar.plot import Plot

    figure = Plot(figsize=figsize)
    return figure, figure.subplots(rows, columns, **shared)


@contextmanager
def laid_out(figure: "Figure") -> Iterator[None]:
    """Computes the layout of a finished figure once, for all files. With a layout engine, each file would lay out and draw the figure twice.

    Panels below each other get a tight layout, which measures all text once. Constrained layout measures it twice, but also places panels
    side by side, colour bars and legends of the whole figure.
    """
    import matplotlib
    from matplotlib.ticker import FixedLocator

    grid = figure.axes[0].get_gridspec()
    if not figure.legends and grid and grid.ncols == 1:
        # A rectangle to fill, the whole figure by default, would take a second measurement.
        figure.set_layout_engine("tight", pad=0.3, rect=None)
        # Other ticks after the measurement could have wider labels.
        for axes in [each for own in figure.axes for each in (own, *own.child_axes)]:
            axes.yaxis.set_major_locator(FixedLocator(axes.yaxis.get_majorticklocs().tolist()))
    if engine := figure.get_layout_engine():
        engine.execute(figure)
    # Otherwise the style would give a figure without an engine the constrained one, also when matplotlib has written a file.
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
        yield


def save(figure: "Figure", file: Path) -> Path:
    """Writes a picture and closes it: the same figure gives the same bytes."""
    import matplotlib.pyplot as plt

    # Text beside the axes may need more room than the figure has.
    figure.savefig(
        file,
        bbox_inches="tight",
        pad_inches=0.1,
        metadata={"Date": None} if file.suffix == ".svg" else {"Software": None},
    )
    plt.close(figure)
    return file


def thinned(time: np.ndarray, *signals: np.ndarray, buckets: int = 2000) -> list[np.ndarray]:
    """Time and signals thinned to about 2·buckets points per signal; the extremes of each bucket are kept."""
    if len(time) <= 2 * buckets:
        return [time, *signals]
    edges = np.linspace(0, len(time), buckets + 1).astype(int)
    kept = {0, len(time) - 1}
    for signal in signals:
        for a, b in pairwise(edges):
            kept.update((a + int(np.argmin(signal[a:b])), a + int(np.argmax(signal[a:b]))))
    index = np.array(sorted(kept))
    return [time[index], *(signal[index] for signal in signals)]


def time_axis(axes: "Axes", runs: list[Run]) -> None:
    """Sets label and limits of the time axis."""
    axes.set_xlabel("time  (s)")
    begin, end = float(runs[0].time[0]), max(float(run.time[-1]) for run in runs)
    axes.set_xlim(begin, end if end > begin else begin + runs[0].step_size)


def drawing_order(runs: list[Run]) -> list[tuple[int, Run]]:
    """Runs with their indices; the scene's own run comes last and so is on top."""
    return list(enumerate(runs))[::-1]


def run_style(i: int) -> dict[str, float]:
    """Line style of a run: overlays are broad bands under the scene's thin line, so that both are visible if they agree."""
    return {"linewidth": 1.2} if i == 0 else {"linewidth": 3.2, "alpha": 0.55}


def run_label(run: Run) -> str:
    """The label of a run, with the time of its failure."""
    return f"{run.label} (failed at {run.time[-1]:.3g} s)" if run.failed else run.label


def ordered_legend(axes: "Axes", count: int) -> None:
    """Adds a legend above the axes, with the scene's own run first."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], ncols=count, **ABOVE)


def legend_above(axes: "Axes", columns: int = 4) -> None:
    """Adds a legend above the axes, clear of the curves."""
    axes.legend(ncols=columns, **ABOVE)


def legend_below(axes: "Axes", columns: int = 4) -> None:
    """Adds a legend below the axes, for a figure with a title in the room above them."""
    handles, labels = axes.get_legend_handles_labels()
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.legend(handles, labels, ncols=columns, loc="outside lower center")


def positive(values: np.ndarray) -> np.ndarray:
    """Values for a logarithmic axis: zeros become NaN, since they cannot be drawn."""
    return np.where(values > 0, values, np.nan)


def logarithmic(axes: "Axes") -> None:
    """Makes the y axis logarithmic."""
    axes.set_yscale("log")
    label_decades(axes.yaxis)


def label_decades(axis: "Axis") -> None:
    """Labels a logarithmic axis in plain text."""
    from fivebar.decades import Decades

    axis.set_major_formatter(Decades())
    axis.set_minor_formatter(Decades())


def full_decades(axes: "Axes", values: np.ndarray) -> None:
    """Sets limits of a logarithmic axis to powers of ten of at least 1e-8, without labels between the powers."""
    from matplotlib.ticker import NullFormatter

    positive = values[values > 0]
    if len(positive):
        low, high = np.floor(np.log10(max(positive.min() / 2, 1e-8))), np.ceil(np.log10(max(positive.max(), 1e-7)))
        axes.set_ylim(10.0**low, 10.0**high)
    axes.yaxis.set_minor_formatter(NullFormatter())


def extent(run: Run, axis: str) -> tuple[float, float]:
    """Limits along x or y that contain the base, the elbows and the tip at all times."""
    feet = np.array([0.0, run.parameters["base.distance"] if axis == "x" else 0.0])
    parts = [feet, run[f"tip.{axis}"], run[f"elbow[1].{axis}"], run[f"elbow[2].{axis}"]]
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    margin = 0.05 * max(high - low, 0.1)
    return low - margin, high + margin


def surroundings(axes: "Axes", run: Run) -> None:
    """The motors, and the obstacles of their links and the tip: end stops and a plane."""
    from matplotlib.patches import Polygon, Wedge

    p = run.parameters
    base = p["base.distance"]
    if p["contact.enabled"]:
        normal, offset = plane(run)
        length = p["link[1].length"]
        along, deep = 1e3 * length * np.array([-normal[1], normal[0]]), 0.12 * length * normal
        edge = normal * offset
        corners = [edge - along, edge + along, edge + along - deep, edge - along - deep]
        axes.add_patch(Polygon(corners, facecolor=BARRIER, edgecolor=FAINT, hatch="////", linewidth=1.0, zorder=0))
    for leg, foot, link in ((1, 0.0, 1), (2, base, 4)):
        lower, upper = (np.degrees(p[f"stop.{limit}[{leg}]"]) for limit in ("lower", "upper"))
        if p["stop.enabled"] and upper - lower < 360:
            radius = 0.3 * p[f"link[{link}].length"]
            axes.add_patch(
                Wedge((foot, 0), radius, upper, lower, facecolor=BARRIER, edgecolor=FAINT, hatch="///", zorder=0)
            )
    axes.plot([0, base], [0, 0], color=FAINT, linewidth=1, linestyle=":", zorder=1)
    axes.plot([0, base], [0, 0], "^", color=INK, markersize=8, zorder=7)


def plane(run: Run) -> tuple[np.ndarray, float]:
    """Unit normal and offset, m, of the plane that the tip may touch."""
    normal = np.array([run.parameters["contact.nx"], run.parameters["contact.ny"]])
    return normal / np.hypot(*normal), run.parameters["contact.offset"]
