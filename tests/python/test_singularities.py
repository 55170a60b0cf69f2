"""Detection of singularities of a run, on made-up motions."""

import math
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from fivebar import singularities
from fivebar.drive import Progress, Run, drive
from fivebar.library import shared
from fivebar.scene import communication_points
from fivebar.singularities import Event
from made_scene import made_scene

LENGTH = 0.21


ITEMS = {1: "none", 2: "direct", 3: "inverse", 4: "combined", 5: "constraint"}


def made_up(
    between: np.ndarray, left: np.ndarray, right: np.ndarray, sigma: np.ndarray | float = 0.1, step: float = 1e-3
) -> Run:
    """A run with the given angles: distal to distal link, and each leg's distal to proximal link; `sigma` belongs to Phi_q."""
    sigma = np.broadcast_to(sigma, between.shape)
    direct = np.abs(np.sin(between)) < 1e-3
    inverse = np.abs(np.sin(left) * np.sin(right)) < 1e-3
    zero = np.zeros(len(between))
    columns = {
        "time": np.arange(len(between)) * step,
        "passive.theta[1]": zero,
        "passive.theta[2]": between,
        "theta[1]": -left,
        "theta[2]": between - right,
        "singular.detJx": LENGTH**2 * np.sin(between),
        "singular.sigmaPhi": sigma,
        "singular.type": np.where(sigma < 1e-3, 5, 1 + direct + 2 * inverse),
    }
    parameters = {"link[2].length": LENGTH, "link[3].length": LENGTH}
    return Run("made up", columns["time"][-1], step, {}, columns, parameters, {"singular.type": ITEMS})


def passing(rate: float, at: float) -> np.ndarray:
    """An angle that passes 0 at the time `at` with `rate` (rad/s) and rests 1 rad before and after."""
    return np.clip(rate * (np.arange(1001) * 1e-3 - at), -1, 1)


def outline(event: Event) -> str:
    """An event without its time; the postures of distal links, left leg and right leg, "-" for none."""
    return f"{event.kind} {event.passage}: {' '.join(posture or '-' for posture in event.postures)}"


def outlines(run: Run) -> list[str]:
    """All events, without times."""
    return [outline(event) for event in singularities.find(run)]


TIME = np.arange(1001) * 1e-3
CALM = np.full(1001, 1.0)


def test_nothing_to_find() -> None:
    assert singularities.find(made_up(CALM, CALM, -CALM)) == []


def test_crossings() -> None:
    """Fast crossings, with no sample near, are found with their times."""
    run = made_up(math.pi - 7 * (TIME - 0.40005), 5 * (TIME - 0.60005), math.pi + 5 * (TIME - 0.80005))
    found = singularities.find(run)
    near = {t: [outline(e) for e in found if abs(e.time - t) < 0.01] for t in (0.4, 0.6, 0.8)}
    assert near == {
        0.4: ["direct crossed: stretched - -"],
        0.6: ["inverse crossed: - stretched -"],
        0.8: ["inverse crossed: - - folded"],
    }
    times = [e.time for e in found]
    assert times == sorted(times)
    assert [t for t in times if abs(t - 0.4) < 0.01] == [pytest.approx(0.40005, abs=1e-7)]


def test_a_slow_crossing_is_one_event() -> None:
    """Many samples below the threshold, one event."""
    run = made_up(0.01 * (TIME - 0.5), CALM, CALM)
    assert outlines(run) == ["direct crossed: folded - -"]
    assert singularities.find(run)[0].time == pytest.approx(0.5, abs=1e-9)


def test_a_touch() -> None:
    """The leg comes within 5e-4 of its stretched posture and turns back."""
    run = made_up(CALM, 5e-4 + (TIME - 0.3) ** 2, CALM)
    assert outlines(run) == ["inverse touched: - stretched -"]
    assert singularities.find(run)[0].time == pytest.approx(0.3, abs=1e-9)


def test_a_near_miss_is_no_event() -> None:
    assert outlines(made_up(CALM, 2e-3 + (TIME - 0.3) ** 2, CALM)) == []


def test_a_start_in_a_singularity() -> None:
    """The paper's free fall starts with its distal links in line, up to the last bits of pi."""
    run = made_up(math.pi + 1e-16 - 4 * TIME**2 * 0.2, CALM, CALM)
    assert outlines(run) == ["direct start: stretched - -"]
    assert singularities.find(run)[0].time == 0.0


