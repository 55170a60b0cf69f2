"""A five-bar in MuJoCo that nobody modelled for FiveBar: play at the tip, soft links, friction, ripple of the motors' torque, eccentric encoders, late and
irregular samples, lengths, masses and offsets that differ from what is believed. A seed determines all of it.

`cargo xtask mujoco` calls `record`, writes what the machine shows as a table and what is true beside it, and lets the unit follow (follow.py).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import tau

import mujoco
import numpy as np

STEP, DRIVE = 2.5e-4, 5e-4
"""Of MuJoCo; of the drives, whose torque is held in between, s."""

SAMPLE = 5e-3
"""Between samples and between orders to the drives, s: 200 Hz."""

GRAVITY = 9.81
"""m/s², along −y: the machine stands upright."""

# Believed parameters of the machine: the scene that the unit is given.
BASE, LENGTH, MASS, COM, INERTIA = 0.1, 0.21, 0.017, 0.105, 6.23e-5
KP, KD, LIMIT, ROTOR = 6.0, 0.09, 0.6, 5e-5
"""Of the drives: N·m/rad, N·m·s/rad, N·m, kg·m²."""

HOME = (2.0, 1.14)
"""Angles of the motors at the start, rad."""

APART = (0.07, 0.385)
"""Distance of the elbows on planned motions, m. Distal links in line, or one on the other, are at 0.42 and 0."""

# Differences of the true machine, each drawn uniformly within plus or minus this, or as said.
OFF_LENGTH, OFF_MASS = 1e-3, 0.05
"""Relative, of each link."""
OFF_BASE = 1e-4
"""Of the distance of the motors, m."""
OFF_OFFSET = 1e-3
"""Of the encoders' zero, rad."""
ECCENTRICITY = (1e-4, 5e-4)
"""Amplitude of the encoders' error once a turn, rad."""
VISCOUS, COULOMB = (0.0, 2e-5), (0.0, 4e-4)
"""Of each joint, N·m·s; of the motors, N·m."""
RIPPLE, COGGING, SLOTS = (0.0, 0.03), (0.0, 5e-4), 21
"""Relative ripple and cogging torque of the motors, N·m, with periods a turn."""
PLAY, FLEXURE = 2e-5, 60.0
"""Play of the pin at the tip to each side, m; stiffness of each link at its middle, N·m/rad."""
DELAY, JITTER = 2e-3, 2e-4
"""Of samples, s: constant; standard deviation of what stamps do not know."""
QUANTUM = tau / 65536
"""Step of the encoders, rad."""


@dataclass(frozen=True)
class Truth:
    """A machine as drawn: lengths, m, and masses, kg, of links 1 to 4; distance of the motors, m; the rest of the motors or joints."""

    length: np.ndarray
    mass: np.ndarray
    base: float
    offset: np.ndarray
    eccentricity: np.ndarray
    phase: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    ripple: np.ndarray
    cogging: np.ndarray


def draw(random: np.random.Generator) -> Truth:
    """A machine at random."""
    return Truth(
        length=LENGTH * (1 + random.uniform(-OFF_LENGTH, OFF_LENGTH, 4)),
        mass=MASS * (1 + random.uniform(-OFF_MASS, OFF_MASS, 4)),
        base=BASE + random.uniform(-OFF_BASE, OFF_BASE),
        offset=random.uniform(-OFF_OFFSET, OFF_OFFSET, 2),
        eccentricity=random.uniform(*ECCENTRICITY, 2),
        phase=random.uniform(0, tau, 2),
        viscous=random.uniform(*VISCOUS, 5),
        coulomb=random.uniform(*COULOMB, 2),
        ripple=random.uniform(*RIPPLE, 2),
        cogging=random.uniform(*COGGING, 2),
    )


