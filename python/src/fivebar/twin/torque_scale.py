"""Size of the unknown torques that the estimates of a record needed, and the `estimator.torqueScale` that fits them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fivebar.library import Library
from fivebar.plain import plain
from fivebar.twin.figures import COVERED, Story, or_none
from fivebar.twin.follower import LONGEST_GAP
from fivebar.twin.messages import TORQUES
from fivebar.twin.watch import STARTING
from fivebar.variables import Value

NAME: Final = "estimator.torqueScale"

SHARE: Final = 0.99
"""Share of the estimates whose unknown torques are at most the measured size; rare pushes do not change it."""

FACTOR: Final = 5.0
"""Fitting scale divided by the size. A sudden change by a quarter of the scale raises an alarm, so at least 4 is needed. A gripper whose gain
is up to 50 % off and whose commands are 17 ms late (`test_twin_validate.py`) had up to two alarms in a minute with 4, and none with 5."""

QUIET: Final = 0.005
"""Largest share of the time with an alarm that needs no advice. Alarms of the gripper last 0.22 s on average: one in a minute is 0.4 %."""

EXCEEDS: Final = 2.0
"""Another scale is tried if it exceeds the scale in use by this factor. The size depends on the scale that it is measured with:
the gripper's is up to 1.7 times larger with the weight of the links."""

FEWEST: Final = 100
"""Minimum number of estimates for a measurement: 1 / (1 - `SHARE`)."""

FOLLOWING: Final = 2.0
"""Value of `estimated.status` if samples of both encoders are used."""

GRAVITY: Final = 9.81
"""m/s²."""


@dataclass(frozen=True)
class Needed:
    """Unknown torques and alarms of a run, without the first 2 s of each series."""

    scale: float
    """Scale in use, N·m."""

    size: float | None
    """The larger of both unknown torques while the twin follows, N·m: `SHARE` of the estimates have at most this size. None if there are too few."""

    alarms: float
    """Share of all estimates with an alarm, whatever their status; NaN if no series is longer than 2 s."""

    inside: float
    """Share of the innovations in the held-out part inside their 95 % bands; NaN if there are none."""

    @property
    def fits(self) -> bool:
        """Whether alarms are rare, or not judged, and the promise about innovations is kept."""
        return not self.alarms > QUIET and not self.inside < COVERED

    def to_try(self) -> float | None:
        """A scale that may fit better, N·m; None if the present one fits or is large enough."""
        if self.fits or self.size is None or FACTOR * self.size <= EXCEEDS * self.scale:
            return None
        return float(f"{FACTOR * self.size:.2g}")

    def content(self) -> dict[str, float | None]:
        return {
            "torque_scale_nm": or_none(self.scale),
            "size99_nm": None if self.size is None else or_none(self.size),
            "alarm_share": or_none(self.alarms),
            "innovations_coverage95": or_none(self.inside),
        }


@dataclass(frozen=True)
class Advice:
    """The measured torques, and those of a second run with the scale that they suggest."""

    now: Needed
    tried: Needed | None = None

    @property
    def proposed(self) -> float | None:
        """Scale to set, N·m: the tried one, if it fits. A run that follows nothing has no alarms, but it has no size and no innovations either."""
        tried = self.tried
        if tried is None or tried.size is None or not tried.fits:
            return None
        return tried.scale if math.isfinite(self.now.inside) and math.isfinite(tried.inside) else None

    def content(self) -> dict[str, Any]:
        tried = None if self.tried is None else self.tried.content()
        return {**self.now.content(), "tried": tried, "proposed": self.proposed, "advice": self.sentence()}

    def sentence(self) -> str:
        """What to set, if another scale fits; else ""."""
        if self.proposed is None or self.tried is None:
            return ""
        now, tried = self.now, self.tried
        return (
            f'If nothing pushed the machine, copy into the scene: "{NAME}": {self.proposed:g} '
            f"(alarms {plain(100 * tried.alarms, 2)} % of the time in place of {plain(100 * now.alarms, 2)} %, "
            f"{plain(100 * tried.inside)} % of the innovations inside in place of {plain(100 * now.inside)} %)"
        )


def effective(library: Library, values: Mapping[str, Value]) -> float:
    """Torque scale of a unit with these start values, N·m. 0 stands for the mean torque that carries the weight of a leg."""

    def value(name: str) -> float:
        return float(values.get(name, library.variable(name).start))

    if value(NAME) > 0:
        return value(NAME)
    payload = value("payload.mass") if values.get("payload.enabled") else 0.0

    def weight(proximal: int, distal: int, carried: float) -> float:
        own = value(f"link[{proximal}].mass") * abs(value(f"link[{proximal}].com"))
        return GRAVITY * (own + (value(f"link[{distal}].mass") + carried) * value(f"link[{proximal}].length"))

    return (weight(1, 2, payload) + weight(4, 3, 0.0)) / 2


def measure(story: Story, scale: float, inside: float) -> Needed:
    """Measures the unknown torques of a record that was followed with a scale; `inside` is the share of its innovations inside 95 %."""
    table = story.estimated
    time = table["time"]
    begins = np.flatnonzero(np.diff(time, prepend=-np.inf) > LONGEST_GAP)
    since = time - time[begins][np.searchsorted(begins, np.arange(len(time)), side="right") - 1]
    started = since >= STARTING
    followed = (table["estimated.status"] == FOLLOWING) & started
    alarms = table["estimated.alarm"][started]
    torque = np.max(np.abs([table[f"estimated.{name}"][followed] for name in TORQUES]), axis=0)
    # Next to a direct singularity, no motor torques are equivalent to the unknown force, and both outputs are 0.
    known = torque[np.isfinite(torque) & (torque > 0)]
    return Needed(
        scale,
        float(np.quantile(known, SHARE)) if len(known) >= FEWEST else None,
        float(np.mean(alarms != 0)) if len(alarms) else math.nan,
        inside,
    )


def lines(content: dict[str, Any]) -> list[str]:
    """The size as text, and the advice if there is any."""
    size = content["size99_nm"]
    found = "not known" if size is None else f"{size:.3g} N.m or less in {100 * SHARE:g} % of the estimates"
    text = f"unknown torque: {found}; torque scale {content['torque_scale_nm']:.3g} N.m"
    return [text, *([content["advice"]] if content["advice"] else [])]
