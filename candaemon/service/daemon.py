"""The service: buses in, pipeline, buses out, until it is told to stop."""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable, Sequence
from threading import Event
from types import TracebackType
from typing import Self

from candaemon.binding.bound import Binding
from candaemon.bus.frame import Frame, Tick
from candaemon.bus.live import LiveBuses
from candaemon.bus.sequence import Sequencer
from candaemon.cycle import Cycle
from candaemon.errors import BusError
from candaemon.pipeline import Pipeline
from candaemon.service.status import StatusLine

logger = logging.getLogger(__name__)

TICK_S = 0.01
"""Silence on all buses after which the pipeline is told how late it is."""
CLOCK_STEP_NS = 1_000_000_000
"""A jump ahead of more than this is the clock being set: ticks come far more often."""


class Daemon:
    """Runs a configuration on its live buses. A context manager: entering it opens the buses, leaving it closes them.

    A bus that is not there, or goes away, is tried again in the background; the others go on meanwhile.

    Args:
        binding: the configuration, bound to its DBC files.
        clock: gives the time in ns, in the clock of the frames' time stamps.
        on_cycle: called with each cycle once its frames are sent.

    Attributes:
        pipeline: with its counts.
        buses: with theirs.
        sequence: with its counts of clock steps.
        received: frames taken from the buses.
        last: the latest cycle, None before the first.
    """

    def __init__(
        self,
        binding: Binding,
        *,
        clock: Callable[[], int] = time.time_ns,
        on_cycle: Callable[[Cycle], None] | None = None,
    ) -> None:
        config = binding.settings
        self.pipeline = Pipeline(binding)
        self.buses = LiveBuses(config.buses, clock=clock, ids={bus.name: bus.can_ids for bus in binding.buses})
        self.sequence = Sequencer(round(config.ordering_window * 1e9), max_gap_ns=CLOCK_STEP_NS)
        self.received = 0
        self.last: Cycle | None = None
        self._clock = clock
        self._on_cycle = on_cycle
        self._stopping = Event()

    def __enter__(self) -> Self:
        for k in range(len(self.buses)):
            try:
                self.buses[k].open()
            except BusError as error:
                logger.warning("%s. It is tried again until it opens", error)
        self.buses.open(strict=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.buses.close()

    def run(self, status: StatusLine | None = None) -> None:
        """Serve until `stop` is called, then finish the open scans.

        Args:
            status: told of every turn of the loop.
        """
        gc.collect()
        gc.freeze()  # what has been loaded stays: the collector need not look at it while frames wait
        while not self._stopping.is_set():
            self.step(TICK_S)
            if status is not None:
                status.update(self.pipeline, self.buses, self.last)
        self.finish()

    def step(self, timeout_s: float) -> None:
        """Take what has come, or after some silence the time, through the pipeline.

        Args:
            timeout_s: longest silence to wait for.
        """
        now_ns = self._clock()  # before the buses are read, so that no tick overtakes a frame
        frames = self.buses.read(timeout_s)
        self.received += len(frames)
        items: Sequence[Frame | Tick] = frames or (Tick(now_ns),)
        push = self.sequence.push
        for cycle in self.pipeline.run(each for item in items for each in push(item)):
            self._tell(cycle)

    def finish(self) -> None:
        """Take what is held back and what is open through the pipeline."""
        for cycle in self.pipeline.run(self.sequence.flush()):
            self._tell(cycle)
        for cycle in self.pipeline.finish():
            self._tell(cycle)

    def stop(self) -> None:
        """Let `run` return soon; for signal handlers and other threads."""
        self._stopping.set()

    def _tell(self, cycle: Cycle) -> None:
        """Send a cycle's frames."""
        self.last = cycle
        if cycle.frames:
            self.buses.send(cycle.frames[0].bus, cycle.frames)
        if self._on_cycle is not None:
            self._on_cycle(cycle)
