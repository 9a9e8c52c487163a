"""Scans that open with a header, which says how many objects follow."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.frames.times import NEVER_NS
from candaemon.radar.assembly import AGAIN_NS, UNKNOWN
from candaemon.radar.claimed_frames import Route
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.radar.timeout_assembler import TimeoutAssembler


class HeaderAssembler(TimeoutAssembler):
    """A scan opens with a header that says how many objects there are; it closes when all came or the next header does.

    Where a scan has several headers, their numbers add up, and any of them opens it.

    Frames may come before their header. A scan whose header was lost closes when its time is up.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        assert sensor.headers, "binding gives headers with close: header"  # noqa: S101  # a promise of binding's
        self._headers, self._used_only = sensor.headers, sensor.headers[0].used_only
        super().__init__(sensor, counts)
        self._state.headers = [-1] * len(self._headers)

    def _all_routes(self) -> dict[int, Route]:
        routes = super()._all_routes()
        for index, header in enumerate(self._headers):
            self._add_mark(routes, header.can_id, (self._begin, index, 0))
        return routes

    def _begin(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take a header; part is which."""
        state, header = self._state, self._headers[part]
        if len(data) < header.message.length:
            state.counts.short += 1
            return None
        if self._mark_monitor is not None and not self._mark_monitor.admits(header.can_id, data, time_ns):
            return None
        count, measurement = header.read(data)
        came = state.headers[part] >= 0
        again, state.marks[part] = state.marks.get(part) == data, data
        if self._is_doubled(time_ns, measurement, came=came, again=again):
            state.counts.duplicate += 1
            return None
        if header.counter is not None:
            self._count_skipped(measurement, header.period)
        closed = None
        if state.is_open and (came or time_ns >= state.first_ns + self._half_cycle_ns):
            closed = self._close()
        if not state.is_open:
            self._start(time_ns)
        state.counts.used += 1
        if header.says_look:
            self._take_look(data)
        self._take_stamp(header.can_id, data, time_ns)
        state.headers[part] = count
        state.last_ns = time_ns
        if min(state.headers) < 0:  # another is to come
            return closed
        state.count = sum(state.headers)
        state.awaited = self._awaits() - sum(map(len, state.frames))
        # One call gives one scan: after the one before, a scan without objects waits for its time-out.
        if state.awaited > 0 or closed is not None:
            return closed
        return self._close()

    def _is_doubled(self, time_ns: int, measurement: int, *, came: bool, again: bool) -> bool:
        """Return whether a header was in the open scan already, or, where none is open, in the one just closed.

        Args:
            time_ns: its time stamp.
            measurement: its counter; −1 where it has none.
            came: whether the open scan has it.
            again: whether its payload is that of the one before.
        """
        state = self._state
        # one without a counter may be the next scan's: a frame that is sent again follows at once
        span_ns = self._half_cycle_ns if measurement >= 0 else min(AGAIN_NS, self._half_cycle_ns)
        if not state.is_open:
            return again and self._is_late(time_ns, span_ns)
        if measurement >= 0:
            return came and measurement == state.measurement
        return came and again and time_ns < state.first_ns + span_ns

    def _count_skipped(self, measurement: int, period: int) -> None:
        """Count the scans that never came; a jump by half the counter's range or more is a restart."""
        state = self._state
        if measurement >= 0 and state.measurement >= 0:
            skipped = (measurement - state.measurement - 1) % period
            if skipped < period // 2:
                state.counts.skipped += skipped
        state.measurement = measurement

    def _objects(self) -> int | None:
        count = self._state.count
        return self._slots if not self._used_only else None if count is None else -(-count // self._points)

    def _count(self) -> int:
        return NEVER_NS if self._state.count is None else self._state.count

    def _awaits(self) -> int:
        return UNKNOWN if self._state.count is None else super()._awaits()

    def _limit(self) -> int:
        count = self._state.count
        return NEVER_NS if count is None or self._used_only else -(-count // self._points)

    def _unmarked(self) -> int:
        return sum(count < 0 for count in self._state.headers)

    def _close(self, *, marked: bool = False) -> Scan | None:
        scan = super()._close(marked=marked)
        self._state.count = None
        self._state.headers = [-1] * len(self._headers)
        return scan
