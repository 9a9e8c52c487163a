"""The service: buses in, pipeline, buses out, until it is stopped."""

from __future__ import annotations

import gc
import logging
import math
import time
from collections.abc import Callable, Sequence
from threading import Event
from types import TracebackType
from typing import Self, TypedDict

from candaemon.binding.bound import Binding
from candaemon.can_io.live_buses import LiveBuses
from candaemon.can_io.reorder import STEP_NS, ReorderBuffer
from candaemon.config.recording import EventSettings, RecordingSettings
from candaemon.daemon.clock_step import ClockStepDetector, since_boot_ns
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.daemon.reload import Reloader
from candaemon.frames.frame import Frame, Tick
from candaemon.log_lines import ANSWER
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.handover import hand_over
from candaemon.pipeline.pipeline import Pipeline

logger = logging.getLogger(__name__)


_DRAIN_S = 0.3
"""How long the last cycle's frames may wait for a busy bus."""


class _Expected(TypedDict):
    ids: dict[str, frozenset[int]]
    rates: dict[str, float]


class Daemon:
    """Runs a configuration on its live buses. A context manager: entering it opens the buses, leaving it closes them.

    A bus that is not there, or goes away, is tried again in the background; the others go on meanwhile.

    Args:
        binding: the configuration, bound to its DBC files.
        clock: gives the time in ns, in the clock of the frames' time stamps.
        steady: gives the time in ns in a clock that nobody can set and that goes on while the machine sleeps.
        observers: called by the core loop, in its thread and in this order.
        reloader: loads the configuration when `reload` asks for it; None: nothing does.
        shadow: whether nothing is sent; all else is as it would be.

    Attributes:
        pipeline: with its counts.
        buses: with theirs.
        sequence: with its counts of clock steps.
        received: frames read from the buses.
        last: the latest cycle, None before the first.
    """

    def __init__(
        self,
        binding: Binding,
        *,
        clock: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = since_boot_ns,
        observers: Sequence[Observer] = (),
        reloader: Reloader | None = None,
        shadow: bool = False,
    ) -> None:
        self._sends = not shadow
        self.pipeline = Pipeline(binding)
        self._ring = _ring(binding)
        self.buses = LiveBuses(binding.settings.buses, clock=clock, **_expected(binding))
        self.sequence = ReorderBuffer(_window_ns(binding), max_gap_ns=_clock_step_ns(binding))
        self._clock_watch = ClockStepDetector(steady)
        self.received = 0
        self._latest_ns = 0
        self.last: Cycle | None = None
        self._clock = clock
        self._observers = tuple(observers)
        self._reloader = reloader
        self._stopping = Event()
        self._marking = Event()

    @property
    def binding(self) -> Binding:
        """The configuration in force."""
        return self.pipeline.binding

    def __enter__(self) -> Self:
        self.buses.open(strict=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.buses.close()
        if self._reloader is not None:
            self._reloader.close()

    def run(self, look: Callable[[], None] = lambda: None) -> None:
        """Serve until `stop` is called, then finish the open scans and close the buses, so that all is counted.

        Args:
            look: called between two iterations; looks for requests such as signals.
        """
        for observer in self._observers:
            observer.on_start(self)
        _freeze()
        look()
        while not self._stopping.is_set():
            self.run_once()
            look()
        self.finish()
        self.buses.drain(_DRAIN_S)
        self.buses.close()
        for observer in self._observers:
            observer.on_stop(self)

    def run_once(self) -> None:
        """Run one iteration of the core loop: a step, a mark or a reload requested meanwhile, the observers."""
        service = self.binding.settings.service
        self.step(service.tick, service.coalescing)
        self._mark()
        self._reload()
        for observer in self._observers:
            observer.on_iteration(self)

    def step(self, timeout_s: float, coalescing_s: float = 0.0) -> None:
        """Process the frames that have arrived, or a tick if none has.

        Args:
            timeout_s: how long to wait for a frame.
            coalescing_s: for how long at most frames wait to be read together, where no cycle comes later for it.
        """
        now_ns = self._clock()  # before the buses are read, so that no tick overtakes a frame
        if coalescing_s:
            stamped_ns = now_ns + self.sequence.offset_ns
            coalescing_s = min(coalescing_s, (self.pipeline.quiet_until_ns(stamped_ns) - stamped_ns) * 1e-9)
        frames = self.buses.read(timeout_s, coalescing_s)
        self._distinguish_pause_from_clock_step(frames)
        self.received += len(frames)
        self._process(self.sequence.push_all([*frames] if frames else [Tick(now_ns)]))

    def finish(self) -> None:
        """Process what the reorder buffer holds, and close the open scans."""
        self._process(self.sequence.flush())
        began_s = time.perf_counter()
        for cycle in self.pipeline.finish():
            began_s = self._send(cycle, began_s, by_frame=False)

    def stop(self) -> None:
        """Let `run` return soon; for other threads too, but not for signal handlers: a lock is held for a moment."""
        self._stopping.set()

    def mark(self) -> None:
        """Request that the observers be notified of this moment; for other threads too, as `stop`."""
        self._marking.set()

    def reload(self) -> None:
        """Request that the configuration be loaded again; for other threads too, as `stop`."""
        if self._reloader is not None:
            self._reloader.ask()

    def _distinguish_pause_from_clock_step(self, frames: Sequence[Frame]) -> None:
        """Take a gap in time for a pause, not a step of the clock, where nobody set it: the process or machine slept.

        Obstacles end in a pause as in any silence; to go on with them as if no time had passed would be wrong.
        """
        now_ns = self._clock()
        was_set = self._clock_watch.was_set(now_ns)
        are_ahead = bool(frames) and frames[-1].time_ns - now_ns > STEP_NS
        self.sequence.tune(
            _window_ns(self.binding), max_gap_ns=_clock_step_ns(self.binding) if was_set or are_ahead else None
        )

    def _process(self, items: Sequence[Frame | Tick]) -> None:
        """Run ordered items through the pipeline; send and report each cycle as it comes."""
        for observer in self._observers:
            observer.on_items(items)
        if items:
            self._latest_ns = items[-1][0]
        began_s = time.perf_counter()
        for cycle in self.pipeline.run(items):
            by_frame = any(len(item) > 1 and item[0] == cycle.time_ns for item in items)
            began_s = self._send(cycle, began_s, by_frame=by_frame)

    def _send(self, cycle: Cycle, began_s: float, *, by_frame: bool) -> float:
        """Send a cycle's frames and notify the observers; return the time, from which the next cycle is measured."""
        self.last = cycle
        latency = math.nan
        if cycle.frames:
            if by_frame:
                now_ns = self._clock()
                delay_ns = now_ns + self.sequence.offset_ns - cycle.time_ns
                latency = math.nan if self._clock_watch.explains(delay_ns, now_ns) else delay_ns * 1e-9
            if self._sends:
                self.buses.send(cycle.frames[0].bus, cycle.frames)
        completed = CompletedCycle(cycle, time.perf_counter() - began_s, latency)
        for observer in self._observers:
            observer.on_cycle(completed)
        return time.perf_counter()

    def _mark(self) -> None:
        """Notify the observers of a moment that was marked."""
        if self._marking.is_set():
            self._marking.clear()
            for observer in self._observers:
                observer.on_mark(self)

    def _reload(self) -> None:
        """Begin to load the configuration where that was requested; put what was loaded in force, or refuse it."""
        if self._reloader is None:
            return
        if self._reloader.begin():
            for observer in self._observers:
                observer.on_reload_begin(self)
        loaded = self._reloader.outcome()
        if loaded is None:
            return
        error = ""
        if isinstance(loaded, Pipeline):
            self._swap(loaded)
        else:
            error = str(loaded)
            logger.error("reload refused, the former configuration stays: %s", loaded, extra=ANSWER)
        for observer in self._observers:
            observer.on_reload_end(self, error)

    def _swap(self, pipeline: Pipeline) -> None:
        """Go on with another pipeline, which takes over what it can of the former one's state, and with its buses."""
        self._process(self.sequence.flush())
        for cycle in self.pipeline.settle(self._latest_ns):  # what waits for other sensors would wait for ever
            self._send(cycle, time.perf_counter(), by_frame=False)
        former, binding = self.pipeline, pipeline.binding
        kept = hand_over(former, pipeline)
        self.buses.change(binding.settings.buses, **_expected(binding))
        self.sequence.tune(_window_ns(binding), max_gap_ns=_clock_step_ns(binding))
        self.pipeline = pipeline
        logger.info("reloaded: %s", kept, extra=ANSWER)
        if _ring(binding) != self._ring:
            logger.warning("service.recording is taken at the start: restart the service for what has changed there")
        gc.unfreeze()
        _freeze()


def _expected(binding: Binding) -> _Expected:
    """Return the identifiers wanted of each bus, and the frames/s expected of it."""
    return {
        "ids": {bus.name: bus.can_ids for bus in binding.buses},
        "rates": {bus.name: bus.rate for bus in binding.buses},
    }


def _ring(binding: Binding) -> RecordingSettings:
    """Return what of the recording a reload does not change: all but its events."""
    recording = binding.settings.service.recording
    return recording.model_copy(update={"events": EventSettings.defaults()})


def _window_ns(binding: Binding) -> int:
    return round(binding.settings.ordering_window * 1e9)


def _clock_step_ns(binding: Binding) -> int:
    return round(binding.settings.service.clock_step * 1e9)


def _freeze() -> None:
    """Exempt what has been loaded from garbage collection, which goes on: traversing it would hold up frames."""
    gc.collect()
    gc.freeze()
    gc.enable()
