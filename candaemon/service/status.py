"""The service's word on itself: a line at a limited rate."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from candaemon.bus.live import LiveBuses
from candaemon.cycle import Cycle
from candaemon.pipeline import Pipeline
from candaemon.tracking.obstacles import TENTATIVE

logger = logging.getLogger(__name__)


class StatusLine:
    """Logs what the service does, every so often.

    Args:
        interval_s: between two lines; 0: none.
        clock: monotonic seconds.
    """

    def __init__(self, interval_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._interval_s = interval_s
        self._clock = clock
        self._last_s = clock()
        self._due_s = self._last_s + interval_s if interval_s else math.inf
        self._frames = self._cycles = 0

    def update(self, pipeline: Pipeline, buses: LiveBuses, last: Cycle | None) -> None:
        """Log a line if one is due; cheap if not.

        Args:
            pipeline: with its counts.
            buses: with theirs.
            last: the latest cycle, None before the first.
        """
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = now_s + self._interval_s
            logger.info("%s", self._line(pipeline, buses, last, now_s))

    def _line(self, pipeline: Pipeline, buses: LiveBuses, last: Cycle | None, now_s: float) -> str:
        """Say what happened since the last line, and what was lost since the start."""
        frames, cycles = sum(bus.frames for bus in pipeline.counts.buses), pipeline.counts.cycles
        span_s = max(now_s - self._last_s, 1e-9)
        obstacles = 0 if last is None else int((last.obstacles.state > TENTATIVE).sum())
        motion = "unknown" if last is None else last.pose.status.name.lower().replace("_", " ")
        each = [buses[k] for k in range(len(buses))]
        lost, unsent = (sum(getattr(bus.counts, name) for bus in each) for name in ("queue_full", "send_failed"))
        down = [bus.name for bus in each if not bus.state.up]
        line = (
            f"{(frames - self._frames) / span_s:.0f} frames/s, {(cycles - self._cycles) / span_s:.1f} cycles/s, "
            f"{obstacles} obstacles, own motion {motion}; since the start {cycles} cycles, {pipeline.drops} frames "
            f"unusable, {lost} lost, {unsent} unsent" + (f"; down: {', '.join(down)}" if down else "")
        )
        self._last_s, self._frames, self._cycles = now_s, frames, cycles
        return line
