"""Quantiles of the χ² distribution, which normalised squared errors of a consistent filter follow."""

from __future__ import annotations

from functools import lru_cache


@lru_cache(maxsize=256)
def chi2_quantile(share: float, dof: float) -> float:
    """Return the value below which a χ² variate of `dof` degrees of freedom lies with probability `share`."""
    from scipy.special import gammaincinv  # noqa: PLC0415 # a live service scores nothing and shall not load scipy

    return 2.0 * float(gammaincinv(dof / 2.0, share))
