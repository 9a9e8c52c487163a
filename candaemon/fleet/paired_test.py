"""Whether the same drives differ between two runs by more than chance: permutation of signs, Holm's correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import floor, log2, sqrt
from typing import Final

import numpy as np

from candaemon.arrays import Floats

EXACT_UP_TO: Final = 14
"""Pairs up to which all permutations are tried."""
PERMUTATIONS: Final = 50_000
"""Random permutations of more pairs."""
_AT_ONCE: Final = 2_000_000
_SEED: Final = 20180802
_SAME: Final = 1e-12


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """How paired values differ.

    Attributes:
        pairs: their number.
        mean: of the differences.
        low, high: 95 % confidence interval of the mean difference, by Student's t; NaN for one pair.
        p: probability of a mean as far from zero, either way, if signs were chance.
    """

    pairs: int
    mean: float
    low: float
    high: float
    p: float


def paired_difference(differences: Floats) -> PairedDifference:
    """Test whether the mean of paired differences is zero.

    Under the hypothesis that two runs do not differ each difference is as likely with the other sign (Fisher 1935,
    ch. 21).
    All signs are tried up to `EXACT_UP_TO` pairs, else `PERMUTATIONS` random ones, the same each time.

    Args:
        differences: one a pair.
    """
    n = len(differences)
    mean = float(differences.mean())
    low, high = mean_interval(differences)
    size = np.abs(differences).max(initial=0.0)
    if size == 0.0:
        return PairedDifference(n, mean, low, high, 1.0)
    scaled = differences / size
    limit = abs(float(scaled.sum())) * (1.0 - _SAME) - _SAME
    if n <= EXACT_UP_TO:
        signs = np.array(list(product((1.0, -1.0), repeat=n)))
        p = float(np.mean(np.abs(signs @ scaled) >= limit))
    else:
        chance = np.random.default_rng(_SEED)
        beyond, left = 0, PERMUTATIONS
        while left:
            rows = min(left, max(_AT_ONCE // n, 1))
            signs = chance.integers(0, 2, (rows, n), dtype=np.int8) * 2.0 - 1.0
            beyond += int(np.count_nonzero(np.abs(signs @ scaled) >= limit))
            left -= rows
        p = (beyond + 1) / (PERMUTATIONS + 1)
    return PairedDifference(n, mean, low, high, p)


def fewest_pairs(figures: int, level: float) -> int:
    """Return how many pairs it takes that a difference of one sign in all of them is more than chance.

    Args:
        figures: that are tested together, at least one.
        level: probability below which that is so, corrected for their number.
    """
    return floor(log2(2 * figures / level)) + 1


def mean_interval(values: Floats) -> tuple[float, float]:
    """Return the 95 % confidence interval of a mean, by Student's t; NaN for a single value."""
    from scipy.stats import t  # noqa: PLC0415 - slow to import, and workers do without

    n = len(values)
    if n < 2:
        return float("nan"), float("nan")
    half = float(t.ppf(0.975, n - 1)) * float(values.std(ddof=1)) / sqrt(n)
    mean = float(values.mean())
    return mean - half, mean + half


def holm(probabilities: Sequence[float]) -> list[float]:
    """Return probabilities corrected for their number (Holm 1979): the family's errors stay below the level."""
    corrected, largest = [0.0] * len(probabilities), 0.0
    for rank, k in enumerate(sorted(range(len(probabilities)), key=probabilities.__getitem__)):
        largest = max(largest, min(probabilities[k] * (len(probabilities) - rank), 1.0))
        corrected[k] = largest
    return corrected
