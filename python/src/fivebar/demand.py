"""Inverse dynamics: motor torques that a motion needs, from accelerations that the unit computes by model exchange.

Servos, stops and the estimator of the scene are off; all other effects count. Friction follows the smooth law, since its
torque depends on the state alone.
"""

import shutil
from ctypes import c_double
from typing import Self

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from fivebar import shipped
from fivebar.drive import StartRefused
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.slave import Log, load, set_values

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
        self._folder = fmpy.extract(str(shipped.unit()))
        self._log = Log()
        try:
            model = fmpy.read_model_description(self._folder, validate=False)
            self._tau = [
                v.valueReference for name in ("tau[1]", "tau[2]") for v in model.modelVariables if v.name == name
            ]
            self._unit = load(fmi2.FMU2Model, model, self._folder, "demand")
            self._unit.instantiate(callbacks=self._log.callbacks())
            set_values(self._unit, model, dict(scene.values) | dict.fromkeys(OFF, False) | smooth | start | still)
            self._unit.setupExperiment(startTime=0.0)
            self._unit.enterInitializationMode()
            self._unit.exitInitializationMode()
            self._unit.newDiscreteStates()
            self._unit.enterContinuousTimeMode()
        except FMICallException as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise StartRefused(self._log.last() or str(error)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._unit.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

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
            unit.fmi2SetContinuousStates(unit.component, (c_double * 4)(*states), 4)
            found = []
            for torques in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
                unit.setReal(self._tau, torques)
                unit.fmi2GetDerivatives(unit.component, derivatives, 4)
                found.append((derivatives[2], derivatives[3]))
            return found
        except FMICallException as error:
            raise FiveBarError(
                f"the torques that the motion needs cannot be computed: {self._log.last() or error}"
            ) from None
