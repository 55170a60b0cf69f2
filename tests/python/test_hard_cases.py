"""A sample of the battery of hard cases through the packed .fmu: perturbed falls, irregular communication steps, equal bits."""

import json
import math
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from conftest import REPOSITORY
from instance import Instance

MGL = 0.017 * 9.81 * 0.21
"""m g L of the paper's links, J."""

FALLS = [(0.003, 0.004, 1), (-0.05, 0.1, 2), (0.01, 0.29, 1), (0.2, 0.3, 2)]
"""Deviation of left and right proximal angle from 90 degrees, rad, and the assembly."""


def start(left: float, right: float, assembly: int) -> dict[str, float | int]:
    """Start values of a perturbed fall."""
    return {"init.theta[1]": math.pi / 2 + left, "init.theta[2]": math.pi / 2 + right, "init.assembly": assembly}


def irregular(duration: float) -> list[float]:
    """Communication steps of 1 µs, 1/60 s, 1 s and anything between."""
    generator = random.Random(3)
    sizes = [1e-6, 1e-6, 1 / 60, 1.0, 1e-6, 1 / 60]
    while sum(sizes) < duration:
        sizes.append(10 ** generator.uniform(-6, -1))
    return sizes


@pytest.mark.parametrize("fall", FALLS)
def test_perturbed_falls(new: Callable[..., Instance], fall: tuple[float, float, int]) -> None:
    """Energy, constraints and counters at every output of 5 s."""
    instance = new().initialise(start(*fall))
    for i in range(500):
        instance.slave.doStep(i * 0.01, 0.01)
        assert abs(instance.get("energy.error")) <= 1e-2 * MGL
        assert instance.get("solver.positionError") <= 1e-12 and instance.get("solver.velocityError") <= 1e-9
    assert instance.get("solver.steps") == 5000


def test_irregular_communication_steps(new: Callable[..., Instance]) -> None:
    """For any steps the energy is constant, time is the sum of the steps, and the motion is near the reference while predictable."""
    instance, even = new().initialise(start(0.0, math.pi / 6, 1)), new("even").initialise(start(0.0, math.pi / 6, 1))
    time = 0.0
    for size in [1e-6] * 100 + [1 / 60] * 12 + [1e-3] * 99 + [9e-4]:
        instance.slave.doStep(time, size)
        time += size
        assert abs(instance.get("energy.error")) <= 1e-2 * MGL
    assert time == pytest.approx(0.3, abs=1e-12)
    even.steps(300, 1e-3)
    assert instance.tip() == pytest.approx(even.tip(), abs=1e-4)
    for size in irregular(5.0):
        instance.slave.doStep(time, size)
        time += size
        assert abs(instance.get("energy.error")) <= 1e-2 * MGL
        assert instance.get("solver.positionError") <= 1e-12 and instance.get("solver.velocityError") <= 1e-9


def replay(fmu: str) -> dict[str, str]:
    """Every output, bit by bit, after a fall over irregular communication steps with jumps of the load."""
    directory = fmpy.extract(fmu)
    instance = Instance(fmpy.read_model_description(directory), directory).initialise(start(*FALLS[1]))
    time = 0.0
    for i, size in enumerate(irregular(3.0)):
        instance.set({"tau[1]": 0.01 * (i % 3), "tip.fy": -0.05 * (i % 2)})
        instance.slave.doStep(time, size)
        time += size
    bits = {name: value.hex() for name, value in instance.bits().items()}
    instance.slave.freeInstance()
    return bits


def test_two_processes_give_the_same_bits(fmu: Path) -> None:
    paths = [str(REPOSITORY / "xtask" / "python"), str(Path(__file__).parent)]
    code = f"import sys; sys.path[:0] = {paths!r}\nimport json, test_hard_cases\nprint(json.dumps(test_hard_cases.replay({str(fmu)!r})))"
    runs = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(2)]
    first, second = (json.loads(run.stdout.splitlines()[-1]) for run in runs)
    assert first == second == replay(str(fmu))
    assert len(first) > 20
