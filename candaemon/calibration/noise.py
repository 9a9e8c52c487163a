"""The noise of a sensor's quantities, from how residuals of standing returns differ over time.

With white noise of variance w, and a part of variance c that lasts for a time T, two residuals of one return that lie τ
apart differ by D(τ) = 2 w + 2 c (1 − exp(−τ / T)) in the mean square. For T far beyond τ that is 2 w + q τ, a random
walk of density q = 2 c / T. Differences need no truth: what a return's residuals share drops out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from candaemon.arrays import Floats, Indices, Integers

_LONGEST: Final = 0.85
"""s between two residuals that are compared: a window is little longer."""
MOST_LAGS: Final = 40
_TIMES: Final = (0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 2.0, 5.0)
"""s, correlation times that are tried."""
WALK_TIME: Final = 0.45
"""s, correlation time beyond which a window cannot tell a correlated part from a walk, and it is taken for one."""
_BLOCKS: Final = 10
"""Parts of the drive, each of which is left out once to see how much depends on it."""
_OUTLIER: Final = 4.0
"""Standard deviations."""
_MEDIAN: Final = 0.4549
"""Of the square of a standard normal variable."""
_FEWEST: Final = 300
"""Differences from scan to scan, from which on a noise is known."""
_FEWEST_WINDOWS: Final = 6
_LEAST_GAIN: Final = 25.0
"""Reduction of the weighted squared error for which a correlated part is believed: five standard deviations."""


@dataclass(frozen=True, slots=True)
class NoiseParts:
    """Noise of a quantity.

    Attributes:
        white: standard deviation of the white part.
        slow: standard deviation of the correlated part; 0 where there is none, or a walk.
        time: s, for which the correlated part lasts; 0 where there is none.
        walk: density of the random walk, unit²/s; 0 where there is none.
        white_sd: one standard deviation of the white part.
        slow_sd: likewise of the correlated part.
        walk_sd: likewise of the walk.
        samples: differences from scan to scan.
    """

    white: float
    slow: float
    time: float
    walk: float
    white_sd: float
    slow_sd: float
    walk_sd: float
    samples: int

    @property
    def deviation(self) -> float:
        """Standard deviation of the white and the correlated part together, without the walk."""
        return float(np.hypot(self.white, self.slow))

    def over(self, seconds: float) -> float:
        """Return the standard deviation of what a filter without a walk sees that averages for so long, s."""
        return float(np.sqrt(self.deviation**2 + self.walk * seconds))

    def uncertainty(self, seconds: float) -> float:
        """Return one standard deviation of `over`."""
        squared = (self.white * self.white_sd) ** 2 + (self.slow * self.slow_sd) ** 2
        squared += (seconds * self.walk_sd / 2) ** 2
        return float(np.sqrt(squared) / max(self.over(seconds), 1e-9))


@dataclass(frozen=True, slots=True)
class ResidualPairs:
    """Pairs of measurements of one return within a window, in the order of the number of scans between.

    Attributes:
        earlier, later: rows of the measurements (pairs,).
        bounds: the pairs with k scans between are those from bounds[k − 1] to bounds[k]; of each k from 1 on.
    """

    earlier: Indices
    later: Indices
    bounds: list[int]


def residual_pairs(cycle: float, scan: Indices, first: Integers, count: Integers) -> ResidualPairs:
    """Return the pairs of n measurements, sorted by return and scan, that are compared.

    Args:
        cycle: s between scans.
        scan: number of the scan of each (n,).
        first: row of each return's first (k,).
        count: measurements of each (k,).
    """
    lags = max(min(int(_LONGEST / cycle), MOST_LAGS), 1)
    track = np.repeat(np.arange(len(first)), count)
    found = [np.empty((3, 0), np.int64)]
    for step in range(1, min(lags, int(count.max(initial=1)) - 1) + 1):
        same = np.flatnonzero(track[step:] == track[:-step])
        apart = scan[same + step] - scan[same]
        near = apart <= min(step + 2, lags)  # a scan or two may be missing between
        found.append(np.stack([apart[near], same[near], same[near] + step]))
    apart, earlier, later = np.concatenate(found, axis=1)
    order = np.argsort(apart, kind="stable")
    return ResidualPairs(earlier[order], later[order], np.searchsorted(apart[order], np.arange(1, lags + 2)).tolist())


@dataclass(slots=True)
class NoiseSamples:
    """Squared differences of one quantity's residuals, window by window.

    Attributes:
        cycle: s between scans.
        squares: of each window, by the number of scans between, from 1 on.
    """

    cycle: float
    squares: list[list[Floats]] = field(default_factory=list)

    def add(self, squares: Floats, bounds: list[int]) -> None:
        """Take the squared differences of a window's pairs in.

        Args:
            squares: of the pairs (pairs,); NaN where one is not known.
            bounds: of the pairs.
        """
        parts = [squares[begin:end] for begin, end in pairwise(bounds)]
        self.squares.append([each[np.isfinite(each)] for each in parts])


def noise_parts(samples: NoiseSamples, like: NoiseParts | None = None) -> NoiseParts | None:
    """Return the noise that explains the differences; None where there are too few.

    Args:
        samples: the differences.
        like: what was found of the same errors in other axes: whether they walk or last for a time, these do likewise,
            unless that explains them clearly worse; None: nothing.
    """
    windows = [each for each in samples.squares if len(each[0])]
    first = sum(len(each[0]) for each in windows)
    if first < _FEWEST or len(windows) < _FEWEST_WINDOWS:
        return None
    lags = min(len(each) for each in windows)
    limits = [_limit([each[lag] for each in windows]) for lag in range(lags)]
    sums = np.array([[each[lag][each[lag] <= limits[lag]].sum() for lag in range(lags)] for each in windows])
    counts = np.array([[np.count_nonzero(each[lag] <= limits[lag]) for lag in range(lags)] for each in windows])
    block = np.arange(len(windows)) * _BLOCKS // len(windows)
    tau = samples.cycle * np.arange(1, lags + 1)
    parts = [_means(sums[block != k], counts[block != k]) for k in np.unique(block)]
    spread = _jackknife(np.array(parts))
    whole = _means(sums, counts)
    usable = (counts.sum(axis=0) >= _FEWEST / 10) & (spread > 0.0)
    usable[0] = True
    weight = 1.0 / np.maximum(spread, 0.01 * whole + 1e-12)
    time = _time(whole[usable], tau[usable], weight[usable], like)
    fits = np.array([_fit(each[usable], tau[usable], weight[usable], time)[:2] for each in parts])
    white, slow = _fit(whole[usable], tau[usable], weight[usable], time)[:2]
    deviations = np.sqrt(np.maximum(fits, 0.0))
    white_sd, slow_sd = _jackknife(deviations)
    is_walk = time > WALK_TIME
    return NoiseParts(
        white=float(np.sqrt(white)),
        slow=0.0 if is_walk else float(np.sqrt(slow)),
        time=0.0 if is_walk else time,
        walk=float(2.0 * slow / time) if is_walk else 0.0,
        white_sd=float(white_sd),
        slow_sd=0.0 if is_walk else float(slow_sd),
        walk_sd=float(_jackknife(2.0 * fits[:, 1] / time)) if is_walk else 0.0,
        samples=first,
    )


def _limit(squares: list[Floats]) -> float:
    """Return the square above which a difference is none of noise."""
    together = np.concatenate(squares)
    return float(_OUTLIER**2 * np.median(together) / _MEDIAN) if len(together) else 0.0


def _means(sums: Floats, counts: Integers) -> Floats:
    return np.asarray(sums.sum(axis=0) / np.maximum(counts.sum(axis=0), 1))


def _jackknife(without: Floats) -> Floats:
    """Return one standard deviation of what was found without each part in turn (parts, …)."""
    count = len(without)
    return np.asarray(np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0)))


def _time(squares: Floats, tau: Floats, weight: Floats, like: NoiseParts | None) -> float:
    """Return for how long the correlated part lasts; 0 where white noise explains all."""
    errors = {time: _fit(squares, tau, weight, time)[2] for time in (0.0, *_TIMES)}
    best = min(_TIMES, key=lambda time: errors[time])
    if len(tau) <= 2 or errors[0.0] - errors[best] <= _LEAST_GAIN:
        return 0.0
    if like is not None:
        alike = [time for time in _TIMES if (time > WALK_TIME) == (like.walk > 0.0)]
        most_alike = min(alike, key=lambda time: errors[time])
        best = most_alike if errors[most_alike] - errors[best] <= _LEAST_GAIN else best
    return best if best <= WALK_TIME else _TIMES[-1]


def _fit(squares: Floats, tau: Floats, weight: Floats, time: float) -> tuple[float, float, float]:
    """Return the variances of both parts, and the weighted squared error, for a correlation time; 0: all white."""
    columns = [2.0 * np.ones(len(tau))]
    if time > 0.0:
        columns.append(2.0 * (1.0 - np.exp(-tau / time)))
    design = np.stack(columns, axis=1) * weight[:, None]
    found = np.linalg.lstsq(design, squares * weight, rcond=None)[0]
    if (found < 0.0).any():  # one part explains all
        alone = [max(float(column @ (squares * weight) / (column @ column)), 0.0) for column in design.T]
        errors = [float(((design[:, k] * each - squares * weight) ** 2).sum()) for k, each in enumerate(alone)]
        chosen = int(np.argmin(errors))
        found = np.zeros(design.shape[1])
        found[chosen] = alone[chosen]
    error = float(((design @ found - squares * weight) ** 2).sum())
    return float(found[0]), float(found[1]) if len(found) > 1 else 0.0, error
