"""The objects of one scan as they were read: a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass

from candaemon.arrays import Booleans, Floats, Integers


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class ObjectBatch:
    """Objects of one scan, a structure of arrays of length n.

    Attributes:
        identity: the identity signal's value, −1 where the format has none.
        valid: whether all conditions hold and every required message came.
        new: whether the object is new in its slot.
        paired: whether the pair signals are equal.
        values: (quantities, n), SI, sensor axes, rows as `ObjectReader.quantities`; NaN where a message did not come.
        not_finite: whether it would be valid, but that a value is no number; None where each one is a number.
        at_end: whether its place is at an end of its signal, or anywhere beyond; None where none is.

    """

    identity: Integers
    valid: Booleans
    new: Booleans
    paired: Booleans
    values: Floats
    not_finite: Booleans | None = None
    at_end: Booleans | None = None

    def part(self, rows: slice) -> ObjectBatch:
        """Return some of the objects."""
        not_finite = None if self.not_finite is None else self.not_finite[rows]
        at_end = None if self.at_end is None else self.at_end[rows]
        return ObjectBatch(
            self.identity[rows],
            self.valid[rows],
            self.new[rows],
            self.paired[rows],
            self.values[:, rows],
            not_finite,
            at_end,
        )
