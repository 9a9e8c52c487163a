"""Reads and writes `.mf4`, ASAM MDF 4 with CAN bus logging, through asammdf.

As python-can has it, with which the tests compare, but many frames at once. Only groups of bus events are read:
measured signals are no frames. BusChannel counts from 1; a file that has a 0 among its first frames counts from 0, as
those that python-can writes. A start that names no time zone is taken for UTC.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, redirect_stdout
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from os import SEEK_END
from pathlib import Path
from struct import Struct
from tempfile import TemporaryFile
from traceback import walk_tb
from typing import Any, BinaryIO, Final, cast

import numpy as np

from candaemon.arrays import Booleans, Bytes, Floats, Integers
from candaemon.can_io.logs.merge import TimedLog, merged
from candaemon.can_io.logs.stream import ChannelMap, LogBytes, LogCounts
from candaemon.errors import InputError
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_block import FD_LENGTHS, FrameBlock, block_of
from candaemon.frames.times import LATEST_NS

LARGEST_MF4_CHANNEL: Final = 254
"""Greatest number of a channel, from 0: BusChannel has 8 bits, from 1."""
LARGEST_COPY: Final = 8 << 30
"""Bytes of a temporary copy, of a log that cannot be read from place to place as it is."""
LONGEST_RECORD: Final = 4096
"""Bytes of a record of a bus event, which has some 100: asammdf reserves room for thousands of them at once."""
LARGEST_BLOCK: Final = 64 << 20
"""Bytes that a compressed block says to unpack to; ASAM's standard allows 4 MiB."""

_PIECE = 1 << 20
_ROWS = 8192  # records read at once
_DATA, _ERROR, _REMOTE = "CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame"
_KINDS = (_DATA, _ERROR, _REMOTE)
_BUS_EVENT, _SOURCE_BUS, _BUS_TYPE_CAN = 2, 2, 2
_ID_29, _ID_11, _CLASSIC_BYTES, _WIDEST = 0x1FFF_FFFF, 0x7FF, 8, 64
_NS_EXACT = 4_000_000.0
"""Seconds up to which a float resolves nanoseconds; beyond, microseconds are what was meant."""
_POSSIBLE = np.isin(np.arange(256), list(FD_LENGTHS))

_RECORD = np.dtype(
    [
        ("CAN_DataFrame.BusChannel", "<u1"),
        ("CAN_DataFrame.ID", "<u4"),
        ("CAN_DataFrame.IDE", "<u1"),
        ("CAN_DataFrame.DLC", "<u1"),
        ("CAN_DataFrame.DataLength", "<u1"),
        ("CAN_DataFrame.DataBytes", "(64,)u1"),
        ("CAN_DataFrame.Dir", "<u1"),
        ("CAN_DataFrame.EDL", "<u1"),
        ("CAN_DataFrame.BRS", "<u1"),
        ("CAN_DataFrame.ESI", "<u1"),
    ]
)
"""A data frame as ASAM's bus logging names its parts."""
_HISTORY = (
    "<FHcomment><TX>CAN bus logging</TX><tool_id>candaemon</tool_id><tool_vendor>candaemon</tool_vendor>"
    "<tool_version>1</tool_version></FHcomment>"
)
_ID_BLOCK = Struct("<60xH2x")  # the file's first bytes: …, flags of what is not finalised, …
_LENGTH_CODES = {length: code for code, length in enumerate((*range(9), 12, 16, 20, 24, 32, 48, 64))}

_OBJECT = re.compile(r"[\"']?<[^>]*>[\"']?")
_TOLD = 200  # characters of what asammdf raises

# What asammdf says of each oddity of a file would flood a terminal; what it costs is counted here.
logging.getLogger("asammdf").setLevel(logging.CRITICAL)


def read_mf4(path: Path, stream: LogBytes, channels: ChannelMap, counts: LogCounts) -> Iterator[FrameBlock]:
    """Read the data frames of a log, in order of time.

    Args:
        path: the log.
        stream: its bytes.
        channels: which bus a channel belongs to.
        counts: filled while reading; `lines` counts records.

    Raises:
        InputError: asammdf is not installed.
    """
    try:
        asammdf = _asammdf("asammdf", path)
    except InputError:
        stream.close()
        raise
    return _blocks(path, stream, asammdf, channels, counts)


