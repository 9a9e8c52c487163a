"""Scans that came whole, found in a block of frames of a log and read together.

Where all frames of a scan came, each once and in time, it makes no difference whether they are assembled one by one.
So the frames of such scans are found, sorted and decoded with numpy, all scans of a block at once; what was lost,
doubled, cut short, damaged, late, or cut by the block's end is left to the assembler.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from candaemon.arrays import Booleans, Bytes, Floats, Indices, Integers
from candaemon.binding.bound import BoundSensor
from candaemon.config.sensors import CounterScan
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.frames.frame_block import FrameBlock
from candaemon.objects.object_batch import ObjectBatch
from candaemon.protection.checksums import Protector
from candaemon.protection.monitor import FrameMonitorSettings
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.counter_assembler import CounterAssembler


class WholeScans:
    """Finds the whole scans of a sensor that distinguishes them by a counter.

    Args:
        sensor: the bound sensor.
        assembler: of its scans.
    """

    def __init__(self, sensor: BoundSensor, assembler: CounterAssembler) -> None:
        scan = sensor.settings.scan
        assert isinstance(scan, CounterScan), "found by `whole_scans`"  # noqa: S101  # a promise within this file
        self.assembler = assembler
        self._reader = sensor.reader
        self._counters = [BatchDecoder(part.shortest, [scan.signal]) for part in sensor.reader.layouts]
        self._lengths = [part.length for part in sensor.reader.layouts]
        self._least = np.array([message.length for part in sensor.reader.layouts for message in part.messages])
        self._protectors = [_protector(monitor) for monitor in sensor.monitors]
        self._frames = sensor.reader.places * len(sensor.reader.layouts)

    def find(
        self, block: FrameBlock, rows: Indices, part: Integers, slot: Integers
    ) -> tuple[Indices, list[ObjectBatch]]:
        """Find the whole scans that begin anew for sure.

        Args:
            block: frames in order of time.
            rows: of the sensor's frames in it (m,).
            part: of each of these frames (m,).
            slot: of each (m,).

        Returns:
            Rows of each scan's frames, in order of time, and its objects, in the order of their slots.
        """
        size = self._frames
        if len(rows) < size:
            return np.empty((0, size), np.intp), []
        counter = self._counter(block, rows, part)
        begins = np.concatenate([[0], np.flatnonzero(counter[1:] != counter[:-1]) + 1])
        spans = np.diff(begins, append=len(rows))
        full = np.flatnonzero(spans == size)
        members = begins[full][:, None] + np.arange(size)
        frames = rows[members]
        key = (part * self._reader.places + slot)[members]
        order = key.argsort(axis=1)
        each_once = (np.take_along_axis(key, order, axis=1) == np.arange(size)).all(axis=1)
        in_time = block.time_ns[frames[:, -1]] - block.time_ns[frames[:, 0]] < self.assembler.timeout_ns
        good = each_once & in_time
        good[good] = self._are_intact(block, frames[good], key[good])
        clean = np.zeros(len(begins), np.bool_)
        clean[full] = good
        first = int(rows[0])
        fresh = self.assembler.would_begin(int(part[0]), block.payload[first].tobytes(), int(block.time_ns[first]))
        times_ns = block.time_ns[rows]
        edges = times_ns[begins], times_ns[begins + spans - 1]
        runs = zip(clean.tolist(), counter[begins].tolist(), *(each.tolist() for each in edges), strict=True)
        sure = np.array(_begin_anew(runs, fresh, self.assembler.settled_ns, self.assembler.straggling_ns))[full]
        return frames[sure], self._read(block, np.take_along_axis(frames, order, axis=1)[sure]) if sure.any() else []

    def _counter(self, block: FrameBlock, rows: Indices, part: Integers) -> Floats:
        """Read the counter of each frame (m,)."""
        counter = np.empty(len(rows))
        for index, decoder in enumerate(self._counters):
            mine = part == index
            counter[mine] = decoder.decode(_payloads(block, rows[mine], self._lengths[index]))[0]
        return counter

    def _are_intact(self, block: FrameBlock, frames: Indices, key: Integers) -> Booleans:
        """Return of which scans all frames are long enough and have the right checksum.

        Args:
            block: with the frames.
            frames: rows of each scan's frames (scans, parts × slots).
            key: of each frame, its place among all messages.
        """
        intact: Booleans = block.length[frames] >= self._least[key]
        for index, protector in enumerate(self._protectors):
            if protector is not None:
                mine = key // self._reader.places == index
                rows = frames[mine]
                lengths = block.length[rows].astype(np.int64)
                intact[mine] &= protector.verified(block.can_id[rows].astype(np.int64), lengths, block.payload[rows])
        of_all: Booleans = np.logical_and.reduce(intact, axis=1)
        return of_all

    def _read(self, block: FrameBlock, frames: Indices) -> list[ObjectBatch]:
        """Read the objects of scans, whose frames (scans, parts × slots) are sorted by part and slot."""
        slots = self._reader.slots
        parts = frames.reshape(len(frames), len(self._lengths), self._reader.places)
        objects = self._reader.read(
            [_payloads(block, parts[:, index].ravel(), length) for index, length in enumerate(self._lengths)]
        )
        return [objects.part(slice(begin, begin + slots)) for begin in range(0, len(frames) * slots, slots)]


def whole_scans(sensor: BoundSensor, assembler: ScanAssembler) -> WholeScans | None:
    """Return what finds the whole scans of a sensor; None where its frames must be looked at one by one."""
    checked = all(each is None or (not each.watches and _protector(each) is not None) for each in sensor.monitors)
    plain = sensor.look is None and sensor.stamp is None and checked
    # a single object's frame that closes one scan may complete the next, of what was awaited then
    alone = sensor.reader.places == 1 and any(part.optional for part in sensor.reader.layouts)
    several = sensor.reader.places * len(sensor.reader.layouts) > 1 and not alone
    if isinstance(assembler, CounterAssembler) and assembler.takes_whole_scans and several and plain:
        return WholeScans(sensor, assembler)
    return None


def _protector(monitor: FrameMonitorSettings | None) -> Protector | None:
    """Return what verifies many frames at once; None where nothing has to, or one that goes frame by frame does."""
    protector = None if monitor is None else monitor.protector
    return protector if isinstance(protector, Protector) else None


def _begin_anew(
    runs: Iterable[tuple[bool, float, int, int]], fresh: bool, settled_ns: int, straggling_ns: int
) -> list[bool]:
    """Return of which clean runs of one counter it is sure that no other scan is open when they begin.

    It is sure of the first run where it is `fresh`, and of each run after a sure one. It is sure, too, of the run after
    a clean one before which no frame had its counter for `settled_ns`. None of that one's frames was late, and no open
    scan waited for its counter: its first frame closed what was open, its frames completed a scan of their own. What is
    optional in it, and was not awaited, may come after that; within `straggling_ns` it is late, and opens no other.

    Args:
        runs: of each whether it is clean, its counter, and the times of its first and last frame, ns.
        fresh: whether none is open at the beginning.
        settled_ns: after this time without a frame of its counter a scan is neither open nor has late frames.
        straggling_ns: for how long after a scan's first frame others of it are late.
    """
    sure: list[bool] = []
    closed, known_ns, last_ns = fresh, None, dict[float, int]()
    for clean, counter, first_ns, end_ns in runs:
        known_ns = first_ns if known_ns is None else known_ns
        sure.append(clean and closed)
        settled = max(known_ns, last_ns.get(counter, known_ns)) + settled_ns <= first_ns
        closed = clean and (closed or (settled and end_ns - first_ns < straggling_ns))
        last_ns[counter] = end_ns
    return sure


def _payloads(block: FrameBlock, rows: Indices, length: int) -> Bytes:
    """Return the payloads of some frames, cut to a length or filled up with zeros (m, length)."""
    payloads = block.payload[rows, :length]
    missing = length - payloads.shape[1]
    return np.ascontiguousarray(payloads if missing == 0 else np.pad(payloads, ((0, 0), (0, missing))))
