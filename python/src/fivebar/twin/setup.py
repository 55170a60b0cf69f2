"""Setup of a twin, which determines its estimates: the unit, its start values, the plan of the drives, the sampling period."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from fivebar.library import Library
from fivebar.twin.config import Config, Machine
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import Message
from fivebar.twin.scene import Scene, parse
from fivebar.variables import Value

CORRECTOR: Final[dict[str, float | int | bool]] = {"estimator.enabled": True}
"""Start values for a unit that follows a machine."""

MOTION: Final[dict[str, float | int | bool]] = {"solver.method": 6, "solver.errorTolerance": 1e-6}
"""Integration method of the twin: automatic, also if the scene has another one. The default tolerance is 1 % of the resolution of a 16-bit encoder, rad.
The inputs change with every sample; there this method is cheaper than i3alp, with 1/200 of its error."""


EXACT: Final[dict[str, float | int | bool]] = {
    "estimator.sigma0.length": 0.0,
    "estimator.sigma0.offset": 0.0,
    "estimator.sigma0.eccentricity": 0.0,
    "estimator.sigma0.scale": 0.0,
}
"""Start values of a twin that assumes exact lengths and encoders."""


def learning(library: Library, values: dict[str, float | int | bool]) -> dict[str, float | int | bool]:
    """Start values with which the twin of a scene learns; prior standard deviations of the scene are kept.

    Viscous friction is also learned if the scene has none, because bearings always have some. Its prior σ is then the unit's default friction.
    """
    switches: dict[str, float | int | bool] = {"estimator.learn.enabled": True}
    if values.get("viscous.enabled"):
        return switches
    usual = float(library.variable("viscous.b[1]").start)
    return (
        switches
        | {"viscous.enabled": True, "estimator.learn.viscous": values.get("estimator.learn.viscous", usual)}
        | {f"viscous.b[{i}]": 0.0 for i in range(1, 6)}
    )


@dataclass(frozen=True)
class Setup:
    """Data that, together with the messages, determine the estimates bit by bit."""

    guid: str
    scene: Scene
    values: dict[str, float | int | bool]
    """Start values of the twin, including the scene's values."""

    period: float
    """Sampling period, s."""

    step: float = 1e-3
    """Macro step of the unit, s. An estimate is for one macro step after its sample, because outputs change only in steps."""

    horizon: float = 0.5
    """Horizon of forecasts, s."""

    @property
    def step_ns(self) -> int:
        return round(1e9 * self.step)

    def to_message(self, unit: str, time: int) -> Message:
        """The message `setup` of a record."""
        content = asdict(self) | {"scene": self.scene.content()}
        return Message("setup", unit, time, 0, {}, content)


def encoders(machine: Machine, values: Mapping[str, Value]) -> dict[str, float]:
    """Resolution and noise of the encoders, rad, by start value: from the scene's values, else from the configuration."""
    names = {
        f"estimator.{name}[{i}]": value
        for i in (1, 2)
        for name, value in (("quantum", machine.quantum), ("sigma", machine.sigma))
    }
    return {name: float(values.get(name, value)) for name, value in names.items()}


def of_run(config: Config, scene: Scene, guid: str) -> Setup:
    """The setup of a configured twin."""
    own = {name: value for name, value in scene.values.items() if name != "solver.method"}
    values = MOTION | own | CORRECTOR | encoders(config.machine, scene.values) | {"estimator.horizon": config.horizon}
    values |= config.twin
    step = values.get("solver.stepSize", 1e-3)
    return Setup(guid, scene, values, config.period, float(step), config.horizon)


def of_message(message: Message) -> Setup:
    """The setup in a record's message."""
    try:
        content: dict[str, Any] = dict(message.extra)
        scene = parse(content.pop("scene"))
        setup = Setup(scene=scene, **content)
    except (KeyError, TypeError, ValueError):
        raise TwinError("the setup of the record does not have the format of this version") from None
    if not (
        isinstance(setup.guid, str)
        and all(math.isfinite(x) and x > 0 for x in (setup.period, setup.step, setup.horizon))
    ):
        raise TwinError("the setup of the record needs a GUID, and a period, a step and a horizon above 0")
    return setup
