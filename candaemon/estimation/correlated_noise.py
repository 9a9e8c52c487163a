"""What detections count for whose errors last longer than a scan.

A radar smooths what it measures, and so its errors are alike from scan to scan for some tenths of a second. A Kalman
filter takes those of each scan for new ones: the more often a radar measures, the surer it becomes, of errors too.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from candaemon.arrays import Floats

_MOST_SCANS = 64  # apart, from which on the factor is that of so many


def inflations(share: float, time: float, cycle_time: float, memory: float) -> Floats:
    """Return by how much variances are to be multiplied for a filter that takes errors for white, by scans apart.

    The mean of n errors of variance σ² and of correlations ρ, ρ², … from one to the next has the variance

        σ² / n · (1 + 2 ρ / (1 − ρ) · (1 − (1 − ρⁿ) / (n (1 − ρ)))),

    where white ones have σ² / n (Bayley and Hammersley 1946: the effective number of independent observations). n is
    that within the memory of a filter: over a longer time no filter averages, since what it tracks manoeuvres.

    Args:
        share: of the variance that is correlated, 0 to 1.
        time: correlation time of that, s.
        cycle_time: between two scans, s.
        memory: of the filter, s.

    Returns:
        The factor for detections that come 0, 1, 2 … scans after the ones before (k,); 0 counts as 1.
    """
    return np.asarray((1.0 - share) + share * _of_correlated(time, cycle_time, memory))


@lru_cache(maxsize=64)
def _of_correlated(time: float, cycle_time: float, memory: float) -> Floats:
    """Return the factors of errors that are wholly correlated (k,)."""
    interval = cycle_time * np.maximum(np.arange(_MOST_SCANS + 1), 1)
    n = np.maximum(memory / interval, 1.0)
    lost = -np.expm1(-interval / time)
    keep = 1.0 - lost
    found: Floats = 1.0 + 2.0 * keep / lost * (1.0 - (1.0 - keep**n) / (n * lost))
    found.flags.writeable = False
    return found
