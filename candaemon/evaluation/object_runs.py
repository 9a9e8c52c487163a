"""Runs: uninterrupted stretches over which a sensor reports one object under the same number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers

_GAP_CYCLES = 1.5


def last_rows(known: Integers, wanted: Integers) -> Indices:
    """Return the last row of `known` (k,) with each of the wanted numbers, −1 where there is none, shape (n,)."""
    if compiled.in_use:
        return compiled.kernels.last_rows(known, wanted)
    if not len(known):
        return np.full(len(wanted), -1, dtype=np.intp)
    order = np.argsort(known, kind="stable")
    at = np.searchsorted(known, wanted, side="right", sorter=order) - 1
    return np.where((at >= 0) & (known[order[at]] == wanted), order[at], -1)


class ObjectRuns:
    """Assigns a number to each run of every sensor's objects.

    A run continues while the object's number is in each scan, no scan is missing (two scans are less than 1.5 cycles
    apart), and the sensor does not flag the object as new. Run numbers increase and are never reused.

    Args:
        cycles: nominal cycle time of each sensor, s, by its index.
    """

    def __init__(self, cycles: Sequence[float]) -> None:
        self._gaps_ns = tuple(round(_GAP_CYCLES * cycle * 1e9) for cycle in cycles)
        nothing = np.empty(0, dtype=np.int64)
        self._last: list[tuple[int, Integers, Integers]] = [(0, nothing, nothing) for _ in cycles]
        self._next = 0

    def update(self, sensor: int, time_ns: int, objects: Integers, new: Booleans) -> Integers:
        """Process one scan.

        Args:
            sensor: index.
            time_ns: measurement time.
            objects: the sensor's number of each valid object, shape (n,), without repetition.
            new: flagged as new by the sensor, shape (n,).

        Returns:
            The run of each object, shape (n,).
        """
        before_ns, known, runs = self._last[sensor]
        starts = np.asarray(new, dtype=bool)
        follows = 0 < time_ns - before_ns <= self._gaps_ns[sensor]
        if follows and not np.count_nonzero(starts) and np.array_equal(objects, known):
            self._last[sensor] = (time_ns, known, runs)  # as a rule, with the objects in the same order
            return runs.copy()
        if follows and len(known):
            at = last_rows(known, objects)
            starts, run = starts | (at < 0), runs[at]
        else:
            starts, run = np.ones(len(objects), dtype=np.bool_), np.empty(len(objects), dtype=np.int64)
        begun = int(starts.sum())
        run[starts] = np.arange(self._next, self._next + begun)
        self._next += begun
        self._last[sensor] = (time_ns, objects, run)
        return run.copy()


@dataclass(frozen=True, slots=True)
class RunTotals:
    """Accumulated values of k runs.

    Attributes:
        first_ns: first sample of each, shape (k,).
        last_ns: last sample of each, shape (k,).
        sums: shape (k, width).
    """

    first_ns: Integers
    last_ns: Integers
    sums: Floats


class RunSums:
    """Accumulates values for each run, until the run has had no sample for `keep_ns`.

    Args:
        width: number of accumulated columns of a run.
        keep_ns: how long after its last sample a run is kept.
    """

    def __init__(self, width: int, keep_ns: int) -> None:
        self._keep_ns = keep_ns
        self._run = np.empty(0, dtype=np.int64)
        self._first = np.empty(0, dtype=np.int64)
        self._last = np.empty(0, dtype=np.int64)
        self._sums = np.zeros((0, width))
        self._swept_ns: int | None = None

    def touch(self, times_ns: Integers, run: Integers) -> None:
        """Record samples (n,) of runs at times, ascending."""
        rows, known = self._find(run)
        if not known.all():
            self._insert(times_ns[~known], run[~known])
            rows, _ = self._find(run)
        self._last[rows] = times_ns  # of a run that comes several times the last

    def add(self, run: Integers, column: int, values: Floats) -> None:
        """Add values, shape (n, k), from `column` on to the runs, one after the other; removed runs are skipped."""
        rows, known = self._find(run)
        rows, values = rows[known], values[known]
        for k in range(values.shape[1]):
            np.add.at(self._sums[:, column + k], rows, values[:, k])

    def open(self) -> RunTotals:
        """Return all runs that have not been removed yet."""
        return RunTotals(self._first, self._last, self._sums)

    def _find(self, run: Integers) -> tuple[Integers, Booleans]:
        """Return each run's row, and whether the run is stored."""
        if not len(self._run):
            return np.zeros(len(run), dtype=np.int64), np.zeros(len(run), dtype=bool)
        rows = np.minimum(np.searchsorted(self._run, run), len(self._run) - 1)
        return rows, self._run[rows] == run

    def _insert(self, times_ns: Integers, run: Integers) -> None:
        """Store further runs, sorted by number; of one that comes several times its first time."""
        run, first = np.unique(run, return_index=True)
        times, sums = times_ns[first], np.zeros((len(run), self._sums.shape[1]))
        if not len(self._run) or run[0] > self._run[-1]:  # as a rule: numbers increase
            self._run, self._sums = np.concatenate((self._run, run)), np.concatenate((self._sums, sums))
            self._first, self._last = np.concatenate((self._first, times)), np.concatenate((self._last, times))
            return
        at = np.searchsorted(self._run, run)
        self._run = np.insert(self._run, at, run)
        self._first = np.insert(self._first, at, times)
        self._last = np.insert(self._last, at, times)
        self._sums = np.insert(self._sums, at, 0.0, axis=0)

    def sweep(self, time_ns: int) -> RunTotals:
        """Remove and return the runs that have ended by a time; every `keep_ns` is enough to bound the memory."""
        if self._swept_ns is None or time_ns < self._swept_ns:
            self._swept_ns = time_ns
        if time_ns - self._swept_ns < self._keep_ns:
            return RunTotals(self._first[:0], self._last[:0], self._sums[:0])
        self._swept_ns = time_ns
        over = self._last < time_ns - self._keep_ns
        ended = RunTotals(self._first[over], self._last[over], self._sums[over])
        live = ~over
        self._run, self._first, self._last = self._run[live], self._first[live], self._last[live]
        self._sums = self._sums[live]
        return ended
