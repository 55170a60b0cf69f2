"""Text of the page: one function per section."""

import html
import itertools
import re

import numpy as np

import hard_cases
from peers import ahead
from report import figures, more_figures, picks
from report.page import Section, table
from report.tables import Marker, Measurements, Reference, by_kind, setting


def run(m: Measurements, about: str) -> Section:
    """1: the runs, the machine, how to repeat them."""
    section = Section("run", "What was run, where, how to repeat it")
    section.text(
        "<code>cargo xtask report</code> builds the measuring programs with the release profile, runs them on this machine and writes "
        "this page to <code>target/report/index.html</code>, with all tables in <code>target/report/data/</code>. "
        "<code>--quick</code> takes a sample of everything, <code>--reuse</code> only draws the last measurements again."
    )
    section.text(f"This page was drawn from: {html.escape(about)}.")
    tables = [(t.file.name, t.about) for t in vars(m).values() if t.about and t.about != about]
    if tables:
        section.text("Some tables are from other runs:")
        section.bullets([f"<code>{html.escape(name)}</code>: {html.escape(text)}" for name, text in tables])
    section.text(
        "Each run takes communication steps of 1 ms (or of the internal step, where that is longer), as a co-simulation master "
        "would; only the tip is read, at the reference's times. Inputs that change are held for 1 ms each, as in the reference. All methods run in "
        "turn within one process, round after round; the median of the rounds counts, on one core. The error is the largest distance of the tip from the reference at the reference's times."
    )
    return section


def need(markers: list[Marker], references: list[Reference]) -> Section:
    """2: the table of wanted accuracy."""
    section = Section("need", "I need an error below …")
    section.text(
        "The cheapest setting that was measured and stays below the wanted error, as all finer ones of its method do, and the cheapest of "
        "the other methods. Errors are "
        "those of the whole run, so a setting is good for motions of a similar kind that last as long as the scene. µs per ms: microseconds of one core per "
        "simulated millisecond."
    )
    cells = [
        [r.kind, html.escape(r.scene), *(answer(picks.pick(markers, r, wanted)) for wanted in picks.SHORT)]
        for r in references
    ]
    section.parts.append(table(["kind", "scene", *(f"{picks.power(wanted)} m" for wanted in picks.SHORT)], cells))
    section.text("The time is that of one simulated millisecond. All decades, scene by scene:")
    for reference in references:
        section.folded(f"{reference.kind}: {html.escape(reference.scene)}", decades(markers, reference))
    head, rows = picks.ratio_table(markers, references)
    if rows:
        section.text(
            "What <code>automatic</code>, which chooses the kind of its steps by itself, takes over what the best of the other methods "
            f"takes; bold: more than {picks.FAIR}. Where two are of one kind of step, what differs from 1 is the choice or luck:"
        )
        cells = [
            [
                html.escape(cell[2:-2]).join(("<b>", "</b>")) if cell.startswith("**") else html.escape(cell)
                for cell in row
            ]
            for row in rows
        ]
        section.parts.append(table(head, cells, tuple(range(1, len(head)))))
    section.text('Data: <a href="data/precision.csv">precision.csv</a>.')
    return section


def answer(choice: picks.Pick) -> str:
    """A cell of the overview."""
    if choice.best is None or not choice.resolved:
        return f'<span class="none">{picks.answer(choice)}</span>'
    return f"<b>{choice.best.method}</b><br>{choice.best.setting}: {picks.cost(choice.best.cost)} µs"


def decades(markers: list[Marker], reference: Reference) -> str:
    """The table of a scene: the method for each wanted error."""
    rows = []
    for choice in picks.picks(markers, reference):
        wanted = f"{picks.power(choice.wanted)} m"
        if not choice.resolved:
            rows.append([wanted, '<span class="none">below the reference\'s own error</span>', "", "", "", "", ""])
        elif choice.best is None:
            rows.append([wanted, '<span class="none">reached by nothing measured</span>', "", "", "", "", ""])
        else:
            best, second = choice.best, choice.second
            other = f"{second.method}, {second.setting}: {picks.cost(second.cost / best.cost)} ×" if second else "none"
            cells = [wanted, f"<b>{best.method}</b>", f"{best.knob} {best.setting}", f"{best.error:.1e} m"]
            rows.append([*cells, picks.cost(best.cost), picks.factor(best.cost), other])
    head = [
        "error below",
        "method",
        "setting",
        "its error",
        "µs per ms",
        "× real time",
        "next method, cost against the first",
    ]
    stiff = sorted({m.method for m in markers if m.scene == reference.scene and m.stiff})
    note = (
        f"<p>The loads of this scene are too stiff for {' and '.join(stiff)}: its steps were limited by its stability and not by the "
        "wanted error, whatever the tolerance. The unit's log says so in such a run.</p>"
    )
    return table(head, rows, (4, 5)) + (note if stiff else "")


