"""A serial arm as a five-bar: converts recordings of a double pendulum to records and scenes.

    python examples/serial_arm.py dfki_double_pendulum out
    fivebar validate out/record.csv --scene out/scene.json --known-commands

The folder contains the CSV files and `model_parameters.yml` from data/experiment_records/design_C.1/sys_id/20230629 of the
repository dfki-ric-underactuated-lab/double_pendulum. Links 1 and 2 are the arm. Link 2 is drawn longer than it is, with its true
mass and centre of mass; links 3 and 4 weigh nearly nothing.

`out/seen.csv` has the first two thirds of each run, which `fivebar validate` does not judge, and `out/off.json` a scene to
calibrate with it (docs/recordings.md).
"""

import json
import sys
from pathlib import Path

import numpy as np

from fivebar import table

BASE = 1.0  # m: axis of the right motor beside the shoulder
LINK_2, LINK_3, LINK_4 = (
    3.0,
    1.2,
    3.06,
)  # m: nearly a parallelogram, so that the right motor turns almost as link 2 does
LIGHT = 1e-5  # kg
STEP = 2 * np.pi / 2**14  # rad: resolution of the arm's encoders
TORQUE = 0.1  # N.m: typical size of unknown torques, from friction, ripple and play
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


def scene(arm, first):
    """Scene of the arm, starting at the first readings."""
    values = {
        "description": "A serial arm with two joints as a five-bar.",
        "experiment": {"stopTime": 10, "stepSize": 0.002},
        "base.distance": BASE,
        "gravity.direction": -np.pi / 2,
        "init.theta[1]": first["measured.theta[1]"],
        "init.theta[2]": first["measured.theta[2]"],
        "init.assembly": "plus",
        "rotor.enabled": True,
        "rotor.inertia[1]": arm["Ir"],
        "rotor.gearRatio[1]": arm["gr"],
        "rotor.inertia[2]": 0,
        "viscous.enabled": True,
        "friction.enabled": True,
        "estimator.quantum[1]": STEP,
        "estimator.quantum[2]": 0,  # computed from both encoders
        "estimator.sigma[2]": 3e-4,
        "estimator.torqueScale": TORQUE,
    }
    # The elbow's rotor turns with gr theta2' - (gr + 1) theta1'. Its inertia about both joints goes to links 1 and 2. Its coupling of
    # both is constant and that of link 2 varies with the cosine of the elbow angle: they are equal for small angles if a part of the
    # weight of link 2 moves to link 4, which turns as link 2 does and is not carried by link 1.
    coupling = arm["gr"] * (arm["gr"] + 1) * arm["Ir"] / arm["l1"]
    com = arm["r2"] - coupling / arm["m2"]
    moved = coupling / com
    about_joint_1 = arm["I1"] + (arm["gr"] + 1) ** 2 * arm["Ir"]
    about_joint_2 = arm["I2"] + arm["gr"] ** 2 * arm["Ir"] - moved * com**2
    links = [
        (arm["l1"], arm["m1"], arm["r1"], about_joint_1 - arm["m1"] * arm["r1"] ** 2),
        (LINK_2, arm["m2"], com, about_joint_2 - arm["m2"] * com**2),
        (LINK_3, LIGHT, LINK_3 / 2, LIGHT * LINK_3**2 / 12),
        (LINK_4, moved, com, LIGHT * LINK_4**2 / 12),
    ]
    for i, link in enumerate(links, 1):
        values |= zip((f"link[{i}].{name}" for name in ("length", "mass", "com", "inertia")), link, strict=True)
    for joint in range(1, 6):
        # The authors' friction law cf arctan(100 w) has the limit pi/2 cf.
        dry = np.pi / 2 * arm.get(f"cf{joint}", 0.0)
        values |= {f"friction.coulomb[{joint}]": dry, f"friction.breakaway[{joint}]": dry}
        values[f"viscous.b[{joint}]"] = arm.get(f"b{joint}", 0.0)
    return values


def write(file, runs):
    """Writes runs to a record. The time of each run starts at 0, so each run becomes a separate series."""
    table.write_columns(file, {name: np.concatenate([run[name] for run in runs]) for name in runs[0]})


def off(values):
    """The scene as a start of a calibration: masses, centres of mass and friction are 20 % too small."""
    unknown = [f"link[{i}].{name}" for i in (1, 2) for name in ("mass", "inertia", "com")]
    unknown += [name for name in values if "coulomb" in name or "breakaway" in name or name.startswith("viscous.b")]
    return values | {name: 0.8 * values[name] for name in unknown}


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
