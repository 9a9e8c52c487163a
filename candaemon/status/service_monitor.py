"""Measures the core loop, and gives the status snapshot to whoever asks for it."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import TypeAlias

from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.observer import CompletedCycle, DaemonView, Observer
from candaemon.daemon.service_log import RepetitionFilter
from candaemon.frames.frame import Frame, Tick
from candaemon.status.collect import rate_counters, take_snapshot
from candaemon.status.histogram import Histogram
from candaemon.status.losses import Losses, LossLedger
from candaemon.status.measurements import ClientCounts, Measurements, NisAccumulator, SensorActivity
from candaemon.status.snapshot import StatusSnapshot

_MOST_WAITING = 16

RecordingCounts: TypeAlias = Callable[[], Mapping[str, int | float | str | bool]]
"""Gives what the recording counts."""


class ServiceMonitor(Observer):
    """Keeps what is counted nowhere else: durations, NIS, when a sensor's latest scan was, reloads.

    A cycle costs some microseconds and nothing grows. The snapshot is taken only when asked for, in the
    core thread between two iterations, so that they are consistent.

    Args:
        settings: buckets, and how far the NIS of late looks back.
        recording: gives what the recording counts; None where nothing is recorded.
        log: leaves out lines of the log; None where nothing does.
        clock: monotonic seconds.

    Attributes:
        clients: those that were not served; who serves them counts them there.
    """

    def __init__(
        self,
        settings: MetricsSettings,
        recording: RecordingCounts | None = None,
        *,
        log: RepetitionFilter | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._settings = settings
        self._recording = recording
        self._log = log
        self.clients = ClientCounts()
        self._ledger = LossLedger()
        self._clock = clock
        self._measured = Measurements(Histogram(settings.buckets), Histogram(settings.buckets), clock())
        self._sensors: tuple[SensorActivity, ...] = ()
        self._waiting: deque[Future[StatusSnapshot]] = deque(maxlen=_MOST_WAITING)

    def on_start(self, daemon: DaemonView) -> None:
        """Look at the daemon's sensors."""
        self._measured.started_s = self._clock()
        self._watch_sensors(daemon)

    def on_items(self, items: Sequence[Frame | Tick]) -> None:
        """Note the pipeline's time."""
        if items:
            self._measured.now_ns = items[-1][0]

    def on_cycle(self, completed: CompletedCycle) -> None:
        """Measure a cycle."""
        measured, cycle = self._measured, completed.cycle
        for histogram, seconds in ((measured.cycle_time, completed.seconds), (measured.latency, completed.latency)):
            if not math.isnan(seconds):
                histogram.add(seconds)
        for sensor in self._sensors:
            sensor.look(cycle.time_ns)
        if cycle.update is not None and cycle.detections is not None:
            self._sensors[cycle.detections.sensor].nis.add(cycle.update)

    def on_iteration(self, daemon: DaemonView) -> None:
        """Note the counters that rates are derived from, and answer the threads that wait for a snapshot."""
        now_s = self._clock()
        if self._measured.rates.due(now_s):
            self._measured.rates.note(now_s, rate_counters(daemon))
        self._answer(daemon)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Count a reload; go on with the sensors that there are."""
        measured = self._measured
        measured.reload_error = error
        if error:
            measured.refused += 1
            return
        measured.reloads += 1
        settings = daemon.pipeline.binding.settings.service.metrics
        if settings.buckets != self._settings.buckets:
            measured.cycle_time, measured.latency = Histogram(settings.buckets), Histogram(settings.buckets)
        self._settings = settings
        self._ledger.watch(daemon)
        self._watch_sensors(daemon)

    def on_stop(self, daemon: DaemonView) -> None:
        """Answer the threads that still wait for a snapshot."""
        self._answer(daemon)

    def snapshot(self, daemon: DaemonView) -> StatusSnapshot:
        """Return the status snapshot; for the core thread."""
        recording = None if self._recording is None else self._recording()
        return take_snapshot(daemon, self._measured, self._clock(), self.losses(daemon), recording)

    def losses(self, daemon: DaemonView) -> Losses:
        """Return all that was lost since the start; for the core thread."""
        recording = {} if self._recording is None else self._recording()
        others = Losses(
            recording_items=int(recording.get("lost", 0)),
            recording_events=int(recording.get("events_lost", 0)),
            log_lines=0 if self._log is None else self._log.left_out,
            status_clients=self.clients.status_clients,
            scrapes=self.clients.scrapes,
        )
        return self._ledger.total(daemon, others)

    def wait_for_snapshot(self, timeout_s: float) -> StatusSnapshot:
        """Ask the core loop for the snapshot, from another thread.

        Args:
            timeout_s: how long to wait for its next iteration.

        Raises:
            TimeoutError: the core loop did not iterate in time.
        """
        wanted: Future[StatusSnapshot] = Future()
        self._waiting.append(wanted)
        return wanted.result(timeout_s)

    def _answer(self, daemon: DaemonView) -> None:
        """Give the snapshot to every thread that waits for it."""
        if self._waiting:
            snapshot = self.snapshot(daemon)
            while self._waiting:
                self._waiting.popleft().set_result(snapshot)

    def _watch_sensors(self, daemon: DaemonView) -> None:
        """Watch the sensors there are; one that was there before keeps its NIS."""
        pipeline, before = daemon.pipeline, self._measured.sensors
        watches = {}
        for sensor, assembler in zip(pipeline.binding.sensors, pipeline.assemblers, strict=True):
            known = before.get(sensor.name)
            watches[sensor.name] = SensorActivity(
                assembler.counts, NisAccumulator(self._settings.nis_scans) if known is None else known.nis
            )
            watches[sensor.name].last_ns = None if known is None else known.last_ns
        self._measured.sensors = watches
        self._sensors = tuple(watches.values())
