"""Reflections of bodies in traffic: points on the outline that come, go, slide, merge and are given up for others."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Integers
from candaemon.simulation.effects import ReflectionEffects
from candaemon.simulation.scenario import Actor
from candaemon.simulation.scene import Scene

_CORNERS = np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j])
_WITHIN = 0.97
"""Of half the apparent width: a ray farther out might miss the body."""
_FIRST_WITHIN = 0.4
"""Of half the apparent width, where the first reflection is at most: the middle returns most."""
_PARTING = 1.5
"""Times the distance at which two reflections merge: from there on they part."""


class LivingReflections:
    """The reflection points of all actors, numbered actor by actor; one that comes again is another one.

    Args:
        scene: the actors.
        settings: of the effects.
        cycle: s between scans.
        random: generator to draw from.

    Attributes:
        actor, order: as `VisibleReflections` has them, shape (n,).
        reach: greatest range at which it is visible, m, shape (n,); of the second one that of the actor's settings.
        first: index of the first reflection of each actor, shape (actors,).
        present: which are there, shape (n,).
        born: which have become another one with the latest step, shape (n,).

    """

    def __init__(self, scene: Scene, settings: ReflectionEffects, cycle: float, random: np.random.Generator) -> None:
        self._settings, self._random = settings, random
        counts = [_drawn_count(actor, settings, random) for actor in scene.actors]
        self.actor: Integers = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
        self.order: Integers = np.array([k for count in counts for k in range(count)], dtype=np.int64)
        self.first: Integers = np.flatnonzero(self.order == 0)
        reach = np.array([actor.reflections_range for actor in scene.actors], dtype=np.float64)
        self.reach: Floats = np.where(self.order == 0, np.inf, 2 * reach[self.actor] / (self.order + 1))
        self._half = np.stack([scene.half_length, scene.half_width], axis=1)[self.actor]
        self._box = self._half[:, :1] * _CORNERS.real + 1j * self._half[:, 1:] * _CORNERS.imag
        n = len(self.actor)
        later = self.order > 0
        self._ends = 1.0 - np.exp(-cycle / np.where(later, settings.shown, settings.renewal))
        self._begins = 1.0 - math.exp(-cycle / settings.gone)
        self._keep = math.exp(-cycle / settings.slide_time)
        self.present: Booleans = ~later | (random.random(n) < settings.shown / (settings.shown + settings.gone))
        self.born: Booleans = np.ones(n, dtype=bool)
        self._slide = settings.slide * random.standard_normal(n)
        self._place, self._depth = np.zeros(n), np.zeros(n)
        self._settle()
        bodies = (range(start, start + count) for start, count in zip(self.first.tolist(), counts, strict=True))
        pairs = [pair for body in bodies for pair in combinations(body, 2)]
        self._one, self._other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        self._merged = np.zeros(len(self._one), dtype=bool)

    def advance(self) -> None:
        """Move on by one scan."""
        n, keep = len(self.actor), self._keep
        chance = self._random.random(n)
        later = self.order > 0
        ends = self.present & (chance < self._ends)
        begins = ~self.present & (chance < self._begins)
        self.present = (self.present & ~(ends & later)) | begins
        self.born = begins | (ends & ~later)
        self._slide = keep * self._slide + self._settings.slide * math.sqrt(1 - keep**2) * self._random.standard_normal(
            n
        )
        self._settle()

    def _settle(self) -> None:
        """Draw places for those that have just come."""
        n = len(self.actor)
        reach = np.where(self.order == 0, _FIRST_WITHIN, _WITHIN)
        place, depth = reach * self._random.uniform(-1, 1, n), self._settings.depth * self._random.random(n)
        self._place = np.where(self.born, place, self._place)
        self._depth = np.where(self.born, depth, self._depth)

    def offsets(self, eye: ComplexPlane) -> ComplexPlane:
        """Return where each reflection lies in its actor's own axes, m, shape (n,).

        Args:
            eye: the observer in each actor's own axes, m, shape (actors,).

        """
        at = eye[self.actor]
        towards = -at / np.maximum(np.abs(at), 1e-9)
        angle = np.angle((self._box - at[:, None]) * np.conj(towards)[:, None])
        low, high = angle.min(axis=1), angle.max(axis=1)
        reach = np.maximum(np.abs(at) * (high - low) / 2, 1e-9)
        share = np.clip(self._place + self._slide / reach, -_WITHIN, _WITHIN)
        ray = towards * np.exp(1j * (low + high + share * (high - low)) / 2)
        hit = at + ray * _distance_to_box(at, ray, self._half)
        inwards = np.minimum(self._depth / np.maximum(np.abs(hit), 1e-9), 1.0)
        outside = (np.abs(at.real) > self._half[:, 0]) | (np.abs(at.imag) > self._half[:, 1])
        return np.where(outside, hit * (1.0 - inwards), 0.0)

    def merge(self, position: ComplexPlane, detectable: Booleans) -> None:
        """Make one of two reflections of a body that are close: in its middle, and the later one is not seen.

        Args:
            position: of each, m, changed (n,).
            detectable: which can be seen, changed (n,).

        """
        apart = np.abs(position[self._one] - position[self._other])
        limit = self._settings.merging * np.where(self._merged, _PARTING, 1.0)
        self._merged = (apart < limit) & detectable[self._one] & detectable[self._other]
        for one, other in zip(self._one[self._merged].tolist(), self._other[self._merged].tolist(), strict=True):
            if detectable[one] and detectable[other]:
                position[one] = (position[one] + position[other]) / 2
                detectable[other] = False


def _distance_to_box(eye: ComplexPlane, ray: ComplexPlane, half: Floats) -> Floats:
    """Return the distance along rays of unit length at which they enter boxes about the origin, m, shape (n,)."""
    nearest = np.full(len(eye), -np.inf)
    for start, step, reach in ((eye.real, ray.real, half[:, 0]), (eye.imag, ray.imag, half[:, 1])):
        step = np.where(np.abs(step) < 1e-12, 1e-12, step)
        nearest = np.maximum(nearest, np.minimum((reach - start) / step, (-reach - start) / step))
    return nearest


def _drawn_count(actor: Actor, settings: ReflectionEffects, random: np.random.Generator) -> int:
    """Return how many reflections an actor has."""
    drawn = int(random.integers(settings.fewest, settings.most + 1))
    if actor.size.length == 0.0:
        return 1
    if actor.reflections is not None:
        return actor.reflections
    return {"pedestrian": 1, "two-wheeler": min(drawn, 2)}.get(actor.kind, drawn)
