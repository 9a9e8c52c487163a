"""Who receives the frames of a block, found for all of them at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Bytes, Indices, Integers
from candaemon.binding.bound import BoundSensor
from candaemon.frames.frame_block import FrameBlock
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.block_scans import WholeScans, whole_scans
from candaemon.radar.claimed_frames import Route
from candaemon.radar.scan import Scan

Event: TypeAlias = tuple[int, int, Callable[[int, int, Any, int], Scan | None], int, int, Any]
"""Time, how many frames before it nobody receives, the receiver, and the part, slot and payload to call it with: as a
`Route`, or with the objects of a whole scan, or the values of a frame that is used for sure; or, of frames that come
one after the other and are received together, begin, end and a `Succession`, time and passed those of the last."""


class Routed(NamedTuple):
    """A block, ready to be received.

    Attributes:
        events: in order of time.
        unheard: times of the frames that nobody receives, and of ticks, ascending: only their times count.
        frames: of each bus.
        unknown: those of them that nobody receives.
    """

    events: Iterator[Event]
    unheard: list[int]
    frames: list[int]
    unknown: list[int]


class JudgedFrames(Protocol):
    """Who receives frames that can be judged many at a time."""

    def judged(self, times_ns: Integers, payloads: Sequence[bytes]) -> list[Sequence[float] | None]:
        """Return the values of frames that are used for sure; None of the others.

        Args:
            times_ns: their time stamps (n,), in order.
            payloads: their payloads.
        """
        ...

    def receive_judged(self, part: int, slot: int, values: Sequence[float], time_ns: int) -> None:
        """Take the values of one."""
        ...


class SteadyReceiver(Protocol):
    """Who receives frames many at a time that come one after the other."""

    def judged(self, times_ns: Integers, message: Indices, payloads: Bytes, lengths: Bytes) -> Booleans:
        """Return which frames are used for sure (n,), and keep them.

        Args:
            times_ns: their time stamps (n,), in order.
            message: which message each is (n,).
            payloads: their payloads (n, bytes), zeros after the end of each.
            lengths: of those, bytes (n,).
        """
        ...

    def receive(self, begin: int, end: int, data: Any, time_ns: int) -> None:
        """Take the kept frames from `begin` to before `end`."""
        ...


class Succession(NamedTuple):
    """The frames that one event is of several: as the first two of `Event` for each.

    Attributes:
        time_ns: of all such frames of a block.
        passed: likewise.
    """

    time_ns: list[int]
    passed: list[int]


class BlockRouter:
    """Routes blocks.

    Args:
        routes: for each bus, who receives an identifier.
        sensors: the bound sensors.
        assemblers: of their scans.
        judges: by bus and identifier, who receives frames that are judged together.
        steady: who receives many frames in one event, and the number of each message by bus and identifier; none of
            them is among the judges'.
    """

    def __init__(
        self,
        routes: Sequence[Mapping[int, Route]],
        sensors: Sequence[BoundSensor],
        assemblers: Sequence[ScanAssembler],
        judges: Mapping[tuple[int, int], JudgedFrames],
        steady: tuple[SteadyReceiver, Mapping[tuple[int, int], int]] | None = None,
    ) -> None:
        self._buses = len(routes)
        known = {_key(bus, can_id): route for bus, each in enumerate(routes) for can_id, route in each.items()}
        self._keys = np.array(sorted(known), np.int64)
        # the place of frames that nobody receives
        self._nobody = len(known)
        in_order = [known[key] for key in sorted(known)]
        self._receivers = np.array([receive for receive, _, _ in in_order], object)
        self._parts, self._slots = np.array([each[1:] for each in in_order], np.int64).reshape(-1, 2).T
        self._judges = [(int(np.searchsorted(self._keys, _key(*at))), each) for at, each in judges.items()]
        self._steady = None if steady is None else steady[0]
        self._message = np.full(len(known) + 1, -1)
        for at, number in ({} if steady is None else steady[1]).items():
            self._message[np.searchsorted(self._keys, _key(*at))] = number
        self._whole: list[tuple[WholeScans, Booleans]] = []
        for sensor, assembler in zip(sensors, assemblers, strict=True):
            scans = whole_scans(sensor, assembler)
            if scans is not None:
                mine = np.isin(self._keys, [_key(sensor.bus, can_id) for can_id in assembler.routes])
                self._whole.append((scans, np.append(mine, False)))

    def routed(self, block: FrameBlock) -> Routed:
        """Route a block's frames; those of a scan that came whole are two events, its begin and its end.

        To be called when all events of the block before were received.

        Args:
            block: frames in order of time.
        """
        place = self._places(block)
        kept = place != self._nobody
        unheard = np.flatnonzero(~kept)
        found = []
        for scans, mine in self._whole:
            rows = mine[place].nonzero()[0]
            routes = place[rows]
            frames, objects = scans.find(block, rows, self._parts[routes], self._slots[routes])
            kept[frames[:, 1:-1]] = False
            found.append((scans.assembler, frames, objects))
        rows = kept.nonzero()[0]
        rows, runs = self._runs(block, rows, place[rows], unheard)
        places, data = place[rows], list[Any](block.payloads(rows))
        times, parts, slots = block.time_ns[rows].tolist(), self._parts[places].tolist(), self._slots[places].tolist()
        receivers, passed = self._receivers[places].tolist(), np.searchsorted(unheard, rows).tolist()
        for assembler, frames, objects in found:
            first, last = np.searchsorted(rows, frames[:, 0]), np.searchsorted(rows, frames[:, -1])
            for begin, end, whole in zip(first.tolist(), last.tolist(), objects, strict=True):
                receivers[begin], receivers[end], data[end] = assembler.begin_whole, assembler.end_whole, whole
        for listed, judge in self._judges:
            mine = (places == listed).nonzero()[0].tolist()
            if mine:
                judged = judge.judged(block.time_ns[rows[mine]], [data[row] for row in mine])
                for row, values in zip(mine, judged, strict=True):
                    if values is not None:
                        receivers[row], data[row] = judge.receive_judged, values
        for at, receive, begin, end, succession in runs:
            receivers[at], parts[at], slots[at], data[at] = receive, begin, end, succession
        events = zip(times, passed, receivers, parts, slots, data, strict=True)
        return Routed(events, block.time_ns[unheard].tolist(), *self._counted(block, place))

    def _runs(
        self, block: FrameBlock, rows: Indices, places: Indices, unheard: Indices
    ) -> tuple[Indices, list[tuple[int, Callable[[int, int, Any, int], None], int, int, Succession]]]:
        """Let the last of frames that come one after the other, and are received together, stand for all.

        Args:
            block: with the frames.
            rows: of the frames that are received (m,).
            places: where their receivers are listed (m,).
            unheard: rows of frames that nobody receives.

        Returns:
            Rows of frames that are events, and of those that stand for several: which it is, the receiver, begin and
            end among all of them, and all of them.
        """
        message = self._message[places]
        mine = (message >= 0).nonzero()[0]
        if self._steady is None or not len(mine):
            return rows, []
        heard = rows[mine]
        times_ns = block.time_ns[heard]
        sure = self._steady.judged(times_ns, message[mine], block.payload[heard], block.length[heard])
        taken = mine[sure]
        ends = (np.diff(taken, append=-1) != 1).nonzero()[0]
        last = taken[ends]
        left = np.ones(len(rows), np.bool_)
        left[taken] = False
        left[last] = True
        succession = Succession(times_ns[sure].tolist(), np.searchsorted(unheard, rows[taken]).tolist())
        numbers = [0, *(ends + 1).tolist()]
        at = (np.cumsum(left) - 1)[last].tolist()
        receive = self._steady.receive
        return rows[left], [
            (each, receive, begin, end, succession)
            for each, begin, end in zip(at, numbers[:-1], numbers[1:], strict=True)
        ]

    def _places(self, block: FrameBlock) -> Indices:
        """Return where the receiver of each frame is listed, (n,)."""
        keys: Integers = _key(block.bus.astype(np.int64), block.can_id)
        place = np.searchsorted(self._keys, keys)
        place[self._keys.take(place, mode="clip") != keys] = self._nobody
        return place

    def _counted(self, block: FrameBlock, place: Indices) -> tuple[list[int], list[int]]:
        """Count the frames of each bus, and those that nobody receives."""
        real = block.bus >= 0  # others are ticks
        lost = real & (place == self._nobody)
        count = partial(np.bincount, minlength=self._buses)
        return count(block.bus[real]).tolist(), count(block.bus[lost]).tolist()


def _key(bus: Any, can_id: Any) -> Any:
    """Return one number for a bus and an identifier, or for arrays of both."""
    return bus << 32 | can_id
