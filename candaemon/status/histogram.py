"""Histogram of durations in fixed buckets: constant memory over months.

prometheus_client's has no quantiles and no maximum, and would have to be loaded where no endpoint is configured.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil


@dataclass(frozen=True, slots=True)
class HistogramSnapshot:
    """What a histogram holds at one instant.

    Attributes:
        bounds: upper bound of each bucket but the last, which has none, s.
        counts: durations in each bucket; one more than bounds.
        sum: of all durations, s.
        max: the longest, s; 0 before the first.
    """

    bounds: tuple[float, ...]
    counts: tuple[int, ...]
    sum: float
    max: float

    @property
    def count(self) -> int:
        """Durations in all."""
        return sum(self.counts)

    def quantile(self, share: float) -> float | None:
        """Return the duration that a share of all do not exceed, s; None before the first.

        It is exact to the bucket it falls into; within it the durations are taken to be spread evenly.

        Args:
            share: over 0, up to 1.
        """
        rank = ceil(share * self.count)
        lower = 0.0
        for upper, inside in zip((*self.bounds, self.max), self.counts, strict=True):
            if 0 < rank <= inside:
                return min(upper - (upper - lower) * (inside - rank) / inside, self.max)
            rank -= inside
            lower = upper
        return None


class Histogram:
    """Counts durations into buckets.

    Args:
        bounds: upper bound of each bucket, s, ascending; one without bound follows.
    """

    __slots__ = ("_bounds", "_counts", "_max", "_sum")

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = tuple(bounds)
        self._counts = [0] * (len(self._bounds) + 1)
        self._sum = self._max = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration; one on a bound belongs below it."""
        self._counts[bisect_left(self._bounds, seconds)] += 1
        self._sum += seconds
        self._max = max(self._max, seconds)

    def spread(self) -> HistogramSnapshot:
        """Return what is held."""
        return HistogramSnapshot(self._bounds, tuple(self._counts), self._sum, self._max)
