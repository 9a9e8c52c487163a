"""Frames into scans, whatever closes them: where frames are kept, and what a scan is made of when it closes.

A frame costs a lookup in the caller, two calls and a dictionary entry here; numpy comes in when a scan closes.

The caller holds `routes` of all its sensors and runs, for each frame or tick in order of time::

    for assembler in assemblers:            # worth doing only once `time_ns` reaches the earliest deadline
        if time_ns >= assembler.deadline_ns:
            scan = assembler.expire(time_ns)
    receive, part, slot = routes[can_id]
    scan = receive(part, slot, data, time_ns)

A scan that opens at t does not run out before t + `timeout_ns`, so the deadlines need a look only when the earliest of
those known, or the last look plus the shortest time-out, has come.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Final, TypeAlias

import numpy as np

from candaemon.binding.bound import BoundSensor
from candaemon.config.sensors import CounterScan, HeaderScan, TimeoutScan, TriggerScan
from candaemon.frames.times import NEVER_NS
from candaemon.objects.object_batch import ObjectBatch
from candaemon.protection.monitor import FrameGuard
from candaemon.radar.frame_validity import FrameValidity
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.radar.selection import Selection

FrameHandler: TypeAlias = Callable[[int, int, bytes, int], Scan | None]
"""Takes part, slot, payload and time stamp (ns) of a frame; gives the scan that it closes."""
Route: TypeAlias = tuple[FrameHandler, int, int]
"""Handler of a CAN id, and the part and slot to call it with."""

UNKNOWN: Final = -1
"""Frames awaited where a scan does not say how many it has: it is counted down from here and never reaches 0."""


class ScanAssembler(ABC):
    """Collects the frames of one sensor until their scan closes.

    Args:
        sensor: the bound sensor.
        counts: where frames are counted; default: counts of its own.

    Attributes:
        counts: what became of the frames.
        routes: each CAN id the sensor takes, and who receives it.
        deadline_ns: when the open scan is closed as it is, `NEVER_NS` where none is open.
        timeout_ns: how long after its first frame that is.

    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        settings, reader = sensor.settings, sensor.reader
        self.counts = ScanCounts() if counts is None else counts
        self.deadline_ns = NEVER_NS
        self.timeout_ns: Final = round(settings.timeout * 1e9)
        self._sensor, self._reader = sensor.index, reader
        self._slots, self._multiplexed = reader.slots, reader.multiplexed
        self._latency_ns = round(settings.latency * 1e9)
        self._from_last = settings.time_from == "last"
        self._half_cycle_ns = round(settings.cycle_time * 5e8)
        self._messages = [[(message.can_id, message.length) for message in part.messages] for part in reader.parts]
        # Some radars give the last slots shorter frames: here the least, to read a counter; `_admit` knows each.
        self._lengths = [min(message.length for message in part.messages) for part in reader.parts]
        self._alike = [len({message.length for message in part.messages}) == 1 for part in reader.parts]
        self._guards = [None if plan is None else FrameGuard(plan, self.counts) for plan in sensor.guards]
        self._mark_guard = None if sensor.mark_guard is None else FrameGuard(sensor.mark_guard, self.counts)
        self._trust = FrameValidity(settings.protection, self.counts, patience=2 * settings.cycle_time)
        self._selection = Selection(sensor, self.counts)
        self._required = [part.index for part in reader.parts if not part.optional]
        self._optional = [part.index for part in reader.parts if part.optional]
        # An optional message is awaited if the scan before had it: a radar is set to send it or not.
        self._expected = [True] * len(reader.parts)
        self._every_slot = np.arange(reader.slots, dtype=np.int64)
        self._every_slot.flags.writeable = False  # scans share it
        self._slot_list = list(range(reader.slots))
        self._in_order = itemgetter(*range(reader.slots)) if reader.slots > 1 else None
        self._frames: list[dict[int, bytes]] = [{} for _ in reader.parts]
        self._open = False
        self._awaited = UNKNOWN
        self._first_ns = self._last_ns = 0
        self._closed_ns = -NEVER_NS
        self.routes: Mapping[int, Route] = self._all_routes()

    @abstractmethod
    def receive(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame of an object, any scan it belongs to.

        Args:
            part: which of the object's messages it is.
            slot: of the object.
            data: payload, unchecked.
            time_ns: time stamp.

        Returns:
            The scan that this closes.

        """

    def expire(self, time_ns: int) -> Scan | None:
        """Close the open scan if its time is up, and return it."""
        return self._close() if time_ns >= self.deadline_ns else None

    def flush(self) -> Scan | None:
        """Close the open scan, because no more frames come, and return it."""
        return self._close() if self._open else None

    @property
    def trust(self) -> float:
        """Share of the sensor's frames that could be used of late, from 0 to 1."""
        return self._trust.share

    @property
    def takes_all_alike(self) -> bool:
        """Whether each frame of an object's slot is taken as it is: of one length, unguarded, awaited."""
        return all(receive == self.receive for receive, _, _ in self.routes.values())

    def _all_routes(self) -> dict[int, Route]:
        plain = [
            self._alike[part] and self._guards[part] is None and part in self._required and not self._multiplexed
            for part in range(len(self._frames))
        ]
        return {
            can_id: (self.receive if plain[part] else self._admit, part, slot)
            for can_id, (part, slot) in self._reader.routes.items()
        }

    def _admit(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame that needs more: its own length, a checksum verified, its object read, its part awaited."""
        can_id, length = self._messages[part][slot]
        if len(data) < length:
            self.counts.short += 1
            return None
        guard = self._guards[part]
        if guard is not None and not guard.admits(can_id, data, time_ns):
            self._trust.refused(time_ns)
            return None
        if slot < 0:
            slot = self._reader.object_key(part, data)
            if slot < 0:
                self.counts.surplus += 1
                return None
        if not self._expected[part]:
            self._expected[part] = True
            if self._awaited > 0:
                self._awaited += self._objects() or 0
        return self.receive(part, slot, data, time_ns)

    def _start(self, time_ns: int) -> None:
        """Open a scan with a frame of this time."""
        self._open = True
        self._first_ns = self._last_ns = time_ns
        self.deadline_ns = time_ns + self.timeout_ns
        self._awaited = self._awaits()

    def _put(self, part: int, slot: int, data: bytes, time_ns: int, closed: Scan | None) -> Scan | None:
        """Keep a frame of the open scan.

        Returns:
            The scan before, where the frame closed that; otherwise this one, if the frame was its last.

        """
        frames = self._frames[part]
        if slot in frames:
            self.counts.duplicate += 1
            return closed
        frames[slot] = data
        self._last_ns = time_ns
        self._awaited -= 1
        # One call gives one scan: if it closed the one before, a scan of a single frame waits for its time-out.
        if self._awaited or closed is not None:
            return closed
        return self._close()

    def _straggles(self, time_ns: int, span_ns: int) -> bool:
        """Tell whether a frame came within a span of the last closed scan's first one."""
        return self._closed_ns <= time_ns < self._closed_ns + span_ns

    def _objects(self) -> int | None:
        """Say how many objects the open scan should bring frames of, None where it does not tell."""
        return None if self._multiplexed else self._slots

    def _awaits(self) -> int:
        """Say how many frames of objects make the open scan complete, `UNKNOWN` where it does not close so."""
        objects = self._objects()
        return UNKNOWN if objects is None else objects * sum(self._expected)

    def _limit(self) -> int:
        """Say from which slot on objects do not hold."""
        return NEVER_NS

    def _unmarked(self) -> int:
        """Count the messages beside the objects' that the scan lacks."""
        return 0

    def _close(self) -> Scan | None:
        """Make the scan of what came, None if too much of it failed, and be ready for the next."""
        frames = self._frames
        stored = sum(map(len, frames))
        scan = self._settle(stored, self._missing(stored) + self._unmarked())
        for part in self._optional:
            self._expected[part] = bool(frames[part])
        for column in frames:
            column.clear()
        return scan

    def _settle(self, stored: int, missing: int, whole: ObjectBatch | None = None) -> Scan | None:
        """Count a scan of so many frames and close it; return it where it can be trusted.

        Args:
            stored: frames in it.
            missing: frames that should be in it and are not.
            whole: all its objects, where they were read already.

        """
        counts, scan = self.counts, None
        if self._trust.damages(stored):
            counts.discarded += stored
            counts.distrusted += 1
        else:
            if whole is not None:
                scan = self._selection.scan(self._time_ns(), whole, self._every_slot, missing)
            else:
                slots = self._complete_objects()
                scan = self._read(slots, missing) if slots else self._nothing(missing)
            counts.used += stored
            counts.scans += 1
        counts.missing += missing
        counts.incomplete += missing > 0
        self._trust.closed(self._last_ns)
        self._open, self.deadline_ns, self._closed_ns = False, NEVER_NS, self._first_ns
        return scan

    def _missing(self, stored: int) -> int:
        """Count the objects' frames that did not come; of optional messages only if one came."""
        objects = self._objects()
        if objects is None:
            objects = len(set[int]().union(*self._frames))
        parts = len(self._required) + sum(1 for part in self._optional if self._frames[part])
        return max(0, objects * parts - stored)

    def _complete_objects(self) -> list[int]:
        """List the slots whose required messages came, in order."""
        frames, counts = self._frames, self.counts
        first, *others = [frames[part] for part in self._required]
        limit = self._limit()
        if len(first) == self._slots and not others and limit == NEVER_NS and not self._multiplexed:
            return self._slot_list
        common = set(first).intersection(*others)
        if others:
            counts.rejected += len(set(first).union(*others)) - len(common)
        slots = sorted(common)
        if len(slots) > self._slots:
            extra = slots[self._slots :]
            surplus = sum(slot in column for column in frames for slot in extra)
            counts.surplus += surplus
            counts.used -= surplus
            slots = slots[: self._slots]
        return slots if limit == NEVER_NS else [slot for slot in slots if slot < limit]

    def _read(self, slots: list[int], missing: int) -> Scan:
        """Read the objects of these slots."""
        full = len(slots) == self._slots and not self._multiplexed
        batch = self._reader.read([self._payloads(column, slots, full) for column in self._frames])
        slot = self._every_slot if full else np.array(slots, np.int64)
        return self._selection.scan(self._time_ns(), batch, slot, missing)

    def _payloads(self, column: Mapping[int, bytes], slots: list[int], full: bool) -> Sequence[bytes | None]:
        """Take the payloads of these slots, None where one did not come."""
        if full and len(column) == self._slots and self._in_order is not None:
            payloads: tuple[bytes, ...] = self._in_order(column)
            return payloads
        return list(map(column.get, slots))

    def _nothing(self, missing: int) -> Scan:
        none = np.empty(0, np.int64)
        values = np.empty((len(self._reader.quantities), 0))
        return Scan(self._time_ns(), self._sensor, none, none, np.empty(0, np.bool_), values, missing)

    def _time_ns(self) -> int:
        return (self._last_ns if self._from_last else self._first_ns) - self._latency_ns


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
        return NEVER_NS if self._count is None or self._header.used_only else self._count

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
