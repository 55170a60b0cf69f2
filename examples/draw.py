"""A drawing machine: fivebar.svg becomes a motion of the tip, the unit runs it, and a picture compares command and result.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/draw.py
Pictures, scene and table go to target/draw/. See docs/kinematics.md for the rules; the command `fivebar path` does the same.
"""

from pathlib import Path

from fivebar import path_pictures, paths, scene, simulate, strokes
from fivebar.pieces import Timing

FOLDER = Path("target/draw")
FOLDER.mkdir(parents=True, exist_ok=True)

# The table-top robot of the scene pick_and_place. Its 50 g payload stands for a pen; all joints have dry and viscous friction.
robot = scene.read("pick_and_place").replace({"friction.enabled": True, "viscous.enabled": True})
limits = paths.Limits(torques=paths.servo_limits(robot))

# The drawing is 180 mm wide, in front of the motors; the tip draws at 0.1 m/s and rests at corners.
file = Path(__file__).with_name("fivebar.svg")
drawing = strokes.read(file).placed((0.05, 0.26), width=0.18)
plan = paths.plan(robot, drawing, Timing("constant", speed=0.1, acceleration=2.0), limits=limits)
print(plan.words(file.name))

# The scene has only positions of the tip; `fivebar` computes angles and rates of the servos when it reads the scene.
paths.write_scene(plan, FOLDER / "fivebar.json", file.name)
outcome = paths.compare(plan, simulate.run(FOLDER / "fivebar.json"))
print(outcome.words())
path_pictures.draw(outcome, file.name, limits, FOLDER)
paths.write_table(plan, outcome, FOLDER / "fivebar.csv")

# The machine cannot draw too close to the motors. The message says where it is blocked, and a picture shows the place.
close = strokes.read(file).placed((0.05, 0.12), width=0.25)
try:
    paths.plan(robot, close, plan.timing)
except paths.Blocked as blocked:
    print(blocked)
    path_pictures.draw_blocked(robot, plan.working, close, blocked, file.name, FOLDER)
print(f"{len(list(FOLDER.iterdir()))} files in {FOLDER}, such as drawn.svg")
