"""Other filters on measured machines, compared with the unit's own: a table, and a picture for docs/notes/estimator.md.

`cargo xtask estimator --only compare` calls it. An unscented Kalman filter of filterpy drives the .fmu through FMPy, as its users do. The
unit's own corrector is also called through FMPy and timed. The crate `tracking` computes the other filters; its tables (runs.csv,
samples.csv, errors.csv) are in the folder `--runs`.

python followers.py --fmu target/fmu/FiveBar.fmu --runs target/estimator --picture docs/images/followers.svg
"""

import argparse
import shutil
import sys
from dataclasses import dataclass
from math import pi
from pathlib import Path
from statistics import median
from time import perf_counter

import fmpy
import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription
from fmpy.simulation import instantiate_fmu

from fivebar.drawing import STYLE

STEP = 1e-3
"""Sampling interval, s."""

SETTLED = 0.1
"""Beginning left out, s."""

LOST = 0.01
"""Error of the tip at the end, m, above which it counts as lost."""

NOISE, START = (0.1, 1e-4), (0.02, 0.2, 0.02)
"""As in the filters of `tracking`: white acceleration of motors, rad²/s³; random walk of torques, N²m²/s; standard deviations of the start."""

INPUTS = ("tau[1]", "tau[2]", "servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")

FILTERPY, UNIT = "filterpy UKF through FMPy", "the unit"
WAYS = ("open loop", "start anew", "EKF, motors", "UKF, motors", FILTERPY, UNIT)
COLOURS = ("#868e96", "#e8590c", "#a67c00", "#862e9c", "#2b8a3e", "#1864ab")


@dataclass(frozen=True)
class Machine:
    """A run: start values of its twin; times, measured angles, inputs and true tip of each sample."""

    scene: str
    encoder: str
    start: dict[str, float]
    time: np.ndarray
    measured: np.ndarray
    inputs: np.ndarray
    tip: np.ndarray


class Unit:
    """An instance, accessed by value references that are looked up once."""

    def __init__(self, model: ModelDescription, directory: str):
        self.variables = {v.name: v for v in model.modelVariables}
        self.references = {name: v.valueReference for name, v in self.variables.items()}
        (self.method,) = [
            int(item.value) for item in self.variables["solver.method"].declaredType.items if item.name == "dop853"
        ]
        # Without a logger FMPy prints refused starts between the rows of the table.
        self.slave = instantiate_fmu(directory, model, "CoSimulation", logger=lambda *_: None)

    def initialise(self, values: dict[str, float], inputs: np.ndarray, assembly: int = 1) -> None:
        """Restarts the instance."""
        self.slave.reset()
        reals = {name: value for name, value in values.items() if self.variables[name].type == "Real"}
        flags = {name: bool(value) for name, value in values.items() if self.variables[name].type == "Boolean"}
        self.slave.setReal([self.references[name] for name in (*reals, *INPUTS)], [*reals.values(), *inputs])
        self.slave.setBoolean([self.references[name] for name in flags], list(flags.values()))
        self.slave.setInteger(
            [self.references["solver.method"], self.references["init.assembly"]], [self.method, assembly]
        )
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def read(self, *names: str) -> list[float]:
        """Values of Real variables."""
        return self.slave.getReal([self.references[name] for name in names])

    def assembly(self) -> int:
        """The current assembly, an item of `mode.assembly`."""
        (value,) = self.slave.getInteger([self.references["mode.assembly"]])
        return value


