"""The unit follows a machine simulated in MuJoCo (machine.py): errors, bands, forecasts, alarms and a calibration, with only a user's settings.

python follow.py --fmu target/fmu/FiveBar.fmu --minutes 20 --seed 1 --out target/mujoco
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np

import calibrate
import machine
from fivebar.drawing import STYLE
from fivebar.instance import Unit
from fivebar.library import Library

STEP = 1e-3
"""Step of the unit and communication interval, s."""

TICKS = round(machine.SAMPLE / STEP)
"""Communication points per sample."""

HORIZONS = (0.1, 0.3, 0.5)
"""Horizons of forecasts, s."""

EVERY = 0.5
"""Interval of forecasts, s."""

INSIDE = 5.991
"""95 % quantile of the chi-squared distribution with two degrees of freedom."""

LOST = 0.01
"""Error of the tip, m, above which the machine counts as lost, if it also exceeds three half-widths."""

ALARM = 0.5
"""An alarm is attributed to a push up to this time after it, s."""

ESTIMATE = ("tip.x", "tip.y", "estimated.tip.cov[1]", "estimated.tip.cov[2]", "estimated.tip.cov[3]", "estimated.alarm")
"""Variables read at each sample; the first five also from forecasts."""

STATUS = "estimated.status"

LEARNED = {f"link[{i}].mass": f"estimated.mass[{i}]" for i in range(1, 5)} | {
    f"viscous.b[{i}]": f"estimated.viscous[{i}]" for i in range(1, 6)
}
LEARNED |= {f"link[{i}].length": f"estimated.length[{i}]" for i in range(1, 5)} | {
    "base.distance": "estimated.length[5]"
}
LEARNED |= {f"encoder.offset[{i}]": f"estimated.offset[{i}]" for i in (1, 2)}
"""Parameters that a unit can learn, with the variables of the learned values."""

QUANTILE = 1.96
"""95 % of a normal variable are within this many standard deviations."""


class Follower:
    """A unit with a user's settings for this machine; with `learn` it learns masses, viscous friction, lengths and mounting angles.

    Learning requires samples without delay. A unit that learns therefore lags behind the machine by the delay of the bus and treats each sample as current.
    """

    def __init__(self, fmu: Path, learn: bool = False):
        self.learns = learn
        values = {
            name: value for name, value in machine.believed().items() if name not in ("description", "experiment")
        }
        values |= {f"estimator.quantum[{i}]": machine.QUANTUM for i in (1, 2)}
        values |= {
            "estimator.enabled": True,
            # The user knows the delay of the bus, and that time stamps are inexact.
            "estimator.maxDelay": 0 if learn else machine.SAMPLE,
            # Tolerances of a workshop: 0.2 mm and 2 mrad.
            "estimator.sigma0.length": 2e-4,
            "estimator.sigma0.offset": 2e-3,
            "estimator.sigma0.theta": 0.01,
            "estimator.sigma0.omega": 0.1,
            "solver.method": "automatic",
            "solver.errorTolerance": 1e-7,
            "estimator.learn.enabled": learn,
            "viscous.enabled": learn,
        }
        values |= {f"viscous.b[{i}]": 0 for i in range(1, 6)}
        self.unit = Unit.of(Library(fmu))
        self.unit.reset(**values)

    def learned(self, truth: machine.Truth) -> dict[str, dict[str, float]]:
        """Learned values and half-widths of their 95 % bands, with the true values."""
        true = calibrate.true_values(truth)
        result = {}
        for name, variable in LEARNED.items():
            found, sigma = self.unit.get(variable, variable.replace("[", ".sigma["))
            result[name] = {
                "true": true[name],
                "found": found,
                "bar": QUANTILE * sigma,
                "inside": abs(found - true[name]) <= QUANTILE * sigma,
            }
        return result


ORDERS = ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")
MEASURED = ("measured.theta[1]", "measured.theta[2]", "measured.time[1]", "measured.time[2]")


def follow(follower: Follower, rows: np.ndarray, progress) -> tuple[np.ndarray, list[str], dict[float, np.ndarray]]:
    """Outputs of the unit at each sample (`ESTIMATE`), the name of its status, and for each horizon the forecasts with the index of the sample at their end.

    A sample arrives `machine.DELAY` after it was taken.
    """
    unit = follower.unit
    wait = 0 if follower.learns else round(machine.DELAY / STEP)
    said, statuses = [], []
    ahead = {horizon: [] for horizon in HORIZONS}
    often = round(EVERY / machine.SAMPLE)
    for index, (stamp, *shown, p, q, v, w, _fx, _fy) in enumerate(rows):
        said.append(unit.numbers(ESTIMATE))
        statuses.append(unit[STATUS])
        unit.update(dict(zip(ORDERS, (p, q, v, w))))
        for _ in range(wait):
            unit.step(STEP)
        taken = unit.time if follower.learns else stamp
        unit.update(dict(zip(MEASURED, (*shown, taken, taken))))
        for _ in range(TICKS - wait):
            unit.step(STEP)
        if (index + 1) % often == 0 and index + 1 + round(max(HORIZONS) / machine.SAMPLE) < len(rows):
            state = unit.state()
            for later in range(1, round(max(HORIZONS) / machine.SAMPLE) + 1):
                unit.update(dict(zip(ORDERS, rows[index + later][3:7])))
                unit.step(TICKS * STEP)
                for horizon in HORIZONS:
                    if later == round(horizon / machine.SAMPLE):
                        ahead[horizon].append([index + 1 + later, *unit.numbers(ESTIMATE[:5])])
            unit.restore(state)
        progress(index * machine.SAMPLE)
    return np.array(said), statuses, {horizon: np.array(found) for horizon, found in ahead.items()}


def judge(said: np.ndarray, tips: np.ndarray) -> dict[str, np.ndarray]:
    """Errors of the tip, m, half-widths of the 95 % ellipses along their major axis, m, and whether the truth is inside."""
    (dx, dy), (xx, xy, yy) = (tips - said[:, :2]).T, said[:, 2:5].T
    middle, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    inside = dx**2 * yy - 2 * dx * dy * xy + dy**2 * xx <= INSIDE * (xx * yy - xy**2)
    return {"error": np.hypot(dx, dy), "half": np.sqrt(INSIDE * (middle + radius)), "inside": inside}


def figures(rows, true, kinds, said, statuses, ahead) -> dict[str, object]:
    """Figures of a run, in mm, %, s."""
    settled = round(2 / machine.SAMPLE)
    found = judge(said, true[:, 3:5])
    result = {"minutes": len(rows) * machine.SAMPLE / 60, "estimate": _row(found, slice(settled, None))}
    kinds = np.array(kinds)
    late = np.arange(len(rows)) >= settled
    pushed = np.hypot(rows[:, 7], rows[:, 8]) > 0
    result["estimate, by motion"] = {
        kind: _row(found, late & (kinds == kind) & ~pushed) for kind in ("pick", "sines", "steps", "rest")
    }
    result["estimate, pushed"] = _row(found, late & pushed)
    result["forecasts"] = {
        f"{horizon:g} s": _row(judge(rest[:, 1:], true[rest[:, 0].astype(int), 3:5]), slice(None))
        for horizon, rest in ahead.items()
    }
    lost = (found["error"] > LOST) & (found["error"] > 3 * found["half"])
    result["lost, % of samples"] = round(100 * float(lost[settled:].mean()), 3)
    counts = np.unique(np.array(statuses)[settled:], return_counts=True)
    result["status, % of samples"] = {
        str(k): round(100 * int(n) / (len(rows) - settled), 2) for k, n in zip(*counts, strict=True)
    }
    alarm = said[:, 5] > 0.5
    onsets = [i for i in range(1, len(rows)) if pushed[i] and not pushed[i - 1]]
    ends = [i for i in range(1, len(rows)) if pushed[i - 1] and not pushed[i]]
    delays = [np.flatnonzero(alarm[i : i + round(ALARM / machine.SAMPLE)]) for i in onsets]
    excused = np.zeros(len(rows), bool)
    for begin, end in zip(onsets, [*ends, len(rows)], strict=False):
        excused[begin : end + round(ALARM / machine.SAMPLE)] = True
    false = [i for i in range(settled + 1, len(rows)) if alarm[i] and not alarm[i - 1] and not excused[i]]
    result["alarms"] = {
        "pushes": len(onsets),
        "found within 0.5 s": sum(bool(len(delay)) for delay in delays),
        "median time to find, ms": float(
            np.median([1e3 * machine.SAMPLE * delay[0] for delay in delays if len(delay)] or [np.nan])
        ),
        "false alarms a minute": round(len(false) / result["minutes"], 2),
    }
    return result


def _row(found: dict[str, np.ndarray], which) -> dict[str, float]:
    part = {name: values[which] for name, values in found.items()}
    if len(part["error"]) == 0:
        return {"samples": 0}
    return {
        "samples": len(part["error"]),
        "error, mm, median": round(1e3 * float(np.median(part["error"])), 4),
        "error, mm, 95 %": round(1e3 * float(np.quantile(part["error"], 0.95)), 4),
        "half-width, mm, median": round(1e3 * float(np.median(part["half"])), 4),
        "inside, %": round(100 * float(part["inside"].mean()), 1),
        # Half-widths multiplied by this would cover 95 %.
        "band too narrow by": round(float(np.quantile(part["error"] / part["half"], 0.95)), 1),
    }


def draw(path: Path, rows, true, said, ahead) -> None:
    """Half a minute of the run: errors of the tip with their bands, forecasts, the unit's alarm and the pushes, which are unknown to the unit."""
    found = judge(said, true[:, 3:5])
    time = true[:, 0]
    begin = next((t for t, push in zip(time, np.hypot(rows[:, 7], rows[:, 8]), strict=True) if push > 0), 15.0) - 10.0
    part = (time >= begin) & (time < begin + 30)
    with plt.rc_context(STYLE):
        figure, (upper, middle, lower) = plt.subplots(3, 1, figsize=(9, 7), sharex=True, layout="constrained")
        upper.plot(time[part], true[part, 3] * 1e3, label="x")
        upper.plot(time[part], true[part, 4] * 1e3, label="y")
        upper.set_ylabel("tip, mm")
        middle.fill_between(
            time[part], 1e-3, found["half"][part] * 1e3, alpha=0.3, label="half-width of the 95 % ellipse"
        )
        middle.plot(time[part], found["error"][part] * 1e3, linewidth=0.8, label="error")
        horizon = HORIZONS[-1]
        end = time[ahead[horizon][:, 0].astype(int)]
        later = judge(ahead[horizon][:, 1:], true[ahead[horizon][:, 0].astype(int), 3:5])
        shown = (end >= begin) & (end < begin + 30)
        middle.plot(end[shown], later["error"][shown] * 1e3, "o", markersize=3, label=f"error, {horizon:g} s ahead")
        middle.plot(end[shown], later["half"][shown] * 1e3, "_", label=f"half-width, {horizon:g} s ahead")
        middle.set_yscale("log")
        middle.set_ylim(bottom=1e-3)
        middle.set_ylabel("mm")
        lower.plot(time[part], np.hypot(rows[part, 7], rows[part, 8]), label="push, N (the unit does not know it)")
        lower.plot(time[part], said[part, 5], linewidth=0.8, label="estimated.alarm")
        lower.set_xlabel("time, s")
        for axes in (upper, middle, lower):
            axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, frameon=False)
        figure.savefig(path)


