"""Writes the accuracy report from the tables of the measurements.

python write_report.py --folder target/report --bench target/bench --hard-cases target/hard-cases --runs target/run --peers target/peers
"""

import argparse
import shutil
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hard_cases_in_docs
import step_times_in_docs
from fivebar import table
from fivebar.pictures import STYLE, thinned
from report import docs, figures, page, picks, sections
from report.tables import Measurements, Table, markers, references

ROOT = Path(__file__).resolve().parents[2]


def main(arguments: list[str] | None = None) -> int:
    """Writes the page; exit code 0: done, 1: nothing to draw or to update."""
    parser = argparse.ArgumentParser(description="Writes the accuracy report from the tables of the measurements.")
    parser.add_argument("--folder", type=Path, required=True, help="the folder of the report; tables are in its data/")
    for name, text in (
        ("bench", "benchmarks"),
        ("hard-cases", "hard cases"),
        ("runs", "runs of scenes"),
        ("peers", "peers"),
    ):
        parser.add_argument(
            f"--{name}", type=Path, required=True, help=f"the folder of the {text}; missing tables are left out"
        )
    parser.add_argument("--update-docs", action="store_true", help="also write tables and pictures into the docs")
    options = parser.parse_args(arguments)
    data = options.folder / "data"
    m = Measurements.read(data, options.bench, options.hard_cases, options.peers)
    if not (m.precision and m.references and m.energy and m.horizon and m.steps):
        print(f"There are no tables in {data}; `cargo xtask report` measures them.", file=sys.stderr)
        return 1
    for measured in (m.effects, m.calls, m.step_times, m.hard_cases, m.peers):
        keep_beside(measured, data)
    curves = {scene: curves_of(options.runs / scene, scene, data) for scene in sections.PAPER}
    with plt.rc_context(STYLE):
        write(options.folder / "index.html", m, {scene: found for scene, found in curves.items() if found})
        refused = update_docs(m, options.bench, options.hard_cases) if options.update_docs else ""
    print(options.folder / "index.html")
    if refused:
        print(refused, file=sys.stderr)
    return 1 if refused else 0


def write(path: Path, m: Measurements, curves: dict[str, dict[str, np.ndarray]]) -> None:
    found, judged = markers(m.precision), references(m.references)
    parts = [
        sections.run(m, m.precision.about),
        sections.need(found, judged),
        sections.precision(found, judged),
        sections.order(found, judged, m.energy.rows),
        sections.horizon(m),
        sections.steps(m),
        sections.effects(m),
        sections.matrix(m),
        sections.paper(curves),
        sections.peers(m),
        sections.failures(m, found),
    ]
    caption = "Error against time, one scene of each kind. Lower and further left is better."
    main_picture = page.figure_element(figures.main_picture(found, judged), "main", caption, ["precision.csv"])
    page.write(path, picks.sentences(found, judged), main_picture, parts)


def update_docs(m: Measurements, bench: Path, hard_cases: Path) -> str:
    """Updates the picture, the short table and the ratios, and if there are any the fixed steps and hard cases; returns the reason if those are
    not fit for the docs."""
    found, judged = markers(m.precision), references(m.references)
    docs.figure(ROOT, "accuracy", figures.main_picture(found, judged))
    head, rows = picks.ratio_table(found, judged)
    docs.update(ROOT, picks.short_table(found, judged), docs.markdown(head, rows, left=1), m.precision.about)
    refused = (
        step_times_in_docs.update(ROOT, bench) if m.step_times else "",
        hard_cases_in_docs.update(ROOT, hard_cases) if m.hard_cases else "",
    )
    return "\n".join(filter(None, refused))


def keep_beside(table: Table, data: Path) -> None:
    """Copies tables of other commands beside the page that shows them; removes copies that no longer have a source."""
    copy = data / table.file.name
    copy.unlink(missing_ok=True)
    if table:
        shutil.copyfile(table.file, copy)


def curves_of(folder: Path, scene: str, data: Path) -> dict[str, np.ndarray]:
    """Time and tip position of a scene's run and its overlays, by label; also written as CSV, as thinned as drawn."""
    curves = {}
    own = folder / f"{scene}.csv"
    for file in [own, *sorted(folder.glob(f"{scene}.*.csv"))] if own.is_file() else []:
        columns = table.read(file, ("tip.x", "tip.y"), "time").columns
        label = "FiveBar, default settings" if file == own else file.name[len(scene) + 1 : -len(".csv")]
        curves[label] = np.column_stack(thinned(*(columns[name] for name in ("time", "tip.x", "tip.y"))))
    if curves:
        with (data / f"{scene}.csv").open("w", encoding="utf-8", newline="\n") as out:
            out.write("run,time [s],tip.x [m],tip.y [m]\n")
            for label, curve in curves.items():
                out.writelines(f'"{label}",{t:.6g},{x:.9g},{y:.9g}\n' for t, x, y in curve)
    return curves


if __name__ == "__main__":
    sys.exit(main())
