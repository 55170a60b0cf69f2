"""Identifiability: error bars of the unknowns, the Cramér-Rao bound, correlations, and combinations that a record does not identify.

The bound assumes white noise with the standard deviation of the residuals: (JᵀJ)⁻¹σ², including the starts of the series. Error bars equal
the bound for white residuals. They are wider for correlated residuals (a resting encoder, a machine that differs from the scene), by a
sandwich estimate with sums of products of neighbouring scores (Newey and West 1987, with a Bartlett window).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import norm

from fivebar.twin.calibrate.fit import LIMIT, WEAK, Fit
from fivebar.twin.calibrate.parameters import Parameter
from fivebar.twin.recording import Array

COMES_AGAIN: Final = 0.3
"""Autocorrelation from which residuals count as periodic."""

DOUBTED: Final = 10.0
"""Minimum ratio of a combination's effect to the error of the derivatives."""

WEIGHT: Final = 0.1
"""Share of an unknown in a combination from which the unknown is named."""


@dataclass(frozen=True)
class Combination:
    """A direction of the unknowns that the record does not identify: a unit vector, in sizes."""

    weights: Array
    sigma: float
    """Standard deviation in this direction, in sizes, if the record gives one."""

    at: Array
    """Values of the unknowns at which this holds."""

    def sentence(self, sought: list[Parameter]) -> str:
        """The combination in words."""
        # For a factor, the relative change counts.
        scale = np.array([max(abs(x), 1e-3) if p.factor else 1.0 for p, x in zip(sought, self.at, strict=True)])
        weights = self.weights / scale
        weights = weights / np.linalg.norm(weights)
        order = [int(k) for k in np.argsort(-np.abs(weights)) if abs(weights[k]) > WEIGHT]
        if len(order) == 1:
            what = sought[order[0]].name
        else:
            lead = float(weights[order[0]])
            terms = [sought[order[0]].name]
            for k in order[1:]:
                ratio = float(weights[k]) / lead
                terms.append(
                    f"{'-' if ratio < 0 else '+'} {'' if abs(abs(ratio) - 1) < 0.05 else f'{abs(ratio):.2g} '}{sought[k].name}"
                )
            same = all(sought[k].factor and abs(float(weights[k]) / lead - 1) < 0.05 for k in order)
            what = f"a common factor of {', '.join(sought[k].name for k in order)}" if same else " ".join(terms)
            what += "" if same else " (in relative changes)" if all(sought[k].factor for k in order) else " (in sizes)"
        return (
            f"{what}: not identified by the record"
            if self.sigma > 1e3
            else f"{what}: known to ±{1.96 * self.sigma:.2g} only"
        )


@dataclass(frozen=True)
class Judgement:
    """Error bars and identifiability of all unknowns, in order; standard deviations in sizes."""

    sigma: Array
    bound: Array
    correlation: Array
    identified: list[bool]
    combinations: list[Combination]
    together: "Together"
    doubt: Array
    """Relative error of each unknown's derivatives."""

    held: Array
    """Prior standard deviations of the scene's values; infinite for unknowns fitted to the record alone."""

    bounded: dict[int, float]
    """Unknowns at their bound, by index, with their upper 95 % limit, SI."""

    def not_identified(self, sought: list[Parameter]) -> list[str]:
        """Sentences about unknowns that the record does not identify."""
        found = [combination.sentence(sought) for combination in self.combinations]
        for k, most in self.bounded.items():
            [least, *_] = sought[k].value(sought[k].lowest)
            found.append(
                f"{sought[k].name}: at its bound of {least:.3g} {sought[k].unit}, below {most:.2g} {sought[k].unit} with 95 % probability"
            )
        for k in np.flatnonzero(np.isfinite(self.held)).tolist():
            bar = max(sought[k].bar(interval(float(self.held[k]))))
            found.append(
                f"{sought[k].name}: the record is less accurate than the scene, so that the scene's value counts as right to ±{bar:.2g} {sought[k].unit}"
            )
        return list(dict.fromkeys(found))


