"""Validation of error bars by calibrations of synthetic records from known machines; `fivebar calibrate --trials N`.

Each machine is `MACHINE` with the six unknowns of `SOUGHT` changed by up to 20 %. Soft servos drive it along sines for 5 s, away from
singularities, and encoders with 13,824 counts per turn and white noise of 0.1 mrad sample it at 200 Hz. The result is how often the 95 %
error bars contain the truth, and the ratio of errors to the Cramér-Rao bound. The rules of the fit were tuned on trials below `FRESH`, never
on later ones. All trials are stored in `trials.jsonl`, so that an interrupted command resumes.
"""

import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Final

import numpy as np

from fivebar.library import Library
from fivebar.twin import recording
from fivebar.twin.calibrate import calibration
from fivebar.twin.calibrate.data import Data, Samples, split
from fivebar.twin.calibrate.identify import interval
from fivebar.twin.calibrate.motion import Machine, Path, Start
from fivebar.twin.calibrate.parameters import Values, parameters
from fivebar.twin.errors import TwinError
from fivebar.twin.recording import Array

BEGIN: Final = (1.9, 1.24)
"""Start and centre of the motor angles, rad: the links stay at least 0.15 m from being stretched."""

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
"""Number of the first trial that was not used for tuning."""

COUNT: Final = 2 * math.pi / 13824
NOISE: Final = 1e-4
"""Standard deviation of the encoders' white noise, rad."""

LEAST, MOST = 0.90, 0.98
"""Allowed range for the share of 95 % error bars that contain the truth, over random machines."""

PERIOD: Final = 0.005
NAMES: Final = ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")


@dataclass(frozen=True)
class Bench:
    """A machine, its drive commands and its encoders."""

    values: Values
    begin: tuple[float, float] = BEGIN
    amplitude: float = 1.0
    """Factor on the amplitudes of the motion in `path`."""

    tempo: float = 1.0
    """Factor on the frequencies of the motion in `path`."""

    count: float = COUNT
    noise: float = NOISE


ONE: Final = Bench(MACHINE)


def any_bench(chance: np.random.Generator, library: Library) -> Bench:
    """A random machine: geometry, masses, servos, friction, payload, motion, encoders; its motion stays away from stretched links."""

    def around(name: str, factor: float) -> float:
        """A random value around the default, larger or smaller by up to `factor`."""
        usual = MACHINE.get(name, library.variable(name).start)
        scale: float = factor ** float(chance.uniform(-1, 1))
        return float(usual) * scale

    while True:
        values: Values = dict(MACHINE)
        values["base.distance"] = float(chance.uniform(0.05, 0.25))
        for i in (1, 2, 3, 4):
            length = f"link[{i}].length"
            stretched = around(length, 1.2) / float(library.variable(length).start)
            heavier = around(f"link[{i}].mass", 2.0) / float(library.variable(f"link[{i}].mass").start)
            for name, factor in (
                ("length", stretched),
                ("com", stretched),
                ("mass", heavier),
                ("inertia", heavier * stretched**2),
            ):
                values[f"link[{i}].{name}"] = float(library.variable(f"link[{i}].{name}").start) * factor
        for name, factor in (
            ("payload.mass", 2.5),
            *((f"servo.{gain}[{i}]", 2.0) for gain in ("kp", "kd") for i in (1, 2)),
        ):
            values[name] = around(name, factor)
        values |= {
            name: around(name, 2.0)
            for name in library.variables
            if name.startswith(("viscous.b[", "friction.coulomb["))
        }
        values |= {
            name.replace("coulomb", "breakaway"): value
            for name, value in list(values.items())
            if name.startswith("friction.coulomb[")
        }
        begin = float(chance.uniform(1.6, 2.4)), float(chance.uniform(0.8, 1.6))
        values |= {"init.theta[1]": begin[0], "init.theta[2]": begin[1]}
        count = 2 * math.pi / float(chance.choice((4096, 13824, 65536)))
        noise = float(chance.uniform(0.0, 2e-4)) if count < 1e-3 else float(chance.uniform(0.25, 1.0)) * count
        bench = Bench(values, begin, float(chance.uniform(0.6, 1.2)), float(chance.uniform(0.7, 1.2)), count, noise)
        if away(bench):
            return bench


