"""A sweep on Dask: the same swing with many payloads and frictions, each task an instance of its own, on all cores.

`cargo xtask package` makes the .fmu; from the root of the repository: target/venv/bin/python examples/sweep.py
It needs Dask: target/venv/bin/pip install dask. The same code runs on a cluster with dask.distributed: a task holds plain values.
"""

import dask
import numpy as np
from unit import Unit

PAYLOADS = np.linspace(0.0, 0.2, 6)
FRICTIONS = np.array([0.0, 1e-4, 3e-4, 1e-3])
"""Of the left motor axis, N·m·s/rad."""


@dask.delayed
def highest(payload: float, friction: float) -> float:
    """How high the tip comes within 2 s after a fall from 90 deg / 120 deg, m."""
    values = {"init.theta[2]": 2.0944, "payload.enabled": True, "payload.mass": payload, "viscous.enabled": True}
    with Unit(**values, **{"viscous.b[1]": friction}) as unit:
        unit.start({})
        heights = []
        for _ in range(200):
            unit.step(0.01)
            heights += unit.get("tip.y")
    # After the first half second, when it has left its start.
    return max(heights[50:])


if __name__ == "__main__":
    tasks = [[highest(float(payload), float(friction)) for payload in PAYLOADS] for friction in FRICTIONS]
    (rows,) = dask.compute(tasks, scheduler="processes")
    print("highest tip (m) with payload (kg)   " + "".join(f"{payload:9.2f}" for payload in PAYLOADS))
    for friction, row in zip(FRICTIONS, rows):
        print(f"friction of {friction:7.4f} N.m.s/rad      " + "".join(f"{height:9.4f}" for height in row))
