"""Times two ways of one thing in turns, so that what slows the machine slows both."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import process_time

Work = Callable[[], int]
"""Does something, and returns how many units of it."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two ways of doing one thing.

    Attributes:
        name: what is done.
        unit: what the times are for.
        candaemon, baseline: do it.
        goal: the ratio of their times that the project wants on an idle machine; printed beside what was measured.
        against: what the baseline is.
    """

    name: str
    unit: str
    candaemon: Work
    baseline: Work
    goal: float
    against: str = "naive"


@dataclass(frozen=True, slots=True)
class Timed:
    """A comparison's times, µs of CPU time a unit."""

    comparison: Comparison
    candaemon: float
    baseline: float

    @property
    def ratio(self) -> float:
        """How many times faster candaemon is."""
        return self.baseline / self.candaemon

    def __str__(self) -> str:
        it = self.comparison
        return (
            f"{it.name:<32}{self.candaemon:>9.2f}{self.baseline:>11.2f} µs/{it.unit:<6}"
            f"{self.ratio:>7.1f} x {it.against:<11} goal {it.goal:g} x"
        )


def timed(comparison: Comparison, repeats: int = 3) -> Timed:
    """Return the medians of several runs of both, each run of the one beside a run of the other."""
    mine, others = [], []
    for _ in range(repeats):
        mine.append(microseconds(comparison.candaemon))
        others.append(microseconds(comparison.baseline))
    return Timed(comparison, median(mine), median(others))


def microseconds(work: Work) -> float:
    """Return the CPU time of a unit of work, µs."""
    gc.collect()
    started = process_time()
    units = work()
    return (process_time() - started) / units * 1e6