def _asammdf(module: str, path: Path) -> Any:
    """Return a module of the library for MDF.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError("an .mf4 needs the extra 'mdf': pip install 'candaemon[mdf]'", file=path) from None


def _blocks(
    path: Path, stream: LogBytes, asammdf: Any, channels: ChannelMap, counts: LogCounts
) -> Iterator[FrameBlock]:
    """Yield the frames of all groups as one."""
    with ExitStack() as files:
        try:
            file = _seekable(path, stream, files, counts)
            size = file.seek(0, SEEK_END)
            measured = _opened(asammdf, file)
            files.callback(measured.close)
            groups = _groups(measured, size, channels, counts)
            least = min((group.least_channel() for group in groups), default=1)
            timed = [TimedLog(group.first_ns(), partial(group.blocks, min(least, 1))) for group in groups]
            for block in merged(sorted(timed, key=lambda log: log.first_ns)):
                if isinstance(block, FrameBlock):
                    yield block
                counts.bytes_read = counts.bytes_total
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - whatever a damaged file makes the library raise
            told = _OBJECT.sub("the file", str(error))[:_TOLD]
            counts.note_end(f"asammdf cannot read on: {type(error).__name__}: {told}")
        else:
            if not groups and not counts.truncated:
                counts.note_advice("it has no group of CAN bus events; measured signals are no frames")


def _opened(asammdf: Any, file: BinaryIO) -> Any:
    """Return a file as asammdf has it."""
    try:
        # unless it is told not to, it decodes all records to see which identifiers there are
        with redirect_stdout(None):  # it prints what goes wrong, among the results
            return _parsed(asammdf, file)
    except Exception as error:
        # an object that is made in part fails again when it is collected, and says so on standard error
        for frame, _ in walk_tb(error.__traceback__):
            part: Any = frame.f_locals.get("self")
            if hasattr(part, "_closed") and hasattr(part, "_tempfile"):
                part._closed = True
                part._tempfile.close()
        raise


def _parsed(asammdf: Any, file: BinaryIO) -> Any:
    try:
        return asammdf.MDF(file, process_bus_logging=False)
    except MemoryError as error:  # a damaged number: what is read here is small
        raise ValueError("a block that says to be larger than memory") from error


def _seekable(path: Path, stream: LogBytes, files: ExitStack, counts: LogCounts) -> BinaryIO:
    """Return a file that can be read from place to place.

    A log that is compressed, comes through a pipe, or is not finalised, which asammdf does in place, is copied first.
    """
    with stream:
        head = stream.peek()[: _ID_BLOCK.size]
        is_final = len(head) == _ID_BLOCK.size and not _ID_BLOCK.unpack(head)[0]
        if is_final and path.is_file() and stream.is_plain:
            return files.enter_context(path.open("rb"))
        copy = files.enter_context(TemporaryFile())  # noqa: SIM115 - closed with the other files
        while piece := stream.read1(_PIECE):
            if stream.delivered > LARGEST_COPY:
                counts.note_end(f"unpacked it has more than {LARGEST_COPY >> 30} GiB")
                break
            copy.write(piece)
        copy.seek(0)
        return cast("BinaryIO", copy)


def _groups(measured: Any, size: int, channels: ChannelMap, counts: LogCounts) -> list[_Group]:
    """Return the groups of CAN bus events that have any, of a file of so many bytes."""
    found = []
    for index, group in enumerate(measured.groups):
        head, names = group.channel_group, {channel.name for channel in group.channels}
        kind = next((kind for kind in _KINDS if kind in names), "")
        source = head.acq_source
        is_event = head.flags & _BUS_EVENT and source is not None and source.source_type & _SOURCE_BUS
        if is_event and source.bus_type == _BUS_TYPE_CAN and kind and head.cycles_nr:
            if fault := _fault(group, size):
                counts.note_end(f"group {index} of the .mf4 is damaged: {fault}")
                continue
            found.append(_Group(measured, index, kind, channels, counts))
    return found


def _fault(group: Any, size: int) -> str:
    """Return what is wrong with a group of a file of so many bytes, if anything.

    asammdf believes what a file says of itself: it would reserve any memory, and read beyond the end of a record.
    """
    head = group.channel_group
    record = head.samples_byte_nr + head.invalidation_bytes_nr
    if record > LONGEST_RECORD:
        return f"records of {record} bytes, {LONGEST_RECORD} at most are read"
    for channel in group.channels:
        end = channel.byte_offset + (channel.bit_offset + channel.bit_count + 7) // 8
        if end > head.samples_byte_nr:
            return f"{channel.name} ends at byte {end} of a record of {head.samples_byte_nr}"
    for block in group.data_blocks:
        if block.address + block.compressed_size > size:
            return f"a block of data ends at byte {block.address + block.compressed_size} of {size}"
        if block.block_type and block.original_size > LARGEST_BLOCK:
            return f"a block unpacks to {block.original_size} bytes, {LARGEST_BLOCK} at most are read"
    return ""


class _Group:
    """A group of bus events, read so many records at once.

    Args:
        measured: the file.
        index: of the group.
        kind: of its events.
        channels: which bus a channel belongs to.
        counts: of the log.
    """

    def __init__(self, measured: Any, index: int, kind: str, channels: ChannelMap, counts: LogCounts) -> None:
        self._measured, self._index, self._kind = measured, index, kind
        self._channels, self._counts = channels, counts
        self._records = int(measured.groups[index].channel_group.cycles_nr)
        self._start_ns = int(measured.header.abs_time)

    def least_channel(self) -> int:
        """Return the least number of a channel among the first records."""
        return int(self._column(self._read(0)[1], "BusChannel", 1).min(initial=1))

    def first_ns(self) -> int:
        """Return the time of the first record."""
        times = self._times(self._read(0, 1)[0])
        return int(times[0]) if len(times) else 0

    def blocks(self, first_channel: int) -> Iterator[FrameBlock]:
        """Yield the frames.

        Args:
            first_channel: the number of channel 0.
        """
        for begin in range(0, self._records, _ROWS):
            seconds, records = self._read(begin)
            if not len(seconds):
                break
            yield self._block(self._times(seconds), records, first_channel, begin)

    def _read(self, begin: int, count: int = _ROWS) -> tuple[Floats, Any]:
        """Return times and records from one on; fewer at the end."""
        with redirect_stdout(None):
            signal = self._measured.get(self._kind, self._index, record_offset=begin, record_count=count, raw=False)
        return signal.timestamps, signal.samples

    def _times(self, seconds: Floats) -> Integers:
        """Return times in ns; −1 where they are out of range."""
        start_s = self._start_ns * 1e-9
        possible = np.isfinite(seconds) & (seconds + start_s >= 0) & (seconds + start_s < LATEST_NS * 1e-9)
        seconds = np.where(possible, seconds, 0.0)
        exact = np.abs(seconds) < _NS_EXACT
        in_ns = np.rint(np.where(exact, seconds, 0.0) * 1e9).astype(np.int64) + self._start_ns
        in_us = np.rint((seconds + start_s) * 1e6).astype(np.int64) * 1000
        return np.where(possible, np.where(exact, in_ns, in_us), -1)

    def _column(self, records: Any, name: str, missing: int) -> Integers:
        """Return a part of the records as numbers; `missing` where they do not have it."""
        full = f"{self._kind}.{name}"
        if full not in (records.dtype.names or ()):
            return np.full(len(records), missing, np.int64)
        return np.asarray(records[full]).astype(np.int64).reshape(len(records))

    def _block(self, times: Integers, records: Any, first_channel: int, begin: int) -> FrameBlock:
        """Return the data frames of records; count the others."""
        counts, rows = self._counts, len(times)
        numbers = self._column(records, "BusChannel", first_channel) - first_channel
        if self._kind != _DATA:
            counts.lines += rows
            skipped = int(np.count_nonzero(self._buses(numbers) >= 0))
            if self._kind == _ERROR:
                counts.error_frames += skipped
            else:
                counts.remote += skipped
            nothing = times[:0]
            return _frames(nothing, nothing, nothing, nothing, nothing > 0, np.empty((0, 8), np.uint8))
        can_id, length = self._column(records, "ID", 0), self._column(records, "DataLength", -1)
        extended = self._column(records, "IDE", 0) != 0
        extended |= (can_id & EXTENDED) != 0
        can_id &= _ID_29
        fd = (self._column(records, "EDL", 0) != 0) | (length > _CLASSIC_BYTES)
        payload = np.asarray(records[f"{_DATA}.DataBytes"])
        payload = payload.reshape(rows, -1).astype(np.uint8)[:, :_WIDEST]
        # records are counted once all of them that is read could be: what a damaged file lacks ends the log before
        counts.lines += rows
        bus = self._buses(numbers)
        claimed = bus >= 0
        possible = (times >= 0) & (length >= 0) & (length <= payload.shape[1]) & (extended | (can_id <= _ID_11))
        possible &= _POSSIBLE[np.clip(length, 0, 255)]
        for row in np.flatnonzero(claimed & ~possible).tolist():
            counts.note_malformed(
                counts.lines - rows + row + 1,
                f"record {begin + row}: {length[row]} bytes, id {can_id[row]:#x}, {times[row]} ns",
            )
        good = np.flatnonzero(claimed & possible)
        counts.frames += len(good)
        can_id = np.where(extended, can_id | EXTENDED, can_id)
        return _frames(times[good], bus[good], can_id[good], length[good], fd[good], payload[good])

    def _buses(self, numbers: Integers) -> Integers:
        """Return the bus of each channel; −1, and counted, where it has none."""
        bus = np.empty(len(numbers), np.int64)
        for number in np.unique(numbers).tolist():
            found, rows = self._channels.numbered(number), numbers == number
            bus[rows] = found
            if found < 0:
                self._counts.note_other_channel(str(number), int(np.count_nonzero(rows)))
        return bus


def _frames(
    times: Integers, bus: Integers, can_id: Integers, length: Integers, fd: Booleans, payload: Bytes
) -> FrameBlock:
    """Return frames as a block, with zeros after each payload's length."""
    width = _CLASSIC_BYTES if int(length.max(initial=0)) <= _CLASSIC_BYTES else _WIDEST
    data = np.zeros((len(times), width), np.uint8)
    used = min(width, payload.shape[1])
    data[:, :used] = payload[:, :used]
    data[np.arange(width) >= length[:, None]] = 0
    return FrameBlock(
        times, bus.astype(np.int16), can_id.astype(np.uint32), length.astype(np.uint8), fd.astype(np.bool_), data
    )


