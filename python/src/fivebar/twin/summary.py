"""Summary of a run: summary.json, pictures, a self-contained page, and a few lines on the terminal."""

import html
import io
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from fivebar.colours import TIP
from fivebar.twin import figures, held_out, learned_scene, scene
from fivebar.twin.config import Config
from fivebar.twin.errors import TwinError
from fivebar.twin.figures import Judged, Story
from fivebar.twin.watch import Histogram

LEARNED: Final = "learned.json"
"""Name of the scene file with the learned parameters."""

MOST_POINTS: Final = 3000
"""Maximum number of points of a line in a picture."""

USUAL, SHOWN = 0.95, 1.5
"""Range of a picture: `SHOWN` times the `USUAL` quantile of all values."""

TWIN, MACHINE, BAND, BAD = TIP, "#1d2329", "#a3b28f", "#c92a2a"
TEMPLATE: Final = Path(__file__).with_name("page") / "summary.html"

plt.rcParams |= {
    "svg.hashsalt": "fivebar",
    "font.size": 9.5,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def write(
    config: Config,
    status: dict[str, list[dict[str, Any]]],
    restarts: dict[str, int],
    out: Path,
    troubles: Sequence[str] = (),
) -> int:
    """Writes the summary to the run's folder and to `out`. Returns 0 if the twin followed, 3 if its forecasts were worse than promised, else 1."""
    try:
        story = figures.read(config.record)
    except TwinError as error:
        print(f"no summary: {error}")
        return 1
    judged = figures.judge(story)
    content = figures.summarise(config, story, judged, status, restarts, troubles)
    content["held_out"] = held_out.judge(config, story).content()
    pictures = {
        "tip": (_tip(story), "The tip, seen by a tracker and estimated"),
        "error": (_error(story, judged), "Error of the estimated tip, and its 95 % radius"),
        "forecast": (_forecast(story, judged), "Forecasts: errors and 95 % radii"),
        "latency": (_latency(status), "Latency from the sample to its estimate at a subscriber"),
    }
    _tell(content, out)
    try:
        _keep(config, content, pictures, out)
    except OSError as error:
        print(f"summary, pictures and page are not all written: {error.filename or out}: {error.strerror}")
        return 1
    finally:
        for figure, _ in pictures.values():
            plt.close(figure)
    if unfollowed := figures.unfollowed(content):
        print(unfollowed)
        return 1
    return figures.MISSED if content["missed"] else 0


def _keep(config: Config, content: dict[str, Any], pictures: dict[str, tuple[Figure, str]], out: Path) -> None:
    """Writes the files, summary.json first: it is small and the most important one."""
    out.mkdir(parents=True, exist_ok=True)
    summary = config.path / "summary.json"
    summary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    page = config.path / "index.html"
    about = scene.read(Path(config.scene))
    title = f"{about.name}: a run of the twin"
    page.write_text(page_of(title, [about.description], _cards(content), pictures, content), encoding="utf-8")
    made = []
    if learned := content["learned"]:
        made.append(config.path / LEARNED)
        learned_scene.write(made[0], config.path / scene.SOURCE, learned["values"])
    else:
        # A file of an earlier run would look like a result of this one.
        (out / LEARNED).unlink(missing_ok=True)
    for name, (figure, _) in pictures.items():
        file = config.path / f"{name}.png"
        figure.savefig(file, dpi=120)
        made.append(file)
    for file in (summary, page, *made):
        shutil.copyfile(file, out / file.name)


def _tell(content: dict[str, Any], out: Path) -> None:
    samples, latency, error, forecasts = (
        content[name] for name in ("samples", "latency_ms", "tip_error_mm", "forecasts")
    )

    def figure(value: float | None, unit: str, factor: float = 1.0) -> str:
        return "not known" if value is None else f"{factor * value:.3g} {unit}"

    print()
    for label, text in (
        ("samples", f"{samples['published']} published, {samples['lost']} lost, {samples['estimated']} estimated"),
        ("sample to estimate", f"median {figure(latency['p50'], 'ms')}, p99 {figure(latency['p99'], 'ms')}"),
        ("tip error", f"rms {figure(error['rms'], 'mm')}, largest {figure(error['max'], 'mm')}"),
        (
            f"forecasts, {forecasts['ahead_s']:g} s",
            (
                f"{forecasts['count']} of {forecasts['due']}, half-width {figure(forecasts['halfwidth_mm']['median'], 'mm')} (median), "
                f"{figure(forecasts['coverage95'], '%', 100)} inside"
            ),
        ),
        (
            "promises",
            "; ".join(content["missed"]) or ("kept" if forecasts["judged"] >= figures.FEWEST else "not judged"),
        ),
        ("alarms, refused", f"{content['alarms']}, {content['refused']}"),
        ("causes of alarms", ", ".join(content["causes"]) or "none"),
        (
            "troubles",
            f"{content['troubles']['count']}, the last: {content['troubles']['last'][-1]}"
            if content["troubles"]["last"]
            else "none",
        ),
        (
            "learned",
            f"{len(learned['values'])} start values, in {out / LEARNED}"
            if (learned := content["learned"])
            else "nothing",
        ),
        ("not recorded", _gaps(content["gaps"])),
        ("restarts", ", ".join(f"{name} {count}" for name, count in content["restarts"].items() if count) or "none"),
        ("record", content["record"]),
        ("page", str(out / "index.html")),
    ):
        print(f"  {label:22} {text}")
    print("\n".join(held_out.lines(content["held_out"])))


def _gaps(gaps: list[dict[str, Any]]) -> str:
    """Description of the gaps in the record."""
    said = [f"{gap['of']} {gap['first']} to {gap['last']}" + (f" ({gap['why']})" if gap["why"] else "") for gap in gaps]
    return "; ".join(said[:3]) + (f" and {len(said) - 3} more gaps" if len(said) > 3 else "") or "nothing"


# --- pictures -----------------------------------------------------------------------------------------------------------------------


def _thin(*columns: np.ndarray) -> tuple[np.ndarray, ...]:
    stride = max(1, len(columns[0]) // MOST_POINTS)
    return tuple(column[::stride] for column in columns)


def _axes(width: float, height: float, columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, columns, figsize=(width, height), layout="constrained", squeeze=False)
    return figure, list(axes[0])


def _tip(story: Story) -> Figure:
    figure, (path, time) = _axes(10, 3.6, 2)
    x, y = _thin(story.measured["tip.x"], story.measured["tip.y"])
    path.plot(1e3 * x, 1e3 * y, color=MACHINE, linewidth=1, label="machine")
    t, x, y = _thin(story.estimated["time"], story.estimated["tip.x"], story.estimated["tip.y"])
    path.plot(1e3 * x, 1e3 * y, color=TWIN, linewidth=1, linestyle=(0, (4, 3)), label="twin")
    path.set(xlabel="x (mm)", ylabel="y (mm)")
    path.set_aspect("equal", adjustable="datalim")
    _legend(path)
    for values, label, style in ((x, "x", "-"), (y, "y", "--")):
        time.plot(t, 1e3 * values, color=TWIN, linewidth=1, linestyle=style, label=label)
    time.set(xlabel="time (s)", ylabel="estimated tip (mm)")
    _legend(time)
    _mark_alarms(time, story)
    return figure


def _error(story: Story, judged: Judged) -> Figure:
    figure, (axes,) = _axes(10, 3)
    t, error, band = _thin(story.estimated["time"], judged.error, story.estimated["band"])
    axes.fill_between(t, np.full_like(t, 1e-4), 1e3 * band, color=BAND, alpha=0.35, linewidth=0, label="95 % band")
    axes.plot(t, 1e3 * error, color=TWIN, linewidth=0.8, label="error of the tip")
    axes.set(xlabel="time (s)", ylabel="mm", yscale="log")
    known = np.concatenate([error[np.isfinite(error)], band[np.isfinite(band)]])
    if len(known):
        axes.set_ylim(1e3 * max(np.quantile(known, 0.02), 1e-7) / 2, 2e3 * max(known.max(), 1e-6))
    _legend(axes)
    _mark_alarms(axes, story)
    return figure


def _forecast(story: Story, judged: Judged) -> Figure:
    figure, (time, ahead) = _axes(10, 3.4, 2)
    table = story.forecasts
    last = table["last"] == 1.0
    at = table["time"][last] + table["ahead"][last]
    widths = 1e3 * table["half_width"][last]
    time.plot(at, widths, color=BAND, linewidth=1.2, label="half-width, 95 %")
    hit, error = judged.inside[last], 1e3 * judged.ahead_error[last]
    time.plot(at[hit == 1], error[hit == 1], ".", color=TWIN, markersize=2.5, label="error, inside")
    time.plot(at[hit == 0], error[hit == 0], "x", color=BAD, markersize=5, label="error, outside")
    time.set(xlabel="time that was forecast (s)", ylabel="mm")
    _legend(time)
    _bound(time, at, np.fmax(widths, np.nan_to_num(error)))
    steps = np.unique(np.round(table["ahead"], 6))
    where = [np.isclose(table["ahead"], step) for step in steps]
    ahead.plot(
        steps,
        [1e3 * np.median(table["half_width"][w]) for w in where],
        color=BAND,
        marker="o",
        markersize=3,
        label="half-width, median",
    )
    errors = [judged.ahead_error[w] for w in where]
    ahead.plot(
        steps,
        [1e3 * np.median(e[np.isfinite(e)]) if np.isfinite(e).any() else np.nan for e in errors],
        color=TWIN,
        marker="o",
        markersize=3,
        label="error, median",
    )
    ahead.set(xlabel="ahead (s)", ylabel="mm")
    _legend(ahead)
    hits = [judged.inside[w] for w in where]
    if not any(np.isfinite(h).any() for h in hits):
        return figure
    share = ahead.twinx()
    share.plot(
        steps,
        [100 * h[np.isfinite(h)].mean() if np.isfinite(h).any() else np.nan for h in hits],
        color=MACHINE,
        linestyle=":",
        label="inside",
    )
    share.axhline(95, color=MACHINE, linewidth=0.6)
    share.set(ylim=(0, 105), ylabel="inside the 95 % circle (%, dotted; line: 95)")
    share.grid(visible=False)
    return figure


def _latency(status: dict[str, list[dict[str, Any]]]) -> Figure:
    figure, (axes,) = _axes(10, 2.6)
    total: dict[int, int] = {}
    for life in status.get("watch", []):
        for place, count in life.get("latency_bins", {}).items():
            total[int(place)] = total.get(int(place), 0) + count
    if total:
        edges = [1e3 * Histogram.LOWEST * Histogram.RATIO ** (place - 1) for place in total]
        axes.bar(
            edges,
            list(total.values()),
            width=[(Histogram.RATIO - 1) * edge for edge in edges],
            align="edge",
            color=TWIN,
            linewidth=0,
        )
    axes.set(xscale="log", xlabel="ms from sample to estimate", ylabel="estimates")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    return figure


def _legend(axes: Axes) -> None:
    """Adds a legend above the picture, only for lines with data: without a tracker, the machine has no line."""
    known = [
        (handle, label) for handle, label in zip(*axes.get_legend_handles_labels(), strict=True) if _is_there(handle)
    ]
    if not known:
        return
    axes.legend(
        *zip(*known, strict=True),
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=3,
        frameon=False,
        borderaxespad=0.2,
    )


def _is_there(drawn: Artist) -> bool:
    """Whether a line or an area has a visible point."""
    if isinstance(drawn, Line2D):
        places = np.asarray(drawn.get_xydata())
    else:
        assert isinstance(drawn, Collection), "a picture has lines and areas"
        places = np.concatenate([np.empty((0, 2)), *(np.asarray(path.vertices) for path in drawn.get_paths())])
    return bool(np.isfinite(places).all(axis=1).any())


def _bound(axes: Axes, at: np.ndarray, values: np.ndarray) -> None:
    """Limits the picture to the usual range. Values far beyond, such as the first forecast of a run, become arrows at the edge with numbers."""
    known = values[np.isfinite(values)]
    if not len(known):
        return
    top = SHOWN * float(np.quantile(known, USUAL))
    if top <= 0 or float(known.max()) <= top:
        return
    axes.set_ylim(0, top)
    beyond = np.flatnonzero(np.isfinite(values) & (values > top))
    axes.plot(at[beyond], np.full(len(beyond), 0.98 * top), "^", color=MACHINE, markersize=5, clip_on=False)
    most = beyond[np.argmax(values[beyond])]
    left = at[most] < np.mean(axes.get_xlim())
    axes.annotate(
        f"{len(beyond)} beyond, up to {values[most]:.3g} mm",
        (at[most], 0.98 * top),
        xytext=(8 if left else -8, -3),
        textcoords="offset points",
        color=MACHINE,
        ha="left" if left else "right",
        va="center",
    )


def _mark_alarms(axes: Axes, story: Story) -> None:
    for time, state, _ in story.alarms:
        if state == "anomaly":
            axes.axvline(time, color=BAD, linewidth=1, alpha=0.6)


# --- page ---------------------------------------------------------------------------------------------------------------------------


def _svg(figure: Figure) -> str:
    """The picture as an element of a page, without XML prolog and external references."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)


def page_of(
    title: str, paragraphs: list[str], cards: str, pictures: dict[str, tuple[Figure, str]], content: dict[str, Any]
) -> str:
    """A self-contained page: paragraphs that are not empty, cards, pictures with captions, and all figures in a collapsed section."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(value))}</td></tr>"
        for name, value in _flat(content)
        if not name.startswith("gaps")
    )
    shown = "".join(
        f"<figure>{_svg(figure)}<figcaption>{html.escape(text)}.</figcaption></figure>"
        for figure, text in pictures.values()
    )
    page = TEMPLATE.read_text(encoding="utf-8")
    for name, value in (
        ("{{title}}", html.escape(title)),
        ("{{paragraphs}}", "\n".join(f"<p>{html.escape(text)}</p>" for text in paragraphs if text)),
        ("{{cards}}", cards),
        ("{{pictures}}", shown),
        ("{{rows}}", rows),
    ):
        page = page.replace(name, value)
    return page


def card(value: float | None, digits: str, unit: str, label: str) -> str:
    """A card with one figure at the top of a page."""
    text = "–" if value is None else f"{value:{digits}}"
    return f"<div><b>{text}<small> {html.escape(unit)}</small></b><span>{html.escape(label)}</span></div>"


def _cards(content: dict[str, Any]) -> str:
    forecasts = content["forecasts"]
    covered = forecasts["coverage95"]
    return "".join(
        (
            card(content["samples"]["estimated"], "d", "", "estimates"),
            card(content["samples"]["lost"], "d", "", "samples lost"),
            card(content["latency_ms"]["p50"], ".1f", "ms", "sample to estimate, median"),
            card(content["latency_ms"]["p99"], ".1f", "ms", "sample to estimate, p99"),
            card(content["tip_error_mm"]["rms"], ".3f", "mm", "tip error, rms"),
            card(content["tip_error_mm"]["max"], ".3f", "mm", "tip error, largest"),
            card(forecasts["count"], "d", "", "forecasts"),
            card(forecasts["halfwidth_mm"]["median"], ".1f", "mm", f"forecast {forecasts['ahead_s']:g} s, half-width"),
            card(None if covered is None else 100 * covered, ".1f", "%", "inside the 95 % circle"),
            card(content["alarms"], "d", "", "alarms"),
        )
    )


def _flat(content: dict[str, Any], before: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in content.items():
        rows += _flat(value, f"{before}{name}.") if isinstance(value, dict) else [(before + name, value)]
    return rows
