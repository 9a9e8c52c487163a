"""Scans that close when all their frames came, or some time after the first."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.scan import Scan, ScanCounts


class TimeoutAssembler(ScanAssembler):
    """A scan closes when all came or its time is up.

    A second frame of the same message and object is a duplicate in the first half of the cycle; later it opens the next
    scan. Frames that come in the same half after the scan was closed are late.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        super().__init__(sensor, counts)
        self._straggling_ns = self._half_cycle_ns

    def receive(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame of an object."""
        state = self._state
        if len(data) < self._lengths[part]:
            state.counts.short += 1
            return None
        closed = None
        if not state.is_open:
            if self._is_late(time_ns, self._straggling_ns):
                state.counts.late += 1
                return None
            self._start(time_ns)
        elif slot in state.frames[part] and time_ns >= state.first_ns + self._half_cycle_ns:
            closed = self._close()
            self._start(time_ns)
        return self._put(part, slot, data, time_ns, closed)