class Around:
    """filterpy's unscented filter. Its state: angles and rates of the motors and two unknown motor torques. The unit moves each sigma point:
    it is initialised there, in the assembly of the mean, and makes one step."""

    def __init__(self, unit: Unit, machine: Machine):
        self.unit, self.drive, self.assembly = unit, machine.inputs[0], 1
        self.constants = {
            name: value for name, value in machine.start.items() if not name.startswith(("init.", "estimator."))
        }
        points = MerweScaledSigmaPoints(6, alpha=0.5, beta=2.0, kappa=-3.0)
        self.filter = UnscentedKalmanFilter(
            6, 2, STEP, hx=lambda x: x[:2], fx=self.move, points=points, residual_z=difference
        )
        start = [machine.start[f"init.{what}[{i}]"] for what in ("theta", "omega") for i in (1, 2)]
        self.filter.x, self.first = np.array([*start, 0.0, 0.0]), np.diag(np.repeat(START, 2) ** 2)
        self.filter.P = self.first.copy()
        self.filter.Q = np.diag([0.0, 0.0, NOISE[0], NOISE[0], NOISE[1], NOISE[1]]) * STEP
        self.filter.R = np.eye(2) * machine.start["estimator.quantum[1]"] ** 2 / 12

    def place(self, x: np.ndarray) -> None:
        """Initialises the unit at a state."""
        names = (f"init.{what}[{i}]" for what in ("theta", "omega") for i in (1, 2))
        drive = np.array(self.drive)
        drive[:2] += x[4:]
        self.unit.initialise(self.constants | dict(zip(names, x[:4], strict=True)), drive, self.assembly)

    def move(self, x: np.ndarray, size: float) -> np.ndarray:
        """The state one step later; unchanged if it cannot be assembled or moved."""
        try:
            self.place(x)
            self.unit.slave.doStep(0.0, size)
        except FMICallException:
            return x
        return np.array([*self.unit.read("theta[1]", "theta[2]", "omega[1]", "omega[2]"), *x[4:]])

    def correct(self, measured: np.ndarray) -> None:
        """Updates with a sample."""
        self.filter.update(measured)
        if not np.isfinite(self.filter.x).all():
            self.restart(measured)

    def restart(self, angles: np.ndarray) -> None:
        """Resets mean and covariance if the mean is not finite or the covariance cannot be factored."""
        self.filter.x = np.array([*angles, 0.0, 0.0, 0.0, 0.0])
        self.filter.P = self.first.copy()

    def tip(self) -> list[float]:
        """Position of the tip at the mean, m; NaN if the mean is out of reach."""
        try:
            self.place(self.filter.x)
        except FMICallException:
            return [np.nan, np.nan]
        return self.unit.read("tip.x", "tip.y")

    def predict(self, drive: np.ndarray, measured: np.ndarray) -> None:
        """Predicts one step after a sample."""
        self.drive = drive
        try:
            # The next step starts in the assembly that the mean has reached.
            self.place(self.filter.x)
            self.unit.slave.doStep(0.0, STEP)
            next_assembly = self.unit.assembly()
        except FMICallException:
            next_assembly = self.assembly
        try:
            self.filter.predict()
        except (np.linalg.LinAlgError, ValueError):
            self.restart(measured)
        self.assembly = next_assembly


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Difference of angles, rad, without whole turns."""
    return (a - b + pi) % (2 * pi) - pi


def by_filterpy(unit: Unit, machine: Machine) -> tuple[np.ndarray, float]:
    """Error of the tip after each sample, m, and median time of a sample, s."""
    around, errors, spent = Around(unit, machine), [], []
    for measured, drive, tip in zip(machine.measured, machine.inputs, machine.tip, strict=True):
        begin = perf_counter()
        around.correct(measured)
        corrected = perf_counter()
        errors.append(np.hypot(*(np.array(around.tip()) - tip)))
        going_on = perf_counter()
        around.predict(drive, measured)
        spent.append(corrected - begin + perf_counter() - going_on)
    return np.array(errors), median(spent)


def by_the_unit(unit: Unit, machine: Machine) -> tuple[float, float]:
    """Median times of a sample, s: setting samples and inputs plus the step; the same plus reading the estimate."""
    unit.initialise(machine.start | {"estimator.enabled": 1.0}, machine.inputs[0])
    names = ("measured.theta[1]", "measured.theta[2]", "measured.time[1]", "measured.time[2]", *INPUTS)
    references = [unit.references[name] for name in names]
    shown = ("tip.x", "tip.y", "estimated.alarm", *(f"estimated.tip.cov[{i}]" for i in (1, 2, 3)))
    read, alone, with_reading = [unit.references[name] for name in shown], [], []
    for time, measured, drive in zip(machine.time, machine.measured, machine.inputs, strict=True):
        values = [*measured, time, time, *drive]
        begin = perf_counter()
        unit.slave.setReal(references, values)
        unit.slave.doStep(time, STEP)
        done = perf_counter()
        unit.slave.getReal(read)
        alone.append(done - begin)
        with_reading.append(perf_counter() - begin)
    return median(alone), median(with_reading)


def machines(folder: Path) -> dict[int, Machine]:
    """The runs in a folder."""
    described = np.genfromtxt(folder / "runs.csv", delimiter=";", names=True, dtype=None, encoding="utf-8")
    samples = np.loadtxt(folder / "samples.csv", delimiter=";", skiprows=1)
    found = {}
    for run in np.unique(described["run"]):
        rows, of = described[described["run"] == run], samples[samples[:, 0] == run]
        start = dict(zip(map(str, rows["variable"]), map(float, rows["value"]), strict=True))
        found[int(run)] = Machine(
            str(rows["scene"][0]), str(rows["encoder"][0]), start, of[:, 1], of[:, 2:4], of[:, 4:10], of[:, 10:]
        )
    return found


def rms(errors: np.ndarray) -> float:
    """Root mean square without the beginning and without samples that have no tip."""
    return float(np.sqrt(np.nanmean(errors[round(SETTLED / STEP) :] ** 2)))


def is_lost(errors: np.ndarray) -> bool:
    """Whether the tip is far off at the end."""
    return not errors[-1] < LOST


def draw(picture: Path, all_machines: dict[int, Machine], errors: dict[tuple[int, str], np.ndarray]) -> None:
    """Top: tip error of the first fall over time for both encoders. Bottom: medians over the runs of every scene."""
    scenes = list(dict.fromkeys(m.scene for m in all_machines.values()))
    encoders = list(dict.fromkeys(m.encoder for m in all_machines.values()))
    with plt.rc_context(STYLE | {"svg.hashsalt": "followers"}):
        figure, panels = plt.subplots(2, 2, figsize=(10, 7))
        for column, encoder in enumerate(encoders):
            over_time, over_scenes = panels[:, column]
            fall = next(run for run, m in all_machines.items() if m.scene.startswith("fall") and m.encoder == encoder)
            for k, (way, colour) in enumerate(zip(WAYS, COLOURS, strict=True)):
                course = errors[fall, way]
                # The largest error in each hundredth of a second.
                worst = 1e3 * course[: len(course) // 10 * 10].reshape(-1, 10).max(axis=1)
                over_time.semilogy(
                    0.01 * np.arange(len(worst)), worst, color=colour, label=way, linewidth=2.2 if way == UNIT else 1.1
                )
                for i, scene in enumerate(scenes):
                    runs = [
                        errors[run, way] for run, m in all_machines.items() if (m.scene, m.encoder) == (scene, encoder)
                    ]
                    x, value, lost = i + 0.12 * (k - 2.5), 1e3 * median(map(rms, runs)), sum(map(is_lost, runs))
                    over_scenes.bar(x, min(value, 1e3), 0.11, color=colour)
                    if lost:
                        over_scenes.annotate(
                            str(lost), (x, 1.2 * min(value, 1e3)), ha="center", fontsize=7, color="#c92a2a"
                        )
            over_time.set(
                title=f"a fall with masses 5 % off, {encoder}",
                xlabel="time  (s)",
                ylabel="tip error  (mm)",
                ylim=(1e-4, 1e3),
            )
            over_scenes.set(
                title=f"median of the runs, {encoder} (in red: lost)",
                ylabel="tip error  (mm)",
                yscale="log",
                ylim=(1e-3, 2e3),
            )
            over_scenes.set_xticks(range(len(scenes)), [scene.split(",")[0] for scene in scenes])
        panels[0, 0].legend(ncols=2, fontsize=7, loc="lower right")
        picture.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(picture, metadata={"Date": None})


def main(arguments: list[str] | None = None) -> int:
    """Follows all runs with filterpy and with the unit; prints the table, draws the picture."""
    parser = argparse.ArgumentParser(description="Compares other filters with the unit.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--runs", type=Path, required=True, help="the folder with runs.csv, samples.csv, errors.csv")
    parser.add_argument("--picture", type=Path, required=True, help="the SVG file to write")
    options = parser.parse_args(arguments)
    found = machines(options.runs)
    errors: dict[tuple[int, str], np.ndarray] = {}
    table = np.loadtxt(options.runs / "errors.csv", delimiter=";", skiprows=1)
    ways = (options.runs / "errors.csv").read_text(encoding="utf-8").splitlines()[0].split(";")[2:]
    for run in found:
        errors |= {(run, way): table[table[:, 0] == run, 2 + k] for k, way in enumerate(ways)}
    directory = fmpy.extract(str(options.fmu))
    around, times = [], []
    try:
        unit = Unit(fmpy.read_model_description(directory, validate=False), directory)
        for run, machine in found.items():
            errors[run, FILTERPY], time = by_filterpy(unit, machine)
            spent = by_the_unit(unit, machine)
            around.append(time)
            times.append(spent)
            print(f"[{run + 1}/{len(found)}] {machine.scene}, {machine.encoder}: through FMPy", file=sys.stderr)
    finally:
        shutil.rmtree(directory, ignore_errors=True)
    print("| scene | encoder | " + " | ".join(WAYS) + " |\n| --- | --- |" + " ---: |" * len(WAYS))
    for scene, encoder in dict.fromkeys((m.scene, m.encoder) for m in found.values()):
        runs = [run for run, m in found.items() if (m.scene, m.encoder) == (scene, encoder)]
        cells = []
        for way in WAYS:
            lost = sum(is_lost(errors[run, way]) for run in runs)
            error = 1e3 * median(rms(errors[run, way]) for run in runs)
            cells.append((f"{error:.0f}" if error >= 100 else f"{error:.2g}") + (f" ({lost})" if lost else ""))
        print(f"| {scene} | {encoder} | " + " | ".join(cells) + " |")
    alone, reading = (1e6 * median(column) for column in zip(*times, strict=True))
    print(
        f"\nA sample through FMPy, median: {alone:.0f} µs by the unit, {reading:.0f} µs with what is read of it; ",
        end="",
    )
    print(f"{1e6 * median(around):.0f} µs by filterpy. Allowed of the unit: 60 µs.")
    draw(options.picture, found, errors)
    return 0 if reading <= 60 else 1


if __name__ == "__main__":
    sys.exit(main())
