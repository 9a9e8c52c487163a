"""Faults that come at random and last: times between which frames are lost, or a source is silent."""

from __future__ import annotations

import math

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.simulation.effects import TransmissionFaults

_NS = 1e9


class Spells:
    """Spells at random times, of random lengths, found as time goes on.

    Args:
        interval: s, mean time from a spell's end to the next one's start; infinite: there are none.
        length: s, mean length of a spell.
        random: generator to draw from.

    """

    def __init__(self, interval: float, length: float, random: np.random.Generator) -> None:
        self._interval, self._length, self._random = interval * _NS, length * _NS, random
        self._begin: float | None = None
        self._end = 0.0

    def cover(self, times_ns: Integers) -> Booleans:
        """Return which of some times, in order and none before those of an earlier call, lie in a spell."""
        covered = np.zeros(len(times_ns), dtype=bool)
        if not len(times_ns) or np.isinf(self._interval):
            return covered
        if self._begin is None:
            self._next(float(times_ns[0]))
        last = float(times_ns[-1])
        while self._begin is not None and self._begin <= last:
            covered |= (times_ns >= self._begin) & (times_ns < self._end)
            if self._end > last:
                break
            self._next(self._end)
        return covered

    def _next(self, since: float) -> None:
        """Draw the next spell after a time, ns."""
        self._begin = since + self._interval * self._random.exponential()
        self._end = self._begin + self._length * self._random.exponential() + 1.0


class FrameLosses:
    """Which frames of one source are lost: in bursts, and with whole scans.

    Args:
        faults: the settings; None: no frame is lost.
        random: generator to draw from.

    """

    def __init__(self, faults: TransmissionFaults | None, random: np.random.Generator) -> None:
        self._faults, self._random = faults, random
        rate = 0.0 if faults is None else faults.bursts
        length = 0.0 if faults is None else faults.burst_time
        self._bursts = Spells(1 / rate if rate > 0.0 else math.inf, length, random)

    def lost(self, times_ns: Integers, *, whole: bool = False) -> Booleans:
        """Return which of some frames are lost, in order of time, none before those of an earlier call.

        Args:
            times_ns: when they are sent (n,).
            whole: whether they are a scan, which can be lost as a whole.

        """
        if self._faults is None:
            return np.zeros(len(times_ns), dtype=bool)
        lost = self._bursts.cover(times_ns) & (self._random.random(len(times_ns)) < self._faults.burst_loss)
        if whole and self._random.random() < self._faults.lost_scans:
            lost[:] = True
        return lost


class Steps:
    """A place that jumps at random times.

    Args:
        interval: s, mean time between jumps.
        deviation: m, standard deviation of each coordinate of a jump.
        random: generator to draw from.

    """

    def __init__(self, interval: float, deviation: float, random: np.random.Generator) -> None:
        self._interval, self._deviation, self._random = interval, deviation, random
        self._place = np.zeros(2)
        self._next: float | None = None

    def at(self, times: Floats) -> Floats:
        """Return the place at some times, s, in order and none before those of an earlier call, m (2, n)."""
        places = np.repeat(self._place[:, None], len(times), axis=1)
        if not len(times):
            return places
        if self._next is None:
            self._next = float(times[0]) + self._interval * self._random.exponential()
        while self._next <= times[-1]:
            self._place = self._place + self._deviation * self._random.standard_normal(2)
            places[:, times >= self._next] = self._place[:, None]
            self._next += self._interval * self._random.exponential()
        return places
