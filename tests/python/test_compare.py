"""compare.py: judging differences of two builds, on made-up runs; and a build against itself."""

from pathlib import Path

import numpy as np
import pytest

import compare
from compare import Verdict
from fivebar.drive import Run
from made_scene import made_scene, write

TIME = np.arange(101) * 0.01


def made_up(rows: int = 101, failure: str | None = None, **columns: np.ndarray) -> Run:
    """A run in which all columns except `columns` are 0."""
    rest = {"time": TIME, "tip.x": np.zeros(101), "tip.y": np.zeros(101), "solver.substeps": np.arange(101)} | columns
    return Run("made up", 1.0, 0.01, {}, {name: column[:rows] for name, column in rest.items()}, {}, failure=failure)


def moved(by: float, since: float) -> np.ndarray:
    """A column that is 0 until `since`, s."""
    return np.where(since <= TIME, by, 0.0)


STILL = made_up()


def test_the_same_bits() -> None:
    """NaN equals NaN; an output that only one build has is not a difference."""
    nothing = {"energy.error": np.full(101, np.nan)}
    found = compare.difference(made_up(**nothing), made_up(**nothing, new=TIME))
    assert compare.verdict(found, []) is Verdict.SAME


def test_every_bit_counts() -> None:
    found = compare.difference(STILL, made_up(**{"tip.x": moved(-0.0, 0.3)}))
    assert (found.since, found.tip) == (0.3, 0.0) and compare.verdict(found, []) is Verdict.ROUND_OFF


def test_tips_are_held_together_for_half_a_second() -> None:
    late, early = (compare.difference(STILL, made_up(**{"tip.y": moved(2e-12, since)})) for since in (0.51, 0.5))
    assert (late.tip, early.tip) == (0.0, 2e-12)
    assert compare.verdict(late, []) is Verdict.ROUND_OFF
    assert compare.verdict(early, []) is compare.verdict(early, [late]) is Verdict.BROKEN
    assert compare.verdict(early, [late, early]) is Verdict.CHAOTIC


def test_counters_are_reported_and_tolerated() -> None:
    counted = np.arange(101) + (TIME > 0.2)
    found = compare.difference(STILL, made_up(**{"solver.substeps": counted}))
    assert found.counters == ("solver.substeps",) and compare.verdict(found, []) is Verdict.ROUND_OFF
    assert str(found) == "differ from 0.21 s on, tips by 0.0e+00 m up to 0.5 s; counted otherwise: solver.substeps"


@pytest.mark.parametrize("other", [made_up(), made_up(50, "too stiff"), made_up(51, "too long"), made_up(0, "too far")])
def test_runs_must_end_alike(other: Run) -> None:
    """A run that fails must fail at the same point with the same sentence, or chaos must explain it."""
    failing = made_up(51, "too stiff")
    assert compare.verdict(compare.difference(failing, failing), []) is Verdict.SAME
    found = compare.difference(failing, other)
    assert compare.verdict(found, []) is Verdict.BROKEN and compare.verdict(found, [found]) is Verdict.CHAOTIC
    assert str(found).startswith("an end at 0.5 s: too stiff but then ")


def test_a_build_is_what_it_is(fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "short.json", made_scene({"init.theta[2]": 2.0944}, 0.1))
    assert compare.main(["--before", str(fmu), "--after", str(fmu), "--scenes", str(tmp_path)]) == 0
    *lines, _, total = capsys.readouterr().out.splitlines()
    assert len(lines) == 7 and all(line.endswith("same bits") for line in lines)
    assert total.startswith("7 of 7 runs have the same bits, 0 differ by round-off")
