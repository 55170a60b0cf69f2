"""Runs every peer and this repository's methods on the same scenes, one after the other on one core, and writes a table.

Times are processor times of the working process alone, so that other work on the machine hardly counts.

    python run.py --fmu target/fmu/FiveBar.fmu --references tests/data/reference --about 'this machine' --out target/peers/peers.csv
"""

import argparse
import csv
import importlib
import itertools
import math
import os
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import ahead
import machine
import native
import own
import timing

# Module and function of each peer. A peer is left out if its package, compiler or library is not installed.
PEERS = {
    "MuJoCo": ("mujoco_engine", "peer"),
    "Exudyn": ("exudyn_engine", "peer"),
    "Drake": ("drake_plant", "peer"),
    "SciPy DOP853": ("scipy_dop853", "peer"),
    "SUNDIALS CVODE": ("sundials", "cvode"),
    "SUNDIALS IDA": ("sundials", "ida"),
    "Pinocchio": ("pinocchio_dynamics", "peer"),
    "rapier2d": ("rapier", "peer"),
    "heyoka": ("heyoka_taylor", "peer"),
}

# Both proximal angles, and side of the tip.
START = {
    "fall_90_120": (math.radians(90), 2.0943951023931953, 1),
    "swing": (-1.05, -1.7, -1),
    "servo_friction": (math.radians(90), 2.0943951023931953, 1),
    "paper_free_fall": (math.radians(90), math.radians(90), 1),
}
END = {"fall_90_120": 2, "swing": 2, "servo_friction": 2, "paper_free_fall": 50}
# Scene with servos and friction, which some peers do not support.
LOADED = "servo_friction"
# Tip at whole seconds, for each scene with a reference.
Tips = dict[str, dict[int, np.ndarray]]
# Exceptions of a peer that fails.
FAILURES = (RuntimeError, ValueError, ArithmeticError)


@dataclass
class Row:
    """A row of the table; missing numbers are empty."""

    scene: str
    peer: str
    version: str
    settings: str
    error_1s_m: float | None = None
    error_2s_m: float | None = None
    ms_per_simulated_second: float | None = None
    energy_error_mgL: float | None = None
    note: str = ""