def judge(fit: Fit, sought: list[Parameter], held: Array) -> Judgement:
    """Computes error bars of the unknowns and decides which of them the record identifies; `held` as in `Judgement`."""
    p = len(sought)
    weights = 1 / fit.sigma[fit.rows[:, 2]]
    # Rows of samples, then rows of the scene's values with a prior.
    scene = np.diag(1 / held)[np.isfinite(held)]
    jacobian = np.vstack([fit.jacobian * weights[:, None], np.pad(scene, ((0, 0), (0, fit.jacobian.shape[1] - p)))])
    errors = np.vstack([fit.doubt * weights[:, None], np.zeros((len(scene), fit.doubt.shape[1]))])
    projected = without_starts(jacobian, p)
    scores = (
        np.concatenate(
            [gap[tuple(fit.rows[fit.rows[:, 0] == number, 1:].T)] for number, gap in enumerate(fit.residuals)]
        )
        * weights
    )
    found = together(fit, scores)
    prior = np.vstack([np.eye(p) / WEAK, scene])
    # A square root of the covariance, so that rounding cannot make the variance of a poorly known direction negative.
    root = np.linalg.inv(np.linalg.qr(np.vstack([projected[: len(scores)], prior]), mode="r"))
    inverse = covariance = root @ root.T
    if found.lag or found.period:
        middle = between(fit, projected[: len(scores)], scores, found) + prior.T @ prior
        covariance = root @ (root.T @ middle @ root) @ root.T
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.diag(inverse)))
    doubts = np.linalg.norm(errors[:, :p], axis=0) / np.maximum(np.linalg.norm(jacobian[:, :p], axis=0), 1e-300)
    combinations = _unknown(jacobian, projected, errors, len(scores), covariance, fit.x)
    known = [
        bool(sigma[k] < LIMIT and doubts[k] < 0.1 and not any(abs(c.weights[k]) > WEIGHT for c in combinations))
        for k in range(p)
    ]
    # An error bar beyond the bound has no meaning: the fit stopped at the bound.
    bounded = {
        k: max(sought[k].value(float(fit.x[k]) + interval(float(sigma[k]))))
        for k in range(p)
        if known[k] and fit.x[k] - sought[k].lowest < interval(float(sigma[k]))
    }
    identified = [known[k] and k not in bounded and not np.isfinite(held[k]) for k in range(p)]
    # With correlated residuals the estimated covariance need not be positive definite; `sigma` is at least the bound.
    correlation = covariance / np.outer(sigma, sigma)
    np.fill_diagonal(correlation, 1.0)
    bound = np.sqrt(np.diag(inverse))
    return Judgement(sigma, bound, correlation, identified, combinations, found, doubts, held, bounded)


def without_starts(jacobian: Array, p: int) -> Array:
    """The columns of the unknowns minus their projection on the columns of the starts."""
    starts = jacobian[:, p:]
    scale = np.maximum(np.linalg.norm(starts, axis=0), 1e-300)
    q, r = np.linalg.qr(starts / scale)
    q = q[:, np.abs(np.diag(r)) > 1e-9]
    own = jacobian[:, :p]
    return np.asarray(own - q @ (q.T @ own))


@dataclass(frozen=True)
class Together:
    """Autocorrelation of the residuals."""

    lag: int
    """Length of the correlation in samples; 0: white residuals."""

    period: int
    """Period of the residuals in samples, for example of a quantised encoder on a periodic motion; 0: not periodic."""

    time_scale: float
    """Number of samples that count as one independent sample."""


