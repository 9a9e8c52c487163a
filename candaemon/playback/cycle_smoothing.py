"""Fixed-lag smoothing of the reported cycles."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from candaemon.arrays import Floats
from candaemon.estimation.smoothing import FixedLag, Smoothed
from candaemon.pipeline.cycle import Cycle
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.smoother_history import concatenated, swing_of, with_motion


class CycleSmoother:
    """Delays cycles by a lag and returns them in order with smoothed motion.

    Sent frames and identities are not affected. A cycle without obstacles is not returned.

    Args:
        trackers: of the pipeline that makes the cycles, before their first step.
        lag: s of later measurements that smooth a cycle.
    """

    def __init__(self, trackers: Sequence[AnyTracker], lag: float) -> None:
        for tracker in trackers:
            tracker.keep_smoother_history()
        self._trackers = trackers
        self._smoother = FixedLag(round(lag * 1e9))
        self._waiting: deque[tuple[Cycle, Floats]] = deque()

    def add(self, cycle: Cycle) -> Iterator[Cycle]:
        """Add the newest cycle; yield the smoothed earlier ones that are due."""
        # also empty: a cycle without ego motion, for which the trackers make no step
        if not len(cycle.obstacles):
            return
        history = concatenated(
            [tracker.smoother_history for tracker in self._trackers if tracker.smoother_history is not None]
        )
        self._waiting.append((cycle, swing_of(history, cycle.obstacles)))
        due = self._smoother.add(
            cycle.obstacles.time_ns, history.id, history.state, history.covariance, history.linked, history.link
        )
        yield from map(self._smoothed, due)

    def finish(self) -> Iterator[Cycle]:
        """Yield the remaining cycles, at the end of a drive."""
        yield from map(self._smoothed, self._smoother.finish())

    def _smoothed(self, smoothed: Smoothed) -> Cycle:
        cycle, swing = self._waiting.popleft()
        obstacles, reported = with_motion(cycle.obstacles, smoothed, cycle.pose, swing), cycle.reported
        if reported is not None:
            used = {name: getattr(reported, name) for name in ("used_row", "used_sensor", "used_object")}
            reported = replace(obstacles, **used)
        return replace(cycle, obstacles=obstacles, reported=reported)
