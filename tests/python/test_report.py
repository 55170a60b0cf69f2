"""The accuracy report: picks, figures and page from a few made-up measurements, and its excerpts in the docs."""

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import hard_cases
import hard_cases_in_docs
import step_times_in_docs
import write_report
from browser import open_browser
from conftest import REPOSITORY
from report import docs, figures, picks, tables
from report.tables import Marker, Reference

ABOUT = "a made-up machine; no compiler; cargo xtask report"
SCENES = [
    ("swing, 2 s", "smooth", 1e-14),
    ("fall_90_120, 1 s", "whipping", 1e-15),
    ("fall_90_120, 2 s", "whipping", 1e-15),
    ("stiff_servo, 0.5 s", "stiff", 1e-8),
    ("haptic, 2 s", "driven", 1e-15),
]
HELD = "inputs are held for 1 ms, a longer step would be another motion"
STEPS = (4e-3, 1e-3, 1e-4, 1e-5)
LINES = {
    "dop853": ("tolerance", "rad", (1e-4, 1e-7, 1e-10, 1e-13), lambda v: 10 * v, lambda v: 0.3 * v**-0.1),
    "i3alp, fixed step": ("step", "s", STEPS, lambda h: 6e3 * h**2, lambda h: 2e-4 / h),
    "rk4": ("step", "s", STEPS, lambda h: 3e6 * h**4, lambda h: 4e-4 / h),
}
# The main picture, two for each kind of motion, and seven others.
FIGURES = 1 + 2 * len({kind for _, kind, _ in SCENES}) + 7
SECTIONS = [
    "run",
    "need",
    "precision",
    "order",
    "horizon",
    "steps",
    "effects",
    "hard-cases",
    "paper",
    "peers",
    "failures",
]


def precision() -> list[list[object]]:
    """Rows of precision.csv; rk4 fails at its longest step, the driven scene has no steps beyond 1 ms."""
    rows = []
    for scene, kind, _ in SCENES:
        for method, (knob, unit, values, error, cost) in LINES.items():
            for v in values:
                ending = "ended early at 0.1 s: <never> converged" if method == "rk4" and v == STEPS[0] else "complete"
                if kind == "driven" and knob == "step" and v > 1e-3:
                    ending = f"left out: {HELD}"
                e, us = (error(v), cost(v)) if ending == "complete" else (math.inf, math.nan)
                stiff = "yes" if kind == "stiff" and method == "dop853" else "no"
                rows.append([scene, kind, 1, method, knob, v, unit, e, us, 0.9 * us, 2 * us, 10, 0, 10, stiff, ending])
    return rows