def believed() -> dict[str, object]:
    """The scene that a user would write for this machine, from its drawing and its encoders' data sheet."""
    scene: dict[str, object] = {
        "description": "A machine simulated by MuJoCo, as its user believes it to be.",
        "experiment": {"stopTime": 1200, "stepSize": SAMPLE},
        "base.distance": BASE,
        "rotor.enabled": True,
        "servo.enabled": True,
    }
    for i in (1, 2, 3, 4):
        scene |= {
            f"link[{i}].length": LENGTH,
            f"link[{i}].mass": MASS,
            f"link[{i}].com": COM,
            f"link[{i}].inertia": INERTIA,
        }
    for i, home in enumerate(HOME, 1):
        scene |= {
            f"init.theta[{i}]": home,
            f"rotor.inertia[{i}]": ROTOR,
            f"servo.kp[{i}]": KP,
            f"servo.kd[{i}]": KD,
            f"servo.limit[{i}]": LIMIT,
            f"servo.theta[{i}]": home,
        }
    return scene


def plan(seconds: float, random: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray, str]]:
    """Angles, rad, and rates, rad/s, that the drives are told at each sample, with the kind of motion: picks, sines, steps and rest in turn, of random
    places, sizes and durations. The elbows stay between `APART`, so that the links are away from their singular configurations."""
    angles, rates = np.array(HOME), np.zeros(2)
    left = round(seconds / SAMPLE)
    while left > 0:
        kind = random.choice(["pick", "sines", "steps", "rest"], p=[0.45, 0.3, 0.15, 0.1])
        count = min(left, round(random.uniform(2, 8) / SAMPLE))
        if kind == "sines":
            # A sum of two sines that begins and ends gently, on the way to the start's place.
            size, speed, phase = (
                random.uniform(0.03, 0.2, (2, 2)),
                random.uniform(0.8, 6.0, (2, 2)),
                random.uniform(0, tau, (2, 2)),
            )

            centre, place = angles.copy(), np.array(HOME)

            def motion(t, end, centre=centre, place=place, size=size, speed=speed, phase=phase):
                blend, slope = _smooth(t / 0.8), _smooth_rate(t / 0.8) / 0.8
                out = 1 - _smooth((t - end + 0.8) / 0.8)
                fall = -_smooth_rate((t - end + 0.8) / 0.8) / 0.8
                waves = (size * np.sin(speed * t + phase)).sum(1)
                swing = (size * speed * np.cos(speed * t + phase)).sum(1)
                way, way_rate = _smooth(t / end), _smooth_rate(t / end) / end
                return (
                    centre + (place - centre) * way + blend * out * waves,
                    (place - centre) * way_rate + blend * out * swing + (slope * out + blend * fall) * waves,
                )

        elif kind == "rest":
            here = angles.copy()

            def motion(t, end, here=here):
                return here, np.zeros(2)

        else:
            # From place to place: by minimum jerk, or at once, as an operator jogs a machine.
            duration = random.uniform(0.35, 1.2) if kind == "pick" else 0.12
            reach = 0.6 if kind == "pick" else 0.12
            places = [angles.copy()]
            while len(places) < count * SAMPLE / duration + 2:
                place = (np.array(HOME) if kind == "pick" else places[0]) + random.uniform(-reach, reach, 2)
                if _apart(place):
                    places.append(place)

            def motion(t, end, places=places, duration=duration):
                index = int(t / duration)
                s, ds = _smooth(t / duration - index), _smooth_rate(t / duration - index) / duration
                return places[index] + (places[index + 1] - places[index]) * s, (places[index + 1] - places[index]) * ds

            count = max(1, round(round(count * SAMPLE / duration) * duration / SAMPLE))
        if not all(_apart(motion(k * SAMPLE, count * SAMPLE)[0]) for k in range(1, count + 1)):
            continue
        for k in range(1, min(count, left) + 1):
            angles, rates = motion(k * SAMPLE, count * SAMPLE)
            yield angles, rates, str(kind)
        left -= count


