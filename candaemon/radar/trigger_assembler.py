"""Scans that a certain message closes."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.radar.assembly import AGAIN_NS, UNKNOWN
from candaemon.radar.claimed_frames import Route
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.radar.timeout_assembler import TimeoutAssembler


class TriggerAssembler(TimeoutAssembler):
    """A scan closes with a certain message; what comes after it is the next scan's."""

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        trigger = sensor.trigger
        assert trigger is not None, "binding gives a trigger with close: trigger"  # noqa: S101  # a promise of binding's
        self._trigger = trigger
        self._foreign = trigger.can_id not in sensor.reader.routes or trigger.can_id in sensor.mark_claims
        super().__init__(sensor, counts)
        self._straggling_ns = 0

    def _all_routes(self) -> dict[int, Route]:
        routes = super()._all_routes()
        if self._foreign:
            self._add_mark(routes, self._trigger.can_id, (self._mark, 0, 0))
        else:
            _, part, slot = routes[self._trigger.can_id]
            routes[self._trigger.can_id] = (self._receive_last, part, slot)
        return routes

    def _receive_last(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take the object's frame that closes the scan; even one that cannot be used says that the scan is over.

        One that comes twice is late: it makes no scan of its own.
        """
        state = self._state
        again, state.marks[0] = state.marks.get(0) == data, data
        if again and not state.is_open and 0 <= time_ns - state.last_ns < AGAIN_NS:
            state.counts.late += 1
            return None
        closed = self._admit(part, slot, data, time_ns)
        return self._close(marked=True) if closed is None and state.is_open else closed

    def _mark(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take the trigger where it is no object's frame."""
        state = self._state
        if len(data) < self._trigger.length:
            state.counts.short += 1
            return None
        if self._mark_monitor is not None and not self._mark_monitor.admits(self._trigger.can_id, data, time_ns):
            return None
        if not state.is_open:
            if self._is_late(time_ns, 2 * self._half_cycle_ns):
                state.counts.late += 1
                return None
            self._start(time_ns)  # a cycle without objects
        self._take_look(data)
        self._take_stamp(self._trigger.can_id, data, time_ns)
        state.last_ns = time_ns
        state.counts.used += 1
        return self._close(marked=True)

    def _awaits(self) -> int:
        return UNKNOWN

    def _unmarked(self) -> int:
        return int(self._foreign)