def precision(markers: list[Marker], references: list[Reference]) -> Section:
    """3: work and precision."""
    section = Section("precision", "Error against time")
    section.text(
        "Lower and further left is better. Step or tolerance stands beside the ends of each line and every third marker, where there is room."
    )
    for kind, scenes in by_kind(references).items():
        caption = f"Work and precision, {kind}: a line per method, from its coarsest to its finest setting. Runs that ended early are left out."
        section.figure(
            figures.work_precision(markers, scenes),
            f"precision-{name_of(kind)}",
            caption,
            ["precision.csv", "references.csv"],
        )
    return section


def name_of(kind: str) -> str:
    """A kind in the form of an id."""
    return kind.replace(" ", "-")


def order(markers: list[Marker], references: list[Reference], energy: list[dict[str, str]]) -> Section:
    """4: error against step, the references, and energy."""
    section = Section("order", "Error against step and tolerance, and how good the references are")
    for kind, scenes in by_kind(references).items():
        caption = (
            f"{kind.capitalize()}. Left: error against step, slopes by least squares where the order shows. Right: error against "
            "tolerance. Grey: below the reference's own error no error can be measured."
        )
        section.figure(
            figures.order(markers, scenes), f"order-{name_of(kind)}", caption, ["precision.csv", "references.csv"]
        )
    rows = [[r.kind, html.escape(r.scene), f"{r.own_error:.1e} m", html.escape(r.source)] for r in references]
    section.parts.append(table(["kind", "scene", "own error of the reference", "where it comes from"], rows))
    if energy:
        section.parts.append("<h3>Energy over 50 s</h3>")
        section.text(
            "Beyond the horizon of the next section no error of position means anything; energy still does. The scene has no input and "
            "no friction, so its energy must stay constant. 1 mgL is 0.035 J."
        )
        caption = "Largest energy error of the fall over 50 s. Settings that ended early or are more than 1000 mgL off are in section 11."
        section.figure(figures.energy(energy), "energy", caption, ["energy.csv"])
    return section


def horizon(m: Measurements) -> Section:
    """5: the predictability horizon."""
    section = Section("horizon", "How far ahead a motion can be predicted")
    section.text(
        "The fall is chaotic: a difference grows by a factor e within some tenths of a second while links whip, so each further second "
        "costs digits, and double precision ends where its round-off has grown to the size of the machine. Beyond that only energy, "
        "constraints and repetition to the bit mean anything."
    )
    caption = "Time until the tip is more than 1 mm away from the best run (dop853 at 1e-14 rad), scene fall_90_120."
    section.figure(figures.horizon(m.horizon.rows), "horizon", caption, ["horizon.csv"])
    if m.growth:
        pairs: dict[str, list[tuple[float, float]]] = {}
        for row in m.growth.rows:
            pairs.setdefault(row["pair"], []).append((float(row["time [s]"]), float(row["difference [rad]"])))
        caption = "Two runs whose start differs by 1e-12 rad/s, at steps of 10 µs: how fast they part. E-fold times within the grey band."
        figure = hard_cases.horizon({name: np.array(pair) for name, pair in pairs.items()})
        section.figure(figure, "growth", caption, ["growth.csv"])
    return section


def steps(m: Measurements) -> Section:
    """6: the cost of single milliseconds."""
    section = Section("steps", "What single milliseconds cost")
    section.text(
        "In real time the slowest call counts, not the mean. Left: the least time of each call over some repeats of the "
        "same run, which is what the method needs. Right: a single run, with everything else that the machine did meanwhile."
    )
    caption = "Share of the calls of 1 ms, each followed by reading the tip, that take longer than a time, fall_90_120."
    section.figure(more_figures.step_times(m.steps.rows), "steps", caption, ["steps.csv"])
    caption = "Sub-steps and iterations against the smallest singular values, a dot per call. Many of them are due to whips, which happen near singularities but reach beyond them."
    section.figure(more_figures.near_singularities(m.steps.rows), "singular", caption, ["steps.csv"])
    section.parts.append("<h3>Every strictly fixed step</h3>")
    if m.step_times:
        section.text(
            "What a real-time user looks for: each step of the perturbed falls by i3alpConserving, timed alone, the rescues of rare steps included."
        )
        caption = "How many steps take how long; the clock's own calls, some 0.05 µs, are part of it. docs/conserving.md says how the longest are bounded."
        section.figure(more_figures.histogram(m.step_times.rows), "histogram", caption, ["step-times.csv"])
    else:
        section.missing("the histogram of strictly fixed steps", "cargo xtask bench")
    if m.calls:
        section.parts.append("<h3>By scene</h3>")
        section.text(
            "At the default settings, one call for each communication step of the scene. The largest time is mostly due to the machine."
        )
        head = [
            "scene",
            "calls",
            "step, ms",
            "mean, µs",
            "p50, µs",
            "p99, µs",
            "largest, µs",
            "mean sub-steps",
            "most sub-steps",
        ]
        section.parts.append(table(head, [calls_of(row) for row in m.calls.rows], tuple(range(1, len(head)))))
        section.text('Data: <a href="data/scenes.csv">scenes.csv</a>.')
    else:
        section.missing("sub-steps and times per call for every scene", "cargo xtask bench")
    return section


