"""Tip accuracy of a robot: an error budget in mm, with one row per source.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/accuracy_budget.py [SCENE [X Y]]
Enter the figures of your own parts. Each is a standard deviation or, for a step or a play, the full width.
"""

import sys
from math import pi, sqrt

import numpy as np

from fivebar.kinematics import Machine

LENGTH = 0.05e-3  # m, error of each length (links and base) after measuring it
ZERO = 0.3e-3  # rad, error of each motor's zero angle after homing
STEP = 2 * pi / 2**14  # rad, resolution of an encoder
PLAY = 0.2e-3  # rad, play of a gear; 0 for direct drive
BEARING = 0.01e-3  # m, radial play of each of the five joints
FORCE = 0.2  # N, at the tip, unknown to the motors
STIFFNESS = 20.0  # N.m/rad, of a motor's servo: servo.kp

scene = sys.argv[1] if len(sys.argv) > 1 else "pick_and_place"
machine = Machine.from_scene(scene)
place = [float(word) for word in sys.argv[2:4]] or [0.5 * machine.distance, 1.4 * machine.lengths[0]]
posture = machine.inverse(place)
jacobian = machine.jacobian(posture.theta)


def moved(sizes: np.ndarray) -> np.ndarray:
    """Position of the tip, m, of a machine with other lengths at the same motor angles."""
    other = Machine(float(sizes[0]), tuple(sizes[1:].tolist()))
    return other.forward(posture.motors, str(posture.assembly)).tip


sizes = np.array([machine.distance, *machine.lengths])
by_size = np.stack([(moved(sizes + d) - moved(sizes - d)) / 2e-6 for d in 1e-6 * np.eye(5)], axis=1)
# An encoder step, or a play of full width w, has the standard deviation w/√12.
# Play of a joint acts along the distal link of its leg, like an error of its length; the joint at the tip belongs to both legs.
sources = {
    f"lengths, {1e3 * LENGTH:g} mm": LENGTH * by_size,
    f"zero angles, {1e3 * ZERO:g} mrad": ZERO * jacobian,
    f"encoder step, {1e3 * STEP:.3g} mrad": STEP / sqrt(12) * jacobian,
    f"play of gears, {1e3 * PLAY:g} mrad": PLAY / sqrt(12) * jacobian,
    f"play of joints, {1e3 * BEARING:g} mm": BEARING * sqrt(2.5 / 12) * by_size[:, 2:4],
    f"{FORCE:g} N against {STIFFNESS:g} N.m/rad": FORCE / STIFFNESS * jacobian @ jacobian.T / sqrt(2),
}
print(f"{scene}, tip at ({place[0]:.3f}, {place[1]:.3f}) m; standard deviations of the tip in mm")
for name, matrix in sources.items():
    print(f"  {name:28} {1e3 * np.linalg.norm(matrix):7.3f}")
print(f"  {'all together':28} {1e3 * np.linalg.norm(np.concatenate([*sources.values()], axis=1)):7.3f}")
