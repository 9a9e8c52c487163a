"""Cycles told again, with what was learnt of the obstacles' motion since."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from candaemon.estimation.smoothing import FixedLag, Smoothed
from candaemon.pipeline.cycle import Cycle
from candaemon.tracking.smoother_history import concatenated, with_motion
from candaemon.tracking.tracker import Tracker


class CycleSmoother:
    """Holds cycles back until a lag has passed, and gives them again in their order with smoothed motion.

    What the daemon sends, and whom it takes for whom, is as it was. A cycle without obstacles is not given again.

    Args:
        trackers: of the pipeline that tells the cycles, before their first step.
        lag: s that a cycle learns from.
    """

    def __init__(self, trackers: Sequence[Tracker], lag: float) -> None:
        for tracker in trackers:
            tracker.keep_smoother_history()
        self._trackers = trackers
        self._smoother = FixedLag(round(lag * 1e9))
        self._waiting: deque[Cycle] = deque()

    def take(self, cycle: Cycle) -> Iterator[Cycle]:
        """Take a cycle as soon as it is told; yield those before it that are due."""
        # so is a cycle for which the trackers made no step, own motion being unknown: it breaks no chain
        if not len(cycle.obstacles):
            return
        trail = concatenated(
            [tracker.smoother_history for tracker in self._trackers if tracker.smoother_history is not None]
        )
        self._waiting.append(cycle)
        due = self._smoother.add(
            cycle.obstacles.time_ns, trail.id, trail.state, trail.covariance, trail.linked, trail.link
        )
        yield from map(self._again, due)

    def finish(self) -> Iterator[Cycle]:
        """Yield the cycles that are left, at the end of a drive."""
        yield from map(self._again, self._smoother.finish())

    def _again(self, smoothed: Smoothed) -> Cycle:
        cycle = self._waiting.popleft()
        return replace(cycle, obstacles=with_motion(cycle.obstacles, smoothed, cycle.pose))
