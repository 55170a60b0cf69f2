"""The comparison with peers: which is faster, contents of the report, and control of programs; needs no peer."""

import ast
import json
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import peers_in_docs
from conftest import REPOSITORY
from peers import ahead, native, timing
from report import docs, sections, tables

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="peers are driven on Unix")

HEAD = (
    "scene",
    "peer",
    "version",
    "settings",
    "error_1s_m",
    "error_2s_m",
    "ms_per_simulated_second",
    "energy_error_mgL",
    "note",
)
FALL = ahead.SCENES[0]


def row(peer: str, settings: str, error: object, ms: object, note: str = "", scene: str = FALL) -> dict[str, str]:
    """A row of peers.csv; the error after 2 s is a hundred times the error after 1 s."""
    later = 100 * error if error else ""
    return dict(zip(HEAD, map(str, (scene, peer, "1.0", settings, error, later, ms, "", note))))


ROWS = [
    row("FiveBar dop853", "1e-4", 3e-3, 0.1),
    # A lucky result of FiveBar: the next more expensive setting is worse.
    row("FiveBar dop853", "1e-5", 1e-7, 0.15),
    row("FiveBar dop853", "1e-6", 2e-5, 0.2),
    row("FiveBar dop853", "1e-12", 5e-10, 0.4),
    row("FiveBar rk4", "1 ms", 5e-6, 0.6),
    row("FiveBar rk4", "4 ms", "", "", "ended after 0 s: gave up"),
    # A lucky result of a peer counts.
    row("Fast & rough", "coarse", 1e-3, 0.05),
    row("Fast & rough", "lucky", 1e-6, 1.2),
    row("Fast & rough", "fine", 1e-5, 30),
    row("Never", "any", "", "", "ended after 0 s: NaN"),
    # From another scene.
    row("Fast & rough", "fine", 1e-12, 0.01, scene="swing"),
    row("Absent", "", "", "", "left out: not installed (no <wheel>)", scene=""),
]


def test_the_cheapest_of_ours_against_the_cheapest_of_each_peer() -> None:
    answers = {f"{a.wanted:.0e}": a for a in ahead.table(ROWS, FALL, 1)}
    assert list(answers) == [f"1e-{n:02}" for n in range(2, 11)]
    assert (answers["1e-02"].method, answers["1e-02"].ratios) == (
        "dop853, 1e-4",
        {"Fast & rough": 0.05 / 0.1, "Never": None},
    )
    assert answers["1e-03"].method == answers["1e-04"].method == "dop853, 1e-5"
    # Not 1e-5, because the next more expensive setting is 2e-5 m off; nor rk4, which costs more than dop853 at 1e-12.
    assert answers["1e-05"].method == answers["1e-06"].method == "dop853, 1e-12"
    assert answers["1e-06"].ratios["Fast & rough"] == pytest.approx(
        1.2 / 0.4
    )  # a quotient of these numbers to a round-off
    assert answers["1e-08"].ratios["Fast & rough"] is None
    assert answers["1e-10"].method == ""
    assert ahead.table(ROWS, FALL, 2)[-2].method == "" and ahead.table(ROWS, FALL, 2)[5].method == "dop853, 1e-12"


def test_the_table_says_who_is_behind() -> None:
    lines = ahead.markdown(ahead.cells(ahead.table(ROWS, FALL, 1)))
    assert lines[0] == "| error below | ours | ms/s | Fast & rough | Never |"
    assert lines[2] == "| 1e-2 m | dop853, 1e-4 | 0.1 | 0.5 ×, behind | not reached |"
    assert lines[6] == "| 1e-6 m | dop853, 1e-12 | 0.4 | 3 × | not reached |"
    assert lines[-1] == "| 1e-10 m | not reached |  |  |  |"