def together(fit: Fit, scores: Array) -> Together:
    """Analyses the autocorrelation of the residuals: sums it up to Sokal's window and searches for a period."""
    series = [scores[(fit.rows[:, 0] == n) & (fit.rows[:, 2] == e)] for n in range(len(fit.residuals)) for e in (0, 1)]
    series = [s for s in series if len(s) > 40]
    if not series:
        return Together(0, 0, 1.0)
    longest = max(map(len, series))
    products = np.zeros(longest // 2)
    for s in series:
        spectrum = np.abs(np.fft.rfft(s, 2 * len(s))) ** 2
        part = np.fft.irfft(spectrum)[: min(len(s), longest) // 2]
        # Unbiased, by the number of products at each lag, so that a periodic part keeps its size.
        products[: len(part)] += part * len(s) / (len(s) - np.arange(len(part)))
    count = sum(map(len, series))
    products /= products[0]
    sums = 2 * np.cumsum(products) - 1
    enough = np.flatnonzero(np.arange(len(sums)) >= 5 * np.maximum(sums, 1.0))
    window = int(enough[0]) if len(enough) else len(sums) - 1
    total = float(sums[window])
    beyond = products[2 * window :] if len(products) > 2 * window else np.zeros(1)
    again = 2 * window + int(np.argmax(beyond)) if float(beyond.max()) > COMES_AGAIN else 0
    # White noise can reach this sum by chance: each product has a standard deviation of 1/sqrt(count).
    if total - 1.0 < 6.0 * math.sqrt(window / count):
        window, total = 0, 1.0
    return Together(2 * window, again, total * (longest / again if again else 1.0))


def between(fit: Fit, projected: Array, scores: Array, found: Together) -> Array:
    """Sums of products of neighbouring scores with a Bartlett window; repeated periods count as one."""
    p = projected.shape[1]
    total = np.zeros((p, p))
    for number in range(len(fit.residuals)):
        inside = fit.rows[:, 0] == number
        length = int(fit.rows[inside, 1].max()) + 1 if inside.any() else 0
        # Sum of the scores of both encoders for each sample.
        g = np.zeros((found.period or length, p))
        np.add.at(g, fit.rows[inside, 1] % len(g), projected[inside] * scores[inside, None])
        total += g.T @ g
        for shift in range(1, min(found.lag, len(g) - 1) + 1):
            part = g[shift:].T @ g[:-shift]
            total += (1 - shift / (found.lag + 1)) * (part + part.T)
    # The window can lead to negative variances.
    values, vectors = np.linalg.eigh(total)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _unknown(
    jacobian: Array, projected: Array, doubt: Array, samples: int, covariance: Array, at: Array
) -> list[Combination]:
    """Poorly known directions: too wide, or only determined by errors of the derivatives. Rows after the samples' rows are exact."""
    p = projected.shape[1]
    starts = jacobian[:, p:]
    scale = np.maximum(np.linalg.norm(starts, axis=0), 1e-300)
    basis = np.linalg.qr(starts / scale)[0]
    found = []
    _, _, directions = np.linalg.svd(projected, full_matrices=False)
    for direction in directions:
        with_it = jacobian[:, :p] @ direction
        # Change of the starts that compensates most of the direction's effect.
        answer = -np.linalg.lstsq(starts / scale, with_it, rcond=1e-9)[0] / scale
        effect = with_it + starts @ answer
        seen, held = float(np.linalg.norm(effect[:samples])), float(np.linalg.norm(effect[samples:]))
        # Errors that a change of the starts also compensates do not count; in a chaotic motion, they are nearly all of the error.
        off = doubt @ np.concatenate([direction, answer])
        errs = float(np.linalg.norm(off - basis @ (basis.T @ off)))
        if seen > DOUBTED * errs:
            sigma = math.sqrt(max(float(direction @ covariance @ direction), 0.0))
        else:
            sigma = 1 / held if held else math.inf
        if sigma > LIMIT:
            found.append(Combination(direction, sigma, at))
    return found


def interval(sigma: float, level: float = 0.95) -> float:
    """Half-width of the confidence interval."""
    return float(norm.ppf(0.5 + level / 2)) * sigma