class Mf4Frames:
    """Writes data frames; the file is made when it is closed, of a temporary one.

    Args:
        first_ns: time of the first frame.
        path: of the file, for messages.

    Raises:
        InputError: asammdf is not installed.
    """

    def __init__(self, first_ns: int, path: Path) -> None:
        asammdf, blocks = _asammdf("asammdf", path), _asammdf("asammdf.blocks.v4_blocks", path)
        self._start_ns = first_ns
        self._measured = asammdf.MDF(version="4.10")
        header, history = self._measured.header, blocks.FileHistory()
        # what would be the clock's is the log's: the same frames give the same bytes
        header.start_time = datetime.fromtimestamp(0, UTC)
        header.abs_time = history.abs_time = first_ns
        history.tz_offset = history.daylight_save_time = 0
        history.comment = _HISTORY
        self._measured.file_history.append(history)
        source = blocks.SourceInformation(source_type=_SOURCE_BUS, bus_type=_BUS_TYPE_CAN)
        nothing = np.empty(0, _RECORD), np.empty(0, np.float64)
        self._measured.append(asammdf.Signal(*nothing, name=_DATA, source=source))

    def write(self, frames: Sequence[Frame], numbers: Sequence[int]) -> None:
        """Write frames.

        Args:
            frames: the frames.
            numbers: of their channels, from 0.
        """
        records = np.zeros(len(frames), _RECORD)
        block = block_of(frames)
        records[f"{_DATA}.BusChannel"] = np.asarray(numbers) + 1
        records[f"{_DATA}.ID"] = block.can_id & _ID_29
        records[f"{_DATA}.IDE"] = block.can_id >= EXTENDED
        records[f"{_DATA}.DLC"] = [_LENGTH_CODES[int(length)] for length in block.length]
        records[f"{_DATA}.DataLength"] = block.length
        records[f"{_DATA}.DataBytes"][:, : block.payload.shape[1]] = block.payload
        records[f"{_DATA}.EDL"] = records[f"{_DATA}.BRS"] = block.fd
        seconds = (block.time_ns - self._start_ns) * 1e-9
        self._measured.extend(0, [(seconds, None), (records, None)])

    def finish(self, target: BinaryIO) -> None:
        """Write the file."""
        try:
            self._measured.save(target, compression=1, add_history_block=False)
        finally:
            self._measured.close()
