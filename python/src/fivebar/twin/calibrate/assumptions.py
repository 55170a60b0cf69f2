"""Other assumptions that may explain a record far better than the scene: signs, order of the encoders, unit of the torques, gravity, an axis that a drive holds.

They are tried if the fit of the shortest pieces leaves more than noise (`Fitter.doubt`). Each is one change of the scene or of the samples.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fivebar.plain import plain
from fivebar.twin.calibrate.data import Data, Samples
from fivebar.twin.calibrate.parameters import Values
from fivebar.twin.recording import Array

SURE: Final = 0.25
"""Ratio of residuals with another assumption to residuals of the fit, below which the assumption counts as right; both with fitted unknowns."""


HELD: Final = 5e-3
"""Maximum motion of an axis that counts as standing still, rad: a drive or friction that holds an axis leaves some mrad."""


@dataclass(frozen=True)
class Assumption:
    """A change of the scene or of the samples."""

    sentence: str
    scene: Values
    samples: Callable[[Samples], Samples]


def others(scene: Values, names: tuple[str, ...]) -> Iterator[Assumption]:
    """Assumptions to try; `names` are the recorded commands."""

    def same(samples: Samples) -> Samples:
        return samples

    def angles(factors: Array, columns: list[int]) -> Callable[[Samples], Samples]:
        return lambda samples: replace(samples, angles=samples.angles[:, columns] * factors)

    def commands(factors: Array) -> Callable[[Samples], Samples]:
        return lambda samples: replace(samples, commands=samples.commands * factors)

    for i in (0, 1):
        yield Assumption(
            f"measured.theta[{i + 1}] seems to have the wrong sign",
            {},
            angles(np.where(np.arange(2) == i, -1.0, 1.0), [0, 1]),
        )
    yield Assumption("the encoders seem to be swapped", {}, angles(np.ones(2), [1, 0]))
    torques = [name for name in names if name.startswith("tau")]
    for name in torques:
        factors = np.where(np.array(names) == name, -1.0, 1.0)
        yield Assumption(f"{name} seems to have the wrong sign", {}, commands(factors))
    if torques:
        factors = np.where(np.isin(names, torques), 1e-3, 1.0)
        yield Assumption(
            f"the values of {' and '.join(torques)} seem to be in mN.m; N.m is expected", {}, commands(factors)
        )
    if scene.get("gravity.enabled", True):
        yield Assumption("the record shows no gravity in the plane (gravity.enabled)", {"gravity.enabled": False}, same)
        direction = float(scene.get("gravity.direction", -0.5 * math.pi))
        for quarter in (1, 2, 3):
            turned = math.remainder(direction + 0.5 * math.pi * quarter, 2 * math.pi)
            yield Assumption(
                f"gravity.direction seems to be near {turned:.2g} rad", {"gravity.direction": turned}, same
            )


def held(data: Data, left: Array) -> str:
    """A sentence about an axis that stands still, where the machine of the scene would move; `left`: residuals of both encoders, rad."""
    for i in (0, 1):
        # A tenth of the samples may be outliers.
        still = max(
            float(np.nanquantile(np.abs(s.angles[:, i] - np.nanmedian(s.angles[:, i])), 0.9)) for s in data.series
        )
        if still < min(HELD, SURE * left[i]):
            return (
                f"measured.theta[{i + 1}] stands still within {plain(1e3 * still, 2)} mrad: a drive that holds it, or friction, is missing in the scene "
                "(servo.enabled) or in the record (servo.theta)"
            )
    return ""