def test_a_stay_is_one_event() -> None:
    """A leg stays folded; its sign is noise."""
    noise = 1e-9 * np.where(np.arange(1001) % 2, 1, -1)
    away = np.where((TIME > 0.2) & (TIME < 0.7), 0.0, 0.5)
    assert outlines(made_up(CALM, CALM, math.pi + noise + away)) == ["inverse touched: - - folded"]


def test_a_constraint_singularity_is_one_event() -> None:
    """All links pass near one line: every pair crosses at a different time, and one event names all."""
    sigma = np.minimum(0.1, np.hypot(4e-4, 2 * (TIME - 0.5)))
    run = made_up(passing(10, 0.4996), math.pi + passing(12, 0.5002), passing(9, 0.4999), sigma)
    assert outlines(run) == ["constraint crossed: folded folded stretched"]
    assert singularities.find(run)[0].time == pytest.approx(0.5, abs=1e-9)


def test_a_combined_singularity_between_two_points() -> None:
    """Direct and inverse are crossed within a millisecond, so fast that no sample is near either."""
    run = made_up(passing(20, 0.50048), CALM, passing(20, 0.50050))
    assert set(run["singular.type"]) == {1}
    assert outlines(run) == ["combined crossed: folded - stretched"]
    assert singularities.find(run)[0].time == pytest.approx(0.5005, abs=5e-5)


def test_combined_at_a_point() -> None:
    """The distal links turn back at the line that a leg crosses."""
    run = made_up(5e-4 + (TIME - 0.5) ** 2, passing(9, 0.49995), CALM)
    assert 4 in run["singular.type"]
    assert outlines(run) == ["combined crossed: folded stretched -"]


def test_neighbours_are_not_combined() -> None:
    """Two milliseconds apart are two events."""
    run = made_up(passing(20, 0.4984), CALM, passing(20, 0.5005))
    assert outlines(run) == ["direct crossed: folded - -", "inverse crossed: - - stretched"]


def test_a_long_stay_keeps_its_name() -> None:
    """If the distal links stay in line while a leg crosses, there is a direct singularity with a combined one within."""
    between = 2e-4 * np.ones(1001) - 1e-4 * (TIME < 0.1)
    run = made_up(between, CALM, passing(9, 0.6))
    assert outlines(run) == ["direct start: folded - -", "combined crossed: folded - stretched"]


def test_a_start_with_all_links_in_line() -> None:
    run = made_up(2 * TIME**2, math.pi - TIME**2, TIME**2, np.minimum(0.1, TIME))
    assert outlines(run) == ["constraint start: folded folded stretched"]


def test_kinds_are_those_of_the_fmu(fmu: Path) -> None:
    """While singular.type says combined or constraint, no pair of links has an event of its own.

    The run starts with all links in line: a motion that only comes near that would depend on the last bit.
    """
    ready = made_scene({"init.theta[1]": 0.0, "init.theta[2]": 0.0}, 0.3)
    run = drive(shared(fmu), ready, ready.variants[0], Progress("", ready.stop_time, StringIO()))
    items = run.items["singular.type"]
    assert tuple(items.values()) == ("none", *singularities.KINDS)
    events = singularities.find(run)
    assert (
        str(events[0])
        == "constraint singularity at the start: distal links stretched, left leg stretched, right leg folded"
    )
    grave = run.time[[items[int(value)] in singularities.GRAVE for value in run["singular.type"]]]
    assert len(grave) > 1
    for event in events:
        if event.kind not in singularities.GRAVE:
            assert np.min(np.abs(grave - event.time)) > run.step_size, event


def test_csv_and_count(tmp_path: Path) -> None:
    run = made_up(0.01 * (TIME - 0.5), 5e-4 + (TIME - 0.3) ** 2, CALM)
    found = singularities.find(run)
    singularities.write(tmp_path / "singularities.csv", found)
    rows = (tmp_path / "singularities.csv").read_text().splitlines()
    assert rows[0] == "time,kind,distal links,left leg,right leg,passage"
    assert rows[1].endswith("inverse,,stretched,,touched") and rows[2].endswith("direct,folded,,,crossed")
    assert singularities.count(found) == "1 direct, 1 inverse (1 left, 0 right), 0 combined, 0 constraint"


@pytest.mark.parametrize(
    ("stop", "step", "last"), [(0.3, 0.1, 3), (1.0, 1e-3, 1000), (0.25, 0.1, 3), (0.01, 1.0, 1), (50, 1e-3, 50000)]
)
def test_communication_points(stop: float, step: float, last: int) -> None:
    points = communication_points(stop, step)
    assert len(points) == last + 1 and points[0] == 0 and points[-1] == stop
    assert np.all(np.diff(points) > 0)