def away(bench: Bench) -> bool:
    """Whether the links stay away from stretched and folded postures if the drives follow their commands exactly."""
    values = bench.values
    lengths = [float(values[f"link[{i}].length"]) for i in (1, 2, 3, 4)]
    angles = path(5.0, bench)[1][:, :2]
    first = lengths[0] * np.exp(1j * angles[:, 0])
    last = float(values["base.distance"]) + lengths[3] * np.exp(1j * angles[:, 1])
    apart = np.abs(last - first) / (lengths[1] + lengths[2])
    if apart.max() > 0.85 or apart.min() < 0.25:
        return False
    along = (np.abs(last - first) ** 2 + lengths[1] ** 2 - lengths[2] ** 2) / (2 * np.abs(last - first))
    tip = first + (last - first) / np.abs(last - first) * (
        along + 1j * np.sqrt(np.maximum(lengths[1] ** 2 - along**2, 0.0))
    )
    inner = [
        np.abs(np.sin(np.angle((tip - elbow) / (elbow - motor))))
        for elbow, motor in ((first, 0.0), (last, float(values["base.distance"])))
    ]
    return float(min(x.min() for x in inner)) > 0.3


def path(seconds: float = 5.0, bench: Bench = ONE) -> tuple[Array, Array]:
    """Times, s, and drive commands (`NAMES`)."""
    time = np.arange(0.0, seconds + PERIOD / 2, PERIOD)
    turn = 2 * math.pi * bench.tempo * time
    angles = np.column_stack([
        bench.begin[0] + bench.amplitude * (0.2 * np.sin(1.3 * turn) + 0.08 * np.sin(2.9 * turn)),
        bench.begin[1] + bench.amplitude * (0.2 * np.sin(1.7 * turn) + 0.08 * (np.cos(3.3 * turn) - 1)),
    ])  # fmt: skip
    return time, np.column_stack([angles, np.gradient(angles, time, axis=0)])


def made(machine: Machine, x: Array, chance: np.random.Generator, seconds: float = 5.0, bench: Bench = ONE) -> Data:
    """The synthetic record of a machine with given unknowns."""
    time, commands = path(seconds, bench)
    samples = Samples(time, np.zeros((len(time), 2)), commands, NAMES)
    motion, _ = machine.run(
        Path(samples, "rate", machine.library, PERIOD), x, Start(np.array([*bench.begin, 0.0, 0.0]), 1)
    )
    angles = (
        np.round((motion[:, :2] + bench.noise * chance.standard_normal((len(time), 2))) / bench.count) * bench.count
    )
    table = {f"measured.theta[{i + 1}]": angles[:, i] for i in (0, 1)} | dict(zip(NAMES, commands.T, strict=True))
    return split(recording.of("a trial", time, table, []))


def one(library: Library, key: int, machines: str = "one") -> dict[str, Any]:
    """Runs a trial: returns errors, estimated standard deviations and bounds, in sizes of the unknowns, and CPU time, s."""
    chance = np.random.Generator(np.random.Philox(key=key))
    bench = ONE if machines == "one" else any_bench(np.random.Generator(np.random.Philox(key=key).jumped()), library)
    sought = parameters(SOUGHT, library, bench.values)
    truth = 1 + 0.2 * chance.uniform(-1, 1, len(SOUGHT))
    maker, machine = Machine(library, bench.values, sought), Machine(library, bench.values, sought)
    try:
        maker.tolerance(1e-11)
        record = made(maker, truth, chance, bench=bench)
        begun = time.process_time()
        result = calibration.solve(machine, record, "rate", 10.0, lambda _: None)
        spent = time.process_time() - begun
    finally:
        maker.close()
        machine.close()
    found = {"off": result.fit.x - truth, "sigma": result.judgement.sigma, "bound": result.judgement.bound}
    of = {"key": key, "unit": library.guid, "machines": machines, "identified": result.judgement.identified}
    return of | {name: values.tolist() for name, values in found.items()} | {"cpu_seconds": spent}


