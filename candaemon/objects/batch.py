"""Objects as they were read: a structure of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Floats, Integers


@dataclass(frozen=True, slots=True)
class ObjectBatch:
    """Objects of one scan, a structure of arrays of length n.

    Attributes:
        identity: the identity signal's value, −1 where the format has none.
        valid: whether all conditions hold and every required message came.
        new: whether the object is new in its slot.
        paired: whether the pair signals are equal.
        values: (quantities, n), SI, sensor axes, rows as `ObjectReader.quantities`; NaN where a message did not come.
        not_finite: whether it would be valid, but that a value is no number; None where each one is a number.

    """

    identity: Integers
    valid: Booleans
    new: Booleans
    paired: Booleans
    values: Floats
    not_finite: Booleans | None = None

    def part(self, rows: slice) -> ObjectBatch:
        """Return some of the objects."""
        not_finite = None if self.not_finite is None else self.not_finite[rows]
        return ObjectBatch(
            self.identity[rows], self.valid[rows], self.new[rows], self.paired[rows], self.values[:, rows], not_finite
        )


@lru_cache
def same(value: int, n: int) -> npt.NDArray[Any]:
    """Make an array (n,) of one value; made once, so not to be written to."""
    array = np.full(n, value)
    array.flags.writeable = False
    return array


def every(tested: Sequence[Booleans], n: int) -> Booleans:
    """Tell for which of n objects all tests passed; the first test's array may be used for it."""
    if not tested:
        return same(True, n)
    first, *others = tested
    for each in others:
        first &= each
    return first
