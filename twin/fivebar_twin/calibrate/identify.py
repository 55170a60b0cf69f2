"""What a record says of each unknown: error bars, the Cramér-Rao bound, correlations, and combinations of which it says nothing.

The bound is that of white noise with the standard deviation of the residuals: (JᵀJ)⁻¹σ², starts of the series included. Error bars
are the same where residuals are white, and wider where they hang together (a resting encoder, a machine that is not as the scene has
it): then JᵀJ is put between sums of products of neighbouring scores (Newey and West 1987, with a Bartlett window).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import norm

from fivebar_twin.calibrate.data import Array
from fivebar_twin.calibrate.fit import WEAK, Fit
from fivebar_twin.calibrate.parameters import Parameter

LIMIT: Final = 0.5
"""Standard deviation, in sizes of an unknown, from which on it counts as not identified: half of what the scene says."""

DOUBTED: Final = 10.0
"""How many times the derivatives' own error what is told by them has to be."""

WEIGHT: Final = 0.1
"""Of an unknown in a combination, from which on it is named."""


@dataclass(frozen=True)
class Combination:
    """A direction among the unknowns of which the record says nothing: sizes of each, of unit length."""

    weights: Array
    sigma: float
    """Its standard deviation as far as the record says one, in sizes."""

    def sentence(self, sought: list[Parameter]) -> str:
        """The combination in words."""
        order = [int(k) for k in np.argsort(-np.abs(self.weights)) if abs(self.weights[k]) > WEIGHT]
        if len(order) == 1:
            what = sought[order[0]].name
        else:
            lead = float(self.weights[order[0]])
            terms = [sought[order[0]].name]
            for k in order[1:]:
                ratio = float(self.weights[k]) / lead
                terms.append(f"{'-' if ratio < 0 else '+'} {'' if abs(abs(ratio) - 1) < 0.05 else f'{abs(ratio):.2g} '}{sought[k].name}")
            same = all(sought[k].factor and abs(float(self.weights[k]) / lead - 1) < 0.05 for k in order)
            what = f"a common factor of {', '.join(sought[k].name for k in order)}" if same else " ".join(terms)
            what += "" if same else " (in relative changes)" if all(sought[k].factor for k in order) else " (in sizes)"
        return f"{what}: the record says nothing of it" if self.sigma > 1e3 else f"{what}: known to ±{1.96 * self.sigma:.2g} only"


@dataclass(frozen=True)
class Judgement:
    """Of all unknowns, in their order; standard deviations in sizes."""

    sigma: Array
    bound: Array
    correlation: Array
    identified: list[bool]
    combinations: list[Combination]
    lag: int
    """Samples over which residuals hang together; 0: they are white."""

    time_scale: float
    """Samples that count as one."""

    doubt: Array
    """Relative error of each unknown's derivatives."""


def judge(fit: Fit, sought: list[Parameter]) -> Judgement:
    """What the record says of each unknown."""
    p = len(sought)
    weights = 1 / fit.sigma[fit.rows[:, 2]]
    jacobian = fit.jacobian * weights[:, None]
    own = jacobian[:, :p]
    projected = without_starts(jacobian, p)
    scores = np.concatenate([gap[tuple(fit.rows[fit.rows[:, 0] == number, 1:].T)] for number, gap in enumerate(fit.residuals)]) * weights
    lag, time_scale = together(fit, scores)
    bread = projected.T @ projected
    prior = np.eye(p) / WEAK**2
    inverse = np.linalg.inv(bread + prior)
    covariance = inverse
    if lag:
        covariance = inverse @ (between(fit, projected, scores, lag) + prior) @ inverse
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.diag(inverse)))
    doubts = np.linalg.norm(fit.doubt * weights[:, None], axis=0) / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    combinations = _unknown(projected, fit.doubt * weights[:, None], covariance)
    identified = [
        bool(sigma[k] < LIMIT and doubts[k] < 0.1 and not any(abs(c.weights[k]) > WEIGHT for c in combinations)) for k in range(p)
    ]
    scale = np.sqrt(np.diag(covariance))
    bound = np.sqrt(np.diag(np.linalg.inv(bread + prior)))
    return Judgement(sigma, bound, covariance / np.outer(scale, scale), identified, combinations, lag, time_scale, doubts)


def without_starts(jacobian: Array, p: int) -> Array:
    """The unknowns' columns, less what starts of the series could do as well."""
    starts = jacobian[:, p:]
    scale = np.maximum(np.linalg.norm(starts, axis=0), 1e-300)
    q, r = np.linalg.qr(starts / scale)
    q = q[:, np.abs(np.diag(r)) > 1e-9]
    own = jacobian[:, :p]
    return np.asarray(own - q @ (q.T @ own))


def together(fit: Fit, scores: Array) -> tuple[int, float]:
    """Over how many samples residuals hang together (0: not at all), and how many count as one (Sokal's window)."""
    products: list[float] = []
    series = [scores[(fit.rows[:, 0] == n) & (fit.rows[:, 2] == e)] for n in range(len(fit.residuals)) for e in (0, 1)]
    series = [s for s in series if len(s) > 20]
    if not series:
        return 0, 1.0
    power = sum(float(s @ s) for s in series)
    count = sum(map(len, series))
    total = 1.0
    for lag in range(1, max(2, count // 20)):
        products.append(sum(float(s[lag:] @ s[:-lag]) for s in series if len(s) > lag) / power)
        total = 1.0 + 2.0 * sum(products)
        if lag >= 5 * total:
            break
    # What white noise shows by chance: products have a standard deviation of 1/sqrt(count) each.
    chance = 2.0 * 3.0 * math.sqrt(len(products) / count)
    return (0, 1.0) if total - 1.0 < chance else (2 * len(products), total)


def between(fit: Fit, projected: Array, scores: Array, lag: int) -> Array:
    """Sums of products of neighbouring scores, Bartlett's window."""
    p = projected.shape[1]
    total = np.zeros((p, p))
    for number in range(len(fit.residuals)):
        inside = fit.rows[:, 0] == number
        length = int(fit.rows[inside, 1].max()) + 1 if inside.any() else 0
        # Both encoders' scores of a sample together.
        g = np.zeros((length, p))
        np.add.at(g, fit.rows[inside, 1], projected[inside] * scores[inside, None])
        total += g.T @ g
        for shift in range(1, min(lag, length - 1) + 1):
            part = g[shift:].T @ g[:-shift]
            total += (1 - shift / (lag + 1)) * (part + part.T)
    # The window may leave a direction with less than nothing.
    values, vectors = np.linalg.eigh(total)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _unknown(projected: Array, doubt: Array, covariance: Array) -> list[Combination]:
    """Directions with less than the record has to say of them."""
    _, singular, directions = np.linalg.svd(projected, full_matrices=False)
    least = DOUBTED * float(np.linalg.norm(doubt, 2))
    found = []
    for value, direction in zip(singular, directions, strict=True):
        sigma = math.sqrt(float(direction @ covariance @ direction))
        believed = max(sigma, 1 / max(value, 1e-300)) if value > least else math.inf
        if believed > LIMIT:
            found.append(Combination(direction, believed))
    return found


def interval(sigma: float, level: float = 0.95) -> float:
    """Half of the interval that holds the truth with that probability."""
    return float(norm.ppf(0.5 + level / 2)) * sigma