def write(folder: Path, truth: machine.Truth, rows, true) -> None:
    """Writes the record as a table for `fivebar calibrate`, the assumed scene, and the true values."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "believed.json").write_text(json.dumps(machine.believed(), indent=1) + "\n")
    (folder / "truth.json").write_text(
        json.dumps({name: np.asarray(value).tolist() for name, value in asdict(truth).items()}, indent=1) + "\n"
    )
    for name, columns, table in (("record.csv", machine.COLUMNS[:7], rows[:, :7]), ("true.csv", machine.TRUE, true)):
        np.savetxt(folder / name, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def show(figures: dict[str, object]) -> str:
    """Figures as lines of a table."""
    lines = [
        "| what | samples | error, mm, median | 95 % | half-width, mm | inside, % | too narrow by |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    named = {"estimate": figures["estimate"]}
    named |= {f"estimate, {kind}": row for kind, row in figures["estimate, by motion"].items()}
    named |= {"estimate, pushed": figures["estimate, pushed"]}
    named |= {f"forecast, {horizon}": row for horizon, row in figures["forecasts"].items()}
    learning = figures["learning"]
    named |= {"learning: estimate": learning["estimate"], "learning: estimate, pushed": learning["estimate, pushed"]}
    named |= {f"learning: forecast, {horizon}": row for horizon, row in learning["forecasts"].items()}
    lines += [f"| {name} | " + " | ".join(f"{value:g}" for value in row.values()) + " |" for name, row in named.items()]
    lines += [f"{name}: {figures[name]}" for name in ("lost, % of samples", "status, % of samples", "alarms")]
    lines += [
        f"learning: {name}: {learning[name]}" for name in ("lost, % of samples", "status, % of samples", "alarms")
    ]
    lines += ["| learned | true | found | 95 % bar | inside |", "| --- | ---: | ---: | ---: | --- |"]
    lines += [
        f"| `{name}` | {row['true']:.5g} | {row['found']:.5g} | {row['bar']:.2g} | {'yes' if row['inside'] else 'no'} |"
        for name, row in learning["learned"].items()
    ]
    return "\n".join(lines)


def main() -> None:
    """Makes the record, follows it, prints and writes the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fmu", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()

    def progress(what: str):
        def tell(done: float) -> None:
            if round(done / machine.SAMPLE) % 2000 == 0:
                print(f"\r\033[K{what}: {done:.0f} of {60 * asked.minutes:.0f} s ", end="", file=sys.stderr, flush=True)

        return tell

    truth, rows, true, kinds = machine.record(60 * asked.minutes, asked.seed, progress("MuJoCo moves the machine"))
    write(asked.out, truth, rows, true)
    said, statuses, ahead = follow(Follower(asked.fmu), rows, progress("the unit follows"))
    print(file=sys.stderr)
    result = figures(rows, true, kinds, said, statuses, ahead)
    learner = Follower(asked.fmu, learn=True)
    result["learning"] = figures(rows, true, kinds, *follow(learner, rows, progress("a unit that learns follows")))
    result["learning"]["learned"] = learner.learned(truth)
    print(file=sys.stderr)
    result["calibration"] = calibrate.calibrate(asked.out, asked.fmu, rows, kinds, truth)
    (asked.out / "figures.json").write_text(json.dumps(result, indent=1) + "\n")
    draw(asked.out / "follow.svg", rows, true, said, ahead)
    print(show(result))
    print(calibrate.show(result["calibration"]))


if __name__ == "__main__":
    main()