def _apart(angles: np.ndarray) -> bool:
    """Whether the elbows are as far from each other as `APART` allows."""
    (p, q), (least, most) = angles, APART
    return least < np.hypot(BASE + LENGTH * (np.cos(q) - np.cos(p)), LENGTH * (np.sin(q) - np.sin(p))) < most


def _smooth(s: float) -> float:
    """Minimum jerk from 0 to 1."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 + s * (6 * s - 15))


def _smooth_rate(s: float) -> float:
    s = min(max(s, 0.0), 1.0)
    return 30 * s**2 * (1 - s) ** 2


COLUMNS = (
    "time",
    "measured.theta[1]",
    "measured.theta[2]",
    "servo.theta[1]",
    "servo.theta[2]",
    "servo.omega[1]",
    "servo.omega[2]",
    "tip.fx",
    "tip.fy",
)
"""Of a record: the stamp of a sample, s, what the encoders show, what the drives were told from then on; the push that nobody tells the unit, N."""

TRUE = ("time", "theta[1]", "theta[2]", "tip.x", "tip.y")
"""Of what is true: time, s, at which the sample was taken; angles of the motors, rad; the middle of the pin, m."""


def record(seconds: float, seed: int, progress=lambda done: None) -> tuple[Truth, np.ndarray, np.ndarray, list[str]]:
    """A machine, a table with `COLUMNS`, what is true with `TRUE`, and the kind of motion for each sample."""
    random = np.random.default_rng(seed)
    truth = draw(random)
    model = mujoco.MjModel.from_xml_string(_xml(truth))
    data = mujoco.MjData(model)
    mujoco.set_mju_user_warning(lambda _text: None)
    motors = [model.jnt_qposadr[model.joint(name).id] for name in ("left", "right")]
    _assemble(model, data, truth)
    rows, true, kinds = [], [], []
    pushes = _pushes(seconds, random)
    pin = model.body("pin").id
    middle = [model.site(name).id for name in ("left_end", "right_end")]
    for index, (angles, rates, kind) in enumerate(plan(seconds, random)):
        time = index * SAMPLE
        theta = data.qpos[motors]
        shown = theta + truth.offset + truth.eccentricity * np.sin(theta + truth.phase)
        shown = QUANTUM * np.round(shown / QUANTUM)
        stamp = time + JITTER * random.standard_normal()
        push = next((force for begin, end, force in pushes if begin <= time < end), np.zeros(2))
        rows.append([stamp, *shown, *angles, *rates, *push])
        true.append([time, *theta, *data.site_xpos[middle].mean(0)[:2]])
        kinds.append(kind)
        data.xfrc_applied[pin, :2] = push
        for _ in range(round(SAMPLE / DRIVE)):
            _drive(model, data, truth, motors, (angles, rates))
            mujoco.mj_step(model, data, round(DRIVE / STEP))
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0:
            raise RuntimeError(f"MuJoCo's accelerations are not finite at {time} s")
        progress(time)
    return truth, np.array(rows), np.array(true), kinds


def _pushes(seconds: float, random: np.random.Generator) -> list[tuple[float, float, np.ndarray]]:
    """Pushes of 0.2 to 0.8 N at the tip for 0.1 to 0.6 s, one every half a minute or so: begin, end, s, force, N."""
    found, time = [], 20.0
    while time < seconds:
        direction, size, length = random.uniform(0, tau), random.uniform(0.2, 0.8), random.uniform(0.1, 0.6)
        found.append((time, time + length, size * np.array([np.cos(direction), np.sin(direction)])))
        time += random.uniform(15, 45)
    return found


def _drive(model, data, truth: Truth, motors: list[int], told: tuple[np.ndarray, np.ndarray]) -> None:
    """Torques of the drives by their own encoders, N·m: the law that the unit has as its servo, with ripple and cogging."""
    theta, omega = data.qpos[motors], data.qvel[motors]
    shown = theta + truth.offset + truth.eccentricity * np.sin(theta + truth.phase)
    torque = LIMIT * np.tanh((KP * (told[0] - shown) + KD * (told[1] - omega)) / LIMIT)
    data.qfrc_applied[motors] = torque * (1 + truth.ripple * np.sin(SLOTS * theta)) + truth.cogging * np.sin(
        2 * SLOTS * theta
    )


def _assemble(model, data, truth: Truth) -> None:
    """The loop closed at the start, by Newton's method over the distal links; motors at the angles that the drives are told."""
    (p, q), (a, b, c, d) = HOME, truth.length
    elbows = np.array([[a * np.cos(p), a * np.sin(p)], [truth.base + d * np.cos(q), d * np.sin(q)]])
    arrow = elbows[1] - elbows[0]
    distance = np.hypot(*arrow)
    along = (b**2 - c**2 + distance**2) / (2 * distance)
    across = np.sqrt(b**2 - along**2)
    tip = elbows[0] + (along * arrow + across * np.array([-arrow[1], arrow[0]])) / distance
    distal = [np.arctan2(*(tip - elbow)[::-1]) for elbow in elbows]
    for name, angle in (("left", p), ("left_elbow", distal[0] - p), ("right", q), ("right_elbow", distal[1] - q)):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
    mujoco.mj_forward(model, data)


