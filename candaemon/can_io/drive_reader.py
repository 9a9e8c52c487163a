"""Logs read as one drive: without stray times, in order of time, within a range of time.

Logs that overlap, such as one for each bus, are merged; logs that follow one another are read one by one, whatever the
order in which they are named. Logs whose times count from their own beginning have no order but the one they are named
in: each goes on from the latest time of those before, unless it is later by itself.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from candaemon.arrays import Integers
from candaemon.can_io.logs.merge import LogBlock, TimedLog, merged
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import TICK_BUS, ChannelMap, LogCounts
from candaemon.can_io.stray_times import StrayTimes
from candaemon.can_io.time_range import TimeRange
from candaemon.errors import InputError
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock
from candaemon.frames.times import LATEST_NS
from candaemon.printable import printable

logger = logging.getLogger(__name__)

EARLIEST_EPOCH_NS: Final = 315_532_800_000_000_000
"""ns: a time before 1980 counts from the log's own beginning, not from 1970."""
_NAMED = 8  # logs in a message
_DAY: Final = 86_400.0
"""s; logs of one drive begin within a day of each other."""


class _Beginning(NamedTuple):
    """How a log begins.

    Attributes:
        time_ns: of its first frame or tick.
        frame: the first frame; None: it has ticks alone.
    """

    time_ns: int
    frame: Frame | None


class DriveReader:
    """Reads the logs of a drive.

    Args:
        channels: as for `read_log_blocks`.
        counts: filled while reading; frames outside the range are counted as `outside`.
        time_range: what is read.
        corrects: whether stray time stamps are corrected.

    Attributes:
        stray_times: frames whose time stamp was far from those before and after, and was corrected.
    """

    def __init__(
        self,
        channels: Mapping[str, int] | ChannelMap,
        counts: LogCounts,
        time_range: TimeRange,
        *,
        corrects: bool = True,
    ) -> None:
        self._corrects = corrects
        self._channels, self._counts = channels, counts
        self._range = time_range
        self._first_ns: int | None = None
        self._passed = self._passed_ticks = 0
        self._strays: list[StrayTimes] = []

    @property
    def stray_times(self) -> int:
        """Frames whose time was corrected."""
        return sum(strays.corrected for strays in self._strays)

    def consecutive(self, logs: Sequence[Path]) -> Iterator[LogBlock]:
        """Yield the frames of logs one after another, as they are named."""
        return self._within(self._corrected(self._each(logs)))

    def by_time(self, logs: Sequence[Path]) -> Iterator[LogBlock]:
        """Yield the frames of logs in order of time."""
        if len(logs) == 1:
            return self.consecutive(logs)
        found = [(log, self._beginning_of(log)) for log in logs]
        _require_different(found)
        if any(begin is not None and begin.time_ns < EARLIEST_EPOCH_NS for _, begin in found):
            return self._within(self._continued(found))
        begun = [(begin.time_ns, log) for log, begin in found if begin is not None]
        in_order = sorted(begun, key=lambda each: each[0])
        if in_order != begun:
            names = ", ".join(printable(log.name) for _, log in in_order[:_NAMED])
            more = f" and {len(in_order) - _NAMED} more" if len(in_order) > _NAMED else ""
            logger.warning("the logs are read in order of time: %s%s", names, more)
        _warn_if_apart(in_order)
        # those without a frame are read for what they count
        empty = chain.from_iterable(self._part(log) for log, begin in found if begin is None)
        timed = [TimedLog(first_ns, partial(self._one, log)) for first_ns, log in in_order]
        return self._within(chain(empty, merged(timed)))

    def _one(self, log: Path) -> Iterator[LogBlock]:
        return self._corrected(self._part(log))

    def _continued(self, logs: Sequence[tuple[Path, _Beginning | None]]) -> Iterator[LogBlock]:
        """Yield the frames of logs as they are named; what counts from its own beginning goes on from those before.

        Args:
            logs: with how each begins.
        """
        latest_ns = 0
        for log, begin in logs:
            counts_anew = begin is not None and begin.time_ns < min(latest_ns, EARLIEST_EPOCH_NS)
            shift_ns = latest_ns - begin.time_ns if begin is not None and counts_anew else 0
            for block in self._one(log):
                shifted = _shifted(block, shift_ns) if shift_ns else block
                if len(shifted):
                    latest_ns = max(latest_ns, int(times_of(shifted).max()))
                yield shifted

    def _each(self, logs: Sequence[Path]) -> Iterator[LogBlock]:
        if len(logs) == 1:
            return iter(read_log_blocks(logs[0], self._channels, self._counts))
        return chain.from_iterable(map(self._part, logs))

    def _part(self, log: Path) -> Iterator[LogBlock]:
        """Yield the frames of one of several logs, which its messages name."""
        part = self._counts.of_one(log)
        for block in read_log_blocks(log, self._channels, part):
            self._counts.take_over(part)
            yield block
        self._counts.take_over(part)

    def _corrected(self, blocks: Iterable[LogBlock]) -> Iterator[LogBlock]:
        if not self._corrects:
            return iter(blocks)
        strays = StrayTimes()
        self._strays.append(strays)
        return strays.removed(blocks)

    def _beginning_of(self, log: Path) -> _Beginning | None:
        """Return how a log begins; None where it has no frame.

        Raises:
            InputError: it is no file: what it gives can be read only once.
        """
        if not log.is_file():
            raise InputError("it is no file, and is read alone; with other logs, save it first", file=log)
        first_ns: int | None = None
        for block in read_log_blocks(log, self._channels, LogCounts(tells=False)):
            for frame in block.frames() if isinstance(block, FrameBlock) else block:
                first_ns = frame.time_ns if first_ns is None else first_ns
                if frame.bus != TICK_BUS:  # a tick tells no log from another: it has a time alone
                    return _Beginning(first_ns, frame)
        return None if first_ns is None else _Beginning(first_ns, None)

    def _within(self, blocks: Iterable[LogBlock]) -> Iterator[LogBlock]:
        """Yield what is within the range; stop behind it."""
        if self._range.is_all:
            return iter(blocks)
        return self._cut(blocks)

    def _cut(self, blocks: Iterable[LogBlock]) -> Iterator[LogBlock]:
        for block in blocks:
            if not len(block):
                continue
            times = times_of(block)
            if self._first_ns is None:
                self._first_ns = int(times[0])
            begin, end = self._range.begin, self._range.end
            inside = np.ones(len(block), np.bool_)
            if begin is not None:
                inside &= times >= begin.from_begin(self._first_ns)
            if end is not None:
                is_before = times < end.from_begin(self._first_ns)
                if not is_before.any():
                    break
                inside &= is_before
            rows = np.flatnonzero(inside)
            if len(rows):
                kept = _chosen(block, rows)
                buses = kept.bus if isinstance(kept, FrameBlock) else [frame[1] for frame in kept]
                ticks = int(np.count_nonzero(np.asarray(buses) < 0))
                self._passed += len(kept) - ticks
                self._passed_ticks += ticks
                yield kept
        counts = self._counts
        counts.outside += counts.frames - self._passed + counts.ticks - self._passed_ticks
        counts.frames, counts.ticks = self._passed, self._passed_ticks