def test_energies_are_compared_at_fixed_steps_of_a_millisecond() -> None:
    def of_fall(peer: str, settings: str, energy: object, note: str = "") -> dict[str, str]:
        return row(peer, settings, "", "", note, ahead.ENERGY_SCENE) | {"energy_error_mgL": str(energy)}

    rows = [
        of_fall("Fast & rough", "RK4, h = 0.001 s, C++ by g++ -O3", 0.9),
        of_fall("Fast & rough", "RK4, h = 0.0001 s", 0.1),
        of_fall(
            "FiveBar i3alp, fixed step",
            "solver.adaptive = False, solver.stepSize = 0.001",
            3,
            "ended after 12 s: gave up",
        ),
        of_fall("FiveBar i3alpConserving", "solver.stepSize = 0.001", 3e-11),
        of_fall("FiveBar dop853", "solver.errorTolerance = 0.001", 1e-3),
        of_fall("Never", "h = 0.001 s", "", "ended after 0 s: NaN"),
    ]
    assert ahead.energies(ROWS + rows)[1:] == [
        ["i3alpConserving", "solver.stepSize = 0.001", "3e-11", "50 s"],
        ["Fast & rough", "RK4, h = 0.001 s", "0.9", "50 s"],
        ["i3alp, fixed step", "solver.adaptive = False, solver.stepSize = 0.001", "3", "ended after 12 s"],
        ["Never", "h = 0.001 s", "", "ended after 0 s"],
    ]


def test_the_report_shows_them_all(tmp_path: object) -> None:
    section = sections.peers(SimpleNamespace(peers=tables.Table(tmp_path, "a made-up machine", ROWS)))
    text = "\n".join(section.parts)
    assert "0.5 ×, behind" in text
    assert "<li>Absent: left out: not installed (no &lt;wheel&gt;)</li>" in text
    assert "<td>Never</td><td>fall_90_120</td><td>any</td><td>ended after 0 s: NaN</td>" in text
    assert "Fast &amp; rough" in text and "Fast & rough" not in text
    assert text.count("<svg") == 1


# Answers like the peers' programs: each second costs 0.25 s and adds 1 to every number; fails after 2 s.
FAKE = """
import sys
angles = [float(word) for word in sys.argv[1:]]
for line in sys.stdin:
    t = float(line)
    if t > 2:
        sys.exit("the step became too small")
    print(t / 4, *(x + t for x in angles + [0.0] * 4), flush=True)
"""


def test_a_program_tells_its_own_time_and_why_it_ends() -> None:
    program = native.Program(sys.executable, "-c", FAKE)
    start = np.array([0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0])
    advance = program.begin(start)
    assert program.clock() == 0
    assert np.array_equal(advance(2.0), start + 2.0)
    assert program.clock() == 0.5
    with pytest.raises(RuntimeError, match="^the step became too small$"):
        advance(3.0)
    program.begin(start)
    assert program.clock() == 0, "a run begins with no time spent"


def test_a_program_that_sticks_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "BUDGET", 1)
    advance = native.Program(sys.executable, "-c", "while True: pass").begin(np.zeros(8))
    with pytest.raises(RuntimeError, match="^takes longer than"):
        advance(1.0)


@pytest.mark.parametrize(
    ("seconds", "runs"), [(1e-3, timing.MOST), (0.03, 7), (0.1, timing.LEAST), (0.4, timing.LEAST), (0.6, 1)]
)
def test_short_runs_are_repeated(seconds: float, runs: int) -> None:
    times = [seconds]
    while not timing.enough(times):
        times.append(seconds)
    assert len(times) == runs


def test_the_median_counts() -> None:
    assert timing.counted([0.1, 9.0, 0.2, 0.15, 0.01]) == 0.15


def test_a_compiler_that_is_not_there_is_named() -> None:
    with pytest.raises(native.CannotBuild, match="^no-such-compiler: No such file or directory$"):
        native.compiled("sundials.c", "no-such-compiler", [], [])


