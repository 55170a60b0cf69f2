"""Forecasts: a stored state of the twin runs ahead without samples, along the plan of its drives, with growing uncertainty.

The FMU computes the probabilities: the 95 % radius of the tip along the path, and the probability of a singularity within the horizon. This
module only finds where the path meets a singularity (a determinant changes sign) or an end stop.
"""

import math
from collections.abc import Callable
from typing import Any, Final

from fivebar.library import Library
from fivebar.twin.follower import Book, Rider, stored
from fivebar.twin.messages import Message
from fivebar.twin.setup import Setup

PROBABILITY_EVERY: Final = 4
"""Forecasts per computation of the singularity probability. It takes 13 runs of the motion, more time than the rest of a forecast."""

POINTS: Final = 10
"""Number of points in the path, evenly spaced over the horizon."""

LEVEL: Final = 5.991464547107979
"""Squared Mahalanobis radius of the 95 % ellipse of a normal distribution in the plane: -2 ln 0.05."""

RADIUS: Final = "estimated.forecast.radius95"
"""Output with the 95 % radius about the forecast tip, m: a quantile over the unit's models."""

COVARIANCE: Final = tuple(f"estimated.tip.cov[{i}]" for i in (1, 2, 3))
ANGLES: Final = ("theta[1]", "theta[2]", "estimated.theta.sigma[1]", "estimated.theta.sigma[2]")
PROBABILITY: Final = "estimated.singular.probability"
DETERMINANTS: Final = {"direct": "singular.detJx", "inverse": "singular.detJq"}
PATH: Final = ("tip.x", "tip.y", RADIUS, *ANGLES)
"""Outputs that are kept at each point of the path."""

SCALES: Final = tuple(f"estimator.commandScale.{name}[{i}]" for name in ("tau", "theta") for i in (1, 2))
"""Parameters that widen a forecast by commands that it does not know."""


def half_width(cov: tuple[float, float, float]) -> float:
    """Major half-axis of the 95 % ellipse, m, for a covariance xx, xy, yy in m²."""
    xx, xy, yy = cov
    largest = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return math.sqrt(LEVEL * max(largest, 0.0))


def crossing(before: float, after: float) -> float | None:
    """Fraction (0 to 1) of the interval at which the sign changes, by linear interpolation; None without a change."""
    if before * after < 0 or (after == 0 and before != 0):
        return before / (before - after)
    return None


class Forecaster(Rider):
    """A second instance of the unit, which runs ahead of the twin's instance."""

    def __init__(self, library: Library, setup: Setup):
        super().__init__(library, setup, "forecast")
        self.stops: dict[str, tuple[str, float, float]] = {}
        self.seen: tuple[str, ...] = tuple(DETERMINANTS.values())
        """Outputs in which the path is searched for singularities and stops."""
        self.made = 0
        self.singular = 0.0
        if setup.values.get("stop.enabled"):
            limits = {f"stop.{limit}[{i}]": (i, limit) for i in (1, 2) for limit in ("lower", "upper")}
            for name, (i, limit) in limits.items():
                value = float(setup.values.get(name, library.variable(name).start))
                self.stops[f"{limit}[{i}]"] = (f"theta[{i}]", value, 1.0 if limit == "upper" else -1.0)
            self.seen += ANGLES

    def run(self, state: Message, stopped: Callable[[], bool] = lambda: False) -> Message | None:
        """Computes the forecast from a state of the twin; None if it was stopped."""
        setup, unit = self.setup, self.unit
        content, begin, book, parameters = stored(state)
        unit.restore(content, begin)
        scales = setup.values | parameters
        if (self.known is not None or book.on_plan) and any(scales.get(name) for name in SCALES):
            # The plan says which commands follow.
            unit.update(dict.fromkeys(SCALES, 0.0))
        if self.made % PROBABILITY_EVERY == 0:
            self.singular = unit[PROBABILITY]
        self.made += 1
        probability = self.singular
        before = unit.floats(self.seen)
        path: dict[str, list[float]] = {name: [] for name in ("ahead", *PATH)}
        singular: dict[str, Any] = {"probability": probability, "time": None, "type": "none"}
        stop: dict[str, Any] = {"probability": self._stop_probability(before), "time": None, "at": "none"}
        now = begin
        for point in range(1, POINTS + 1):
            for then in self.coast(book, begin + setup.horizon * point / POINTS):
                if stopped():
                    return None
                after = unit.floats(self.seen)
                self._meets(singular, stop, before, after, now - begin, then - now, book)
                stop["probability"] = max(stop["probability"], self._stop_probability(after))
                now, before = then, after
            path["ahead"].append(round(now - begin, 9))
            for name, value in unit.floats(PATH).items():
                path[name].append(value)
        fields = {name: values[-1] for name, values in path.items() if name != "ahead"}
        fields |= {PROBABILITY: probability}
        if not all(math.isfinite(x) for values in path.values() for x in values) or not math.isfinite(probability):
            return None
        time = book.time + setup.step_ns
        extra = {"ahead": setup.horizon, "path": path, "singular": singular, "stop": stop, "half_width": fields[RADIUS]}
        return Message("forecast", "", time, book.seq, fields, extra)

    def _meets(
        self,
        singular: dict[str, Any],
        stop: dict[str, Any],
        before: dict[str, float],
        after: dict[str, float],
        now: float,
        span: float,
        book: Book,
    ) -> None:
        """Records the first singularity and the first stop on the path."""
        origin = book.time + self.setup.step_ns
        for kind, name in DETERMINANTS.items():
            share = crossing(before[name], after[name])
            if share is not None and singular["time"] is None:
                singular |= {"time": origin + round(1e9 * (now + share * span)), "type": kind}
        for place, (angle, limit, side) in self.stops.items():
            share = crossing(side * (before[angle] - limit), side * (after[angle] - limit))
            if share is not None and stop["time"] is None and side * (after[angle] - limit) >= 0:
                stop |= {"time": origin + round(1e9 * (now + share * span)), "at": place}

    def _stop_probability(self, seen: dict[str, float]) -> float:
        """Probability that a link is beyond a stop, from the mean and standard deviation of its angle."""
        most = 0.0
        for angle, limit, side in self.stops.values():
            sigma = max(seen[f"estimated.{angle.replace('[', '.sigma[')}"], 1e-12)
            most = max(most, 0.5 * math.erfc(side * (limit - seen[angle]) / sigma / math.sqrt(2)))
        return most

    def close(self) -> None:
        """Frees the unit."""
        self.unit.close()


def covariance(fields: dict[str, float]) -> tuple[float, float, float]:
    """The covariance of the tip in fields: xx, xy, yy in m²."""
    xx, xy, yy = (fields[name] for name in COVARIANCE)
    return xx, xy, yy
