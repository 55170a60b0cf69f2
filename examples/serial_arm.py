"""A serial arm as a five-bar: converts recordings of a double pendulum to records and scenes.

    python examples/serial_arm.py dfki_double_pendulum out
    fivebar validate out/record.csv --scene out/scene.json --known-commands

The folder contains the CSV files and `model_parameters.yml` from data/experiment_records/design_C.1/sys_id/20230629 of the
repository dfki-ric-underactuated-lab/double_pendulum. serial_arm_model.py has the scene.

`out/seen.csv` has the first two thirds of each run, which `fivebar validate` does not judge, and `out/off.json` a scene to
calibrate with it (docs/recordings.md).
"""

import json
import sys
from pathlib import Path

import numpy as np

from fivebar import table
from serial_arm_model import BASE, LINK_2, LINK_3, LINK_4, off, scene

DELAY = 0.012  # s: measured torques of the shoulder follow the commanded ones by this time


def columns(file, arm):
    """Columns of a run. The arm measures angles from hanging down, and its elbow angle relative to link 1."""
    given = np.genfromtxt(file, delimiter=",", names=True)
    theta1 = given["pos_meas1"] - np.pi / 2
    theta2 = theta1 + given["pos_meas2"]
    tip = arm["l1"] * np.exp(1j * theta1) + LINK_2 * np.exp(1j * theta2) - BASE
    theta4 = np.unwrap(np.angle(tip) + np.arccos((LINK_4**2 + abs(tip) ** 2 - LINK_3**2) / (2 * LINK_4 * abs(tip))))
    theta3 = np.angle(tip - LINK_4 * np.exp(1j * theta4))
    # Rates obey theta4' = a theta1' + b theta2'. Both pairs of motors have equal power:
    # shoulder theta1' + elbow (theta2' - theta1') = left theta1' + right theta4'.
    a = arm["l1"] * np.sin(theta3 - theta1) / (LINK_4 * np.sin(theta3 - theta4))
    b = LINK_2 * np.sin(theta3 - theta2) / (LINK_4 * np.sin(theta3 - theta4))
    shoulder, elbow = (np.interp(given["time"] - DELAY, given["time"], given[f"tau_con{i}"]) for i in (1, 2))
    right = elbow / b
    motors = {"tau[1]": shoulder - elbow - a * right, "tau[2]": right}
    return {"time": given["time"], "measured.theta[1]": theta1, "measured.theta[2]": theta4} | motors


def write(file, runs):
    """Writes runs to a record. The time of each run starts at 0, so each run becomes a separate series."""
    table.write_columns(file, {name: np.concatenate([run[name] for run in runs]) for name in runs[0]})


if __name__ == "__main__":
    source, out = map(Path, sys.argv[1:])
    lines = (source / "model_parameters.yml").read_text(encoding="utf-8").splitlines()
    arm = {name: float(value) for name, value in (line.split(":") for line in lines if ":" in line)}
    runs = [columns(file, arm) for file in sorted(source.glob("*.csv"))]
    out.mkdir(parents=True, exist_ok=True)
    write(out / "record.csv", runs)
    seen = [run["time"] < run["time"][0] + 2 / 3 * np.ptp(run["time"]) for run in runs]
    write(
        out / "seen.csv",
        [{name: column[rows] for name, column in run.items()} for run, rows in zip(runs, seen, strict=True)],
    )
    values = scene(arm, {name: float(column[0]) for name, column in runs[0].items()})
    for name, content in (("scene", values), ("off", off(values))):
        (out / f"{name}.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
