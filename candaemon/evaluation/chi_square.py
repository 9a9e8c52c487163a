"""Quantiles of the χ² distribution, which normalised squared errors of a consistent filter follow."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

_TABLE: Final[Mapping[tuple[float, float], float]] = {
    (0.95, 1): 3.841458820694124,
    (0.95, 2): 5.991464547107979,
    (0.95, 3): 7.814727903251179,
    (0.95, 4): 9.487729036781154,
}
"""Those of one innovation, as scipy gives them: its import takes longer than many a drive."""


@lru_cache(maxsize=256)
def chi2_quantile(share: float, dof: float) -> float:
    """Return the value below which a χ² variate of `dof` degrees of freedom lies with probability `share`."""
    if (share, dof) in _TABLE:
        return _TABLE[share, dof]
    from scipy.special import gammaincinv  # noqa: PLC0415 # a live service scores nothing and shall not load scipy

    return 2.0 * float(gammaincinv(dof / 2.0, share))
