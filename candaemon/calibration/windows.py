"""The windows of a sensor together: an estimate whose uncertainty is what the windows themselves differ by.

Within a window noise is correlated: a radar's own filter makes it slow, all returns share an error of ego motion. So
the number of measurements says little of how well the parameters are known. Each window votes with its normal
equations; the scatter of the votes gives the covariance (a sandwich estimate with a window as the cluster), and a
window whose vote is far off counts less.

What the ego's speed is off lasts for several windows; it is estimated with the rest, one value a
window, as a first-order Gauss-Markov process.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import radians
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.calibration.parameters import (
    BIAS,
    COLUMNS,
    COUNT,
    LARGEST_YAW,
    LATENCY,
    LONGEST_LATENCY,
    OFFSET,
    SIGHT,
    SIGHT_SD,
    YAW,
    EgoNoise,
    Estimate,
)
from candaemon.calibration.window import WindowEquations

MOST_WINDOWS: Final = 60
"""Windows of a sensor that are kept; of more, the older half becomes the prior."""

_PRIOR_WINDOWS: Final = 3.0
"""Windows that the prior of the overdispersion counts for."""
_PRIOR_DISPERSION: Final = 16.0
"""Variance of a window's vote, times what white noise would make it, as long as few have voted."""
_HUBER: Final = 2.0
"""Standard deviations of a window's vote from which on it counts less."""
REACH: Final = np.array([0.03, radians(1.5)])
"""s and rad: equations made so far from the estimate count half, for they are linear about another one."""
_FLOOR: Final = np.array([0.003, radians(0.09), 0.001, radians(0.03)])
"""One standard deviation of what no scatter shows: reflections that wander together, rounding, a bent mounting."""
_AGING: Final = np.array([0.002, radians(0.05), 0.002, radians(0.1)])
"""One standard deviation by which the parameters drift in an hour."""
_HOUR: Final = 3600.0
_MEMORY: Final = 10.0
"""s, for which the error of the ego's speed lasts."""
_ITERATIONS: Final = 3


@dataclass(slots=True)
class WindowsState:
    """What the windows of one sensor have shown.

    Attributes:
        mean: of the prior (4,).
        covariance: of the prior (4, 4).
        information: of the latest windows (k, 5, 5).
        score: of them (k, 5).
        at: where they are linear (k, 4).
        seconds: when they were, s (k,).
        measurements: in all windows so far.
        windows: so far.
    """

    mean: Floats
    covariance: Floats
    information: Floats = field(default_factory=lambda: np.zeros((0, COLUMNS, COLUMNS)))
    score: Floats = field(default_factory=lambda: np.zeros((0, COLUMNS)))
    at: Floats = field(default_factory=lambda: np.zeros((0, COUNT)))
    seconds: Floats = field(default_factory=lambda: np.zeros(0))
    measurements: int = 0
    windows: int = 0

    def validate(self) -> None:
        """Refuse windows that do not fit together.

        Raises:
            ValueError: they do not, there are too many, or a covariance is none.
        """
        count = len(self.information)
        if count > MOST_WINDOWS or not count == len(self.score) == len(self.at) == len(self.seconds):
            raise ValueError(f"{count} windows of calibration, expected {MOST_WINDOWS} at most, each whole")
        if self.information.shape[1:] != (COLUMNS, COLUMNS) or self.score.shape[1:] != (COLUMNS,):
            raise ValueError("a window of calibration of other parameters")
        if not is_covariance(self.covariance):
            raise ValueError("a covariance of calibration that is not positive")
        largest = np.abs(self.information).max(axis=(1, 2), initial=1e-12)
        if count and (np.linalg.eigvalsh(self.information).min(axis=1) < -1e-6 * largest).any():
            raise ValueError("a window of calibration whose information is not positive")


def is_covariance(matrix: Floats) -> bool:
    """Return whether a matrix is that of a Gaussian estimate of the parameters, in any units."""
    unit = matrix.diagonal() if matrix.shape == (COUNT, COUNT) else np.zeros(COUNT)
    if not (unit > 0.0).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
        return False
    scaled = matrix / np.sqrt(np.outer(unit, unit))
    return bool(np.linalg.eigvalsh(scaled).min() > 1e-9)


def added(
    state: WindowsState, equations: WindowEquations, at: Estimate, seconds: float, noise: EgoNoise
) -> WindowsState:
    """Return the windows with one more; the older half becomes the prior where there are too many.

    Args:
        state: of the sensor.
        equations: of the window.
        at: where they are linear.
        seconds: when the window was.
        noise: of ego motion.
    """
    before = _retired(state, noise) if len(state.information) == MOST_WINDOWS else state
    information, score = _without_own_errors(equations, noise)
    return WindowsState(
        before.mean,
        before.covariance,
        np.concatenate([before.information, information[None]]),
        np.concatenate([before.score, score[None]]),
        np.concatenate([before.at, at.mean[None]]),
        np.append(before.seconds, seconds),
        before.measurements + equations.measurements,
        before.windows + 1,
    )


def age(state: WindowsState, seconds: float) -> None:
    """Let what the prior says grow uncertain over a time."""
    state.covariance = state.covariance + np.diag(_AGING**2) * (seconds / _HOUR)


