"""A five-bar in MuJoCo, independent of FiveBar's model: play at the tip, soft links, friction, torque ripple, eccentric encoders, late and irregular samples, and
lengths, masses and offsets that differ from the assumed ones. A seed determines all of it.

`cargo xtask mujoco` calls `record`, writes the machine's samples and the true values as tables, and lets the unit follow (follow.py).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import tau

import mujoco
import numpy as np

STEP, DRIVE = 2.5e-4, 5e-4
"""Step of MuJoCo; interval of the drives' torque updates, s."""

SAMPLE = 5e-3
"""Interval of samples and of setpoints for the drives, s: 200 Hz."""

GRAVITY = 9.81
"""m/s², along −y: the machine stands upright."""

# Assumed parameters of the machine, as in the unit's scene.
BASE, LENGTH, MASS, COM, INERTIA = 0.1, 0.21, 0.017, 0.105, 6.23e-5
KP, KD, LIMIT, ROTOR = 6.0, 0.09, 0.6, 5e-5
"""Gains, torque limit and rotor inertia of the drives: N·m/rad, N·m·s/rad, N·m, kg·m²."""

HOME = (2.0, 1.14)
"""Motor angles at the start, rad."""

APART = (0.07, 0.385)
"""Range of the distance between the elbows on planned motions, m. The direct singularities are at 0.42 (distal links in line) and 0 (folded)."""

# Errors of the true machine, each uniform within plus or minus the value, unless stated otherwise.
OFF_LENGTH, OFF_MASS = 1e-3, 0.05
"""Relative errors of each link."""
OFF_BASE = 1e-4
"""Error of the distance between the motors, m."""
OFF_OFFSET = 1e-3
"""Error of the encoders' zero, rad."""
ECCENTRICITY = (1e-4, 5e-4)
"""Range of the amplitude of the encoders' error once per turn, rad."""
VISCOUS, COULOMB = (0.0, 2e-5), (0.0, 4e-4)
"""Ranges of viscous friction of each joint, N·m·s, and of Coulomb friction of the motors, N·m."""
RIPPLE, COGGING, SLOTS = (0.0, 0.03), (0.0, 5e-4), 21
"""Ranges of relative torque ripple and of cogging torque of the motors, N·m, and periods per turn."""
PLAY, FLEXURE = 2e-5, 60.0
"""Play of the pin at the tip to each side, m; stiffness of each link at its middle, N·m/rad."""
DELAY, JITTER = 2e-3, 2e-4
"""Delay of samples, s: constant part, and standard deviation that is not in the time stamps."""
QUANTUM = tau / 65536
"""Resolution of the encoders, rad."""


@dataclass(frozen=True)
class Truth:
    """A random machine: lengths, m, and masses, kg, of links 1 to 4; distance of the motors, m; other fields per motor or joint."""

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
    """Draws a random machine."""
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
    """The scene that a user would write for this machine, from its drawing and the encoders' data sheet."""
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
    """Setpoints of the drives at each sample: angles, rad, and rates, rad/s, with the kind of motion. Picks, sines, steps and rest alternate, with random places,
    sizes and durations. The distance between the elbows stays in `APART`, so that the links avoid their singular configurations."""
    angles, rates = np.array(HOME), np.zeros(2)
    left = round(seconds / SAMPLE)
    while left > 0:
        kind = random.choice(["pick", "sines", "steps", "rest"], p=[0.45, 0.3, 0.15, 0.1])
        count = min(left, round(random.uniform(2, 8) / SAMPLE))
        if kind == "sines":
            # A sum of two sines with smooth beginning and end, starting from the current position.
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
            # From place to place: by minimum jerk, or at once, like an operator who jogs a machine.
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
    """Whether the distance between the elbows is within `APART`."""
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
"""Columns of a record: time stamp of a sample, s; encoder readings; setpoints from then on; the push, N, which is unknown to the unit."""

TRUE = ("time", "theta[1]", "theta[2]", "tip.x", "tip.y")
"""Columns of the truth: time of the sample, s; motor angles, rad; middle of the pin, m."""


def record(seconds: float, seed: int, progress=lambda done: None) -> tuple[Truth, np.ndarray, np.ndarray, list[str]]:
    """A machine, its record (`COLUMNS`), the truth (`TRUE`), and the kind of motion for each sample."""
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
    """Pushes of 0.2 to 0.8 N at the tip for 0.1 to 0.6 s, about one every half minute: begin, end, s, force, N."""
    found, time = [], 20.0
    while time < seconds:
        direction, size, length = random.uniform(0, tau), random.uniform(0.2, 0.8), random.uniform(0.1, 0.6)
        found.append((time, time + length, size * np.array([np.cos(direction), np.sin(direction)])))
        time += random.uniform(15, 45)
    return found


def _drive(model, data, truth: Truth, motors: list[int], setpoints: tuple[np.ndarray, np.ndarray]) -> None:
    """Torques of the drives from their own encoders, N·m: the unit's servo law, with ripple and cogging."""
    theta, omega = data.qpos[motors], data.qvel[motors]
    shown = theta + truth.offset + truth.eccentricity * np.sin(theta + truth.phase)
    torque = LIMIT * np.tanh((KP * (setpoints[0] - shown) + KD * (setpoints[1] - omega)) / LIMIT)
    data.qfrc_applied[motors] = torque * (1 + truth.ripple * np.sin(SLOTS * theta)) + truth.cogging * np.sin(
        2 * SLOTS * theta
    )


def _assemble(model, data, truth: Truth) -> None:
    """Closes the loop at the start by Newton's method over the distal links; the motors are at their setpoints."""
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
    """Each link consists of two halves with a stiff hinge between them. The pin slides within its play at the end of the left leg; the right leg carries it."""

    def link(i: int, joint: str, damping: float, motor: str, inner: str, at: str) -> str:
        length, mass = truth.length[i], truth.mass[i]
        half, part = length / 2, mass / 2
        # Two uniform rods of half the length, with discs at their middles for the remaining inertia.
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
