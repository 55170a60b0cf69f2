"""The scene of a serial arm as a five-bar, for serial_arm.py: links 1 and 2 are the arm.

Link 2 is drawn longer than it is, with its true mass and centre of mass; links 3 and 4 weigh nearly nothing.
"""

import numpy as np

BASE = 1.0  # m: axis of the right motor beside the shoulder
# m: nearly a parallelogram, so that the right motor turns almost as link 2 does
LINK_2, LINK_3, LINK_4 = 3.0, 1.2, 3.06
LIGHT = 1e-5  # kg
STEP = 2 * np.pi / 2**14  # rad: resolution of the arm's encoders
TORQUE = 0.1  # N.m: typical size of unknown torques, from friction, ripple and play


def scene(arm, first):
    """Scene of the arm, starting at the first readings."""
    values = {
        "description": "A serial arm with two joints as a five-bar.",
        "experiment": {"stopTime": 10, "stepSize": 0.002},
        "base.distance": BASE,
        "gravity.direction": -np.pi / 2,
        "init.theta[1]": first["measured.theta[1]"],
        "init.theta[2]": first["measured.theta[2]"],
        "init.assembly": "minus",
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


def off(values):
    """The scene as a start of a calibration: masses, centres of mass and friction are 20 % too small."""
    unknown = [f"link[{i}].{name}" for i in (1, 2) for name in ("mass", "inertia", "com")]
    unknown += [name for name in values if "coulomb" in name or "breakaway" in name or name.startswith("viscous.b")]
    return values | {name: 0.8 * values[name] for name in unknown}
