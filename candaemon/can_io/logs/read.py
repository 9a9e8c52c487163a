"""Reads recorded logs: the file's suffix tells the format, and `.gz` after it that it is compressed.

What each format keeps of a frame (python-can 4.6 reads and writes all but `.log`; `tests/test_logs.py` holds this):

======  =====================================================  =============================  ======================
suffix  time                                                   channel                        frames
======  =====================================================  =============================  ======================
.log    exact, to the digit: whole nanoseconds                 its name                       all
.blf    exact to 1 µs (python-can goes through floats)         its number                     all
.asc    relative to the first frame, to 1 µs: no epoch         its number                     all
.trc    to about 1 µs; the epoch is a float of days            its number                     no CAN FD (not written)
.csv    exact to 1 µs                                          none: all on one bus           CAN FD under 9 bytes
                                                                                              comes back as classic
======  =====================================================  =============================  ======================

Numbers of channels count from 1 in these files and from 0 here: see `ChannelMap`. Remote frames and error frames are
counted and skipped in all of them. What python-can's own readers skip without a word (in `.asc` and `.trc`: comments,
events, and lines that do not look like a frame) is in `LogCounts.lines` alone.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import can
from can.io.blf import BLFParseError

from candaemon.can_io.logs.candump import read_candump_blocks
from candaemon.can_io.logs.stream import NO_CHANNEL, ChannelMap, LogBytes, LogCounts
from candaemon.can_io.python_can import to_frame
from candaemon.errors import InputError
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock

if TYPE_CHECKING:
    from typing import TextIO

LogBlock: TypeAlias = FrameBlock | Sequence[Frame]
"""Consecutive frames of a log."""
_Reader: TypeAlias = Callable[[LogBytes, LogCounts], Iterator[can.Message]]

_BATCH = 1024  # frames

_EMPTY_OBJECT = re.compile(rb"LOBJ.{4}\0{4}", re.DOTALL)
"""Head of a BLF object: mark, size and version of the header, size of the object."""

_BAD_LINE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What python-can's text readers raise on a line that they cannot read."""


def read_log_blocks(path: Path, channels: Mapping[str, int], counts: LogCounts) -> Iterator[LogBlock]:
    """Read the data frames of a log, in the order of the file and many at a time: arrays of candump, lists of others.

    Frames may be out of order in time where the recorder left them so. What the log holds never raises: call
    `LogCounts.require_frames` at its end to refuse one that held nothing.

    Args:
        path: the log.
        channels: bus index by channel name; the key `*` takes every channel that no other key names. Frames of other
            channels are counted and skipped.
        counts: filled while reading.

    Raises:
        InputError: the file is not there, cannot be opened, or has a suffix of no known format.
    """
    suffix = log_suffix(path)
    resolved = ChannelMap(channels)
    if suffix == ".log":
        return read_candump_blocks(path, resolved, counts)
    frames = _frames(_READERS[suffix](LogBytes(path, counts), counts), suffix, resolved, counts)
    return iter(lambda: list(islice(frames, _BATCH)), [])


def read_log(path: Path, channels: Mapping[str, int], counts: LogCounts) -> Iterator[Frame]:
    """Read a log frame by frame; otherwise as `read_log_blocks`."""
    return frames_of(read_log_blocks(path, channels, counts))


def frames_of(blocks: Iterable[LogBlock]) -> Iterator[Frame]:
    """Return the frames of blocks one by one."""
    return chain.from_iterable(block.frames() if isinstance(block, FrameBlock) else block for block in blocks)


def log_suffix(path: Path) -> str:
    """Return the suffix that tells a log's format, without `.gz`, in lower case.

    Raises:
        InputError: no format has that suffix; lists those there are.
    """
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if suffixes and suffixes[-1] == ".gz":
        suffixes.pop()
    suffix = suffixes[-1] if suffixes else ""
    if suffix not in LOG_SUFFIXES:
        known = ", ".join(LOG_SUFFIXES)
        raise InputError(
            f"found the suffix '{suffix}', expected one of {known}, each also with .gz after it", file=path
        )
    return suffix