def calls_of(row: dict[str, str]) -> list[str]:
    """A row of the table by scene, in readable units."""
    times = [picks.cost(1e-3 * float(row[f"{which}_ns"])) for which in ("mean", "p50", "p99", "largest")]
    step = f"{1e3 * float(row['communication_step_s']):g}"
    return [
        html.escape(row["scene"]),
        row["calls"],
        step,
        *times,
        f"{float(row['mean_substeps']):.2f}",
        row["most_substeps"],
    ]


def effects(m: Measurements) -> Section:
    """7: the price list."""
    section = Section("effects", "What effects cost")
    if m.effects:
        section.text(
            "An effect that is off costs nothing: it is not in memory. What it costs when it is on, at a fixed step of i3alp:"
        )
        caption = "Instructions of a step with the effect on, relative to gravity only; instructions do not depend on the load of the machine."
        section.figure(more_figures.prices(m.effects.rows), "effects", caption, ["effects.csv"])
    else:
        section.missing("the price list of effects", "cargo xtask bench")
    return section


def matrix(m: Measurements) -> Section:
    """8: the hard cases."""
    section = Section("hard-cases", "Hard cases")
    if m.hard_cases:
        section.text(
            "Motion through and near singularities, and how each method copes with it; docs/hard-cases.md explains the cases."
        )
        caption = "Worst energy error by case and method, and how many runs do not meet the demand."
        section.figure(hard_cases.matrix(m.hard_cases.rows), "hard-cases", caption, ["hard-cases.csv"])
    else:
        section.missing("the matrix of hard cases", "cargo xtask hard-cases")
    return section


PAPER = {"paper_torque": ("Fig. 2", "Fig. 3"), "paper_free_fall": ("Fig. 4", "Fig. 5")}
"""Scenes of the paper, with its figures of x and of y."""


def paper(curves: dict[str, dict[str, np.ndarray]]) -> Section:
    """9: the paper's figures; `curves` by scene."""
    section = Section("paper", "The paper's Figs. 2 to 5")
    section.text("The motions that the paper shows, through the packed .fmu, at the default settings.")
    for scene, figures_of_paper in PAPER.items():
        if scene in curves:
            caption = f"Position of the tip in the scene {scene}, as in the paper's {figures_of_paper[0]} and {figures_of_paper[1]}."
            section.figure(more_figures.paper(curves[scene], figures_of_paper), scene, caption, [f"{scene}.csv"])
        else:
            section.missing(f"the curves of {scene}", f"cargo xtask run --scene {scene}")
    section.text(
        "The free fall is symmetric until round-off breaks the symmetry after some seconds, which the paper's run shows as well; after "
        "that no two programs show the same curve."
    )
    return section


def peers(m: Measurements) -> Section:
    """10: other programs."""
    section = Section("peers", "Other programs on the same scene")
    if not m.peers:
        section.missing("all other programs: none is needed to make this page", "cargo xtask peers")
        return section
    section.text(
        "<code>cargo xtask peers</code> runs them and the packed unit over the same scenes, one after the other on one core; "
        "docs/notes/peers.md says how. Times are processor times of the process that does the work, without building the model."
    )
    section.parts.append("<h3>Who is ahead</h3>")
    section.text(
        "For each wanted error of the tip after 1 s and after 2 s our cheapest setting and the time of the cheapest setting of each peer, "
        "relative to ours, in a motion that whips and in a smooth one. Both are means over the 2 s of the run. A small error by luck "
        "counts for a peer; one of our settings counts only if all dearer ones of its method are good enough as well."
    )
    for scene, second in itertools.product(ahead.SCENES, (1, 2)):
        head, *lines = [
            [html.escape(cell) for cell in line] for line in ahead.cells(ahead.table(m.peers.rows, scene, second))
        ]
        section.parts.append(f"<h3>Error after {second} s of {scene}</h3>")
        section.parts.append(table(head, lines, tuple(range(2, len(head)))))
    head, *lines = [[html.escape(cell) for cell in line] for line in ahead.energies(m.peers.rows)]
    section.parts.append(f"<h3>Energy over 50 s of {ahead.ENERGY_SCENE} at strictly fixed steps of 1 ms</h3>")
    section.parts.append(table(head, lines, (2,)))
    caption = "Error of the tip after 1 s against time, each program at several settings; FiveBar through the .fmu, in steps of 1 s."
    section.figure(more_figures.peers(m.peers.rows), "peers", caption, ["peers.csv"])
    absent = [row for row in m.peers.rows if not row["scene"]]
    ended = [row for row in m.peers.rows if row["scene"] and row["note"]]
    section.parts.append("<h3>What failed or was left out</h3>")
    section.bullets(
        [f"{html.escape(row['peer'])}: {html.escape(row['note'])}" for row in absent] or ["Nothing was left out."]
    )
    head = ["peer", "scene", "settings", "note"]
    section.parts.append(table(head, [[html.escape(row[name]) for name in head] for row in ended]))
    head = list(m.peers.rows[0])
    cells = [[html.escape(shortened(row[h])) for h in head] for row in m.peers.rows]
    section.folded("all settings of all peers", table([html.escape(h.replace("_", " ")) for h in head], cells))
    return section