def estimate(state: WindowsState, noise: EgoNoise) -> Estimate:
    """Return the estimate of all windows and the prior together."""
    count = len(state.information)
    floor = np.diag(np.minimum(_FLOOR**2, state.covariance.diagonal()))
    if not count:
        return Estimate(state.mean.copy(), state.covariance + floor)
    unit = np.append(np.sqrt(state.covariance.diagonal()), noise.speed)  # all in standard deviations of the prior
    information = state.information * np.outer(unit, unit)
    score, at = state.score * unit, (state.at - state.mean) / unit[:COUNT]
    votes = score + np.einsum("wij,wj->wi", information[:, :, :COUNT], at)
    prior = np.zeros((COUNT + count, COUNT + count))
    prior[:COUNT, :COUNT] = np.linalg.inv(state.covariance / np.outer(unit[:COUNT], unit[:COUNT]))
    prior[COUNT:, COUNT:] = _process(state.seconds)
    reach = REACH / unit[[LATENCY, YAW]]
    place = np.empty((count, COLUMNS), np.int64)  # where the unknowns of a window stand among all
    place[:, :COUNT], place[:, OFFSET] = np.arange(COUNT), COUNT + np.arange(count)
    freedom = _freedom(information)
    weight, dispersion = np.ones(count), _PRIOR_DISPERSION
    for _ in range(_ITERATIONS):
        precision, total = prior.copy(), np.zeros(COUNT + count)
        np.add.at(precision, (place[:, :, None], place[:, None, :]), information * (weight / dispersion)[:, None, None])
        np.add.at(total, place, votes * (weight / dispersion)[:, None])
        model = np.linalg.inv(precision)
        mean = model @ total
        rest = votes - np.einsum("wij,wj->wi", information, mean[place])
        fading = 1.0 / (1.0 + np.sum(((at - mean[:COUNT])[:, [LATENCY, YAW]] / reach) ** 2, axis=1))
        ratio = _distance(information, rest) / np.maximum(freedom, 1e-9)
        capped = fading * freedom * np.minimum(ratio, 2.0 * _HUBER**2 * dispersion)
        weighted = fading @ freedom + _PRIOR_WINDOWS * COUNT
        dispersion = max((capped.sum() + _PRIOR_WINDOWS * COUNT * _PRIOR_DISPERSION) / weighted, 1.0)
        weight = fading * np.minimum(1.0, _HUBER / np.sqrt(np.maximum(ratio / dispersion, 1e-9)))
    covariance = model[:COUNT, :COUNT]
    if count > COUNT:
        pulls = np.zeros((COUNT + count, count))
        pulls[place, np.arange(count)[:, None]] = rest * (weight / dispersion)[:, None]
        pulled = model[:COUNT] @ pulls
        of_prior = model[:COUNT] @ prior @ model[:, :COUNT]
        scatter = of_prior + pulled @ pulled.T * (count / (count - COUNT))
        larger = np.sqrt(np.maximum(scatter.diagonal() / covariance.diagonal(), 1.0))
        covariance = covariance * np.outer(larger, larger)
    covariance = covariance * np.outer(unit[:COUNT], unit[:COUNT]) + floor
    limited = state.mean + mean[:COUNT] * unit[:COUNT]
    limited[LATENCY] = min(max(limited[LATENCY], -LONGEST_LATENCY), LONGEST_LATENCY)
    limited[YAW] = min(max(limited[YAW], -LARGEST_YAW), LARGEST_YAW)
    return Estimate(limited, (covariance + covariance.T) / 2)


def _without_own_errors(equations: WindowEquations, noise: EgoNoise) -> tuple[Floats, Floats]:
    """Return equations from which what is off in this window alone is eliminated: yaw rate and lines of sight."""
    information, score = equations.information, equations.score
    for column, deviation in ((BIAS, noise.turn), (SIGHT, SIGHT_SD)):
        share = information[:, column] / (information[column, column] + deviation**-2)
        information, score = information - np.outer(share, information[column]), score - share * score[column]
    return information[:COLUMNS, :COLUMNS], score[:COLUMNS]


def _process(seconds: Floats) -> Floats:
    """Return the precision of a first-order Gauss-Markov process of variance 1 at some times, (k, k)."""
    keep = np.minimum(np.exp(-np.abs(np.diff(seconds)) / _MEMORY), 1.0 - 1e-6)
    fresh = 1.0 / (1.0 - keep**2)
    diagonal = np.ones(len(seconds))
    diagonal[1:] = fresh
    diagonal[:-1] += keep**2 * fresh
    beside = -keep * fresh
    return np.asarray(np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))


def _freedom(information: Floats) -> Floats:
    """Return for how many degrees of freedom each window votes."""
    return np.asarray(np.trace(np.linalg.solve(information + np.eye(COLUMNS), information), axis1=1, axis2=2))


def _distance(information: Floats, rest: Floats) -> Floats:
    """Return how far off each window's vote is, squared."""
    solved = np.linalg.solve(information + np.eye(COLUMNS), rest[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("wi,wi->w", rest, solved))


def _retired(state: WindowsState, noise: EgoNoise) -> WindowsState:
    """Return the newer half of the windows; the older one is the prior, as uncertain as it says that it is."""
    half = len(state.information) // 2
    old, new = (
        WindowsState(
            state.mean,
            state.covariance,
            state.information[part],
            state.score[part],
            state.at[part],
            state.seconds[part],
            state.measurements,
            state.windows,
        )
        for part in (slice(None, half), slice(half, None))
    )
    found = estimate(old, noise)
    return replace(new, mean=found.mean, covariance=found.covariance)
