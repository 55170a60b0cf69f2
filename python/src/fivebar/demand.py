"""Inverse dynamics: motor torques that a motion needs, from accelerations that the unit computes by model exchange.

Servos, stops and the estimator of the scene are off; all other effects count. Friction follows the smooth law, since its
torque depends on the state alone.
"""

from ctypes import byref, c_double
from typing import Self

import numpy as np
from fmpy import fmi2
from numpy.typing import NDArray

from fivebar.drive import StartRefused
from fivebar.errors import FiveBarError, UnitError
from fivebar.instance import Instance
from fivebar.library import shared
from fivebar.scene import Scene

Floats = NDArray[np.float64]

OFF = ("servo.enabled", "stop.enabled", "estimator.enabled")
"""Switches of effects that do not load the motors."""

SMOOTH = 1
"""Number of the smooth item of friction.law and contact.law, with a torque that depends on the state alone."""


class Demand:
    """Context manager of a unit that computes accelerations at given states.

    The unit is in the assembly of `theta`, a posture (4,) of the scene's machine.
    """

    def __init__(self, scene: Scene, theta: Floats):
        plus = bool(np.sin(theta[2] - theta[1]) > 0)
        start = {"init.theta[1]": float(theta[0]), "init.theta[2]": float(theta[3]), "init.assembly": 1 if plus else 2}
        still = {name: 0.0 for name in ("init.omega[1]", "init.omega[2]", "tau[1]", "tau[2]")}
        smooth = {"friction.law": SMOOTH, "contact.law": SMOOTH}
        self._unit = Instance(shared(), "demand", exchange=True)
        (self._tau,) = self._unit.library.blocks(("tau[1]", "tau[2]"))
        try:
            self._unit.update(dict(scene.values) | dict.fromkeys(OFF, False) | smooth | start | still)
            self._unit.initialise(0.0)
            self._unit.call("fmi2NewDiscreteStates", byref(fmi2.fmi2EventInfo()))
            self._unit.call("fmi2EnterContinuousTimeMode")
        except UnitError as refusal:
            self._unit.close()
            raise StartRefused(str(refusal)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._unit.close()

    def torques(self, theta: Floats, omega: Floats, alpha: Floats) -> Floats:
        """Motor torques, N·m, (n, 2), for accelerations `alpha` (n, 2), rad/s2, at postures (n, 4) and rates (n, 2), rad/s."""
        found = np.empty((len(theta), 2))
        for row, (motors, rates, wanted) in enumerate(zip(theta[:, [0, 3]].tolist(), omega.tolist(), alpha.tolist())):
            free, by_left, by_right = self._accelerations([*motors, *rates])
            a, b, c, d = by_left[0] - free[0], by_right[0] - free[0], by_left[1] - free[1], by_right[1] - free[1]
            missing = wanted[0] - free[0], wanted[1] - free[1]
            found[row] = np.array([d * missing[0] - b * missing[1], a * missing[1] - c * missing[0]]) / (a * d - b * c)
        return found

    def _accelerations(self, states: list[float]) -> list[tuple[float, float]]:
        """Motor accelerations with zero torque, with 1 N·m left and with 1 N·m right: they are affine in the torques."""
        unit, derivatives = self._unit, (c_double * 4)()
        try:
            unit.call("fmi2SetContinuousStates", (c_double * 4)(*states), 4)
            found = []
            for torques in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
                unit.write(self._tau, torques)
                unit.call("fmi2GetDerivatives", derivatives, 4)
                found.append((derivatives[2], derivatives[3]))
            return found
        except UnitError as error:
            raise FiveBarError(f"the torques that the motion needs cannot be computed: {error}") from None