def shortened(cell: str) -> str:
    """Three digits instead of seventeen."""
    value = more_figures.number(cell)
    return f"{value:.3g}" if np.isfinite(value) else cell


def failed(m: Measurements, markers: list[Marker]) -> dict[tuple[str, str, str], list[str]]:
    """Failed settings, by scene, method and reason."""
    found: dict[tuple[str, str, str], list[str]] = {}

    def add(scene: str, method: str, chosen: str, ending: str, off: str) -> None:
        # An ending contains time, reason, and numbers of one run.
        why = re.sub(r" at [\d.]+ s", "", re.split(r"[:;,] (?:after|\d)", ending)[0]) if ending != "complete" else off
        found.setdefault((scene, method, html.escape(why)), []).append(chosen)

    for r in markers:
        if not r.left_out and (not r.complete or r.error >= figures.USELESS):
            add(r.scene, r.method, r.setting, r.ending, f"ran to the end, more than {figures.USELESS:g} m off")
    for row in m.energy.rows:
        if row["ending"] != "complete" or float(row["worst |dE| [mgL]"]) > 1:
            add(
                "energy over 50 s",
                row["method"],
                setting(row["knob"], float(row["value"])),
                row["ending"],
                "ran to the end, energy more than 1 mgL off",
            )
    return found


def listed(settings: list[str]) -> str:
    """`0.1, 0.05 ms`: the settings of a method share their unit."""
    values, units = zip(*(text.split(" ") for text in settings))
    return f"{', '.join(values)} {units[0]}"


def failures(m: Measurements, markers: list[Marker]) -> Section:
    """11: failures, omissions, and possible bias of the comparison."""
    section = Section("failures", "What failed, was left out, or could bias the comparison")
    section.parts.append("<h3>Failed</h3>")
    rows = [
        [html.escape(scene), method, listed(settings), why]
        for (scene, method, why), settings in failed(m, markers).items()
    ]
    if rows:
        section.parts.append(table(["scene", "method", "settings", "what happened"], rows))
        section.text("The exact messages and times are in precision.csv and energy.csv.")
    else:
        section.text("Nothing.")
    section.parts.append("<h3>Left out</h3>")
    absent = [t.file.name for t in vars(m).values() if not t]
    left_out = [f"the table <code>{html.escape(name)}</code> was missing" for name in absent]
    aside: dict[tuple[str, str], dict[str, list[str]]] = {}
    for r in markers:
        if r.left_out:
            aside.setdefault((r.scene, r.left_out), {}).setdefault(r.method, []).append(r.setting)
    for (scene, why), chosen in aside.items():
        settings_of = "; ".join(f"{method} at {listed(settings)}" for method, settings in chosen.items())
        left_out.append(html.escape(f"{scene}: {settings_of}: {why}"))
    left_out.append(
        "settings coarser or finer than those in the tables; fixed steps below 10 µs; the cost of reading more than the tip, and of the FMI calls"
    )
    section.bullets(left_out)
    section.parts.append("<h3>What could bias it</h3>")
    spreads = sorted(r.spread for r in markers if r.complete)
    spread = (
        f"the slowest round took {spreads[len(spreads) // 2]:.2g} times the fastest in the median, at most {spreads[-1]:.2g} times"
        if spreads
        else ""
    )
    bias = [
        f"The machine did other things too: {spread}. The load at the start stands in section 1; instruction counts (section 7) do not depend on it.",
        "One machine, one compiler: other processors may order methods of similar cost differently.",
        "All methods are ours and share the mechanism's code, so they compare methods, not programs; the peers in section 10 are other people's programs.",
        "The settings form a grid, by decades or so: between two markers a cheaper setting may exist.",
        "The error of a whole run is its largest at the reference's times; between them it may be larger near a whip.",
    ]
    section.bullets(bias)
    return section
