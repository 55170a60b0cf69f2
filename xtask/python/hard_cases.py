"""Draws the tables of the battery of hard cases: the matrix case x method, and the predictability horizon.

python hard_cases.py --folder target/hard-cases
"""

import argparse
import csv
import sys
from collections import defaultdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from fivebar.drawing import INK, RUN_COLOURS, STYLE

Row = dict[str, str]

COLOURS = {
    "pass": ("#69db7c", "judged: pass"),
    "FAIL": ("#fa5252", "judged: FAIL"),
    "meets": ("#d3f9d8", "for comparison: meets the demand as well"),
    "status": ("#ffe8cc", "for comparison: some runs end early, with a status"),
    "misses": ("#ffc9c9", "for comparison: runs to the end, but not within the demand"),
}

FIT = (1e-10, 1e-3)
"""Range of differences, rad, for the exponential fit: above round-off, below the size of the machine."""


def main(arguments: list[str] | None = None) -> int:
    """Draws both pictures; exit code 0: done, 1: no tables."""
    parser = argparse.ArgumentParser(description="Draws the tables of the battery of hard cases.")
    parser.add_argument("--folder", type=Path, required=True, help="the folder with hard-cases.csv and horizon.csv")
    folder = parser.parse_args(arguments).folder
    try:
        rows, pairs = read_rows(folder / "hard-cases.csv"), read_pairs(folder / "horizon.csv")
    except OSError as error:
        print(f"There are no tables to draw: {error}", file=sys.stderr)
        return 1
    with plt.rc_context(STYLE):
        for name, figure in (("hard-cases", matrix(rows)), ("horizon", horizon(pairs))):
            figure.savefig(folder / f"{name}.png")
            # Same text rendering as docs/hard-cases.md.
            with plt.rc_context({"svg.hashsalt": name}):
                figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)
            print(folder / f"{name}.png")
    return 0


def read_rows(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_pairs(path: Path) -> dict[str, np.ndarray]:
    """Time (s) and difference (rad) of each pair of runs."""
    pairs: dict[str, list[tuple[float, float]]] = defaultdict(list)
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            pairs[row["pair"]].append((float(row["time [s]"]), float(row["difference [rad]"])))
    return {name: np.array(values) for name, values in pairs.items()}


def colour_of(row: Row) -> str:
    """The key of COLOURS for a row."""
    if row["verdict"] in ("pass", "FAIL"):
        return row["verdict"]
    if row["not met"] == "0":
        return "meets"
    return "status" if row["ended early"] != "0" else "misses"


def e_fold(pair: np.ndarray) -> float:
    """Time, s, in which the difference grows by a factor e: least-squares fit to its logarithm, up to the end of the range FIT."""
    time, difference = pair.T
    reached = np.flatnonzero(difference > FIT[1])
    end = reached[0] if len(reached) else len(time)
    inside = np.flatnonzero(difference[:end] > FIT[0])
    if len(inside) < 3:
        return float("nan")
    slope = np.polyfit(time[inside], np.log(difference[inside]), 1)[0]
    return float(1 / slope)


def matrix(rows: list[Row]) -> Figure:
    """Cases by methods; the number is the worst energy error. The first case has every method and setting; each row of another case takes
    the whole line and names its own method."""
    cases = sorted(dict.fromkeys((row["item"], row["case"]) for row in rows), key=lambda case: int(case[0]))
    columns = [(row["method"], row["setting"]) for row in rows if (row["item"], row["case"]) == cases[0]]
    figure, axes = plt.subplots(figsize=(2.6 + 1.28 * len(columns), 1.3 + 0.56 * len(cases)))
    for row in rows:
        y = cases.index((row["item"], row["case"]))
        column = (row["method"], row["setting"])
        x, width, note = (
            (columns.index(column), 1, _count(row))
            if column in columns
            else (0, len(columns), f"{_count(row)}, {', '.join(column)}")
        )
        colour = COLOURS[colour_of(row)][0]
        axes.add_patch(Rectangle((x, y), width, 1, facecolor=colour, edgecolor="white", linewidth=1.5))
        axes.text(x + width / 2, y + 0.3, _energy(row), ha="center", va="center", fontsize=9, color=INK)
        axes.text(
            x + width / 2, y + 0.69, note, ha="center", va="center", fontsize=6.5, color="#495057", linespacing=1.1
        )
    axes.set(xlim=(0, len(columns)), ylim=(len(cases), 0))
    axes.set_xticks(
        np.arange(len(columns)) + 0.5, [f"{method}\n{_short(setting)}" for method, setting in columns], fontsize=8
    )
    axes.set_yticks(np.arange(len(cases)) + 0.5, [f"{name}   {item}" for item, name in cases])
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title("Hard cases: worst |energy error| in mgL", pad=12)
    handles = [Patch(facecolor=colour, label=label) for colour, label in COLOURS.values()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def horizon(pairs: dict[str, np.ndarray]) -> Figure:
    """Difference over time between runs with nearly equal starts."""
    figure, axes = plt.subplots(figsize=(10, 4.6))
    for (name, pair), colour in zip(pairs.items(), RUN_COLOURS):
        time, difference = pair.T
        positive = np.where(difference > 0, difference, np.nan)
        axes.semilogy(time, positive, color=colour, label=f"{name}: e-fold in {e_fold(pair):.3f} s")
    axes.axhspan(*FIT, color="#f1f3f5", zorder=0)
    axes.set(xlabel="time  (s)", ylabel="largest difference of a link angle  (rad)", ylim=(1e-16, 1e2))
    axes.set_xlim(0, max(pair[-1, 0] for pair in pairs.values()))
    axes.set_title("Two free falls whose proximal rates differ by 1e-12 rad/s at the start")
    axes.legend(loc="lower right", title="start; e-fold within the grey band", title_fontsize=9)
    return figure


def _energy(row: Row) -> str:
    energy = float(row["worst |dE| [mgL]"])
    if row["item"] == "8":
        return "the same bits" if row["verdict"] == "pass" else "different bits"
    if row["item"] == "10":
        # A correction adds energy, so there is no balance.
        return "followed"
    return "0" if energy == 0 else f"{energy:.1e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def _count(row: Row) -> str:
    runs, failed, early = int(row["runs"]), int(row["not met"]), int(row["ended early"])
    text = f"{failed} of {runs} not met" if failed else f"{runs} run{'s' if runs > 1 else ''}"
    return f"{text}\n{early} end early" if early else text


def _short(setting: str) -> str:
    return setting.replace("tolerance ", "tol. ").replace("default tolerance", "default")


if __name__ == "__main__":
    sys.exit(main())