def _frames(messages: Iterable[can.Message], suffix: str, channels: ChannelMap, counts: LogCounts) -> Iterator[Frame]:
    """Turn python-can's messages into frames; count those that are none."""
    first_channel = 1 if suffix == ".trc" else 0  # python-can's TRC reader alone does not make it 0
    for message in messages:
        channel = message.channel if suffix != ".csv" else None
        number = None if channel is None else int(cast("int", channel)) - first_channel
        bus = channels.numbered(number)
        if bus < 0:
            counts.note_other_channel(NO_CHANNEL if number is None else str(number))
        elif message.is_error_frame:
            counts.error_frames += 1
        elif message.is_remote_frame:
            counts.remote += 1
        else:
            try:
                frame = to_frame(message, bus)
            except (ValueError, OverflowError) as error:
                counts.note_malformed(counts.lines, str(error))
                continue
            counts.frames += 1
            yield frame


class _Lines:
    """The lines of a text log as python-can's readers take them: counted, and one can be put in front.

    Args:
        stream: the log's bytes.
        counts: `lines` is counted.
    """

    def __init__(self, stream: LogBytes, counts: LogCounts) -> None:
        self._text = io.TextIOWrapper(io.BufferedReader(stream), encoding="utf-8", errors="replace")
        self._counts = counts
        self._front: str | None = None
        self.last = ""

    def put_in_front(self, line: str) -> None:
        """Give out `line` next; it is not counted."""
        self._front = line

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._front is not None:
            line, self._front = self._front, None
            return line
        self.last = next(self._text)
        self._counts.lines += 1
        return self.last

    def close(self) -> None:
        """Close the log."""
        self._text.close()


def _text_reader(make: Callable[[TextIO], Iterable[can.Message]], header: str) -> _Reader:
    """Return a reader that survives lines which python-can cannot read.

    Args:
        make: python-can's reader of a text file.
        header: what that reader takes for the end of a header: it wants one each time it starts.
    """

    def read(stream: LogBytes, counts: LogCounts) -> Iterator[can.Message]:
        lines = _Lines(stream, counts)
        reader = make(cast("TextIO", lines))
        with stream:
            failed_at = -1
            while True:
                try:
                    yield from reader
                except _BAD_LINE:
                    if counts.lines == failed_at:  # at the log's end, where it would fail for ever
                        return
                    failed_at = counts.lines
                    # the reader has stopped behind the bad line: it starts again there
                    counts.note_malformed(counts.lines, lines.last)
                    lines.put_in_front(header)
                else:
                    return

    return read


class _BlfReader(can.BLFReader):
    """python-can's reader, which would read an object that says it has no bytes for ever."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        if _EMPTY_OBJECT.search(data):
            raise BLFParseError("an object of no bytes")
        return super()._parse_data(data)


def _read_blf(stream: LogBytes, counts: LogCounts) -> Iterator[can.Message]:
    """Read a `.blf`; a damaged container is skipped, a damaged structure ends it."""
    with stream:
        try:
            reader = _BlfReader(cast("Any", io.BufferedReader(stream)))
        except (struct.error, BLFParseError) as error:
            counts.note_malformed(1, f"no BLF header: {error}")
            return
        while True:
            try:
                for message in reader:
                    counts.lines += 1
                    yield message
            except zlib.error as error:
                counts.note_malformed(counts.lines + 1, f"a container cannot be decompressed: {error}")
            except (struct.error, BLFParseError, ValueError) as error:
                counts.note_end(f"a BLF object cannot be read: {error}")
                return
            else:
                if stream.given < reader.file_size:
                    counts.note_end(f"its header tells of {reader.file_size} bytes, it has {stream.given}")
                return


_READERS: dict[str, _Reader] = {
    ".asc": _text_reader(can.ASCReader, "no internal events logged\n"),
    ".blf": _read_blf,
    ".csv": _text_reader(can.CSVReader, "timestamp,arbitration_id,extended,remote,error,dlc,data\n"),
    ".trc": _text_reader(can.TRCReader, ";\n"),
}
LOG_SUFFIXES = (".log", *_READERS)
"""Suffixes of the formats that can be read, each also with `.gz` after it."""
