"""How good error bars are: made records of machines that are known, calibrated one after the other; `fivebar-twin calibrate --trials N`.

Each machine is the one of `MACHINE` with the six unknowns of `SOUGHT` up to 20 % off; soft servos lead it on sines for 5 s, away from
singularities, and encoders of 13,824 counts a turn with white noise of 0.1 mrad see it at 200 Hz. Counted is how often the 95 % bars
hold the truth, and how large errors are against the Cramér-Rao bound. Rules were chosen with trials below `FRESH` in view, none of
those from it on. Every trial is kept in `trials.jsonl`: a command that was interrupted goes on where it was.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from fivebar_twin.calibrate import command
from fivebar_twin.calibrate.data import Array, Data, Samples, split
from fivebar_twin.calibrate.identify import interval
from fivebar_twin.calibrate.motion import Machine, Path, Start
from fivebar_twin.calibrate.parameters import Values, parameters
from fivebar_twin.errors import TwinError
from fivebar_twin.unit import Library

BEGIN: Final = (1.9, 1.24)
"""rad: where the motors begin, and turn about: the links come within 0.15 m of being stretched, and no nearer."""

MACHINE: Final[Values] = {
    "base.distance": 0.1,
    "payload.enabled": True,
    "payload.mass": 0.02,
    "servo.enabled": True,
    "friction.enabled": True,
    "viscous.enabled": True,
    "init.theta[1]": BEGIN[0],
    "init.theta[2]": BEGIN[1],
}
"""A machine on a wall with servos of 2 N.m/rad, 20 g at its tip and friction in every joint."""

SOUGHT: Final = ("payload.mass", "link[1,4].mass", "link[2,3].mass", "friction.coulomb", "viscous.b", "gravity.g")
FRESH: Final = 100
"""The number of the first trial, whose records nobody has looked at."""

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
        BEGIN[0] + 0.2 * np.sin(1.3 * turn) + 0.08 * np.sin(2.9 * turn),
        BEGIN[1] + 0.2 * np.sin(1.7 * turn) + 0.08 * (np.cos(3.3 * turn) - 1),
    ])  # fmt: skip
    return time, np.column_stack([angles, np.gradient(angles, time, axis=0)])


def made(machine: Machine, x: Array, chance: np.random.Generator, seconds: float = 5.0) -> Data:
    """The record of a machine with those unknowns."""
    time, commands = path(seconds)
    samples = Samples(time, np.zeros((len(time), 2)), commands, NAMES)
    motion, _ = machine.run(Path(samples, "rate", machine.library, PERIOD), x, Start(np.array([*BEGIN, 0.0, 0.0]), 1))
    angles = np.round((motion[:, :2] + NOISE * chance.standard_normal((len(time), 2))) / COUNT) * COUNT
    table = {f"measured.theta[{i + 1}]": angles[:, i] for i in (0, 1)} | dict(zip(NAMES, commands.T, strict=True))
    return split(time, table, [])


def one(library: Library, key: int) -> dict[str, Any]:
    """A trial: how far off it is, what it says of itself, and the bound, in sizes of the unknowns; seconds of CPU."""
    sought = parameters(SOUGHT, library, MACHINE)
    chance = np.random.Generator(np.random.Philox(key=key))
    truth = 1 + 0.2 * chance.uniform(-1, 1, len(SOUGHT))
    maker, machine = Machine(library, MACHINE, sought), Machine(library, MACHINE, sought)
    try:
        maker.tolerance(1e-11)
        record = made(maker, truth, chance)
        begun = time.process_time()
        result = command.calibrate(machine, record, "rate", 10.0, lambda _: None)
        spent = time.process_time() - begun
    finally:
        maker.close()
        machine.close()
    found = {"off": result.fit.x - truth, "sigma": result.judgement.sigma, "bound": result.judgement.bound}
    return {"key": key, "unit": library.guid} | {name: values.tolist() for name, values in found.items()} | {"cpu_seconds": spent}


def done(file: Path, guid: str) -> dict[int, dict[str, Any]]:
    """Trials of this unit that were made before, by their keys."""
    if not file.is_file():
        return {}
    try:
        rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        return {int(row["key"]): row for row in rows if row["unit"] == guid}
    except (ValueError, KeyError, TypeError):
        raise TwinError(f"{file} is not as this command writes it; delete it to begin anew") from None


def run(arguments: argparse.Namespace) -> int:
    """0 if the bars of each unknown hold the truth as often as they should, within what chance does in so many trials."""
    keys = range(arguments.first, arguments.first + arguments.trials)
    if len(keys) < 1 or keys[0] < 0:
        raise TwinError(f"trials are {arguments.trials}, from number {arguments.first}; at least one is needed, from 0 on")
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "trials.jsonl"
    library = Library(arguments.fmu)
    try:
        made_before = done(file, library.guid)
        rows = [made_before[key] for key in keys if key in made_before]
        for key in keys:
            if key in made_before:
                continue
            rows.append(one(library, key))
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
            print(f"\r{len(rows)} of {len(keys)} trials, {inside(rows).mean():.1%} inside", end="", file=sys.stderr, flush=True)
    finally:
        library.close()
    print(file=sys.stderr)
    return _report(rows, keys, arguments.out)


def column(rows: list[dict[str, Any]], name: str) -> Array:
    """(trials, unknowns)."""
    return np.array([row[name] for row in rows])


def inside(rows: list[dict[str, Any]]) -> Array:
    """Which 95 % bars hold the truth, (trials, unknowns)."""
    return np.asarray(np.abs(column(rows, "off")) <= interval(1.0) * column(rows, "sigma"))


def _report(rows: list[dict[str, Any]], keys: range, out: Path) -> int:
    ratio = np.sqrt(np.mean((column(rows, "off") / column(rows, "bound")) ** 2, axis=0))
    cover = inside(rows).mean(axis=0)
    seconds = [row["cpu_seconds"] for row in rows]
    print(f"{len(keys)} trials of 5 s at 200 Hz, numbers {keys[0]} to {keys[-1]}; {np.median(seconds):.1f} s of CPU each (median), {max(seconds):.1f} at most\n")
    print(f"  {'':20} {'inside 95 % bars':>17} {'error / bound':>14} {'bound, % of value':>18}")
    for k, name in enumerate(SOUGHT):
        print(f"  {name:20} {cover[k]:17.1%} {ratio[k]:14.2f} {100 * float(np.median(column(rows, 'bound')[:, k])):18.3f}")
    print(f"  {'all':20} {cover.mean():17.1%} {float(np.sqrt(np.mean(ratio**2))):14.2f}")
    figures = {"trials": len(keys), "first": keys[0], "inside": dict(zip(SOUGHT, cover.tolist(), strict=True)), "error_by_bound": dict(zip(SOUGHT, ratio.tolist(), strict=True))}
    (out / "trials.json").write_text(json.dumps(figures | {"cpu_seconds": {"median": float(np.median(seconds)), "max": max(seconds)}}, indent=2) + "\n", encoding="utf-8")
    # 200 trials have to be between 90 and 98 %, which is some three standard deviations; fewer may be further off.
    allowed = 3 * math.sqrt(0.95 * 0.05 / (len(keys) * len(SOUGHT)))
    return 0 if abs(float(cover.mean()) - 0.95) <= max(allowed, 0.03) and float(ratio.max()) <= 1.5 else 1