def test_the_peers_have_the_loads_of_the_scene() -> None:
    """Python and C each have their own copy of them."""
    scene = json.loads((native.REPOSITORY / "scenes/servo_friction.json").read_text(encoding="utf-8"))
    model = ET.parse(native.REPOSITORY / "modelDescription/modelDescription.xml")
    values = {v.get("name"): v[0].get("start") for v in model.iter("ScalarVariable")} | scene
    both = lambda name: {float(values[f"servo.{name}[{motor}]"]) for motor in (1, 2)}
    joints = lambda name: {float(values[f"{name}[{joint}]"]) for joint in range(1, 6)}
    wanted = {
        "KP": both("kp"),
        "KD": both("kd"),
        "LIMIT": both("limit"),
        "COULOMB": joints("friction.coulomb"),
        "BREAKAWAY": joints("friction.breakaway"),
        "VISCOUS": joints("viscous.b"),
        "BREAKAWAY_RATE": {float(values["friction.breakawayVelocity"])},
    }
    references = [float(values[f"servo.theta[{motor}]"]) for motor in (1, 2)]
    in_python = {}
    for line in ast.parse((native.REPOSITORY / "xtask/python/peers/machine.py").read_text(encoding="utf-8")).body:
        if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Tuple):
            try:
                in_python |= zip((name.id for name in line.targets[0].elts), ast.literal_eval(line.value))
            except ValueError:  # computed from others
                pass
    assert {name: {in_python[name]} for name in wanted} == wanted and list(in_python["REFERENCES"]) == references
    text = (native.SOURCES / "sundials.c").read_text(encoding="utf-8")
    in_c = {name: float(value) for name, value in re.findall(r"\b([A-Z_]+) = ([0-9.e-]+)[,;]", text)}
    assert {name: {in_c[name]} for name in wanted} == wanted
    assert f"REFERENCES[2] = {{{references[0]:g}, {references[1]:g}}}" in text
    text = (native.REPOSITORY / "xtask/python/peers/run.py").read_text(encoding="utf-8")
    left, right = re.search(r'"servo_friction": \(math.radians\(([0-9]+)\), ([0-9.]+), 1\)', text).groups()
    assert np.radians(float(left)) == float(values["init.theta[1]"]) and float(right) == scene["init.theta[2]"]


def test_docs_show_the_tables_of_all_peers(tmp_path: Path) -> None:
    own = REPOSITORY / peers_in_docs.FILE
    copy = tmp_path / peers_in_docs.FILE
    copy.parent.mkdir(parents=True)
    copy.write_text(own.read_text(encoding="utf-8"), encoding="utf-8")
    for _ in range(2):
        peers_in_docs.update(tmp_path, ROWS, "a machine; cargo xtask peers")
    text = copy.read_text(encoding="utf-8")
    ahead_of, energies = (docs.block(text, "", marks) for marks in (peers_in_docs.AHEAD, peers_in_docs.ENERGIES))
    assert all(f"(../../scenes/{scene}.json), after 1 s:" in ahead_of for scene in ahead.SCENES)
    shown = ahead.markdown(ahead.cells(ahead.table(ROWS, FALL, 1)))
    assert "\n".join(shown) in ahead_of and len(shown) > len(ahead.WANTED)
    assert ahead_of.count("Measured on: a machine") == energies.count("Measured on: a machine") == 1


PRESENT = [line for line in ROWS if line["scene"]]


@pytest.mark.parametrize(
    ("about", "rows", "missing"),
    [
        ("x; cargo xtask peers", PRESENT, ""),
        ("x; cargo xtask peers heyoka", PRESENT, "others than heyoka"),
        ("x; cargo xtask peers", [*PRESENT, row("Drake", "", "", "", "left out", scene="")], "Drake"),
    ],
)
def test_docs_are_not_written_from_some_peers(about: str, rows: list[dict[str, str]], missing: str) -> None:
    assert peers_in_docs.left_out(tables.Table(Path(), about, rows)) == missing
