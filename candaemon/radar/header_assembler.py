"""Scans that open with a header, which says how many objects follow."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.frames.times import NEVER_NS
from candaemon.radar.assembly import UNKNOWN
from candaemon.radar.claimed_frames import Route
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.radar.timeout_assembler import TimeoutAssembler


class HeaderAssembler(TimeoutAssembler):
    """A scan opens with a header that says how many objects there are; it closes when all came or the next header does.

    Frames may come before their header. A scan whose header was lost closes when its time is up.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        header = sensor.header
        assert header is not None, "binding gives a header with close: header"  # noqa: S101  # a promise of binding's
        self._header = header
        super().__init__(sensor, counts)

    def _all_routes(self) -> dict[int, Route]:
        return super()._all_routes() | {self._header.can_id: (self._begin, 0, 0)}

    def _begin(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take a header."""
        state = self._state
        if len(data) < self._header.message.length:
            state.counts.short += 1
            return None
        if self._mark_monitor is not None and not self._mark_monitor.admits(self._header.can_id, data, time_ns):
            return None
        count, measurement = self._header.read(data)
        if state.is_open and state.count is not None and measurement >= 0 and measurement == state.measurement:
            state.counts.duplicate += 1
            return None
        self._count_skipped(measurement)
        closed = None
        if state.is_open and (state.count is not None or time_ns >= state.first_ns + self._half_cycle_ns):
            closed = self._close()
        if not state.is_open:
            self._start(time_ns)
        state.counts.used += 1
        self._take_look(data)
        state.count = max(count, 0)
        state.last_ns = time_ns
        state.awaited = self._awaits() - sum(map(len, state.frames))
        # One call gives one scan: after the one before, a scan without objects waits for its time-out.
        if state.awaited > 0 or closed is not None:
            return closed
        return self._close()

    def _count_skipped(self, measurement: int) -> None:
        """Count the scans that never came; a jump by half the counter's range or more is a restart."""
        state = self._state
        if measurement >= 0 and state.measurement >= 0:
            skipped = (measurement - state.measurement - 1) % self._header.period
            if skipped < self._header.period // 2:
                state.counts.skipped += skipped
        state.measurement = measurement

    def _objects(self) -> int | None:
        count = self._state.count
        return self._slots if not self._header.used_only else None if count is None else -(-count // self._points)

    def _count(self) -> int:
        return NEVER_NS if self._state.count is None else self._state.count

    def _awaits(self) -> int:
        return UNKNOWN if self._state.count is None else super()._awaits()

    def _limit(self) -> int:
        count = self._state.count
        return NEVER_NS if count is None or self._header.used_only else -(-count // self._points)

    def _unmarked(self) -> int:
        return int(self._state.count is None)

    def _close(self, *, marked: bool = False) -> Scan | None:
        scan = super()._close(marked=marked)
        self._state.count = None
        return scan
