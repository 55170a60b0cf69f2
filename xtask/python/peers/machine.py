"""The paper's mechanism for the peers: parameters, equations of motion in the four link angles, energy, and the loads of one scene.

Links 1 to 4: left proximal, left distal, right distal, right proximal; absolute angles, distal ones from elbow to tip. A state is
(four angles, four rates), SI units. All links are equal, gravity pulls along -y.
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit

LENGTH, MASS, INERTIA, COM, BASE, G = 0.21, 0.017, 6.23e-5, 0.105, 0.42, 9.81
MGL = MASS * G * LENGTH

NEAR = INERTIA + MASS * COM**2 + MASS * LENGTH**2  # proximal link about the motor, with the distal mass at its end
FAR = INERTIA + MASS * COM**2  # distal link about the elbow
COUPLING = MASS * COM * LENGTH

# Loads of the scene servo_friction, with the laws of src/effects: servos on links 1 and 4, friction in all joints.
REFERENCES, KP, KD, LIMIT = (1.2, 2.4), 0.2, 5e-4, 0.1
COULOMB, BREAKAWAY, BREAKAWAY_RATE, VISCOUS = 1e-3, 1.2e-3, 0.1, 1e-4
STRIBECK = math.sqrt(2 * math.e) * (BREAKAWAY - COULOMB)
STRIBECK_RATE, COULOMB_RATE = math.sqrt(2) * BREAKAWAY_RATE, BREAKAWAY_RATE / 10
# Links of each joint. Its rate is the first link's minus the second's; its torque acts with + on the first and - on the second.
JOINTS = ((0, None), (1, 0), (1, 2), (2, 3), (3, None))


@dataclass(frozen=True)
class Setting:
    """One way to run a peer: a description of its settings, and a function that starts a run from angles at rest.

    The run advances to a time and returns the state there; a peer that fails raises.
    """

    text: str
    begin: Callable[[np.ndarray], Callable[[float], np.ndarray]]
    clock: Callable[[], float] = time.process_time
    """Processor time so far, s: of this process, or of the last run if the peer is a separate program."""
    begin_loaded: Callable[[np.ndarray], Callable[[float], np.ndarray]] | None = None
    """`begin` with servos and friction; None if the peer runs only under gravity."""


@dataclass(frozen=True)
class Peer:
    """A program for comparison."""

    name: str
    version: str
    settings: Iterable[Setting]


def closed(left: float, right: float, side: int) -> np.ndarray:
    """State at rest with these proximal angles; the tip is to the left (1) or right (-1) of the arrow between the elbows."""
    ax, ay = LENGTH * math.cos(left), LENGTH * math.sin(left)
    bx, by = BASE + LENGTH * math.cos(right), LENGTH * math.sin(right)
    gap = math.hypot(bx - ax, by - ay)
    # Equal distal links form an isosceles triangle over the line between the elbows.
    base_angle, line = side * math.acos(min(1.0, gap / (2 * LENGTH))), math.atan2(by - ay, bx - ax)
    return np.array([left, line + base_angle, line + math.pi - base_angle, right, 0.0, 0.0, 0.0, 0.0])


def tip(y: np.ndarray) -> np.ndarray:
    """Position of the end of the left leg."""
    return LENGTH * np.array([math.cos(y[0]) + math.cos(y[1]), math.sin(y[0]) + math.sin(y[1])])


def energy(y: np.ndarray) -> float:
    """Kinetic and potential energy, J."""
    total = 0.0
    for near, far in ((0, 1), (3, 2)):
        w1, w2 = y[4 + near], y[4 + far]
        total += NEAR * w1 * w1 / 2 + FAR * w2 * w2 / 2 + COUPLING * math.cos(y[near] - y[far]) * w1 * w2
        total += MASS * G * ((COM + LENGTH) * math.sin(y[near]) + COM * math.sin(y[far]))
    return total


@njit(cache=False)
def servo_torque(motor, angle, rate):
    """Torque of the left (0) or right (1) servo, N·m."""
    return LIMIT * np.tanh((KP * (REFERENCES[motor] - angle) - KD * rate) / LIMIT)


@njit(cache=False)
def friction_torque(w):
    """Friction torque of a joint at a rate, N·m: Coulomb, Stribeck, viscous."""
    u = w / STRIBECK_RATE
    return -(STRIBECK * u * np.exp(-u * u) + COULOMB * np.tanh(w / COULOMB_RATE) + VISCOUS * w)


@njit(cache=False)
def torques(y):
    """Torques of servos and friction on the links, N·m."""
    out = np.zeros(4)
    out[0] = servo_torque(0, y[0], y[4]) + friction_torque(y[4])
    out[3] = servo_torque(1, y[3], y[7]) + friction_torque(y[7])
    for first, second in ((1, 0), (1, 2), (2, 3)):
        torque = friction_torque(y[4 + first] - y[4 + second])
        out[first] += torque
        out[second] -= torque
    return out


@njit(cache=False)
def joint_torques(y):
    """Torques of servos and friction on the hinge angles of two legs: left motor, left elbow, right motor, right elbow."""
    t = torques(y)
    return np.array([t[0] + t[1], t[1], t[3] + t[2], t[2]])


@njit(cache=False)
def terms(y):
    """Off-diagonal masses of the legs, forces with centrifugal terms, closure Jacobian by x and y, right sides of J a = c."""
    b, f, jx, jy, c = np.empty(2), np.empty(4), np.empty(4), np.empty(4), np.zeros(2)
    for leg in range(2):
        near, far = (0, 1) if leg == 0 else (3, 2)
        b[leg] = COUPLING * np.cos(y[near] - y[far])
        turn = COUPLING * np.sin(y[near] - y[far])
        f[near] = -turn * y[4 + far] ** 2 - MASS * G * (COM + LENGTH) * np.cos(y[near])
        f[far] = turn * y[4 + near] ** 2 - MASS * G * COM * np.cos(y[far])
    for i in range(4):
        sign = LENGTH if i < 2 else -LENGTH
        jx[i], jy[i] = -sign * np.sin(y[i]), sign * np.cos(y[i])
        c[0] += sign * np.cos(y[i]) * y[4 + i] ** 2
        c[1] += sign * np.sin(y[i]) * y[4 + i] ** 2
    return b, f, jx, jy, c


@njit(cache=False)
def by_mass(b, f):
    """M^-1 f."""
    out = np.empty(4)
    for leg in range(2):
        near, far = (0, 1) if leg == 0 else (3, 2)
        det = NEAR * FAR - b[leg] * b[leg]
        out[near] = (FAR * f[near] - b[leg] * f[far]) / det
        out[far] = (NEAR * f[far] - b[leg] * f[near]) / det
    return out


@njit(cache=False)
def derivative(_t, y):
    """Rates and accelerations under gravity alone."""
    return moved(y, np.zeros(4))


@njit(cache=False)
def loaded_derivative(_t, y):
    """Derivative of the state with servos and friction."""
    return moved(y, torques(y))


@njit(cache=False)
def moved(y, applied):
    """Rates and accelerations under torques on the links. Index 1: the two closing forces at the tip are eliminated."""
    b, f, jx, jy, c = terms(y)
    f = f + applied
    free, by_x, by_y = by_mass(b, f), by_mass(b, jx), by_mass(b, jy)
    xx, xy, yy = jx @ by_x, jx @ by_y, jy @ by_y
    rx, ry = c[0] - jx @ free, c[1] - jy @ free
    det = xx * yy - xy * xy
    force_x, force_y = (yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det
    out = np.empty(8)
    out[:4] = y[4:]
    out[4:] = by_mass(b, f + force_x * jx + force_y * jy)
    return out
