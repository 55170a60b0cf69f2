"""Signals: inputs that change with time, given by a few knots [time in s, value] in a scene's `signals`.

`{"linear": [[t, v], ...]}` joins the knots by straight lines; `{"minimumJerk": [[t, v], ...]}` goes from knot to knot and
rests in each, by 10u^3 - 15u^4 + 6u^5, the path of least mean square jerk between two rests (Flash and Hogan, J. Neurosci. 5
(1985) 1688, eq. 3); `{"rateOf": "servo.theta[1]"}` is the derivative of another signal. Before its first and after its last
knot a signal stays what it is there.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from fmpy.model_description import ScalarVariable

from refusal import SceneError, is_number, similar


@dataclass(frozen=True)
class Shape:
    """The way from 0 to 1 while u goes from 0 to 1, and its derivative."""

    way: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]


SHAPES = {
    "linear": Shape(lambda u: u, np.ones_like),
    "minimumJerk": Shape(lambda u: u**3 * (10 - 15 * u + 6 * u**2), lambda u: 30 * u**2 * (1 - u) ** 2),
}
RATE_OF = "rateOf"
KINDS = (*SHAPES, RATE_OF)


@dataclass(frozen=True)
class Signal:
    """A signal, or with `rate` its derivative. A knot is a time, s, and a value."""

    shape: str
    knots: tuple[tuple[float, float], ...]
    rate: bool = False

    def at(self, time: np.ndarray) -> np.ndarray:
        """Values at `time`, s."""
        times, values = np.array(self.knots).T
        segment = np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
        duration, change = np.diff(times)[segment], np.diff(values)[segment]
        u = (time - times[segment]) / duration
        if self.rate:
            return np.where((u >= 0) & (u < 1), change / duration * SHAPES[self.shape].slope(np.clip(u, 0, 1)), 0.0)
        return values[segment] + change * SHAPES[self.shape].way(np.clip(u, 0, 1))


def read(where: str, given: Any, inputs: dict[str, ScalarVariable], unit: Callable[[ScalarVariable], str]) -> dict[str, Signal]:
    """The signals of a scene by the names of their inputs, checked."""
    if not isinstance(given, dict):
        raise SceneError(f"{where}: 'signals' must be an object of input names and signals, not {json.dumps(given)}.")
    for name in given:
        if name not in inputs:
            raise SceneError(f"{where}: 'signals' has '{name}', which is not an input of the FMU{similar(name, tuple(inputs))}")
    kinds = {name: _kind(f"{where}, signal '{name}'", signal) for name, signal in given.items()}
    signals = {
        name: Signal(kind, _knots(f"{where}, signal '{name}'", kind, given[name][kind]))
        for name, kind in kinds.items()
        if kind in SHAPES
    }
    rates = {}
    for name in kinds.keys() - signals.keys():
        source = given[name][RATE_OF]
        if not isinstance(source, str) or source not in signals or unit(inputs[name]) != unit(inputs[source]) + "/s":
            raise SceneError(
                f"{where}, signal '{name}': 'rateOf' must name a signal with knots whose rate has the unit {unit(inputs[name])}, "
                f"not {json.dumps(source)}."
            )
        rates[name] = replace(signals[source], rate=True)
    return {name: (signals | rates)[name] for name in given}


def _kind(where: str, given: Any) -> str:
    if not isinstance(given, dict) or len(given) != 1 or next(iter(given)) not in KINDS:
        raise SceneError(f"{where} must be an object with one key, one of {', '.join(KINDS)}, not {json.dumps(given)}.")
    return next(iter(given))


def _knots(where: str, kind: str, given: Any) -> tuple[tuple[float, float], ...]:
    def is_knot(knot: Any) -> bool:
        return isinstance(knot, list) and len(knot) == 2 and all(map(is_number, knot))

    if not isinstance(given, list) or len(given) < 2 or not all(map(is_knot, given)):
        raise SceneError(f"{where}: '{kind}' must be a list of two or more knots [time in s, value], not {json.dumps(given)}.")
    for (before, _), (after, _) in pairwise(given):
        if after <= before:
            raise SceneError(f"{where}: the knots' times must increase, but {after:g} s follows {before:g} s.")
    return tuple((float(time), float(value)) for time, value in given)
