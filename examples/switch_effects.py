"""Effects on and off: how each changes the same fall, and how a parameter changes during a run.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/switch_effects.py
"""

import numpy as np
from fmpy import read_model_description, simulate_fmu

import fivebar

FMU = str(fivebar.unit())
START = {"init.theta[2]": 2.0944}
"""The fall of scenes/fall_90_120.json. At first, gravity is the only effect."""

OUTPUT = ["theta[1]", "tip.y", "energy.dissipated", "energy.error"]

EFFECTS = {
    "nothing but gravity": {},
    "no gravity": {"gravity.enabled": False},
    "payload of 0.1 kg": {"payload.enabled": True, "payload.mass": 0.1},
    "rotors behind gears": {"rotor.enabled": True, "rotor.gearRatio[1]": 10.0, "rotor.gearRatio[2]": 10.0},
    "viscous friction": {"viscous.enabled": True},
    "dry friction": {"friction.enabled": True},
    "springs": {"spring.enabled": True},
    "end stops": {"stop.enabled": True, "stop.lower[1]": 0.5, "stop.upper[1]": 2.6},
    "a floor": {"contact.enabled": True, "contact.offset": 0.1},
    "servos that hold": {"servo.enabled": True, "servo.theta[1]": 1.5708, "servo.theta[2]": 2.0944},
    "all of friction": {"viscous.enabled": True, "friction.enabled": True},
}


def fall(effects: dict[str, float | bool], **more: object) -> np.ndarray:
    """One second of the fall with these effects."""
    return simulate_fmu(FMU, stop_time=1, output_interval=1e-3, start_values=START | effects, output=OUTPUT, **more)


print(f"{'after 1 s':>20}  theta[1] (rad)  tip.y (m)  dissipated (mJ)  balance (J)")
for name, effects in EFFECTS.items():
    end = fall(effects)[-1]
    print(f"{name:>20}  {end['theta[1]']:14.4f}  {end['tip.y']:9.4f}", end="")
    print(f"  {1e3 * end['energy.dissipated']:15.3f}  {end['energy.error']:11.1e}")

# A tunable parameter may change during the run and acts from the next step on. FMPy takes it from its table of inputs. The table
# lists all inputs, because FMPy warns of each missing one. Energy that the change adds to a spring counts as energy.input.
inputs = [variable.name for variable in read_model_description(FMU).modelVariables if variable.causality == "input"]
stiffen = np.zeros(4, dtype=[(name, float) for name in ("time", "spring.k[1]", *inputs)])
stiffen["time"], stiffen["spring.k[1]"] = (0.0, 0.5, 0.5, 1.0), (0.05, 0.05, 0.5, 0.5)
softer, stiffer = fall({"spring.enabled": True}), fall({"spring.enabled": True}, input=stiffen)
apart = np.abs(stiffer["theta[1]"] - softer["theta[1]"]) > 0
print(
    f"a spring made ten times as stiff at 0.5 s: the motion differs from t = {softer['time'][np.argmax(apart)]:.3f} s on"
)
