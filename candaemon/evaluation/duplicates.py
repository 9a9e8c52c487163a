"""Obstacles that are one thing twice."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats


def duplicated(
    x: Floats, y: Floats, vx: Floats, *, along: float = 3.0, across: float = 1.0, speed: float = 1.0
) -> Booleans:
    """Tell which of a cycle's obstacles have another one close by that moves alike, shape (n,).

    Args:
        x: m forward, shape (n,).
        y: m to the left, shape (n,).
        vx: m/s over ground, forward, shape (n,).
        along: how close in x, m.
        across: how close in y, m.
        speed: how alike in vx, m/s. Lateral velocity is the least certain number of a radar track and is not asked.
    """
    close: Booleans = np.abs(x[:, None] - x) <= along
    close &= np.abs(y[:, None] - y) <= across
    close &= np.abs(vx[:, None] - vx) <= speed
    # each is close to itself
    alike: Booleans = np.count_nonzero(close, axis=1) > 1
    return alike


class DuplicateScore:
    """Share of obstacle samples that have a duplicate, over many cycles.

    Attributes:
        samples: obstacle samples taken in.
        duplicates: those with another one close by, as `duplicated` tells.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.duplicates = 0

    def add(self, x: Floats, y: Floats, vx: Floats) -> None:
        """Take in one cycle's confirmed obstacles, each array of shape (n,)."""
        self.samples += len(x)
        self.duplicates += int(duplicated(x, y, vx).sum())

    @property
    def share(self) -> float:
        """Share of samples with a duplicate; 0 without samples."""
        return self.duplicates / self.samples if self.samples else 0.0
