"""False objects that move with true ones: echoes that went twice between both vehicles, or by way of a guard rail."""

from __future__ import annotations

import math

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Indices
from candaemon.simulation.effects import GhostEffects
from candaemon.simulation.scene import Points, Scene

_BESIDE = 12.0
"""m from a rail, within which it mirrors a vehicle."""


class Ghosts:
    """Which actors have a ghost, of either kind, scan by scan.

    Args:
        scene: the actors and rails.
        settings: of the effect.
        cycle: s between scans.
        random: generator to draw from.

    Attributes:
        present: by double bounce and by a rail, shape (2, actors).
        born: which of them have just come, shape (2, actors).

    """

    def __init__(self, scene: Scene, settings: GhostEffects, cycle: float, random: np.random.Generator) -> None:
        self._rails, self._random = scene.rails, random
        self.reach = settings.reach
        rates = np.array([[settings.double_bounce], [settings.mirrored]])
        self._begins, self._ends = 1.0 - np.exp(-cycle * rates), 1.0 - math.exp(-cycle / settings.time)
        self.present: Booleans = np.zeros((2, len(scene.actors)), dtype=bool)
        self.born: Booleans = self.present

    def advance(self) -> None:
        """Move on by one scan."""
        chance = self._random.random(self.present.shape)
        self.born = ~self.present & (chance < self._begins)
        self.present = self.born | (self.present & (chance >= self._ends))

    def mirrored(self, points: Points) -> tuple[Indices, Points]:
        """Return which of some points (local axes) have a rail beside them, and the mirror images of those."""
        if not len(self._rails) or not len(points.position):
            none = np.empty(0, dtype=np.complex128)
            return np.empty(0, dtype=np.int64), Points(none, none, none)
        begin, along = self._rails[:, 0], self._rails[:, 1] - self._rails[:, 0]
        direction = along / np.maximum(np.abs(along), 1e-9)
        local = (points.position[:, None] - begin) * np.conj(direction)
        beside = (local.real >= 0.0) & (local.real <= np.abs(along)) & (np.abs(local.imag) < _BESIDE)
        rail = np.argmin(np.where(beside, np.abs(local.imag), np.inf), axis=1)
        row = np.flatnonzero(beside.any(axis=1))
        turn, origin = direction[rail[row]], begin[rail[row]]

        def image(vectors: ComplexPlane) -> ComplexPlane:
            return np.asarray(turn * np.conj(vectors * np.conj(turn)))

        return row, Points(
            origin + image(points.position[row] - origin),
            image(points.velocity[row]),
            image(points.acceleration[row]),
        )
