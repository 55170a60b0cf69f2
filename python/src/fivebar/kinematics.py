"""Kinematics of planar five-bar machines, in closed form, for arrays of postures. docs/kinematics.md has the derivation.

Links: 1 left proximal, 2 left distal, 3 right distal, 4 right proximal. Angles are absolute, in rad, counter-clockwise from
+x; distal links point from elbow to tip. The left motor is at (0, 0), the right one at (base.distance, 0). Lengths are in m.
Every function takes arrays of any shape: positions (..., 2), motor angles (..., 2), postures (..., 4).

Working mode: the signs of sin(theta2 - theta1) and sin(theta3 - theta4), left leg first. Assembly: the sign of
sin(theta3 - theta2). In `plus` the tip is to the left of the arrow from the left to the right elbow.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fivebar import arguments
from fivebar.errors import FiveBarError
from fivebar.variables import of_unit

if TYPE_CHECKING:
    from fivebar.scene import Scene

Sign = Literal["plus", "minus"]
Working = tuple[Sign, Sign]
Line = Literal["stretched", "folded"]
"""The two ways in which links can be in line."""

Floats = NDArray[np.float64]

WORKING_MODES: tuple[Working, ...] = (("minus", "plus"), ("plus", "plus"), ("minus", "minus"), ("plus", "minus"))
"""The four working modes; in the first, the elbows point outwards if the tip is above the motors."""


def mode_name(working: Working) -> str:
    """Name of a working mode, such as `minusPlus`, as in the unit's `mode.working`.

    Parameters
    ----------
    working : tuple of str
        `plus` or `minus` for the left and the right leg.

    Returns
    -------
    str
        The name.

    Examples
    --------
    >>> from fivebar.kinematics import mode_name
    >>> mode_name(("minus", "plus"))
    'minusPlus'
    """
    return working[0] + working[1].capitalize()


GEOMETRY = ("base.distance", "link[1].length", "link[2].length", "link[3].length", "link[4].length")
"""Names of the lengths that define a machine."""

NEAR = 1e-3
"""A posture counts as singular if |det J_x| or |det J_q| is below this share of its largest possible value, as in the unit's
`singular.type`."""

LEAST_SINE = 1e-8
"""Smaller sines count as 0 in the divisor of a Jacobian; the unit refuses such postures as coordinates."""

SHORT = 1e-2
"""The distance of the elbows is short if it is below this share of the machine's size: more than two digits of the angle between
them would be lost."""

ROUND_OFF = 16 * np.finfo(float).eps
"""Round-off of a distance, in multiples of the machine's size. Within it, a stretched leg still counts as reaching a point."""

SIGN = {"plus": 1.0, "minus": -1.0}
SIDES = ("left", "right")
LENGTHS = (("link[1].length", "link[2].length"), ("link[4].length", "link[3].length"))


@dataclass(frozen=True)
class Posture:
    """Postures of a machine that close its loop."""

    theta: Floats
    """Angles of the links 1 to 4, rad, shape (..., 4): given angles unchanged, computed angles in [-pi, pi]."""

    tip: Floats
    """Position of the tip, m, shape (..., 2)."""

    elbows: Floats
    """Positions of the left and the right elbow, m, shape (..., 2, 2): leg, then x and y."""

    @property
    def motors(self) -> Floats:
        """Motor angles, theta[1] and theta[2] of the unit, rad, shape (..., 2)."""
        return self.theta[..., [0, 3]]

    @property
    def assembly(self) -> NDArray[np.str_]:
        """`plus` or `minus`, shape (...)."""
        return _names(sines(self.theta)[..., 0])

    @property
    def working(self) -> NDArray[np.str_]:
        """`plus` or `minus` for the left and the right leg, shape (..., 2)."""
        return _names(sines(self.theta)[..., 1:])


class Ellipse(NamedTuple):
    """Ellipses of velocities or forces at the tip."""

    axes: Floats
    """Semi-axes, the major one first, shape (..., 2)."""

    angle: Floats
    """Angle of the major axis, rad, counter-clockwise from +x, in (-pi/2, pi/2], shape (...)."""


class Circle(NamedTuple):
    """Inverse singularities of a leg: the tip is on a circle about the leg's motor."""

    leg: int
    """0 left, 1 right."""

    posture: Line
    centre: tuple[float, float]
    radius: float


class Locus(NamedTuple):
    """A curve of direct singularities: the distal links are in line."""

    posture: Line
    theta: Floats
    """Angles of the links 1 to 4 along the curve, rad, shape (n, 4)."""

    tip: Floats
    """Positions of the tip, m, shape (n, 2); the last equals the first."""


def sines(theta: ArrayLike) -> Floats:
    """sin(theta3 - theta2), sin(theta2 - theta1) and sin(theta3 - theta4).

    The first sine is 0 at direct singularities, and its sign is the assembly. The others are 0 at inverse singularities of the
    left and the right leg, and their signs are the working mode.

    Parameters
    ----------
    theta : array_like
        Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

    Returns
    -------
    numpy.ndarray
        The three sines, shape (..., 3).

    Examples
    --------
    >>> from fivebar.kinematics import sines
    >>> sines([2.0, 1.0, 2.0, 1.0]).round(3).tolist()
    [0.841, -0.841, 0.841]
    """
    t1, t2, t3, t4 = np.moveaxis(np.asarray(theta, dtype=np.float64), -1, 0)
    return np.stack([np.sin(t3 - t2), np.sin(t2 - t1), np.sin(t3 - t4)], axis=-1)


