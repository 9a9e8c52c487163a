"""Numbers of a table as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats

_LARGEST: Final = 1e15
"""Beyond, in units of the last decimal, a double tells no integer from its neighbour."""


def number_lines(values: Floats, decimals: int) -> bytes:
    """Return numbers (n, k) as comma-separated text, a line a row: rounded to decimals, −0 as 0, not finite as nothing.

    The text is that of Python's format `.{decimals}f`.
    """
    if compiled.in_use and np.fmax.reduce(np.abs(values), axis=None, initial=0.0) < _LARGEST / 10**decimals:
        return compiled.kernels.number_text(values, decimals)
    rounded = _rounded(values, decimals)
    row = ",".join([f"%.{decimals}f"] * values.shape[1])
    lines = text_lines([row % tuple(each) for each in rounded.tolist()])
    return lines.replace(b"nan", b"") if np.isnan(rounded).any() else lines


def text_lines(texts: Sequence[str]) -> bytes:
    """Return texts as lines."""
    return "\n".join((*texts, "")).encode()


def joined_lines(start: str, parts: list[bytes], count: int) -> bytes:
    """Return so many lines: the start, and of each part its next line, with commas between.

    Raises:
        ValueError: a part has other lines than that.
    """
    if compiled.in_use:
        return compiled.kernels.joined_lines(start.encode(), parts, count)
    cells = [part.decode().split("\n")[:-1] for part in parts]
    if any(len(lines) != count for lines in cells):
        raise ValueError("columns of different length")
    return text_lines([start + ",".join(row) for row in zip(*cells, strict=True)])


def _rounded(values: Floats, decimals: int) -> Floats:
    """Round to decimals, with −0 as 0 and non-finite values as NaN."""
    with np.errstate(over="ignore"):  # scaled for rounding, a value near the largest double is none any more
        rounded: Floats = values.round(decimals)
    np.copyto(rounded, values, where=np.isinf(rounded))
    rounded += 0.0
    rounded[~np.isfinite(rounded)] = np.nan
    return rounded
