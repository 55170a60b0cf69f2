"""Statics: motor torques that hold weight, payload and springs, and the additional tip force that the motors can hold.

Friction, stops and the contact plane are neglected; friction can hold additional loads.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fivebar.errors import FiveBarError
from fivebar.kinematics import Machine, numbers, sines
from fivebar.scene import Scene

Floats = NDArray[np.float64]


def holding_torques(scene: Scene, theta: ArrayLike) -> Floats:
    """Motor torques, N·m, shape (..., 2), that hold the scene's machine at rest at postures (..., 4).

    Refused at direct singularities.
    """
    theta = _postures(theta)
    machine = Machine.from_scene(scene)
    carried = np.stack(
        [
            np.sum(_weight(scene, theta) * machine.link_rates(theta, rates), axis=-1)
            for rates in ((1.0, 0.0), (0.0, 1.0))
        ],
        axis=-1,
    )
    return -carried - _springs(scene, theta)


def tip_force(scene: Scene, theta: ArrayLike, limits: tuple[float, float]) -> Floats:
    """Largest force, N, shape (...), that the tip at rest holds in every direction with motor torques within +-`limits`, N·m.

    Torques against weight and springs are deducted first. A negative value means that the motors cannot hold even these. At
    direct singularities the value is at most 0.
    """
    theta = _postures(theta)
    machine = Machine.from_scene(scene)
    if np.shape(limits) != (2,) or not np.all(np.asarray(limits, dtype=np.float64) >= 0):
        raise FiveBarError(f"limits = {limits!r:.60}: two torques of at least 0 N·m are expected, left motor first.")
    sine = sines(theta)
    # All torques are multiplied by sin(theta3 - theta2) and so stay finite at direct singularities.
    t1, t2, t3, t4 = (theta[..., i] for i in range(4))
    l1, l2, l3, l4 = machine.lengths
    by_angle = _weight(scene, theta)
    turn_2 = [-l1 * np.sin(t3 - t1) / l2, l4 * np.sin(t3 - t4) / l2]
    turn_3 = [-l1 * np.sin(t2 - t1) / l3, l4 * np.sin(t2 - t4) / l3]
    forces = []
    for motor, (own, arm) in enumerate(((0, l1 * sine[..., 1]), (3, l4 * sine[..., 2]))):
        free = _springs(scene, theta)[..., motor] + by_angle[..., own]
        carried = free * sine[..., 0] + by_angle[..., 1] * turn_2[motor] + by_angle[..., 2] * turn_3[motor]
        spare = limits[motor] * np.abs(sine[..., 0]) - np.abs(carried)
        forces.append(np.where(arm != 0, spare / np.where(arm != 0, np.abs(arm), 1.0), np.copysign(np.inf, spare)))
    least: Floats = np.minimum(*forces)
    return least


def _postures(theta: ArrayLike) -> Floats:
    """Angles of the links as an array (..., 4); NaN, as at points out of reach, is allowed."""
    return numbers("theta", theta, 4, "rad")


def _weight(scene: Scene, theta: Floats) -> Floats:
    """Generalised forces of gravity in the link angles, N·m, shape (..., 4); the payload is on links 1 and 2."""
    masses, arms, lengths = (
        [float(scene[f"link[{i}].{what}"]) for i in range(1, 5)] for what in ("mass", "com", "length")
    )
    payload = float(scene["payload.mass"]) if scene["payload.enabled"] else 0.0
    pull = float(scene["gravity.g"]) * np.sin(float(scene["gravity.tilt"])) if scene["gravity.enabled"] else 0.0
    moments = np.array(
        [
            masses[0] * arms[0] + (masses[1] + payload) * lengths[0],
            masses[1] * arms[1] + payload * lengths[1],
            masses[2] * arms[2],
            masses[3] * arms[3] + masses[2] * lengths[3],
        ]
    )
    # Scalar product of gravity with the link's direction rotated by 90 degrees.
    return pull * moments * np.sin(float(scene["gravity.direction"]) - theta)


def _springs(scene: Scene, theta: Floats) -> Floats:
    """Spring torques on the motor axes, N·m, shape (..., 2), with the angle at the whole turn nearest to the spring's rest angle."""
    motors = theta[..., [0, 3]]
    if not scene["spring.enabled"]:
        return np.zeros_like(motors)
    k, rest = (np.array([float(scene[f"spring.{what}[{i}]"]) for i in (1, 2)]) for what in ("k", "theta0"))
    torques: Floats = -k * (np.remainder(motors - rest + np.pi, 2 * np.pi) - np.pi)
    return torques
