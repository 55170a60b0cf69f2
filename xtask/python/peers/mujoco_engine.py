"""MuJoCo: two legs of two hinges, joined at their ends by a point constraint as stiff as the step allows."""

from functools import partial

import mujoco
import numpy as np

from machine import BASE, COM, INERTIA, LENGTH, MASS, G, Peer, Setting, joint_torques

# The constraint stiffens as the step shrinks, so RK4 is only of second order here.
RUNS = tuple(("RK4", h) for h in (4e-3, 2e-3, 1e-3, 4e-4, 1e-4, 2e-5)) + tuple(
    ("implicitfast", h) for h in (1e-3, 1e-4, 2e-5)
)


def peer() -> Peer:
    # By default MuJoCo appends warnings to MUJOCO_LOG.TXT in the working directory; failures are checked below.
    mujoco.set_mju_user_warning(lambda _text: None)
    return Peer("MuJoCo", mujoco.__version__, (_setting(*run) for run in RUNS))


def _setting(integrator: str, step: float) -> Setting:
    # A time constant of two steps is the stiffest that MuJoCo accepts (refsafe); the impedance is close to 1.
    text = f"{integrator}, h = {step:g} s, equality solref = (2 h, 1), solimp = 0.9999, Newton tolerance 1e-14"

    def begin(start, loaded=False):
        mujoco.set_mjcb_passive(None)  # while compiling, MuJoCo steps a model that Python does not know
        model = mujoco.MjModel.from_xml_string(_xml(integrator, step))
        data = mujoco.MjData(model)
        mujoco.set_mjcb_passive(_load if loaded else None)
        a, b, c, d = start[:4]
        data.qpos[:] = a, b - a, d, c - d
        mujoco.mj_forward(model, data)
        done = 0

        def advance(until):
            nonlocal done
            steps = round(until / step)
            mujoco.mj_step(model, data, steps - done)
            done = steps
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0:
                raise RuntimeError("accelerations that are not finite; MuJoCo reset the state")
            return _state(data)

        return advance

    return Setting(text, begin, begin_loaded=partial(begin, loaded=True))


def _state(data) -> np.ndarray:
    """Angles and rates of the links."""
    (p, q, r, s), (v, w, x, z) = data.qpos, data.qvel
    return np.array([p, p + q, r + s, r, v, v + w, x + z, x])


def _load(_model, data) -> None:
    """Servos and friction. MuJoCo calls this at each evaluation of forces, so that RK4 sees them at every stage."""
    data.qfrc_passive[:] = joint_torques(_state(data))


def _xml(integrator: str, step: float) -> str:
    # At angle 0 a link lies along +x. Inertia about the other axes has no influence, but must satisfy the triangle inequality.
    link = f'<joint axis="0 0 1"/><inertial pos="{COM} 0 0" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>'

    def leg(side: str, x: float) -> str:
        return (
            f'<body pos="{x} 0 0">{link}<body name="{side}" pos="{LENGTH} 0 0">{link}'
            f'<site name="{side}" pos="{LENGTH} 0 0"/></body></body>'
        )

    return f"""<mujoco><compiler angle="radian"/>
      <option timestep="{step}" gravity="0 {-G} 0" integrator="{integrator}" tolerance="1e-14" iterations="100"/>
      <worldbody>{leg("left", 0)}{leg("right", BASE)}</worldbody>
      <equality><connect site1="left" site2="right" solref="{2 * step} 1" solimp="0.9999 0.9999 0.001"/></equality></mujoco>"""
