"""Workspace of a machine: motor angles for positions of the tip, the condition number there, and maps.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/workspace.py
Pictures and tables go to target/workspace/. See docs/kinematics.md for conventions and formulas.
"""

import numpy as np

from fivebar import scene, workspace, workspace_pictures
from fivebar.kinematics import Machine

FOLDER = "target/workspace"

# The table-top robot of the scene pick_and_place: all links 210 mm, motors 100 mm apart.
machine = Machine.from_scene("pick_and_place")
posture = machine.inverse((0.05, 0.25), working=("minus", "plus"))
print(
    f"motors at {np.degrees(posture.motors[0]):.3f} and {np.degrees(posture.motors[1]):.3f} deg put the tip at x = 0.05 m, y = 0.25 m"
)
print(f"condition number {machine.condition(posture.theta):.4f}, assembly {posture.assembly}")

velocity = machine.velocity_ellipse(posture.theta)
print(f"1 rad/s of the motors moves the tip at {velocity.axes[1]:.4f} to {velocity.axes[0]:.4f} m/s")

# A hundred positions on a line at once: the largest joint rates along it at 0.5 m/s.
line = np.linspace((-0.06, 0.24), (0.16, 0.24), 100)
along = machine.inverse(line)
rates = machine.motor_rates(along.theta, (0.5, 0.0))
print(f"along y = 0.24 m at 0.5 m/s: motor rates up to {np.abs(rates).max():.3f} rad/s")

# A position out of reach raises ValueError; its message contains the distances.
try:
    machine.inverse((0.5, 0.2))
except ValueError as sentence:
    print(sentence)

# Maps of each working mode, with the motion of the scene and the tip force within the limits of its servos.
robot = scene.read("pick_and_place")
survey = workspace.compute(robot, path=workspace.follow(robot))
print("\n".join(workspace.summary(survey)))
files = workspace.write(survey, FOLDER) + workspace_pictures.draw(survey, FOLDER)
wider = Machine.from_values({"base.distance": 0.25})
workspace_pictures.draw_modes(wider, (0.10, 0.24), f"{FOLDER}/modes.svg")
print(f"{len(files) + 1} files in {FOLDER}, such as condition_minusPlus.svg")