def done(file: FilePath, guid: str, machines: str = "one") -> dict[int, dict[str, Any]]:
    """Earlier trials of this unit with this kind of machines, by key."""
    if not file.is_file():
        return {}
    try:
        rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        return {int(row["key"]): row for row in rows if row["unit"] == guid and row.get("machines", "one") == machines}
    except (ValueError, KeyError, TypeError):
        raise TwinError(f"{file} does not have the format of this command; delete it to start again") from None


def run(trials: int, first: int, machines: str, fmu: FilePath, out: FilePath) -> int:
    """Runs the trials; returns 0 if error bars contain the truth as often as they should, within the statistical error of the trials."""
    keys = range(first, first + trials)
    if len(keys) < 1 or keys[0] < 0:
        raise TwinError(f"trials are {trials}, from number {first}; at least one is needed, from 0 on")
    out.mkdir(parents=True, exist_ok=True)
    file = out / "trials.jsonl"
    library = Library(fmu)
    try:
        made_before = done(file, library.guid, machines)
        rows = [made_before[key] for key in keys if key in made_before]
        for key in keys:
            if key in made_before:
                continue
            rows.append(one(library, key, machines))
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(rows[-1]) + "\n")
            print(
                f"\r{len(rows)} of {len(keys)} trials, {np.nanmean(inside(rows)):.1%} inside",
                end="",
                file=sys.stderr,
                flush=True,
            )
    finally:
        library.close()
    print(file=sys.stderr)
    return _report(rows, keys, machines, out)


def column(rows: list[dict[str, Any]], name: str) -> Array:
    """The entry `name` of all trials, (trials, unknowns)."""
    return np.array([row[name] for row in rows])


def inside(rows: list[dict[str, Any]]) -> Array:
    """1 if a 95 % error bar contains the truth, else 0; NaN if the unknown was not identified; (trials, unknowns)."""
    held = np.abs(column(rows, "off")) <= interval(1.0) * column(rows, "sigma")
    identified = np.array([row.get("identified", [True] * held.shape[1]) for row in rows])
    return np.where(identified, held, np.nan)


def _report(rows: list[dict[str, Any]], keys: range, machines: str, out: FilePath) -> int:
    ratio = np.sqrt(np.mean((column(rows, "off") / column(rows, "bound")) ** 2, axis=0))
    cover = np.nanmean(inside(rows), axis=0)
    every = float(np.nanmean(inside(rows)))
    seconds = [row["cpu_seconds"] for row in rows]
    print(
        f"{len(keys)} trials ({'one machine' if machines == 'one' else 'any machine'}) of 5 s at 200 Hz, numbers {keys[0]} to {keys[-1]}; {np.median(seconds):.1f} s of CPU each (median), {max(seconds):.1f} at most\n"
    )
    print(f"  {'':20} {'inside 95 % bars':>17} {'error / bound':>14} {'bound, % of value':>18}")
    for k, name in enumerate(SOUGHT):
        print(
            f"  {name:20} {cover[k]:17.1%} {ratio[k]:14.2f} {100 * float(np.median(column(rows, 'bound')[:, k])):18.3f}"
        )
    print(f"  {'all':20} {every:17.1%} {float(np.sqrt(np.mean(ratio**2))):14.2f}")
    figures = {
        "trials": len(keys),
        "machines": machines,
        "first": keys[0],
        "inside": dict(zip(SOUGHT, cover.tolist(), strict=True)),
        "error_by_bound": dict(zip(SOUGHT, ratio.tolist(), strict=True)),
    }
    (out / "trials.json").write_text(
        json.dumps(figures | {"cpu_seconds": {"median": float(np.median(seconds)), "max": max(seconds)}}, indent=2)
        + "\n",
        encoding="utf-8",
    )
    # Three standard deviations of the share over all error bars; with few trials, this is more than `LEAST` to `MOST` allow.
    allowed = 3 * math.sqrt(0.95 * 0.05 / (len(keys) * len(SOUGHT)))
    if machines == "any":
        print(f"not identified: {int(np.isnan(inside(rows)).sum())} of {len(rows) * len(SOUGHT)}")
        # Coarse encoders leave correlated residuals, so that error bars may be far wider than the white-noise bound.
        return 0 if LEAST <= every <= MOST or abs(every - 0.95) <= allowed else 1
    return 0 if abs(every - 0.95) <= max(allowed, 0.03) and float(ratio.max()) <= 1.5 else 1
