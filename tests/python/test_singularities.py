"""Detection of the singularities that a run met, on motions made up for the purpose."""

import math
from pathlib import Path

import numpy as np
import pytest

import singularities
from drive import Run, communication_points

LENGTH = 0.21


def made_up(between: np.ndarray, left: np.ndarray, right: np.ndarray, step: float = 1e-3) -> Run:
    """A run with the given angles: distal to distal link, and each leg's distal to proximal link."""
    zero = np.zeros(len(between))
    columns = {
        "time": np.arange(len(between)) * step,
        "passive.theta[1]": zero,
        "passive.theta[2]": between,
        "theta[1]": -left,
        "theta[2]": between - right,
        "singular.detJx": LENGTH**2 * np.sin(between),
    }
    parameters = {"link[2].length": LENGTH, "link[3].length": LENGTH}
    return Run("made up", columns["time"][-1], step, {}, columns, parameters)


def kinds(run: Run) -> list[tuple[str, str, str, str]]:
    """What was found, without times."""
    return [(e.kind, e.leg, e.posture, e.passage) for e in singularities.find(run)]


TIME = np.arange(1001) * 1e-3
CALM = np.full(1001, 1.0)


def test_nothing_to_find() -> None:
    assert singularities.find(made_up(CALM, CALM, -CALM)) == []


def test_crossings() -> None:
    """Fast ones, which no sample comes near to, and their times."""
    run = made_up(math.pi - 7 * (TIME - 0.40005), 5 * (TIME - 0.60005), math.pi + 5 * (TIME - 0.80005))
    found = singularities.find(run)
    near = {t: [(e.kind, e.leg, e.posture, e.passage) for e in found if abs(e.time - t) < 0.01] for t in (0.4, 0.6, 0.8)}
    assert near == {
        0.4: [("direct", "", "stretched", "crossed")],
        0.6: [("inverse", "left", "stretched", "crossed")],
        0.8: [("inverse", "right", "folded", "crossed")],
    }
    times = [e.time for e in found]
    assert times == sorted(times)
    assert [t for t in times if abs(t - 0.4) < 0.01] == [pytest.approx(0.40005, abs=1e-7)]


def test_a_slow_crossing_is_one_event() -> None:
    """Many samples below the threshold, one event."""
    run = made_up(0.01 * (TIME - 0.5), CALM, CALM)
    assert kinds(run) == [("direct", "", "folded", "crossed")]
    assert singularities.find(run)[0].time == pytest.approx(0.5, abs=1e-9)


def test_a_touch() -> None:
    """The leg comes within 5e-4 of its stretched posture and turns back."""
    run = made_up(CALM, 5e-4 + (TIME - 0.3) ** 2, CALM)
    assert kinds(run) == [("inverse", "left", "stretched", "touched")]
    assert singularities.find(run)[0].time == pytest.approx(0.3, abs=1e-9)


def test_a_near_miss_is_no_event() -> None:
    assert kinds(made_up(CALM, 2e-3 + (TIME - 0.3) ** 2, CALM)) == []


def test_a_start_in_a_singularity() -> None:
    """The paper's free fall: distal links in line at the start, up to the last bits of pi."""
    run = made_up(math.pi + 1e-16 - 4 * TIME**2 * 0.2, CALM, CALM)
    assert kinds(run) == [("direct", "", "stretched", "start")]
    assert singularities.find(run)[0].time == 0.0


def test_a_stay_is_one_event() -> None:
    """A leg that stays folded, its sign being noise."""
    noise = 1e-9 * np.where(np.arange(1001) % 2, 1, -1)
    away = np.where((TIME > 0.2) & (TIME < 0.7), 0.0, 0.5)
    assert kinds(made_up(CALM, CALM, math.pi + noise + away)) == [("inverse", "right", "folded", "touched")]


def test_csv_and_count(tmp_path: Path) -> None:
    run = made_up(0.01 * (TIME - 0.5), 5e-4 + (TIME - 0.3) ** 2, CALM)
    found = singularities.find(run)
    singularities.write(tmp_path / "singularities.csv", found)
    rows = (tmp_path / "singularities.csv").read_text().splitlines()
    assert rows[0] == "time [s],kind,leg,posture,passage"
    assert rows[1].endswith("inverse,left,stretched,touched") and rows[2].endswith("direct,,folded,crossed")
    assert singularities.count(found) == "1 direct, 1 inverse (1 left, 0 right)"


@pytest.mark.parametrize(
    ("stop", "step", "last"), [(0.3, 0.1, 3), (1.0, 1e-3, 1000), (0.25, 0.1, 3), (0.01, 1.0, 1), (50, 1e-3, 50000)]
)
def test_communication_points(stop: float, step: float, last: int) -> None:
    points = communication_points(stop, step)
    assert len(points) == last + 1 and points[0] == 0 and points[-1] == stop
    assert np.all(np.diff(points) > 0)