def main() -> int:
    parser = argparse.ArgumentParser(description="Compares peers with the unit.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--references", type=Path, required=True, help="the folder of reference trajectories")
    parser.add_argument("--about", required=True, help="machine, commit and command, for the head of the table")
    parser.add_argument("--out", type=Path, required=True, help="the table to write")
    parser.add_argument(
        "--only", nargs="*", choices=PEERS, help="names of peers to run beside our methods [default: all]"
    )
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    tips = {scene: reference(options.references / f"{scene}.csv") for scene in ahead.SCENES}
    peers, left_out = find(options.fmu, options.only)
    runs = [
        (scene, peer, setting)
        for peer in peers
        for setting in peer.settings
        for scene in START
        if scene != LOADED or setting.begin_loaded is not None
    ]
    rows = []
    for run in runs:
        rows.append(measure(*run, tips))
        show(rows[-1])
    for turn in range(2, timing.ROUNDS + 1):
        print(f"round {turn} of {timing.ROUNDS}: the short runs again", flush=True)
        for i, run in enumerate(runs):
            if is_short(rows[i]):
                rows[i] = min(rows[i], measure(*run, tips), key=cost)
    cells = [{name: "" if value is None else str(value) for name, value in asdict(row).items()} for row in rows]
    for scene, second in itertools.product(ahead.SCENES, (1, 2)):
        print(f"\nTime against ours for an error of the tip after {second} s of {scene}:\n")
        print("\n".join(ahead.markdown(ahead.cells(ahead.table(cells, scene, second)))))
    print(f"\nEnergy over 50 s of {ahead.ENERGY_SCENE} at strictly fixed steps of 1 ms:\n")
    print("\n".join(ahead.markdown(ahead.energies(cells))) + "\n")
    rows += [Row("", name, "", "", note=f"left out: {why}") for name, why in left_out.items()]
    for row in rows[len(rows) - len(left_out) :]:
        print(f"{row.peer}: {row.note}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", encoding="utf-8", newline="") as file:
        file.write(f"# {options.about}\n")
        writer = csv.DictWriter(file, asdict(rows[0]).keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    print(f"written: {os.path.relpath(options.out)}")
    return 0


def find(fmu: Path, only: Iterable[str] | None) -> tuple[list[machine.Peer], dict[str, str]]:
    """Our methods, the installed peers, and the reason for each peer left out; `only` selects peers."""
    found, left_out = own.peers(fmu), {}
    for name, (module, function) in PEERS.items():
        if only and name not in only:
            continue
        try:
            found.append(getattr(importlib.import_module(module), function)())
        except (ImportError, native.CannotBuild) as error:
            left_out[name] = f"not installed ({error})"
    return found, left_out


def reference(file: Path) -> dict[int, np.ndarray]:
    """The tip at whole seconds."""
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = {float(row["t"]): np.array([float(row["Qx"]), float(row["Qy"])]) for row in csv.DictReader(lines)}
    return {t: rows[float(t)] for t in (1, 2)}


def measure(scene: str, peer: machine.Peer, setting: machine.Setting, tips: Tips) -> Row:
    """Runs a scene at one setting. A run of 1 ms before the measurement takes model building and compilation out of the time."""
    row = Row(scene, peer.name, peer.version, setting.text)
    start, times = machine.closed(*START[scene]), []
    begin = setting.begin_loaded if scene == LOADED else setting.begin
    try:
        begin(start)(1e-3)
        while not times or not (row.note or timing.enough(times)):
            done, spent, row.note = once(row, (begin, setting.clock), start, tips)
            times.append(spent)
    except FAILURES as error:
        done, row.note = 0, f"ended at the start: {words(error)}"
    if done:
        row.ms_per_simulated_second = 1e3 * timing.counted(times) / done
    return row


def once(row: Row, run: tuple, start: np.ndarray, tips: Tips) -> tuple[int, float, str]:
    """One run: whole seconds completed, their time, and the reason if it ended early. Errors go to the row."""
    begin, clock = run
    before, spent, done = machine.energy(start), 0.0, 0
    row.energy_error_mgL = None
    try:
        advance = begin(start)
        for second in range(1, END[row.scene] + 1):
            before_it = clock()
            y = advance(float(second))
            took = clock() - before_it
            if not np.isfinite(y).all():
                raise RuntimeError("NaN")
            done, spent = second, spent + took
            if row.scene != LOADED:
                row.energy_error_mgL = max(row.energy_error_mgL or 0.0, abs(machine.energy(y) - before) / machine.MGL)
            if row.scene in tips:
                setattr(row, f"error_{second}s_m", float(np.hypot(*(machine.tip(y) - tips[row.scene][second]))))
            if spent > native.BUDGET and second < END[row.scene]:
                raise RuntimeError(native.TOO_LONG)
    except FAILURES as error:
        return done, spent, f"ended after {done} s: {words(error)}"
    return done, spent, ""


def is_short(row: Row) -> bool:
    """Whether a run reached its end within a time that is measured again."""
    return not row.note and 1e-3 * cost(row) * END[row.scene] < timing.LONG


def cost(row: Row) -> float:
    """Milliseconds per simulated second, infinite for a run that failed."""
    return math.inf if row.ms_per_simulated_second is None else row.ms_per_simulated_second


def words(error: Exception) -> str:
    """Text of an error, on one line."""
    return " ".join(str(error).split())


def show(row: Row) -> None:
    """Prints the row while the program runs."""
    numbers = [row.error_1s_m, row.error_2s_m, row.ms_per_simulated_second, row.energy_error_mgL]
    e1, e2, cost, energy = ("-" if x is None else f"{x:.2g}" for x in numbers)
    print(
        f"{row.scene:16} {row.peer:15} e1 {e1:8} e2 {e2:8} m {cost:8} ms/s  dE {energy:8} mgL  {row.settings}  {row.note}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
