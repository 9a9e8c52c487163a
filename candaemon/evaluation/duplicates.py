"""Duplicate obstacles: several tracks of one physical object."""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats
from candaemon.tracking.reflections import near_pairs


def duplicated(
    x: Floats, y: Floats, vx: Floats, *, along: float = 3.0, across: float = 1.0, speed: float = 1.0
) -> Booleans:
    """Return which of a cycle's obstacles have another one close by at a similar speed, shape (n,).

    Args:
        x: m forward, shape (n,).
        y: m to the left, shape (n,).
        vx: m/s over ground, forward, shape (n,).
        along: greatest distance in x, m.
        across: greatest distance in y, m.
        speed: greatest difference in vx, m/s. The lateral velocity of a radar track is too uncertain to be compared.
    """
    if compiled.in_use:
        return compiled.kernels.duplicated(x, y, vx, along, across, speed)
    later, earlier = near_pairs(x, y, np.nextafter(max(along, across), np.inf))
    close = np.abs(x[later] - x[earlier]) <= along
    close &= np.abs(y[later] - y[earlier]) <= across
    close &= np.abs(vx[later] - vx[earlier]) <= speed
    alike = np.zeros(len(x), dtype=np.bool_)
    alike[later[close]] = alike[earlier[close]] = True
    return alike


class DuplicateScore:
    """Share of obstacle samples that have a duplicate, over many cycles.

    Attributes:
        samples: obstacle samples counted so far.
        duplicates: those of them for which `duplicated` is true.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.duplicates = 0

    def add(self, x: Floats, y: Floats, vx: Floats) -> None:
        """Count one cycle's confirmed obstacles, each array of shape (n,)."""
        self.samples += len(x)
        self.duplicates += int(duplicated(x, y, vx).sum())

    @property
    def share(self) -> float:
        """Share of samples with a duplicate; 0 without samples."""
        return self.duplicates / self.samples if self.samples else 0.0
