"""Numbers of a table as text."""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation import compiled

_LARGEST: Final = 1e15
"""Beyond, in units of the last decimal, a double tells no integer from its neighbour."""


def number_rows(values: Floats, decimals: int) -> list[str]:
    """Return each row of numbers (n, k) as comma-separated text: rounded to decimals, −0 as 0, not finite as nothing.

    The text is that of Python's format `.{decimals}f`.
    """
    if compiled.in_use and np.fmax.reduce(np.abs(values), axis=None, initial=0.0) < _LARGEST / 10**decimals:
        return compiled.kernels.number_text(values, decimals).decode().split("\n")[:-1]
    rounded = _rounded(values, decimals)
    row = ",".join([f"%.{decimals}f"] * values.shape[1])
    lines = [row % tuple(each) for each in rounded.tolist()]
    return [line.replace("nan", "") for line in lines] if np.isnan(rounded).any() else lines


def _rounded(values: Floats, decimals: int) -> Floats:
    """Round to decimals, with −0 as 0 and non-finite values as NaN."""
    with np.errstate(over="ignore"):  # scaled for rounding, a value near the largest double is none any more
        rounded: Floats = values.round(decimals)
    np.copyto(rounded, values, where=np.isinf(rounded))
    rounded += 0.0
    rounded[~np.isfinite(rounded)] = np.nan
    return rounded