def _require_different(logs: Sequence[tuple[Path, _Beginning | None]]) -> None:
    """Raise if one log is named twice, by its name or a copy's.

    Args:
        logs: with how each begins.

    Raises:
        InputError: two are one file, or have the same first frame at the same time.
    """
    known: dict[Frame | tuple[int, int], Path] = {}
    for log, begin in logs:
        status = log.stat()
        marks: list[Frame | tuple[int, int]] = [(status.st_dev, status.st_ino)]
        if begin is not None and begin.frame is not None and begin.time_ns >= EARLIEST_EPOCH_NS:
            marks.append(begin.frame)  # of logs without a date, two drives may begin alike
        same = next((known[mark] for mark in marks if mark in known), None)
        if same is not None:
            raise InputError(
                f"it is the same log as {printable(str(same))}, or begins with the same frame at the same time: each "
                "frame would count twice; name one of them",
                file=log,
            )
        known.update(dict.fromkeys(marks, log))


def _warn_if_apart(logs: Sequence[tuple[int, Path]]) -> None:
    """Tell of logs that begin too far apart to be of one drive."""
    for (earlier_ns, before), (later_ns, log) in pairwise(logs):
        seconds = (later_ns - earlier_ns) * 1e-9
        if seconds > _DAY:
            names = printable(before.name), printable(log.name)
            logger.warning(
                "%s begins %.1f days before %s: they are read as one drive", names[0], seconds / _DAY, names[1]
            )
            return


def times_of(block: LogBlock) -> Integers:
    """Return the time stamps of a block."""
    return block.time_ns if isinstance(block, FrameBlock) else np.array([frame[0] for frame in block], np.int64)


def _shifted(block: LogBlock, shift_ns: int) -> LogBlock:
    """Return a block with something added to its times, which end at `LATEST_NS`."""
    times = np.minimum(times_of(block) + shift_ns, LATEST_NS)
    if isinstance(block, FrameBlock):
        return replace(block, time_ns=times)
    return [frame._replace(time_ns=time_ns) for frame, time_ns in zip(block, times.tolist(), strict=True)]


def _chosen(block: LogBlock, rows: Integers) -> LogBlock:
    """Return some frames of a block."""
    if len(rows) == len(block):
        return block
    return block.rows(rows) if isinstance(block, FrameBlock) else [block[row] for row in rows.tolist()]
