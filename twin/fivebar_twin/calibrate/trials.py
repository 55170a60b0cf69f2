"""How good error bars are: made records of machines that are known, calibrated one after the other; `fivebar-twin calibrate --trials N`.

Each machine is the one of `MACHINE` with the six unknowns of `SOUGHT` up to 20 % off; soft servos lead it on sines for 5 s, away from
singularities, and encoders of 13,824 counts a turn with white noise of 0.1 mrad see it at 200 Hz. Counted is how often the 95 % bars
hold the truth, and how large errors are against the Cramér-Rao bound.
"""

import argparse
import json
import math
import sys
import time
from typing import Final

import numpy as np

from fivebar_twin.calibrate import command
from fivebar_twin.calibrate.data import Array, Data, Samples, split
from fivebar_twin.calibrate.identify import interval
from fivebar_twin.calibrate.motion import Machine, Path, Start
from fivebar_twin.calibrate.parameters import Values, parameters
from fivebar_twin.unit import Library

MACHINE: Final[Values] = {
    "base.distance": 0.1,
    "payload.enabled": True,
    "payload.mass": 0.02,
    "servo.enabled": True,
    "friction.enabled": True,
    "viscous.enabled": True,
    "init.theta[1]": 2.2,
    "init.theta[2]": 0.94,
}
"""A machine on a wall with servos of 2 N.m/rad, 20 g at its tip and friction in every joint."""

SOUGHT: Final = ("payload.mass", "link[1,4].mass", "link[2,3].mass", "friction.coulomb", "viscous.b", "gravity.g")
COUNT: Final = 2 * math.pi / 13824
NOISE: Final = 1e-4
"""rad."""

PERIOD: Final = 0.005
NAMES: Final = ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")


def path(seconds: float = 5.0) -> tuple[Array, Array]:
    """Times, s, and what the drives are told (`NAMES`)."""
    time = np.arange(0.0, seconds + PERIOD / 2, PERIOD)
    turn = 2 * math.pi * time
    angles = np.column_stack([
        2.2 + 0.35 * np.sin(1.3 * turn) + 0.15 * np.sin(2.9 * turn),
        0.94 + 0.35 * np.sin(1.7 * turn) + 0.15 * (np.cos(3.3 * turn) - 1),
    ])  # fmt: skip
    return time, np.column_stack([angles, np.gradient(angles, time, axis=0)])


def made(machine: Machine, x: Array, chance: np.random.Generator, seconds: float = 5.0) -> Data:
    """The record of a machine with those unknowns."""
    time, commands = path(seconds)
    samples = Samples(time, np.zeros((len(time), 2)), commands, NAMES)
    motion, _ = machine.run(Path(samples, "rate", machine.library, PERIOD), x, Start(np.array([2.2, 0.94, 0.0, 0.0]), 1))
    angles = np.round((motion[:, :2] + NOISE * chance.standard_normal((len(time), 2))) / COUNT) * COUNT
    table = {f"measured.theta[{i + 1}]": angles[:, i] for i in (0, 1)} | dict(zip(NAMES, commands.T, strict=True))
    return split(time, table, [])


def run(arguments: argparse.Namespace) -> int:
    """0 if the bars of each unknown hold the truth as often as they should, within what chance does in so many trials."""
    library = Library(arguments.fmu)
    inside = np.zeros(len(SOUGHT))
    errors, bounds, seconds = [], [], []
    try:
        sought = parameters(SOUGHT, library, MACHINE)
        for trial in range(arguments.trials):
            chance = np.random.Generator(np.random.Philox(key=trial))
            truth = 1 + 0.2 * chance.uniform(-1, 1, len(SOUGHT))
            maker, machine = Machine(library, MACHINE, sought), Machine(library, MACHINE, sought)
            maker.tolerance(1e-11)
            record = made(maker, truth, chance)
            begun = time.process_time()
            result = command.calibrate(machine, record, "rate", 10.0, lambda _: None)
            seconds.append(time.process_time() - begun)
            off = result.fit.x - truth
            inside += np.abs(off) <= np.array([interval(float(s)) for s in result.judgement.sigma])
            errors.append(off)
            bounds.append(result.judgement.bound)
            maker.close()
            machine.close()
            print(f"\r{trial + 1} of {arguments.trials} trials, {inside.sum() / (trial + 1) / len(SOUGHT):.1%} inside", end="", file=sys.stderr, flush=True)
    finally:
        library.close()
    print(file=sys.stderr)
    ratio = np.sqrt(np.mean((np.array(errors) / np.array(bounds)) ** 2, axis=0))
    cover = inside / arguments.trials
    print(f"{arguments.trials} trials of 5 s at 200 Hz, {np.median(seconds):.1f} s of CPU each (median)\n")
    print(f"  {'':20} {'inside 95 % bars':>17} {'error / bound':>14} {'bound, % of value':>18}")
    for k, name in enumerate(SOUGHT):
        print(f"  {name:20} {cover[k]:17.1%} {ratio[k]:14.2f} {100 * float(np.median(np.array(bounds)[:, k])):18.3f}")
    print(f"  {'all':20} {cover.mean():17.1%} {float(np.sqrt(np.mean(ratio**2))):14.2f}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    figures = {"trials": arguments.trials, "inside": dict(zip(SOUGHT, cover.tolist(), strict=True)), "error_by_bound": dict(zip(SOUGHT, ratio.tolist(), strict=True))}
    (arguments.out / "trials.json").write_text(json.dumps(figures | {"cpu_seconds": float(np.median(seconds))}, indent=2) + "\n", encoding="utf-8")
    # 200 trials have to be between 90 and 98 %, which is some three standard deviations; fewer may be further off.
    allowed = 3 * math.sqrt(0.95 * 0.05 / (arguments.trials * len(SOUGHT)))
    return 0 if abs(float(cover.mean()) - 0.95) <= max(allowed, 0.03) and float(ratio.max()) <= 1.5 else 1
