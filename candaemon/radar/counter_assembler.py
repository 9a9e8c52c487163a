"""Scans distinguished by a counter that all their frames carry."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.objects.object_batch import ObjectBatch
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.scan import Scan, ScanCounts


class CounterAssembler(ScanAssembler):
    """Frames with the same counter are one scan; it closes when all came or another counter does.

    Attributes:
        straggling_ns: for how long after a closed scan's first frame others with its counter are late.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        super().__init__(sensor, counts)
        self._counters = sensor.counters
        # A counter of one bit shows the closed scan's value again two cycles later; a straggler comes long before.
        self.straggling_ns = 3 * self._half_cycle_ns

    def receive(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame of an object."""
        state = self._state
        if len(data) < self._lengths[part]:
            state.counts.short += 1
            return None
        counter = self._counters[part](data)
        if counter != state.counter:
            return self._turn_over(counter, part, slot, data, time_ns)
        frames = state.frames[part]
        if slot in frames:
            state.counts.duplicate += 1
            return None
        frames[slot] = data
        state.last_ns = time_ns
        state.awaited -= 1
        return None if state.awaited else self._close()

    def _turn_over(self, counter: int, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take the first frame of another scan."""
        state = self._state
        if counter == state.closed_counter and self._is_late(time_ns, self.straggling_ns):
            state.counts.late += 1
            return None
        closed = self._close() if state.is_open else None
        self._start(time_ns)
        state.counter = counter
        return self._put(part, slot, data, time_ns, closed)

    @property
    def settled_ns(self) -> int:
        """Time after which no frame is late, and no scan is open any longer, ns."""
        return max(self.straggling_ns, self.timeout_ns)

    def would_begin(self, part: int, data: bytes, time_ns: int) -> bool:
        """Return whether a frame would be the first one of a scan that awaits all there is, none being open."""
        state = self._state
        late = self._counters[part](data) == state.closed_counter and self._is_late(time_ns, self.straggling_ns)
        return all(state.expected) and not state.is_open and not late

    def begin_whole(self, part: int, slot: int, data: bytes, time_ns: int) -> None:  # noqa: ARG002  # as every receiver
        """Open a scan of which it is known that all frames come, and come together, with the first of them."""
        self._start(time_ns)
        self._state.counter = self._counters[part](data)

    def end_whole(self, part: int, slot: int, whole: ObjectBatch, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Close that scan, its objects read, at its last frame's time."""
        state = self._state
        state.last_ns = time_ns
        state.counter, state.closed_counter = None, state.counter
        stored, state.awaited = state.awaited, 0
        return self._settle(stored, 0, whole)

    def _close(self, *, marked: bool = False) -> Scan | None:
        state = self._state
        state.counter, state.closed_counter = None, state.counter
        return super()._close(marked=marked)
