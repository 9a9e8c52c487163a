"""What closes a scan: a change of counter, a trigger message, a header's count, or time.

Whatever closes it otherwise, a scan closes `timeout` after its first frame and is used as it is.
"""

from __future__ import annotations

from candaemon.binding.batch import ObjectBatch
from candaemon.binding.bound import BoundSensor
from candaemon.config.sensors import CounterScan, HeaderScan, TimeoutScan, TriggerScan
from candaemon.sensing.assembly import NEVER, UNKNOWN, Route, ScanAssembler
from candaemon.sensing.scan import Scan, ScanCounts


class CounterAssembler(ScanAssembler):
    """Frames with the same counter are one scan; it closes when all came or another counter does."""

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        super().__init__(sensor, counts)
        self._counters = sensor.counters
        self._counter: int | None = None
        self._closed_counter: int | None = None
        # A counter of one bit shows the closed scan's value again two cycles later; a straggler comes long before.
        self._straggling_ns = 3 * self._half_cycle_ns

    def receive(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame of an object."""
        if len(data) < self._lengths[part]:
            self.counts.short += 1
            return None
        counter = self._counters[part](data)
        if counter != self._counter:
            return self._turn_over(counter, part, slot, data, time_ns)
        frames = self._frames[part]
        if slot in frames:
            self.counts.duplicate += 1
            return None
        frames[slot] = data
        self._last_ns = time_ns
        self._awaited -= 1
        return None if self._awaited else self._close()

    def _turn_over(self, counter: int, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take the first frame of another scan."""
        if counter == self._closed_counter and self._straggles(time_ns, self._straggling_ns):
            self.counts.late += 1
            return None
        closed = self._close() if self._open else None
        self._start(time_ns)
        self._counter = counter
        return self._put(part, slot, data, time_ns, closed)

    def would_begin(self, part: int, data: bytes, time_ns: int) -> bool:
        """Tell whether a frame would be the first one of a scan, none being open."""
        late = self._counters[part](data) == self._closed_counter and self._straggles(time_ns, self._straggling_ns)
        return not self._open and not late

    def begin_whole(self, part: int, slot: int, data: bytes, time_ns: int) -> None:  # noqa: ARG002  # as every receiver
        """Open a scan of which it is known that all frames come, and come together, with the first of them."""
        self._start(time_ns)
        self._counter = self._counters[part](data)

    def end_whole(self, part: int, slot: int, whole: ObjectBatch, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Close that scan, its objects read, at its last frame's time."""
        self._last_ns = time_ns
        self._counter, self._closed_counter = None, self._counter
        return self._settle(self._awaited, 0, whole)

    def _close(self) -> Scan | None:
        self._counter, self._closed_counter = None, self._counter
        return super()._close()


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
        if len(data) < self._lengths[part]:
            self.counts.short += 1
            return None
        closed = None
        if not self._open:
            if self._straggles(time_ns, self._straggling_ns):
                self.counts.late += 1
                return None
            self._start(time_ns)
        elif slot in self._frames[part] and time_ns >= self._first_ns + self._half_cycle_ns:
            closed = self._close()
            self._start(time_ns)
        return self._put(part, slot, data, time_ns, closed)


class TriggerAssembler(TimeoutAssembler):
    """A scan closes with a certain message; what comes after it is the next scan's."""

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        trigger = sensor.trigger
        assert trigger is not None, "binding gives a trigger with close: trigger"  # noqa: S101  # a promise of binding's
        self._trigger = trigger
        self._foreign = trigger.can_id not in sensor.reader.routes
        self._triggered = False
        super().__init__(sensor, counts)
        self._straggling_ns = 0

    def _all_routes(self) -> dict[int, Route]:
        routes = super()._all_routes()
        if self._foreign:
            routes[self._trigger.can_id] = (self._mark, 0, 0)
        else:
            _, part, slot = routes[self._trigger.can_id]
            routes[self._trigger.can_id] = (self._receive_last, part, slot)
        return routes

    def _receive_last(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take the object's frame that closes the scan; even one that cannot be used says that the scan is over."""
        closed = self._admit(part, slot, data, time_ns)
        return self._finish() if closed is None and self._open else closed

    def _mark(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take the trigger where it is no object's frame."""
        if len(data) < self._trigger.length:
            self.counts.short += 1
            return None
        if self._mark_guard is not None and not self._mark_guard.admits(self._trigger.can_id, data, time_ns):
            return None
        if not self._open:
            if self._straggles(time_ns, 2 * self._half_cycle_ns):
                self.counts.late += 1
                return None
            self._start(time_ns)  # a cycle without objects
        self._last_ns = time_ns
        self.counts.used += 1
        return self._finish()

    def _finish(self) -> Scan | None:
        self._triggered = True
        scan = self._close()
        self._triggered = False
        return scan

    def _awaits(self) -> int:
        return UNKNOWN

    def _unmarked(self) -> int:
        return int(self._foreign and not self._triggered)


class HeaderAssembler(TimeoutAssembler):
    """A scan opens with a header that says how many objects there are; it closes when all came or the next header does.

    Frames may come before their header. A scan whose header was lost closes when its time is up.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        header = sensor.header
        assert header is not None, "binding gives a header with close: header"  # noqa: S101  # a promise of binding's
        self._header = header
        self._count: int | None = None
        self._measurement = -1
        super().__init__(sensor, counts)

    def _all_routes(self) -> dict[int, Route]:
        return super()._all_routes() | {self._header.can_id: (self._begin, 0, 0)}

    def _begin(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take a header."""
        if len(data) < self._header.message.length:
            self.counts.short += 1
            return None
        if self._mark_guard is not None and not self._mark_guard.admits(self._header.can_id, data, time_ns):
            return None
        count, measurement = self._header.read(data)
        if self._open and self._count is not None and measurement >= 0 and measurement == self._measurement:
            self.counts.duplicate += 1
            return None
        self._note(measurement)
        closed = None
        if self._open and (self._count is not None or time_ns >= self._first_ns + self._half_cycle_ns):
            closed = self._close()
        if not self._open:
            self._start(time_ns)
        self.counts.used += 1
        self._count = max(count, 0)
        self._last_ns = time_ns
        self._awaited = self._awaits() - sum(map(len, self._frames))
        # One call gives one scan: after the one before, a scan without objects waits for its time-out.
        if self._awaited > 0 or closed is not None:
            return closed
        return self._close()

    def _note(self, measurement: int) -> None:
        """Count the scans that never came; a jump by half the counter's range or more is a restart."""
        if measurement >= 0 and self._measurement >= 0:
            skipped = (measurement - self._measurement - 1) % self._header.period
            if skipped < self._header.period // 2:
                self.counts.skipped += skipped
        self._measurement = measurement

    def _objects(self) -> int | None:
        return self._count if self._header.used_only else self._slots

    def _awaits(self) -> int:
        return UNKNOWN if self._count is None else super()._awaits()

    def _limit(self) -> int:
        return NEVER if self._count is None or self._header.used_only else self._count

    def _unmarked(self) -> int:
        return int(self._count is None)

    def _close(self) -> Scan | None:
        scan = super()._close()
        self._count = None
        return scan


def make_assembler(sensor: BoundSensor, counts: ScanCounts | None = None) -> ScanAssembler:
    """Make the assembler that a sensor's configuration asks for.

    Args:
        sensor: the bound sensor.
        counts: where frames are counted; default: counts of its own.

    """
    match sensor.settings.scan:
        case CounterScan():
            return CounterAssembler(sensor, counts)
        case TriggerScan():
            return TriggerAssembler(sensor, counts)
        case HeaderScan():
            return HeaderAssembler(sensor, counts)
        case TimeoutScan():
            return TimeoutAssembler(sensor, counts)