def write(folder: Path, name: str, head: list[str], rows: list[list[object]]) -> None:
    """A table as the measuring program writes it."""
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        file.write(f"# {ABOUT}\n")
        csv.writer(file).writerows([head, *rows])


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report with its tables."""
    folder = tmp_path_factory.mktemp("report")
    data = folder / "data"
    data.mkdir()
    choice = ["method", "knob", "value", "unit"]
    us = [f"{prefix}us per simulated ms" for prefix in ("", "best ", "worst ")]
    counts = ["sub-steps", "rejected", "iterations", "stiff", "ending"]
    write(data, "precision", ["scene", "kind", "end [s]", *choice, "error [m]", *us, *counts], precision())
    write(
        data,
        "references",
        ["scene", "kind", "own error [m]", "source"],
        [[*scene, "by other means"] for scene in SCENES],
    )
    fall = [row for row in precision() if row[0] == SCENES[1][0]]
    energy = [[*row[3:7], row[7] if row[7] < 1 else 5, row[8], 50, row[-1]] for row in fall]
    write(data, "energy", [*choice, "worst |dE| [mgL]", us[0], "reached [s]", "ending"], energy)
    best = ["double precision", "tolerance", 2e-14, "rad", 5.5, "parted"]
    write(
        data,
        "horizon",
        [*choice, "within 1 mm until [s]", "ending"],
        [best] + [[*row[3:7], 1.5, "parted"] for row in fall],
    )
    pairs = [["90/120 deg", 0.01 * i, 1e-12 * math.exp(0.1 * i)] for i in range(300)]
    write(data, "growth", ["pair", "time [s]", "difference [rad]"], pairs)
    names = ["i3alp, default tolerance", "dop853, 1e-8 rad"]
    steps = [
        [name, 1e-3 * i, 1 + i % 7, 2 + i % 9, 1 + i % 5, 1 + i % 6, 0.1, 0.2, 0.01]
        for name in names
        for i in range(50)
    ]
    sigmas = ["sigmaPhi", "sigmaJx [m]", "sigmaJq [m2]"]
    write(data, "steps", ["setting", "time [s]", "best [us]", "first [us]", "sub-steps", "iterations", *sigmas], steps)
    (folder / "bench").mkdir()
    rows = [["gravity only", 2000, 200, 1], ["friction", 8000, 800, 4]]
    write(folder / "bench", "effects", ["case", "instructions", "ns", "ratio"], rows)
    times = [[step, 1000, up, count] for step in (0.001, 0.004) for up, count in ((501.2, 900), (1000.0, 90), (1e5, 1))]
    write(folder / "bench", "step-times", ["step [s]", "solver.maxWork", "up to [ns]", "steps"], times)
    work = [
        "step [s]",
        "solver.maxWork",
        "steps",
        "median",
        "99.99 %",
        "most iterations",
        "rescued",
        "by the fallback",
        "ended",
    ]
    steps = step_times_in_docs.STEPS
    write(
        folder / "bench",
        "step-work",
        work,
        [[0.001, 400_000, steps, 2, 8, 618, 166, 0, 0], [0.001, 0, 500_000, 2, 8, 12, 0, 0, 104]],
    )
    return folder


def options(folder: Path) -> list[str]:
    """The command line; tables of hard cases, runs and peers are missing."""
    nothing = folder / "nothing"
    others = [f"--{name}={nothing}" for name in ("hard-cases", "runs", "peers")]
    return [f"--folder={folder}", f"--bench={folder / 'bench'}", *others]


@pytest.fixture(scope="module")
def page(measured: Path) -> Path:
    """The page."""
    assert write_report.main(options(measured)) == 0
    return measured / "index.html"


def marker(method: str, error: float, cost: float, ending: str = "complete", step: float | None = None) -> Marker:
    """A marker with the given cost and error; by default a more expensive one has a smaller step."""
    return Marker("fall", "whipping", method, "step", step or 1e-3 / cost, "s", error, cost, 1.0, 1, False, ending)


def test_the_cheapest_that_is_good_enough() -> None:
    found = [
        marker("rk4", 1e-7, 5.0),
        marker("rk4", 1e-9, 50.0),
        marker("dop853", 1e-8, 3.0),
        marker("i3alp, fixed step", 1e-3, 0.2),
        marker("i3alpPrinted", math.inf, 0.1, "ended early at 0.1 s"),
        # A lucky result: with half the step the error is larger.
        marker("i3alp, adaptive", 1e-8, 0.1, step=2e-3),
        marker("i3alp, adaptive", 1e-2, 0.2, step=1e-3),
    ]
    reference = Reference("fall", "whipping", 1e-9, "")
    chosen = picks.pick(found, reference, 1e-6)
    assert (chosen.best, chosen.second, chosen.resolved) == (found[2], found[0], True)
    assert picks.pick(found, reference, 1e-3).best == found[3]
    assert picks.pick(found, reference, 1e-10).best is None
    assert not picks.pick(found, reference, 2e-9).resolved


def test_what_a_choice_of_its_own_costs() -> None:
    reference = Reference("fall", "whipping", 1e-9, "")
    found = [marker("automatic", 1e-7, 5.0), marker("dop853", 1e-8, 3.0), marker("rk4", 1e-3, 2.0)]
    assert picks.by_itself(found, reference, 1e-2) == 2.5
    assert picks.by_itself(found, reference, 1e-6) == 5.0 / 3.0
    # Three cases: no setting of the method reaches it; no fixed method reaches it; the reference is not accurate enough.
    assert picks.by_itself(found, reference, 1e-8) is picks.by_itself(found[:1], reference, 1e-6) is None
    assert picks.by_itself(found, reference, 2e-9) is None
    head, [row] = picks.ratio_table(
        [*found, marker("automatic", 1e-3, 2.1)], [reference, Reference("other", "whipping", 1e-9, "")]
    )
    assert len(head) == len(row) and row[:4] == ["fall", "1.05", "1.05", "**1.67**"]


def test_sentences_name_a_method_for_every_stretch() -> None:
    found = [marker("i3alp, fixed step", 1e-3, 0.2), marker("dop853", 1e-8, 3.0)]
    [(kind, sentence)] = picks.sentences(found, [Reference("fall", "whipping", 1e-15, "")])
    assert kind == "whipping"
    assert sentence == (
        "for errors of 1e-2 to 1e-3 m <strong>i3alp, fixed step</strong>, at 0.2 µs; "
        "for errors of 1e-4 to 1e-8 m <strong>dop853</strong>, at 3 µs"
    )


@pytest.mark.parametrize(("us", "text"), [(0.06, "17 000"), (1.0, "1 000"), (250.0, "4"), (3e3, "0.33")])
def test_real_time_factor(us: float, text: str) -> None:
    assert picks.factor(us) == text


def test_slope_is_the_order() -> None:
    line = [
        Marker("fall", "whipping", "rk4", "step", h, "s", 2e5 * h**4 + 1e-13, 1.0, 1.0, 1, False, "complete")
        for h in (1e-2, 1e-3, 5e-4, 1e-4)
    ]
    # Round-off in the last error is 1e-13 of 2e-11: it changes the slope over two decades of steps by less than 1e-2.
    assert figures.fitted_slope(line, 1e-15) == pytest.approx(4, abs=0.01)
    # Only two errors are ten times the reference's own error.
    assert math.isnan(figures.fitted_slope(line, 1e-8))


def test_a_table_says_where_it_comes_from(measured: Path) -> None:
    table = tables.read(measured / "data" / "precision.csv")
    assert table.about == ABOUT and len(table.rows) == len(precision())
    assert not tables.read(measured / "none.csv")


def test_nothing_to_draw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert write_report.main(options(tmp_path)) == 1
    assert "cargo xtask report" in capsys.readouterr().err


def test_the_page_has_its_sections_and_stands_alone(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.findall(r'<section id="([^"]+)"', text) == SECTIONS
    assert re.findall(r'<li><a href="#([^"]+)"', text) == SECTIONS
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids)), "an id twice"
    assert {link for link in re.findall(r'href="#([^"]+)"', text)} <= set(ids)
    assert "{{" not in text
    # Names of XML vocabularies are not addresses: nothing is fetched.
    outside = [url for url in re.findall(r'(?:src|href)="(https?:[^"]+)"', text)]
    assert outside == []
    assert ABOUT in text


def test_every_figure_has_its_data_beside_it(page: Path) -> None:
    found = re.findall(r"<figure.*?</figure>", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(found) == FIGURES
    for figure in found:
        links = re.findall(r'href="(data/[^"]+)"', figure)
        assert links and all((page.parent / link).is_file() for link in links)
        assert 'role="img" aria-label="' in figure and "viewBox" in figure


def test_what_failed_and_what_is_left_out_is_said(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for scene, kind, _ in SCENES:
        failed = (
            f"<tr><td>{scene}</td><td>rk4</td><td>4 ms</td><td>ended early: &lt;never&gt; converged</td></tr>" in text
        )
        assert failed == (kind != "driven")
    assert text.count(f"<li>haptic, 2 s: i3alp, fixed step at 4 ms; rk4 at 4 ms: {HELD}</li>") == text.count(HELD) == 1
    for command in (
        "cargo xtask hard-cases",
        "cargo xtask peers",
        "cargo xtask bench",
        "cargo xtask run --scene paper_torque",
    ):
        assert f"<code>{command}</code> measures it" in text
    assert "below the reference's own error" in text
    assert text.count("The loads of this scene are too stiff for dop853") == 1


@pytest.mark.parametrize("content", ["", "old\n"])
def test_docs_are_rewritten_between_their_marks(tmp_path: Path, content: str) -> None:
    (tmp_path / "docs" / "notes").mkdir(parents=True)
    (tmp_path / docs.FILE).write_text(f"before\n{docs.BEGIN}\n{content}{docs.END}\nafter\n", encoding="utf-8")
    begin, end = docs.RATIOS
    (tmp_path / "docs/notes/automatic.md").write_text(f"before\n{begin}\n{content}{end}\nafter\n", encoding="utf-8")
    table, ratios = ["| a |", "| --- |", "| 1 |"], ["| b |", "| --- |", "| 2 |"]
    for _ in range(2):
        docs.update(tmp_path, table, ratios, ABOUT)
        own = (tmp_path / "docs/notes/automatic.md").read_text(encoding="utf-8")
        assert own == "\n".join(["before", begin, *ratios, "", f"Measured on: {ABOUT}", end, "after", ""])
        text = (tmp_path / docs.FILE).read_text(encoding="utf-8")
        assert text.startswith("before\n") and text.endswith("\nafter\n") and "old" not in text
        assert text.count(table[0]) == 1
        assert docs.table_of(text, docs.FILE) == table and f"]({docs.PICTURE})" in text and ABOUT in text
    with pytest.raises(ValueError, match="docs/accuracy.md must have the lines"):
        docs.block("no marks", docs.FILE)


def test_docs_show_the_table_and_the_picture() -> None:
    shown = (REPOSITORY / docs.FILE).read_text(encoding="utf-8")
    own = docs.table_of(shown, docs.FILE)
    assert [line.split("|")[1].strip() for line in own[2:]] == [f"{picks.power(wanted)} m" for wanted in picks.SHORT]
    assert f"]({docs.PICTURE})" in shown
    file = (REPOSITORY / docs.FILE).parent / docs.PICTURE
    # One panel per kind of scene, each some 50 kB.
    assert 0 < file.stat().st_size < 60_000 * len(own[0].split("|")[2:-1])


@pytest.fixture
def browser(page: Path, tmp_path: Path) -> Iterator[object]:
    """A browser that has the page open."""
    with open_browser(page.as_uri(), tmp_path) as driver:
        yield driver


@pytest.mark.full
def test_in_a_browser(browser: object) -> None:
    """On a screen and on a phone no word or picture overflows; the contents link to sections; folded parts open for the printer."""
    assert "accuracy" in browser.title
    for width in (1280, 390):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
        drawn = browser.execute_script(
            "return [...document.querySelectorAll('figure svg')].map(s => [s.getBoundingClientRect().width, s.getBBox().width])"
        )
        assert len(drawn) == FIGURES and all(shown > 200 and content > 0 for shown, content in drawn)
    browser.find_element("css selector", 'nav a[href="#failures"]').click()
    assert browser.execute_script("return location.hash") == "#failures"
    paper = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    # Some pages of drawings; an empty one has a thousandth of that.
    assert len(paper["data"]) > 100_000
    assert browser.execute_script("return [...document.querySelectorAll('details')].every(d => d.open)")


def test_notes_in_pictures_overlap_nothing_and_appear_once() -> None:
    """Three panels with lines that lie on each other."""
    scenes = [Reference(f"scene {i}", "smooth", 1e-16, "made up") for i in range(3)]
    markers = [
        Marker(
            s.scene,
            s.kind,
            method,
            "tolerance",
            10.0**-k,
            "rad",
            10.0**-k,
            0.1 * (1 + 0.004 * j) * 1.25**k,
            1.0,
            1,
            False,
            "complete",
        )
        for s in scenes
        for j, method in enumerate(figures.COLOURS)
        for k in range(1, 14)
    ]
    figure = figures.work_precision(markers, scenes)
    figure.draw_without_rendering()
    for axes, scene in zip(figure.axes, scenes):
        notes = [note for note in axes.texts if note.get_text() in {m.setting for m in markers}]
        boxes = [note.get_window_extent() for note in notes]
        assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
        points = axes.transData.transform([(m.cost, m.error) for m in markers if m.scene == scene.scene])
        assert not [(box, point) for box in boxes for point in points if box.contains(*point)]
        # Markers of equal settings coincide, because all methods are equally good here.
        assert len({note.get_text() for note in notes}) == len(notes) > 3


def test_hard_cases_are_in_the_column_of_their_setting_or_span_the_line() -> None:
    """Runs with special settings or of several methods belong to no column."""
    columns = [("i3alp", "default tolerance"), ("dop853", "tolerance 1e-10 rad")]
    made_up = [(1, "falls", *column) for column in columns]
    made_up += [
        (10, "followed", *columns[1]),
        (6, "tolerances", "i3alp", "own settings"),
        (8, "same bits", "all", "a sample"),
    ]
    names = ("item", "case", "method", "setting", "runs", "not met", "ended early", "worst |dE| [mgL]", "verdict")
    figure = hard_cases.matrix(
        [dict(zip(names, (str(item), *row, "2", "0", "0", "1e-9", "pass"))) for item, *row in made_up]
    )
    [axes] = figure.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "falls   1",
        "tolerances   6",
        "same bits   8",
        "followed   10",
    ]
    assert [(*cell.get_xy(), cell.get_width()) for cell in axes.patches] == [
        (0, 0, 1),
        (1, 0, 1),
        (1, 3, 1),
        (0, 1, 2),
        (0, 2, 2),
    ]
    assert "2 runs, i3alp, own settings" in {text.get_text() for text in axes.texts}


HARD_CASES = (
    "item",
    "case",
    "method",
    "setting",
    "runs",
    "not met",
    "ended early",
    "status",
    "worst |dE| [mgL]",
    "worst Phi [m]",
    "worst Phidot [m/s]",
)
HARD_CASES += ("mean sub-steps", "criterion", "verdict")


def hard_row(item: int, case: str, column: tuple[str, ...], energy: str = "1.00e-9", **others: str) -> dict[str, str]:
    """A row of hard-cases.csv."""
    values = (
        item,
        case,
        *column[:2],
        1000,
        0,
        0,
        "",
        energy,
        "2.0e-16",
        "3.0e-15",
        "0.50",
        "complete, |dE| <= 1e-2 mgL",
        "pass",
    )
    return dict(zip(HARD_CASES, map(str, values))) | others


def battery() -> list[dict[str, str]]:
    """A row of every item by every column."""
    d = hard_cases_in_docs
    columns = (d.DEFAULT, d.TIGHT, d.EXPLICIT, d.AUTOMATIC, *d.CONSERVING)
    names = [(1 + i % 7, case) for i, case in enumerate(case for cases in d.BARE.values() for case in cases)]
    rows = [
        hard_row(item, case, column)
        for item, case in [*names, (8, "same bits"), (9, "stops"), (10, "followed")]
        for column in columns
    ]
    compared = hard_row(1, "exact crossings", ("rk4", "1 ms"), "2.67e9", verdict="for comparison")
    fallen = hard_row(6, "steps of load", d.CONSERVING[1], "0.00e0", status="3 x of 5000 steps by the fallback")
    worse = hard_row(4, "coaxial motors, rest in line", d.DEFAULT, "2.00e-9")
    replaced = {tuple(row[name] for name in HARD_CASES[1:4]): row for row in (*rows, compared, fallen, worse)}
    return list(replaced.values())


def written(folder: Path, rows: list[dict[str, str]]) -> Path:
    """The folder of a battery with its table and empty pictures."""
    folder.mkdir(exist_ok=True)
    with (folder / "hard-cases.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, HARD_CASES)
        table.writeheader()
        table.writerows(rows)
    for name in hard_cases_in_docs.PICTURES:
        (folder / f"{name}.svg").write_text("<svg/>", encoding="utf-8")
    return folder


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the pages that the commands update, used instead of the repository's."""
    for name in (
        docs.FILE,
        "docs/notes/automatic.md",
        step_times_in_docs.NOTES,
        hard_cases_in_docs.PAGE,
        hard_cases_in_docs.NOTES,
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((REPOSITORY / name).read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "docs/images").mkdir()
    for script in (hard_cases_in_docs, step_times_in_docs, write_report):
        monkeypatch.setattr(script, "ROOT", tmp_path)
    return tmp_path


def test_hard_cases_are_written_into_their_pages(copied: Path) -> None:
    folder = written(copied / "battery", battery())
    assert hard_cases_in_docs.main([f"--folder={folder}"]) == hard_cases_in_docs.main([f"--folder={folder}"]) == 0
    page, notes = (
        (copied / name).read_text(encoding="utf-8") for name in (hard_cases_in_docs.PAGE, hard_cases_in_docs.NOTES)
    )
    # The worst of the cases on one line.
    assert (
        "| coaxial motors | 2000 | 2.00e-9 | 1.00e-9 | 1.00e-9 |" in page
        and "leaves at most 2.0e-16 m and 3.0e-15 m/s" in page
    )
    assert (
        "| steps of load | 1000 | 1.00e-9 | 0 | 1.00e-9 | 1e-2 | 2.0e-16 | 3.0e-15 | 0 / 0 / 0 | 0 / 3 / 0 |" in notes
    )
    assert (
        "| exact crossings | rk4 | 1 ms | 0 | 0 | 1000 | 2.67e9 |" in notes
        and "| stops | 1.00e-9 | 1.00e-9 | 1.00e-9 | 1.00e-9 |" in notes
    )
    assert sorted(file.stem for file in (copied / "docs/images").iterdir()) == sorted(hard_cases_in_docs.PICTURES)


def test_times_and_work_of_steps_are_written_into_their_notes(
    measured: Path, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert step_times_in_docs.main([f"--folder={measured / 'bench'}"]) == 0
    notes = (copied / step_times_in_docs.NOTES).read_text(encoding="utf-8")
    lines = ["| 1 ms | 400,000 | 2 | 8 | 618 | 16.6 | 0 | 0 |", "| 1 ms | 0 | 2 | 8 | 12 | 0 | 0 | 208 |"]
    assert docs.table_of(notes, step_times_in_docs.NOTES, step_times_in_docs.MARKS)[2:] == lines
    assert (copied / "docs/images/step-times.svg").is_file()
    work = (
        (measured / "bench/step-work.csv").read_text(encoding="utf-8").replace(str(step_times_in_docs.STEPS), "100000")
    )
    (copied / "step-work.csv").write_text(work, encoding="utf-8")
    (copied / "step-times.csv").write_text(
        (measured / "bench/step-times.csv").read_text(encoding="utf-8"), encoding="utf-8"
    )
    assert step_times_in_docs.main([f"--folder={copied}"]) == 1 and "of a sample" in capsys.readouterr().err
    assert (copied / step_times_in_docs.NOTES).read_text(encoding="utf-8") == notes


def test_the_report_writes_all_that_it_measures_into_the_docs(
    measured: Path, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Tests above judge the page.
    monkeypatch.setattr(write_report, "write", lambda *_: None)
    given = [
        f"--hard-cases={written(copied / 'battery', battery())}" if "hard-cases" in option else option
        for option in options(measured)
    ]
    assert write_report.main([*given, "--update-docs"]) == 0
    assert {file.stem for file in (copied / "docs/images").iterdir()} == {
        "accuracy",
        "step-times",
        *hard_cases_in_docs.PICTURES,
    }
    for name in (docs.FILE, "docs/notes/automatic.md"):
        assert f"Measured on: {ABOUT}" in (copied / name).read_text(encoding="utf-8")
    assert "2000 | 2.00e-9" in (copied / hard_cases_in_docs.PAGE).read_text(encoding="utf-8")
    assert "| 618 | 16.6 |" in (copied / step_times_in_docs.NOTES).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ([row | {"runs": "20"} for row in battery()], "the table is of a sample"),
        ([row for row in battery() if row["item"] != "10"], "items are missing"),
        (
            [*battery(), hard_row(9, "touches", ("dop853", "tight"), verdict="FAIL")],
            "cases are not met: touches by dop853",
        ),
    ],
)
def test_docs_are_not_written_from_some_hard_cases(
    copied: Path, rows: list[dict[str, str]], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (copied / hard_cases_in_docs.PAGE).read_text(encoding="utf-8")
    assert hard_cases_in_docs.main([f"--folder={written(copied / 'battery', rows)}"]) == 1
    assert why in capsys.readouterr().err
    assert (copied / hard_cases_in_docs.PAGE).read_text(encoding="utf-8") == before and not any(
        (copied / "docs/images").iterdir()
    )


def test_docs_show_the_hard_cases_of_one_run() -> None:
    """The table on the page has the same numbers as the tables in the notes."""
    d = hard_cases_in_docs
    page, notes = ((REPOSITORY / name).read_text(encoding="utf-8") for name in (d.PAGE, d.NOTES))
    rows = []
    for name, columns in (
        ("default method", [d.DEFAULT, d.TIGHT]),
        ("explicit method", [d.EXPLICIT]),
        ("conserving step", d.CONSERVING),
    ):
        for line in docs.table_of(notes, d.NOTES, d.marks(name))[2:]:
            item, case, runs, *cells = (cell.strip() for cell in line.strip("|").split(" | "))
            violations = dict(zip((d.POSITION, d.VELOCITY), cells[2:4])) if name == "default method" else {}
            rows += [
                hard_row(int(item), case, column, energy, runs=runs, **violations)
                for column, energy in zip(columns, cells)
                if energy
            ]
    shown = docs.block(page, d.PAGE, d.marks("bare machine")).strip("\n").splitlines()
    assert shown == d.bare_machine(rows) and len(shown) > len(d.BARE) and rows[0]["runs"] == str(d.FALLS)