def numbers(name: str, values: ArrayLike, width: int, unit: str) -> Floats:
    """Values as an array (..., width); NaN is allowed. Raises FiveBarError for anything else."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise FiveBarError(
            f"{name} = {values!r:.80}: {width} numbers in {unit} are expected, in the last axis of an array."
        ) from None
    if array.ndim == 0 or array.shape[-1] != width:
        raise FiveBarError(f"{name} has the shape {array.shape}: the last axis must have {width} elements.")
    return array


@dataclass(frozen=True)
class Machine:
    """A planar five-bar mechanism with its motors on the x axis: lengths, m, and kinematics.

    Examples
    --------
    >>> import fivebar
    >>> robot = fivebar.Machine.from_scene("pick_and_place")
    >>> posture = robot.inverse((0.05, 0.3), working=("minus", "plus"))
    >>> posture.theta.shape
    (4,)
    >>> robot.forward(posture.motors, "plus").tip.round(12).tolist()
    [0.05, 0.3]
    """

    distance: float
    """Distance of the motors; 0 if they are coaxial."""

    lengths: tuple[float, float, float, float]
    """Lengths of the links 1 to 4."""

    def __post_init__(self) -> None:
        """Refuses the lengths that the unit refuses too."""
        for name, value in zip(GEOMETRY, (self.distance, *self.lengths)):
            least = ">= 0" if name == "base.distance" else "> 0"
            if not np.isfinite(value) or value < 0 or (value == 0 and least == "> 0"):
                raise FiveBarError(f"{name} = {value!r} m: it must be finite and {least}.")

    @classmethod
    def from_values(cls, values: Mapping[str, float]) -> "Machine":
        """The machine with given lengths.

        Parameters
        ----------
        values : mapping of str to float
            `base.distance` and `link[1].length` to `link[4].length`, m; missing ones have the unit's start values.

        Returns
        -------
        Machine
            The machine.

        Raises
        ------
        FiveBarError
            If a name is no length, or a length is refused.

        Examples
        --------
        >>> import fivebar
        >>> fivebar.Machine.from_values({"base.distance": 0.0}).distance
        0.0
        """
        if strange := set(arguments.values("values", values)) - set(GEOMETRY):
            raise FiveBarError(f"{min(strange)} is not a length of a machine; allowed are {', '.join(GEOMETRY)}.")
        distance, l1, l2, l3, l4 = (
            arguments.number(name, values[name] if name in values else of_unit().start[name], "m") for name in GEOMETRY
        )
        return cls(distance, (l1, l2, l3, l4))

    @classmethod
    def from_scene(cls, scene: "str | Path | Mapping[str, Any] | Scene") -> "Machine":
        """The machine of a scene.

        Parameters
        ----------
        scene
            A scene as `fivebar.run` takes it.

        Returns
        -------
        Machine
            The machine with the scene's lengths.

        Raises
        ------
        FiveBarError
            If there is no such scene, or it is refused.

        Examples
        --------
        >>> import fivebar
        >>> fivebar.Machine.from_scene("pick_and_place").lengths
        (0.21, 0.21, 0.21, 0.21)
        """
        # Imported here, since reading a scene in tip coordinates needs this module.
        from fivebar import scene as scenes

        read = scenes.read(scene)
        return cls.from_values({name: float(read[name]) for name in GEOMETRY})

    @property
    def size(self) -> float:
        """Sum of all lengths, m; the scale of round-off."""
        return self.distance + sum(self.lengths)

    @property
    def motors(self) -> Floats:
        """Positions of the left and the right motor, m, shape (2, 2)."""
        return np.array([[0.0, 0.0], [self.distance, 0.0]])

    @property
    def legs(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Proximal and distal length of the left and the right leg, m."""
        l1, l2, l3, l4 = self.lengths
        return (l1, l2), (l4, l3)

    @property
    def is_symmetric(self) -> bool:
        """Whether both legs have equal lengths. The direct singularities with stretched distal links are then Watt's curve."""
        return self.legs[0] == self.legs[1]

    # Positions

    def inverse(self, tip: ArrayLike, working: Working = ("minus", "plus"), assembly: Sign | None = None) -> Posture:
        """Inverse kinematics: postures with the tip at given points, in a working mode.

        Parameters
        ----------
        tip : array_like
            Positions of the tip, m, shape (..., 2).
        working : tuple of str, optional
            `plus` or `minus` for the left and the right leg: the sign of the sine from proximal to distal link.
        assembly : str, optional
            `plus` or `minus`. Tip and working mode determine the assembly: a tip in the other one is refused.

        Returns
        -------
        Posture
            The postures.

        Raises
        ------
        FiveBarError
            If a point is out of reach, with the leg and the missing distance; on a motor's axis; or in the other assembly.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.inverse((0.05, 0.3)).motors.round(3).tolist()
        [2.167, 0.975]
        """
        tip = self._finite("tip", tip, 2, "m")
        bends = self._bends(working)
        legs = [self._leg(tip, leg, bend) for leg, bend in enumerate(bends)]
        for leg, (_, _, missing) in enumerate(legs):
            if np.any(missing != 0):
                raise FiveBarError(self._out_of_reach(tip, leg, missing))
            if np.any(axis := np.hypot(*np.moveaxis(tip - self.motors[leg], -1, 0)) <= ROUND_OFF * self.size):
                at, _ = _first(axis)
                raise FiveBarError(
                    f"{_item('tip', tip, at, 'm')} lies on the {SIDES[leg]} motor's axis: the links of that leg are folded, and the angle of "
                    "the motor is undetermined."
                )
        posture = self._posture(legs, tip)
        if assembly is not None:
            beyond = sines(posture.theta)[..., 0] * _sign("assembly", assembly) < 0
            if np.any(beyond):
                at, count = _first(beyond)
                raise FiveBarError(
                    f"{_item('tip', tip, at, 'm')} lies in the other assembly in working mode {mode_name(working)}: "
                    f"it needs assembly {'minus' if assembly == 'plus' else 'plus'}{count}."
                )
        return posture

    def forward(self, theta: ArrayLike, assembly: Sign = "plus") -> Posture:
        """Forward kinematics: postures from the motor angles, in an assembly.

        Parameters
        ----------
        theta : array_like
            Motor angles, `theta[1]` and `theta[2]` of the unit, rad, shape (..., 2).
        assembly : str, optional
            `plus` or `minus`.

        Returns
        -------
        Posture
            The postures.

        Raises
        ------
        FiveBarError
            If the loop cannot be closed, with the distance of the elbows and the distances that the distal links allow.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.forward([2.2, 0.9]).tip.round(3).tolist()
        [0.055, 0.28]
        """
        theta = self._finite("theta", theta, 2, "rad")
        side = _sign("assembly", assembly)
        l1, l2, l3, l4 = self.lengths
        left, right = l1 * _direction(theta[..., 0]), self.motors[1] + l4 * _direction(theta[..., 1])
        arrow = right - left
        distance = np.hypot(arrow[..., 0], arrow[..., 1])
        round_off = ROUND_OFF * self.size
        wrong = (distance > l2 + l3 + round_off) | (distance < abs(l2 - l3) - round_off)
        if np.any(wrong):
            at, count = _first(wrong)
            raise FiveBarError(
                f"{_item('theta', theta, at, 'rad')} cannot be closed: the elbows are {distance[at]:.10g} m apart, link[2].length and "
                f"link[3].length allow {abs(l2 - l3):.10g} to {l2 + l3:.10g} m{count}."
            )
        if np.any(same := distance <= 1e-9 * (l2 + l3)):
            at, count = _first(same)
            raise FiveBarError(
                f"{_item('theta', theta, at, 'rad')} puts both elbows on the same point: the direction to the tip is undetermined{count}."
            )
        along = ((l2 - l3) * (l2 + l3) + distance**2) / (2 * distance)
        # This form avoids cancellation if the distal links are nearly in line.
        across_squared = (l2 + l3 - distance) * (l3 + distance - l2) * (l2 + along) / (2 * distance)
        # An error of one ulp in the distance would tilt links in line by about its square root.
        in_line = np.minimum(l2 + l3 - distance, distance - abs(l2 - l3)) < round_off
        across = side * np.sqrt(np.where(in_line, 0.0, np.maximum(across_squared, 0.0)))
        unit = arrow / distance[..., None]
        from_left = along[..., None] * unit + across[..., None] * _turned(unit)
        from_right = from_left - arrow
        passive = [np.arctan2(v[..., 1], v[..., 0]) for v in (from_left, from_right)]
        angles = np.stack([theta[..., 0], *passive, theta[..., 1]], axis=-1)
        return Posture(angles, left + from_left, np.stack([left, right], axis=-2))

    def shortfall(self, tip: ArrayLike) -> Floats:
        """Distance by which the legs miss points.

        Parameters
        ----------
        tip : array_like
            Positions, m, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            For the left and the right leg, m, shape (..., 2): positive if a point is too far, negative if too near, 0 in reach.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.shortfall((0.05, 0.5)).round(3).tolist()
        [0.082, 0.082]
        """
        tip = self._finite("tip", tip, 2, "m")
        return np.stack([self._missing(tip, leg)[1] for leg in (0, 1)], axis=-1)

    def is_reachable(self, tip: ArrayLike) -> NDArray[np.bool_]:
        """Whether both legs reach points, in any working mode.

        Parameters
        ----------
        tip : array_like
            Positions, m, shape (..., 2).

        Returns
        -------
        numpy.ndarray of bool
            Shape (...).

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.is_reachable([(0.05, 0.3), (0.05, 0.5)]).tolist()
        [True, False]
        """
        within: NDArray[np.bool_] = np.all(self.shortfall(tip) == 0, axis=-1)
        return within

    @property
    def reach(self) -> Floats:
        """Smallest and largest distance of the tip from the left and the right motor, m, shape (2, 2)."""
        return np.array([[abs(proximal - distal), proximal + distal] for proximal, distal in self.legs])

    @property
    def reach_area(self) -> float:
        """Area that both legs reach, m2: the intersection of two rings."""
        (near_left, far_left), (near_right, far_right) = self.reach

        def lens(left: float, right: float) -> float:
            return _lens_area(self.distance, left, right)

        return (
            lens(far_left, far_right)
            - lens(near_left, far_right)
            - lens(far_left, near_right)
            + lens(near_left, near_right)
        )

    # Velocities and forces

    def link_rates(self, theta: ArrayLike, omega: ArrayLike) -> Floats:
        """Rates of all links from motor rates.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        omega : array_like
            Motor rates, rad/s, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Rates of the links 1 to 4, rad/s, shape (..., 4).

        Raises
        ------
        FiveBarError
            At a direct singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.link_rates(theta, (1.0, 0.0)).round(3).tolist()
        [1.0, -0.338, 1.04, 0.0]
        """
        theta, omega = self._regular(theta), self._finite("omega", omega, 2, "rad/s")
        tip = np.einsum("...ij,...j->...i", self.jacobian(theta), omega)
        l1, l2, l3, l4 = self.lengths
        n1, n2, n3, n4 = (_turned(_direction(theta[..., i])) for i in range(4))
        left = np.sum(n2 * (tip - l1 * n1 * omega[..., :1]), axis=-1) / l2
        right = np.sum(n3 * (tip - l4 * n4 * omega[..., 1:]), axis=-1) / l3
        return np.stack(np.broadcast_arrays(omega[..., 0], left, right, omega[..., 1]), axis=-1)

    def tip_velocity(self, theta: ArrayLike, omega: ArrayLike) -> Floats:
        """Velocity of the tip from motor rates.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        omega : array_like
            Motor rates, rad/s, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Velocity, m/s, shape (..., 2).

        Raises
        ------
        FiveBarError
            At a direct singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.tip_velocity(theta, (1.0, 0.5)).round(3).tolist()
        [-0.197, -0.087]
        """
        velocity: Floats = np.einsum("...ij,...j->...i", self.jacobian(theta), self._finite("omega", omega, 2, "rad/s"))
        return velocity

    def motor_rates(self, theta: ArrayLike, velocity: ArrayLike) -> Floats:
        """Motor rates from a velocity of the tip. Defined at direct singularities.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        velocity : array_like
            Velocity of the tip, m/s, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Motor rates, rad/s, shape (..., 2).

        Raises
        ------
        FiveBarError
            At an inverse singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.motor_rates(theta, (0.1, 0.0)).round(3).tolist()
        [-0.381, -0.381]
        """
        theta, velocity = self._finite("theta", theta, 4, "rad"), self._finite("velocity", velocity, 2, "m/s")
        self._refuse_singular(theta, "inverse", "no motor rate moves the tip along its leg")
        rates: Floats = np.einsum("...ij,...j->...i", self._rows(theta), velocity) / self._arms(theta)
        return rates

    def motor_accelerations(self, theta: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Floats:
        """Motor accelerations from velocity and acceleration of the tip. Defined at direct singularities.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        velocity : array_like
            Velocity of the tip, m/s, shape (..., 2).
        acceleration : array_like
            Acceleration of the tip, m/s2, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Motor accelerations, rad/s2, shape (..., 2).

        Raises
        ------
        FiveBarError
            At an inverse singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.motor_accelerations(theta, (0.1, 0.0), (0.0, 1.0)).round(3).tolist()
        [-2.944, 2.944]
        """
        theta, velocity = self._finite("theta", theta, 4, "rad"), self._finite("velocity", velocity, 2, "m/s")
        acceleration, omega = self._finite("acceleration", acceleration, 2, "m/s2"), self.motor_rates(theta, velocity)
        found = []
        for leg, (own, distal) in enumerate(((0, 1), (3, 2))):
            proximal_length, distal_length = self.legs[leg]
            bend = theta[..., distal] - theta[..., own]
            to_elbow = proximal_length * omega[..., leg, None] * _turned(_direction(theta[..., own]))
            across = _turned(_direction(theta[..., distal]))
            turning = np.sum(across * (velocity - to_elbow), axis=-1) / distal_length
            # Time derivative of the loop's velocity equation u_D . v = l_P sin(bend) omega.
            known = np.sum(
                _direction(theta[..., distal]) * acceleration + turning[..., None] * across * velocity, axis=-1
            )
            known = known - proximal_length * np.cos(bend) * (turning - omega[..., leg]) * omega[..., leg]
            found.append(known / (proximal_length * np.sin(bend)))
        return np.stack(np.broadcast_arrays(*found), axis=-1)

    def tip_force(self, theta: ArrayLike, torque: ArrayLike) -> Floats:
        """Force of the tip on its surroundings from motor torques, without weight: F = J^-T tau.

        Defined at direct singularities, where no torque resists along one direction.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        torque : array_like
            Motor torques, N·m, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Force, N, shape (..., 2).

        Raises
        ------
        FiveBarError
            At an inverse singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.tip_force(theta, (0.1, 0.0)).round(3).tolist()
        [-0.381, -0.286]
        """
        theta, torque = self._finite("theta", theta, 4, "rad"), self._finite("torque", torque, 2, "N·m")
        self._refuse_singular(theta, "inverse", "the links carry forces that the motors do not feel")
        force: Floats = np.einsum("...ji,...j->...i", self._rows(theta), torque / self._arms(theta))
        return force

    def motor_torques(self, theta: ArrayLike, force: ArrayLike) -> Floats:
        """Motor torques for a force of the tip on its surroundings, without weight: tau = J^T F.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.
        force : array_like
            Force, N, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Motor torques, N·m, shape (..., 2).

        Raises
        ------
        FiveBarError
            At a direct singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.motor_torques(theta, (1.0, 0.0)).round(3).tolist()
        [-0.131, -0.131]
        """
        torques: Floats = np.einsum("...ji,...j->...i", self.jacobian(theta), self._finite("force", force, 2, "N"))
        return torques

    def jacobian(self, theta: ArrayLike) -> Floats:
        """Jacobian d tip / d (theta1, theta4).

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        numpy.ndarray
            m/rad, shape (..., 2, 2): rows x and y, columns left and right motor.

        Raises
        ------
        FiveBarError
            At a direct singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.jacobian(theta).round(3).tolist()
        [[-0.131, -0.131], [-0.175, 0.175]]
        """
        theta = self._regular(theta)
        return self._adjugate(theta) / sines(theta)[..., 0, None, None]

    def loop_jacobians(self, theta: ArrayLike) -> tuple[Floats, Floats]:
        """J_x and J_q in J_x tip' = J_q (theta1', theta4'). Defined everywhere.

        The rows of J_x are the vectors of the distal links, so det J_x = l2 l3 sin(theta3 - theta2). J_q is diagonal.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        tuple of numpy.ndarray
            J_x, m, and J_q, m2, each of shape (..., 2, 2).

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> j_x, j_q = robot.loop_jacobians(theta)
        >>> bool(abs(j_x @ robot.jacobian(theta) - j_q).max() < 1e-15)
        True
        """
        theta = self._finite("theta", theta, 4, "rad")
        distal = np.array(self.lengths[1:3])
        j_q = np.zeros((*theta.shape[:-1], 2, 2))
        j_q[..., [0, 1], [0, 1]] = distal * self._arms(theta)
        return distal[:, None] * self._rows(theta), j_q

    def velocity_ellipse(self, theta: ArrayLike) -> Ellipse:
        """Tip velocities for motor rates on the unit circle, 1 rad/s: J J^T.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        Ellipse
            Semi-axes, m/s, and angle, rad.

        Raises
        ------
        FiveBarError
            At a direct singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.velocity_ellipse(theta).axes.round(3).tolist()
        [0.247, 0.186]
        """
        theta = self._regular(theta)
        adjugate, sine = self._adjugate(theta), sines(theta)[..., 0]
        large, small, angle = _singular_values(adjugate)
        return Ellipse(np.stack([large, small], axis=-1) / np.abs(sine)[..., None], angle)

    def force_ellipse(self, theta: ArrayLike) -> Ellipse:
        """Tip forces for motor torques on the unit circle, 1 N·m: (J J^T)^-1.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        Ellipse
            Semi-axes, N, and angle, rad.

        Raises
        ------
        FiveBarError
            At an inverse singularity.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> robot.force_ellipse(theta).axes.round(3).tolist()
        [5.389, 4.052]
        """
        theta = self._finite("theta", theta, 4, "rad")
        self._refuse_singular(theta, "inverse", "the links carry forces that the motors do not feel")
        large, small, angle = _singular_values(np.swapaxes(self._rows(theta) / self._arms(theta)[..., None], -1, -2))
        return Ellipse(np.stack([large, small], axis=-1), angle)

    def condition(self, theta: ArrayLike) -> Floats:
        """Condition number of the Jacobian: its largest over its smallest singular value.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        numpy.ndarray
            At least 1, shape (...); infinite at direct and inverse singularities.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> round(float(robot.condition(theta)), 3)
        1.33
        """
        with np.errstate(divide="ignore"):
            return 1 / self.dexterity(theta)

    def dexterity(self, theta: ArrayLike) -> Floats:
        """Reciprocal of the condition number.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        numpy.ndarray
            From 0 to 1, shape (...); 0 at direct and inverse singularities.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> round(float(robot.dexterity(theta)), 3)
        0.752
        """
        large, small, _ = _singular_values(self._adjugate(self._finite("theta", theta, 4, "rad")))
        return np.divide(small, large, out=np.zeros_like(large), where=large > 0)

    # Singularities

    def singularity(self, theta: ArrayLike) -> NDArray[np.str_]:
        """Kind of singularity, with the bounds of the unit's `singular.type`.

        The unit's `constraint` (all links near one line through the motors) is `combined` here.

        Parameters
        ----------
        theta : array_like
            Postures: angles of the links 1 to 4, rad, shape (..., 4), such as `Posture.theta`.

        Returns
        -------
        numpy.ndarray of str
            `none`, `direct`, `inverse` or `combined`, shape (...).

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> theta = robot.inverse((0.05, 0.3)).theta
        >>> str(robot.singularity(theta))
        'none'
        """
        tip, left, right = np.moveaxis(sines(self._finite("theta", theta, 4, "rad")), -1, 0)
        direct, inverse = np.abs(tip) < NEAR, np.abs(left * right) < NEAR
        return np.select([direct & inverse, direct, inverse], ["combined", "direct", "inverse"], "none")

    def inverse_singularities(self) -> list[Circle]:
        """The circles of the tip on which a leg is stretched or folded.

        Returns
        -------
        list of Circle
            Two for each leg. A circle of radius 0 is the motor's axis.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> [(circle.leg, circle.posture, circle.radius) for circle in robot.inverse_singularities()]
        [(0, 'stretched', 0.42), (0, 'folded', 0.0), (1, 'stretched', 0.42), (1, 'folded', 0.0)]
        """
        rims: tuple[tuple[int, Line], ...] = ((1, "stretched"), (0, "folded"))
        return [
            Circle(leg, posture, (float(self.motors[leg, 0]), 0.0), float(self.reach[leg, side]))
            for leg in (0, 1)
            for side, posture in rims
        ]

    def direct_singularities(self, points: int = 2000) -> list[Locus]:
        """The closed curves of the tip on which the distal links are in line: coupler curves of four-bars.

        Folded distal links of equal length have both elbows at the same point, so their curves are circles. If the motors are also
        coaxial and the proximal links equal, every posture in the working modes `plus`, `plus` and `minus`, `minus` is singular:
        then there is no curve, see `is_degenerate`.

        Parameters
        ----------
        points : int, optional
            Number of points on each curve.

        Returns
        -------
        list of Locus
            The curves.

        Raises
        ------
        FiveBarError
            If `points` is not a whole number of at least 1.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> [(locus.posture, locus.tip.shape) for locus in robot.direct_singularities(points=100)]
        [('stretched', (100, 2)), ('folded', (100, 2)), ('folded', (100, 2))]
        """
        points = arguments.count("points", points)
        return [
            locus for posture, coupler in self._couplers() for locus in self._coupler_curves(posture, coupler, points)
        ]

    def direct_at(self, theta1: float) -> list[tuple[Line, Posture]]:
        """Postures with a given angle of the left motor and the distal links in line.

        Folded links of equal length are left out: both elbows are at the same point, and the tip may be anywhere around it.

        Parameters
        ----------
        theta1 : float
            Angle of the left motor, rad.

        Returns
        -------
        list of tuple
            `stretched` or `folded`, and the posture; empty if the elbows cannot have that distance.

        Raises
        ------
        FiveBarError
            If the angle is no number.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> [(kind, posture.motors.round(3).tolist()) for kind, posture in robot.direct_at(2.9)]
        [('stretched', [2.9, -1.441]), ('stretched', [2.9, 1.114])]
        """
        theta1 = arguments.number("theta1", theta1, "rad")
        found: list[tuple[Line, Posture]] = []
        for posture, coupler in self._couplers():
            if coupler == 0:
                continue
            elbow = self.lengths[0] * _direction(np.array(theta1))
            cosine, middle = self._turn_of_coupler(elbow, coupler)
            if abs(cosine) <= 1:
                both = [self._in_line(elbow, middle + side * np.arccos(cosine), coupler) for side in (-1, 1)]
                found += [(posture, each) for each in both[: 1 if abs(cosine) == 1 else 2]]
        return found

    def is_degenerate(self, working: Working) -> bool:
        """Whether every posture of a working mode is a direct singularity: the motors are coaxial and the legs equal and congruent.

        Lengths below `LEAST_SINE` times the machine's size count as 0.

        Parameters
        ----------
        working : tuple of str
            `plus` or `minus` for the left and the right leg.

        Returns
        -------
        bool
            Whether it is.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.is_degenerate(("plus", "plus"))
        False
        """
        (l1, l2), (l4, l3) = self.legs
        return max(self.distance, abs(l1 - l4), abs(l2 - l3)) <= LEAST_SINE * self.size and working[0] == working[1]

    # Parts

    def field(self, tip: ArrayLike, working: Working) -> tuple[Posture, NDArray[np.bool_]]:
        """Postures for an array of points, some of which may be out of reach.

        Parameters
        ----------
        tip : array_like
            Positions, m, shape (..., 2).
        working : tuple of str
            `plus` or `minus` for the left and the right leg.

        Returns
        -------
        tuple of Posture and numpy.ndarray of bool
            The postures, and whether each point is reached, shape (...); the postures of other points are meaningless.

        Examples
        --------
        >>> import fivebar
        >>> robot = fivebar.Machine.from_scene("pick_and_place")
        >>> robot.field([(0.05, 0.3), (0.05, 0.5)], ("minus", "plus"))[1].tolist()
        [True, False]
        """
        tip = self._finite("tip", tip, 2, "m")
        legs = [self._leg(tip, leg, bend) for leg, bend in enumerate(self._bends(working))]
        return self._posture(legs, tip), (legs[0][2] == 0) & (legs[1][2] == 0)

    @staticmethod
    def _bends(working: Working) -> tuple[float, float]:
        if not isinstance(working, (tuple, list)) or len(working) != 2:
            raise FiveBarError(
                f"working = {working!r}: it must name two bends, such as ('minus', 'plus'), the left leg first."
            )
        return _sign("working", working[0]), _sign("working", working[1])

    def _missing(self, tip: Floats, leg: int) -> tuple[Floats, Floats]:
        """Distance from the leg's motor, and its excess over the reach (> 0) or its deficit (< 0)."""
        distance = np.hypot(*np.moveaxis(tip - self.motors[leg], -1, 0))
        nearest, farthest = self.reach[leg]
        round_off = ROUND_OFF * self.size
        missing = np.where(distance > farthest + round_off, distance - farthest, 0.0)
        return distance, np.where(distance < nearest - round_off, distance - nearest, missing)

    def _leg(self, tip: Floats, leg: int, bend: float) -> tuple[Floats, Floats, Floats]:
        """Proximal and distal angle of a leg, and the distance by which it misses the tip."""
        proximal, distal = self.legs[leg]
        distance, missing = self._missing(tip, leg)
        to_tip = tip - self.motors[leg]
        # Half-angle formula from the triangle's sides: an arc cosine would suffer from cancellation near 0 and pi.
        opposite = np.maximum((distal - proximal + distance) * (distal + proximal - distance), 0.0)
        adjacent = np.maximum((proximal + distance + distal) * (proximal + distance - distal), 0.0)
        half = np.arctan2(np.sqrt(opposite), np.sqrt(adjacent))
        theta = np.arctan2(to_tip[..., 1], to_tip[..., 0]) - bend * 2 * half
        theta = np.where(np.abs(theta) > np.pi, theta - np.copysign(2 * np.pi, theta), theta)
        to_elbow = to_tip - proximal * _direction(theta)
        return theta, np.arctan2(to_elbow[..., 1], to_elbow[..., 0]), missing

    def _posture(self, legs: list[tuple[Floats, Floats, Floats]], tip: Floats) -> Posture:
        (t1, t2, _), (t4, t3, _) = legs
        elbows = [self.lengths[0] * _direction(t1), self.motors[1] + self.lengths[3] * _direction(t4)]
        return Posture(np.stack([t1, t2, t3, t4], axis=-1), tip, np.stack(elbows, axis=-2))

    def _rows(self, theta: Floats) -> Floats:
        """Directions of the distal links as rows: rows · tip' = arms * (theta1', theta4')."""
        return np.stack([_direction(theta[..., 1]), _direction(theta[..., 2])], axis=-2)

    def _arms(self, theta: Floats) -> Floats:
        """Lever arms of the distal links about their motors, m, shape (..., 2): l1 sin(theta2 - theta1), l4 sin(theta3 - theta4)."""
        return np.array([self.lengths[0], self.lengths[3]]) * sines(theta)[..., 1:]

    def _adjugate(self, theta: Floats) -> Floats:
        """The Jacobian times sin(theta3 - theta2), which is finite everywhere."""
        left, right = np.moveaxis(self._arms(theta), -1, 0)
        (s2, c2), (s3, c3) = ((np.sin(theta[..., i]), np.cos(theta[..., i])) for i in (1, 2))
        return np.stack(
            [np.stack([s3 * left, -s2 * right], axis=-1), np.stack([-c3 * left, c2 * right], axis=-1)], axis=-2
        )

    def _couplers(self) -> tuple[tuple[Line, float], ...]:
        """Vector from the left to the right elbow if the distal links are in line: its component along the left distal link, m."""
        _, l2, l3, _ = self.lengths
        return ("stretched", l2 + l3), ("folded", l2 - l3)

    def _turn_of_coupler(self, elbow: Floats, coupler: float) -> tuple[Floats, Floats]:
        """Angles of the left distal link with the left elbow at `elbow` (..., 2), as middle ± arccos(cosine): cosine and middle, rad.

        There is none if the magnitude of the cosine is above 1.
        """
        arrow, l4 = self.motors[1] - elbow, self.lengths[3]
        away = np.hypot(arrow[..., 0], arrow[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = np.where(away > 0, (coupler**2 + (away - l4) * (away + l4)) / (2 * coupler * away), np.inf)
        # Remove round-off at the ends of the range: the right proximal link is in line with the coupler there.
        return np.where(np.abs(np.abs(cosine) - 1) < 1e-12, np.sign(cosine), cosine), np.arctan2(
            arrow[..., 1], arrow[..., 0]
        )

    def _elbow_at(self, turn: Floats, coupler: float, side: Floats | float) -> Floats:
        """The left elbow (..., 2) for angles `turn` (...) of the left distal link; `side`, -1 or 1, selects the solution."""
        l1, _, _, l4 = self.lengths
        # Vector from the left to the right motor, with the coupler shrunk to a point.
        arrow = self.motors[1] - coupler * _direction(turn)
        away = np.hypot(arrow[..., 0], arrow[..., 1])
        along = ((l1 - l4) * (l1 + l4) + away**2) / (2 * away)
        across = side * np.sqrt(np.maximum((l1 - along) * (l1 + along), 0.0))
        unit = arrow / away[..., None]
        elbow: Floats = along[..., None] * unit + across[..., None] * _turned(unit)
        return elbow

    def _in_line(self, left: Floats, turn: Floats, coupler: float) -> Posture:
        """Postures with the left elbow at `left` (..., 2), the left distal link at the angle `turn` (...), and both distal links in line."""
        along = _direction(turn)
        right, tip = left + coupler * along, left + self.lengths[1] * along
        vectors = (left, along, along * np.sign(self.lengths[1] - coupler), right - self.motors[1])
        theta = np.stack([np.arctan2(v[..., 1], v[..., 0]) for v in vectors], axis=-1)
        return Posture(theta, tip, np.stack([left, right], axis=-2))

    def _coupler_curves(self, posture: Line, coupler: float, points: int) -> list[Locus]:
        """Curves of the tip as the four-bar linkage of motors, proximal links and coupler moves through its whole range.

        The crank is the left proximal link. If the coupler is short, the coupler is the crank, since the angle between nearly
        coincident elbows would be lost in round-off. If the coupler is as long as the distance of the motors, it need not turn
        while the proximal links do.
        """
        l1, _, _, l4 = self.lengths
        length = abs(coupler)
        by_coupler = length < SHORT * self.size and abs(length - self.distance) >= length / 2
        crank, nearest, farthest = (
            (length, abs(l1 - l4), l1 + l4) if by_coupler else (l1, abs(length - l4), length + l4)
        )
        loci = []
        for lower, upper in self._crank_ranges(crank, nearest, farthest):
            if upper - lower >= 2 * np.pi:
                angles = np.linspace(lower, upper, points)
                runs: list[tuple[Floats, Floats | float]] = [(angles, side) for side in (-1.0, 1.0)]
            else:
                # Both branches meet at the ends of the range. The curve is smooth in this parameter; its points are densest there.
                phase = np.linspace(0, 2 * np.pi, points)
                angles = (lower + upper) / 2 - (upper - lower) / 2 * np.cos(phase)
                runs = [(angles, np.where(phase <= np.pi, 1.0, -1.0))]
            for angles, side in runs:
                if by_coupler:
                    turn = angles if coupler >= 0 else angles + np.pi
                    elbow = self._elbow_at(turn, coupler, side)
                else:
                    elbow = l1 * _direction(angles)
                    cosine, middle = self._turn_of_coupler(elbow, coupler)
                    turn = middle + side * np.arccos(np.clip(cosine, -1, 1))
                made = self._in_line(elbow, turn, coupler)
                loci.append(Locus(posture, made.theta, made.tip))
        return loci

    def _crank_ranges(self, crank: float, nearest: float, farthest: float) -> list[tuple[float, float]]:
        """Angle ranges of a crank on the left motor with its end between `nearest` and `farthest` from the right motor."""
        round_off = ROUND_OFF * self.size
        if min(self.distance, crank) <= round_off:
            away = max(self.distance, crank)
            return [(-np.pi, np.pi)] if away > round_off and nearest - round_off <= away <= farthest + round_off else []
        highest, lowest = (
            ((self.distance - away) * (self.distance + away) + crank**2) / (2 * self.distance * crank)
            for away in (nearest, farthest)
        )
        if highest < -1 - 1e-12 or lowest > 1 + 1e-12:
            return []
        begin, end = np.arccos(np.clip(highest, -1, 1)), np.arccos(np.clip(lowest, -1, 1))
        if highest > 1 - 1e-12 and lowest < -1 + 1e-12:
            return [(-np.pi, np.pi)]
        if highest > 1 - 1e-12:
            return [(-end, end)]
        if lowest < -1 + 1e-12:
            return [(begin, 2 * np.pi - begin)]
        return [(begin, end), (-end, -begin)]

    def _finite(self, name: str, values: ArrayLike, width: int, unit: str) -> Floats:
        array = numbers(name, values, width, unit)
        if not np.all(np.isfinite(array)):
            at, count = _first(~np.all(np.isfinite(array), axis=-1))
            raise FiveBarError(f"{_item(name, array, at, unit)}: it must be finite{count}.")
        return array

    def _regular(self, theta: ArrayLike) -> Floats:
        """The postures as an array; refuses infinite ones and direct singularities."""
        theta = self._finite("theta", theta, 4, "rad")
        self._refuse_singular(theta, "direct", "the motors do not determine how the tip moves")
        return theta

    @staticmethod
    def _refuse_singular(theta: Floats, kind: Literal["direct", "inverse"], reason: str) -> None:
        sine = sines(theta)[..., :1] if kind == "direct" else sines(theta)[..., 1:]
        if np.any(singular := np.any(np.abs(sine) < LEAST_SINE, axis=-1)):
            at, count = _first(singular)
            raise FiveBarError(
                f"{_item('theta', theta, at, 'rad')} is a singularity of the {kind} kind: {reason}{count}."
            )

    def _out_of_reach(self, tip: Floats, leg: int, missing: Floats) -> str:
        at, count = _first(missing != 0)
        distance = float(np.hypot(*(tip[at] - self.motors[leg])))
        nearest, farthest = self.reach[leg]
        proximal, distal = LENGTHS[leg]
        return (
            f"{_item('tip', tip, at, 'm')} is out of reach of the {SIDES[leg]} leg: it is {distance:.10g} m from the leg's motor, {proximal} "
            f"and {distal} reach from {nearest:.10g} to {farthest:.10g} m, so that it is {abs(missing[at]):.4g} m too "
            f"{'far' if missing[at] > 0 else 'near'}{count}."
        )


def _direction(angle: Floats) -> Floats:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _turned(vector: Floats) -> Floats:
    """Vectors rotated by +90 degrees."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def _sign(name: str, value: str) -> float:
    if not isinstance(value, str) or value not in SIGN:
        raise FiveBarError(f"{name} = {value!r}: it must be 'plus' or 'minus'.")
    return SIGN[value]


def _names(signs: Floats) -> NDArray[np.str_]:
    return np.where(signs >= 0, "plus", "minus")


def _first(wrong: NDArray[np.bool_]) -> tuple[tuple[int, ...], str]:
    """Index of the first wrong element, and the number of wrong elements as the end of a sentence."""
    count = int(np.count_nonzero(wrong))
    at = tuple(int(i) for i in np.argwhere(wrong)[0])
    return at, f" ({count} of {wrong.size} are so)" if wrong.size > 1 else ""


def _item(name: str, array: Floats, at: tuple[int, ...], unit: str) -> str:
    index = f"[{', '.join(map(str, at))}]" if at else ""
    return f"{name}{index} = ({', '.join(f'{value:.10g}' for value in array[at])}) {unit}"


def _singular_values(matrix: Floats) -> tuple[Floats, Floats, Floats]:
    """Singular values of 2 x 2 matrices, larger first, and the angle of the left singular vector of the larger one, rad."""
    (a, b), (c, d) = ((matrix[..., i, 0], matrix[..., i, 1]) for i in (0, 1))
    rotation, reflection = np.hypot(a + d, c - b), np.hypot(a - d, b + c)
    large = (rotation + reflection) / 2
    # |det| divided by the larger value: no difference of nearly equal numbers.
    small = np.divide(np.abs(a * d - b * c), large, out=np.zeros_like(large), where=large > 0)
    angle = (np.arctan2(c - b, a + d) + np.arctan2(b + c, a - d)) / 2
    return large, small, np.pi / 2 - np.mod(np.pi / 2 - angle, np.pi)


def _lens_area(apart: float, a: float, b: float) -> float:
    """Area of the intersection of two discs, m2."""
    if apart >= a + b:
        return 0.0
    if apart <= abs(a - b):
        return float(np.pi * min(a, b) ** 2)
    angle_a = np.arccos(np.clip((apart**2 + a**2 - b**2) / (2 * apart * a), -1, 1))
    angle_b = np.arccos(np.clip((apart**2 + b**2 - a**2) / (2 * apart * b), -1, 1))
    kite = np.sqrt(max((-apart + a + b) * (apart + a - b) * (apart - a + b) * (apart + a + b), 0.0)) / 2
    return float(a**2 * angle_a + b**2 * angle_b - kite)