def _xml(truth: Truth) -> str:
    """Links of two halves with a stiff hinge between them; the pin slides within its play at the end of the left leg, and the right leg holds it."""

    def link(i: int, joint: str, damping: float, motor: str, inner: str, at: str) -> str:
        length, mass = truth.length[i], truth.mass[i]
        half, part = length / 2, mass / 2
        # Two uniform rods of half the length, and discs at their middles for the rest of the inertia.
        about = max((INERTIA * mass / MASS - 2 * part * (half / 2) ** 2) / 2, part * half**2 / 12)
        body = f'<inertial pos="{half / 2} 0 0" mass="{part}" diaginertia="{about} {about} {about}"/>'
        return (
            f'<body pos="{at}"><joint name="{joint}" axis="0 0 1" damping="{damping}" {motor}/>{body}'
            f'<body pos="{half} 0 0"><joint axis="0 0 1" stiffness="{FLEXURE}" damping="{2 * 0.02 * (FLEXURE * about) ** 0.5}"/>{body}'
            f"{inner.format(end=half)}</body></body>"
        )

    pin = (
        '<body name="pin" pos="{{end}} 0 0"><joint type="slide" axis="1 0 0" range="-{0} {0}" limited="true" damping="0.05" {2}/>'
        '<joint type="slide" axis="0 1 0" range="-{0} {0}" limited="true" damping="0.05" {2}/>'
        '<joint type="hinge" axis="0 0 1" damping="{1}"/>'
        '<inertial pos="0 0 0" mass="2e-4" diaginertia="1e-9 1e-9 1e-9"/><site name="pin"/></body><site name="left_end" pos="{{end}} 0 0"/>'
    ).format(PLAY, truth.viscous[2], f'solreflimit="{2 * STEP} 1" solimplimit="0.9999 0.9999 0.001"')
    motors = [f'frictionloss="{loss}" armature="{ROTOR}"' for loss in truth.coulomb]
    left = link(
        0, "left", truth.viscous[0], motors[0], link(1, "left_elbow", truth.viscous[1], "", pin, "{end} 0 0"), "0 0 0"
    )
    end = '<site name="right_end" pos="{end} 0 0"/>'
    right = link(
        3,
        "right",
        truth.viscous[4],
        motors[1],
        link(2, "right_elbow", truth.viscous[3], "", end, "{end} 0 0"),
        f"{truth.base} 0 0",
    )
    return f"""<mujoco><compiler angle="radian"/>
      <option timestep="{STEP}" gravity="0 {-GRAVITY} 0" integrator="implicitfast" tolerance="1e-12" iterations="50"/>
      <worldbody>{left}{right}</worldbody>
      <equality><connect site1="pin" site2="right_end" solref="{2 * STEP} 1" solimp="0.9999 0.9999 0.001"/></equality></mujoco>"""
