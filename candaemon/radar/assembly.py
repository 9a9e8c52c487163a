"""Frames into scans: what all assemblers share, from the first frame of a scan to the objects it is read into.

What closes a scan is each assembler's own: a counter (`counter_assembler`), a time-out (`timeout_assembler`), a trigger
message (`trigger_assembler`) or the count in a header (`header_assembler`).

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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Final

import numpy as np

from candaemon.binding.bound import BoundSensor
from candaemon.frames.times import LONG_AGO_NS, NEVER_NS
from candaemon.objects.object_batch import ObjectBatch
from candaemon.objects.scan_messages import LookReader
from candaemon.protection.monitor import FrameMonitor, FrameMonitorState
from candaemon.radar.claimed_frames import ClaimedFrames, ClaimedRoute, Route
from candaemon.radar.frame_validity import FrameValidity, FrameValidityState
from candaemon.radar.measurement_time import MeasurementTime, TimeStampState
from candaemon.radar.plausibility import ObjectPlausibilityState, count_keys
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.radar.selection import Selection

UNKNOWN: Final = -1
"""Frames awaited where a scan does not say how many it has: it is counted down from here and never reaches 0."""
AGAIN_NS: Final = 5_000_000
"""Within which a frame that is sent twice comes again: at once on a bus, after some ms through gateways."""
LONGEST_PAYLOAD: Final = 64
BUNCH: Final = 4
"""Frames that come at once at most: adapters on USB deliver some together."""


@dataclass(slots=True)
class AssemblerState:
    """What an assembler remembers between two frames.

    Attributes:
        counts: what became of the frames.
        monitors: of each part, None where its frames are not monitored.
        mark_monitor: of the header or trigger, None where it needs none.
        validity: of the valid-frame ratio.
        plausibility: of the objects.
        expected: of each part, whether its frames are awaited. An optional message is awaited if the scan before had
            it: a radar is set to send it or not.
        frames: of each part, the payloads of the open scan by slot.
        is_open: whether a scan is open.
        awaited: frames of objects that the open scan still lacks; `UNKNOWN` and less where that is not known.
        first_ns, last_ns: time of the first and latest frame of the open scan, or of the last closed one.
        closed_ns: time of the first frame of the last closed scan.
        deadline_ns: when the open scan is closed as it is, `NEVER_NS` where none is open.
        counter: of the open scan, where a counter distinguishes scans.
        closed_counter: of the last closed scan.
        count: objects that the header of the open scan announces; None before the header.
        headers: objects that each of its headers announces; −1 before it, empty where there are none.
        measurement: the latest header's measurement counter; −1 where there is none.
        marks: the latest header of each number, or the object's frame that closed the latest scan.
        look: of the open scan, where its header or trigger says it; −1 before.
        stamp: of the sensor's own time stamps.
    """

    counts: ScanCounts
    monitors: list[FrameMonitorState | None]
    mark_monitor: FrameMonitorState | None
    validity: FrameValidityState
    plausibility: ObjectPlausibilityState
    expected: list[bool]
    frames: list[dict[int, bytes]]
    is_open: bool = False
    awaited: int = UNKNOWN
    first_ns: int = 0
    last_ns: int = 0
    closed_ns: int = -NEVER_NS
    deadline_ns: int = NEVER_NS
    counter: int | None = None
    closed_counter: int | None = None
    count: int | None = None
    headers: list[int] = field(default_factory=list)
    measurement: int = -1
    marks: dict[int, bytes] = field(default_factory=dict)
    look: int = -1
    stamp: TimeStampState = field(default_factory=TimeStampState)


class ScanAssembler(ABC):
    """Collects the frames of one sensor until their scan closes.

    Args:
        sensor: the bound sensor.
        counts: where frames are counted; default: counts of its own.

    Attributes:
        routes: each CAN id the sensor takes, and who receives it.
        claimed: the CAN ids among them of which only frames with certain values are the sensor's.
        timeout_ns: from the first frame of a scan to its deadline.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts | None = None) -> None:
        settings, reader = sensor.settings, sensor.reader
        counts = ScanCounts() if counts is None else counts
        self.timeout_ns: Final = round(settings.timeout * 1e9)
        self._sensor, self._reader = sensor.index, reader
        self._slots, self._multiplexed = reader.places, reader.multiplexed
        self._listed_in_order = any(entry.id_signal is False for entry in settings.objects.messages)
        self._points, self._point = reader.points, np.arange(reader.points)
        self._latency_ns = round(settings.latency * 1e9)
        self._from_last = settings.time_from == "last"
        self._half_cycle_ns = round(settings.cycle_time * 5e8)
        self._messages = [[(message.can_id, message.length) for message in part.messages] for part in reader.layouts]
        # Some radars give the last slots shorter frames: here the least, to read a counter; `_admit` knows each.
        self._lengths = [min(message.length for message in part.messages) for part in reader.layouts]
        self._alike = [len({message.length for message in part.messages}) == 1 for part in reader.layouts]
        self._monitors = [None if each is None else FrameMonitor(each, counts) for each in sensor.monitors]
        self._mark_monitor = None if sensor.mark_monitor is None else FrameMonitor(sensor.mark_monitor, counts)
        self._validity = FrameValidity(settings.protection, counts, longest_gap=2 * settings.cycle_time)
        self._selection = Selection(sensor, counts)
        self._required = [part.index for part in reader.layouts if not part.optional]
        self._optional = [part.index for part in reader.layouts if part.optional]
        self._every_slot = np.arange(reader.slots, dtype=np.int64)
        self._every_slot.flags.writeable = False  # scans share it
        self._slot_list = list(range(reader.places))
        self._in_order = itemgetter(*range(reader.places)) if reader.places > 1 else None
        self._keys = count_keys(sensor)
        self._mark_claims = sensor.mark_claims
        self._look, self._views = sensor.look, sensor.settings.views
        stamps, field_ = settings.time_stamp, sensor.stamp
        self._times = (
            None
            if stamps is None or field_ is None
            else MeasurementTime(stamps, field_, 2 * self._half_cycle_ns, counts)
        )
        self._state = AssemblerState(
            counts,
            [None if monitor is None else monitor.state for monitor in self._monitors],
            None if self._mark_monitor is None else self._mark_monitor.state,
            self._validity.state,
            self._selection.plausibility.state,
            [True] * len(reader.layouts),
            [{} for _ in reader.layouts],
        )
        if self._times is not None:
            self._state.stamp = self._times.state
        self.claimed: dict[int, tuple[ClaimedRoute, ...]] = {}
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
        return self._close() if self._state.is_open else None

    @property
    def state(self) -> AssemblerState:
        """What it remembers; another assembler of the same configuration goes on with it.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        return self._state

    @state.setter
    def state(self, state: AssemblerState) -> None:
        self._require_fit(state)
        self._state = state
        for monitor, of_monitor in zip(
            (*self._monitors, self._mark_monitor), (*state.monitors, state.mark_monitor), strict=True
        ):
            if monitor is not None and of_monitor is not None:
                monitor.faults, monitor.state = state.counts, of_monitor
        self._validity.counts, self._validity.state = state.counts, state.validity
        self._selection.counts = self._selection.plausibility.counts = state.counts
        self._selection.plausibility.state = state.plausibility
        if self._times is not None:
            self._times.counts, self._times.state = state.counts, state.stamp

    @property
    def counts(self) -> ScanCounts:
        """What became of the frames."""
        return self._state.counts

    @property
    def deadline_ns(self) -> int:
        """When the open scan is closed as it is, `NEVER_NS` where none is open."""
        return self._state.deadline_ns

    def closes_after_ns(self, now_ns: int, frame_ns: int) -> int:
        """Return a time before which no frame closes the open scan, or the next where none is open.

        A scan that lacks n frames lacks them for the time that they take on the bus, but for those that an adapter may
        deliver together. No scan follows another within half a cycle. Where frames were lost the next scan's may come
        sooner, and close it.

        Args:
            now_ns: a time by which all frames that had come were received.
            frame_ns: what a frame takes on the bus at least.
        """
        state = self._state
        awaited = state.awaited if state.is_open else self._awaits()
        return max(now_ns + (awaited - BUNCH) * frame_ns, state.closed_ns + self._half_cycle_ns)

    @property
    def valid_share(self) -> float:
        """Share of the sensor's frames that could be used of late, from 0 to 1."""
        return self._validity.state.share

    @property
    def takes_whole_scans(self) -> bool:
        """Whether a frame of a whole scan needs no more than its length and the right checksum to be taken."""
        own = all(receive in (self.receive, self._admit) for receive, _, _ in self.routes.values())
        return own and not (self._multiplexed or self._reader.paged)

    def _all_routes(self) -> dict[int, Route]:
        plain = [
            self._alike[part]
            and self._monitors[part] is None
            and part in self._required
            and not self._multiplexed
            and not self._reader.paged
            for part in range(len(self._lengths))
        ]
        routes: dict[int, Route] = {
            can_id: (self.receive if plain[part] else self._admit, part, slot)
            for can_id, (part, slot) in self._reader.routes.items()
        }
        for can_id, claims in self._reader.claims.items():
            self.claimed[can_id] = tuple(
                (
                    claim.length,
                    claim.read,
                    claim.value,
                    (self.receive if plain[claim.layout] else self._admit, claim.layout, claim.place),
                )
                for claim in claims
            )
            routes[can_id] = (ClaimedFrames(self.claimed[can_id]).receive, 0, 0)
        if self._times is not None and self._times.stamp.own:
            routes[self._times.stamp.message.can_id] = (self._receive_stamp, 0, 0)
        return routes

    def _add_mark(self, routes: dict[int, Route], can_id: int, route: Route) -> None:
        """Add the route of a header or trigger; where a value says that a frame is one, beside the objects'."""
        claim = self._mark_claims.get(can_id)
        if claim is None:
            routes[can_id] = route
            return
        self.claimed[can_id] = (*self.claimed.get(can_id, ()), (claim.length, claim.read, claim.value, route))
        routes[can_id] = (ClaimedFrames(self.claimed[can_id]).receive, 0, 0)

    def _admit(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame that needs more: its own length, a checksum verified, its object read, its part awaited."""
        state = self._state
        can_id, length = self._messages[part][slot]
        if len(data) < length:
            state.counts.short += 1
            return None
        monitor = self._monitors[part]
        if monitor is not None and not monitor.admits(can_id, data, time_ns):
            self._validity.refused(time_ns)
            return None
        if slot < 0 or self._reader.paged:
            if slot < 0:
                slot = len(state.frames[part]) if self._listed_in_order else self._reader.object_key(part, data)
            slot = self._reader.place_of(part, slot, data)
            if not 0 <= slot < self._keys:
                state.counts.surplus += 1
                return None
        if not state.expected[part]:
            state.expected[part] = True
            if state.awaited > 0:
                state.awaited += self._objects() or 0
        return self.receive(part, slot, data, time_ns)

    def _start(self, time_ns: int) -> None:
        """Open a scan with a frame of this time."""
        state = self._state
        state.is_open = True
        state.first_ns = state.last_ns = time_ns
        state.deadline_ns = time_ns + self.timeout_ns
        state.awaited = self._awaits()

    def _put(self, part: int, slot: int, data: bytes, time_ns: int, closed: Scan | None) -> Scan | None:
        """Keep a frame of the open scan.

        Returns:
            The scan before, where the frame closed that; otherwise this one, if the frame was its last.
        """
        state = self._state
        frames = state.frames[part]
        if slot in frames:
            state.counts.duplicate += 1
            return closed
        frames[slot] = data
        state.last_ns = time_ns
        state.awaited -= 1
        # One call gives one scan: if it closed the one before, a scan of a single frame waits for its time-out.
        if state.awaited or closed is not None:
            return closed
        return self._close()

    def _is_late(self, time_ns: int, span_ns: int) -> bool:
        """Return whether a frame came within a span of the last closed scan's first one."""
        closed_ns = self._state.closed_ns
        return closed_ns <= time_ns < closed_ns + span_ns

    def _objects(self) -> int | None:
        """Return how many objects the open scan should bring frames of, None where it does not say."""
        return None if self._multiplexed else self._slots

    def _awaits(self) -> int:
        """Return how many frames of objects make the open scan complete, `UNKNOWN` where it does not close so."""
        objects = self._objects()
        return UNKNOWN if objects is None else objects * sum(self._state.expected)

    def _count(self) -> int:
        """Return how many objects the open scan says that it has; more than there can be where it does not."""
        return NEVER_NS

    def _limit(self) -> int:
        """Return from which place on frames do not hold."""
        return NEVER_NS

    def _unmarked(self) -> int:
        """Count the messages beside the objects' that the scan lacks, where it is not closed by one of them."""
        return 0

    def _close(self, *, marked: bool = False) -> Scan | None:
        """Return the scan of what came, None if too much of it failed, and be ready for the next.

        Args:
            marked: the message beside the objects' that closes a scan has come.
        """
        state = self._state
        stored = sum(map(len, state.frames))
        scan = self._settle(stored, self._missing(stored) + (0 if marked else self._unmarked()))
        for part in self._optional:
            state.expected[part] = bool(state.frames[part])
        for column in state.frames:
            column.clear()
        return scan

    def _settle(self, stored: int, missing: int, whole: ObjectBatch | None = None) -> Scan | None:
        """Count a scan of so many frames and close it; return it where enough of its frames are valid.

        Args:
            stored: frames in it.
            missing: frames that should be in it and are not.
            whole: all its objects, where they were read already.
        """
        state, scan = self._state, None
        counts = state.counts
        if self._validity.damages(stored):
            counts.discarded += stored
            counts.distrusted += 1
        else:
            if whole is not None:
                scan = self._selection.scan(self._time_ns(), whole, self._every_slot, missing)
            else:
                slots = self._complete_objects()
                scan = self._read(slots, missing) if slots else self._nothing(missing)
            if self._look is not None:
                scan = replace(scan, look=self._known_look(self._look))
            counts.used += stored
            counts.scans += 1
        counts.missing += missing
        counts.incomplete += missing > 0
        self._validity.closed(state.last_ns)
        state.is_open, state.deadline_ns, state.closed_ns, state.look = False, NEVER_NS, state.first_ns, -1
        if self._times is not None:
            self._times.begin_next()
        return scan

    def _known_look(self, look: LookReader) -> int:
        """Return which of the configured looks the open scan is; −1 where it does not say, or is none, which counts."""
        if look.part is None:
            found = self._state.look
        else:
            data = next(iter(self._state.frames[look.part].values()), None)
            if data is None:  # a scan without objects
                return -1
            found = look.read(data)
        if found in self._views:
            return found
        self._state.counts.unknown_look += 1
        return -1

    def _take_look(self, data: bytes) -> None:
        """Take the look from the scan's header or trigger, where that says it."""
        if self._look is not None and self._look.part is None:
            self._state.look = self._look.read(data)

    def _take_stamp(self, can_id: int, data: bytes, time_ns: int) -> None:
        """Take the time stamp from the scan's header or trigger, where that has it."""
        times = self._times
        if times is not None and times.stamp.part is None and times.stamp.message.can_id == can_id:
            times.take(data, time_ns)

    def _receive_stamp(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:  # noqa: ARG002  # as every receiver
        """Take the message that is there for the time stamp alone: of the open scan, or of the next one."""
        times, state = self._times, self._state
        if times is None or len(data) < times.stamp.message.length:
            state.counts.short += 1
            return None
        state.counts.used += 1
        times.take_alone(data, time_ns, state.first_ns if state.is_open else None)
        return None

    def _missing(self, stored: int) -> int:
        """Count the objects' frames that did not come; of optional messages only if one came."""
        frames, objects = self._state.frames, self._objects()
        if objects is None:
            objects = len(set[int]().union(*frames))
        parts = len(self._required) + sum(1 for part in self._optional if frames[part])
        return max(0, objects * parts - stored)

    def _complete_objects(self) -> list[int]:
        """List the slots whose required messages came, in order."""
        frames, counts = self._state.frames, self._state.counts
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
        batch = self._reader.read([self._payloads(column, slots, full) for column in self._state.frames])
        slot = self._every_slot if full else np.array(slots, np.int64)
        if self._points > 1:
            if not full:
                slot = (slot[:, None] * self._points + self._point).ravel()
            batch = replace(batch, valid=batch.valid & (slot < self._count()))
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
        """Return when the scan to be closed was measured."""
        state, times = self._state, self._times
        arrival_ns = state.last_ns if self._from_last else state.first_ns
        if times is None:
            return arrival_ns - self._latency_ns
        if times.stamp.part is not None and state.frames[times.stamp.part]:
            times.take(next(iter(state.frames[times.stamp.part].values())), state.first_ns)
        return times.measured_ns(state.first_ns, arrival_ns) - self._latency_ns

    def _require_fit(self, state: AssemblerState) -> None:
        """Refuse a state of another configuration, or one that no assembler comes to.

        Raises:
            ValueError: it is one; says what does not fit.
        """
        parts = len(self._lengths)
        if not len(state.monitors) == len(state.expected) == len(state.frames) == parts:
            raise ValueError(f"a scan of other than {parts} messages")
        monitors = zip((*self._monitors, self._mark_monitor), (*state.monitors, state.mark_monitor), strict=True)
        if len(state.headers) != len(self._state.headers):
            raise ValueError(f"{len(state.headers)} headers, expected {len(self._state.headers)}")
        if any((monitor is None) != (of_monitor is None) for monitor, of_monitor in monitors):
            raise ValueError("other frame guards than the configuration's")
        if state.is_open != (state.deadline_ns != NEVER_NS):
            raise ValueError("an open scan without a deadline, or a deadline without a scan")
        if not all(abs(time_ns) <= -LONG_AGO_NS for time_ns in (state.first_ns, state.last_ns)):
            raise ValueError("a scan's time is out of range")
        for part, frames in enumerate(state.frames):
            for slot, data in frames.items():
                if not 0 <= slot < self._keys:
                    raise ValueError(f"slot {slot} of {self._keys}")
                _, length = self._messages[part][slot % len(self._messages[part])]
                if not length <= len(data) <= LONGEST_PAYLOAD:
                    raise ValueError(f"a frame of {len(data)} bytes, expected {length} to {LONGEST_PAYLOAD}")
