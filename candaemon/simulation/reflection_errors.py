"""Errors of reflections in traffic: noise that a filter has made slow in part, and a radar's own tracking."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats
from candaemon.simulation.effects import OwnFilter, TrafficEffects

POSITIONS: Final = ("x", "y", "range", "azimuth")
_SAME_SIZE = 0.8
"""Share of a size's error that is the same in all scans of an object."""


@dataclass(frozen=True, slots=True)
class ScanErrors:
    """The errors of one scan.

    Attributes:
        noise: added to each quantity, shape (quantities, n), SI.
        displacement: of each point, along the line of sight + i · to the left of it, m, shape (n,).
        size: factor on length and width, shape (n,).

    """

    noise: Floats
    displacement: ComplexPlane
    size: Floats


class ReflectionErrors:
    """The errors of all points that a sensor reports, scan by scan.

    Args:
        settings: of the effects.
        quantities: names of the rows.
        deviation: one standard deviation of the whole noise of each row, shape (quantities, 1), SI.
        count: number of points.
        cycle: s between scans.
        random: generator to draw from.

    """

    def __init__(
        self,
        settings: TrafficEffects,
        quantities: tuple[str, ...],
        deviation: Floats,
        count: int,
        cycle: float,
        random: np.random.Generator,
    ) -> None:
        self._correlation, self._size_noise, self._random = settings.correlation, settings.size_noise, random
        self._deviation = deviation
        self._keep = math.exp(-cycle / settings.correlation.time)
        self._slow = random.standard_normal((len(quantities), count))
        self._size = random.standard_normal(count)
        self._own = None if settings.own_filter is None else OwnTracks(settings.own_filter, count, cycle, random)
        self._position = np.array([[name in POSITIONS] for name in quantities])
        self._azimuth = np.array([[name == "azimuth"] for name in quantities])

    def next(self, distance: Floats, born: Booleans) -> ScanErrors:
        """Return the errors of the next scan.

        Args:
            distance: of each point, m, shape (n,).
            born: which points are others than in the scan before, shape (n,).

        """
        random, keep, count = self._random, self._keep, len(distance)
        drawn = random.standard_normal(self._slow.shape)
        self._slow = np.where(born, drawn, keep * self._slow + math.sqrt(1 - keep**2) * drawn)
        self._size = np.where(born, random.standard_normal(count), self._size)
        settings = self._correlation
        share = settings.near + (settings.far - settings.near) * np.minimum(distance / settings.range, 1.0)
        share, deviation = np.broadcast_to(share, self._slow.shape), self._deviation
        displacement = np.zeros(count, dtype=np.complex128)
        if self._own is not None:
            share = np.where(self._position, 0.0, share)
            white = np.where(self._azimuth, self._own.white / np.maximum(distance, 1.0), self._own.white)
            deviation = np.where(self._position, white, deviation)
            displacement = self._own.next(born)
        white = random.standard_normal(self._slow.shape)
        noise = deviation * (np.sqrt(1 - share) * white + np.sqrt(share) * self._slow)
        size = _SAME_SIZE * self._size + math.sqrt(1 - _SAME_SIZE**2) * random.standard_normal(count)
        return ScanErrors(noise, displacement, np.maximum(1 + self._size_noise * size, 0.2))


class OwnTracks:
    """Where a radar's own filter believes its objects, beside the truth: a random walk that returns, and slides.

    Args:
        settings: of the effect.
        count: number of points.
        cycle: s between scans.
        random: generator to draw from.

    """

    def __init__(self, settings: OwnFilter, count: int, cycle: float, random: np.random.Generator) -> None:
        self._settings, self._cycle, self._random = settings, cycle, random
        self._keep = math.exp(-cycle / settings.return_time)
        self._step = np.sqrt(np.array([settings.walk_along, settings.walk]) * cycle)
        settled = np.sqrt(np.array([settings.walk_along, settings.walk]) * settings.return_time / 2)
        self._along, self._across = settled[:, None] * random.standard_normal((2, count))
        self._speed, self._left = np.zeros(count), np.zeros(count)

    @property
    def white(self) -> float:
        """The white part's standard deviation, m."""
        return self._settings.white

    def next(self, born: Booleans) -> ComplexPlane:
        """Return each point's displacement in the next scan, m; those that are others begin at the truth."""
        settings, random, count = self._settings, self._random, len(born)
        begins = random.random(count) < settings.slides * self._cycle
        begins &= self._left <= 0.0
        side = np.where(random.random(count) < 0.5, -1.0, 1.0)
        speed = side * random.uniform(settings.slowest, settings.fastest, count)
        self._left = np.where(begins, random.uniform(settings.shortest, settings.longest, count), self._left)
        self._speed = np.where(begins, speed, self._speed)
        slides = np.minimum(np.abs(self._speed) * self._cycle, self._left)
        self._left = np.where(born, 0.0, self._left - slides)
        walk = self._step[:, None] * random.standard_normal((2, count))
        self._along = np.where(born, 0.0, self._keep * self._along + walk[0])
        self._across = np.where(born, 0.0, self._keep * self._across + walk[1] + np.copysign(slides, self._speed))
        return np.asarray(self._along + 1j * self._across)
