"""Reads recorded logs: the file's suffix determines the format, or its first bytes; a further one its compression.

What each format preserves of a frame (python-can 4.6 writes `.asc`, `.blf`, `.csv` and `.trc`, and reads these but
`.blf`; tests check this):

=======  =====================================================  =============================  ======================
suffix   time                                                   channel                        frames
=======  =====================================================  =============================  ======================
.log     exact, to the digit: whole nanoseconds                 its name                       all
.pcapng  exact                                                  its name                       all
.pcap    exact                                                  none: all on one bus           all
.mf4     to 1 ns, as it is written here                         its number                     all
.blf     exact to 1 µs, as python-can writes it                 its number                     all
.asc     relative to the first frame, to 1 µs: no epoch         its number                     all
.trc     to about 1 µs; the epoch is a float of days            its number                     no CAN FD (not written)
.csv     exact to 1 µs                                          none: all on one bus           CAN FD under 9 bytes
                                                                                               comes back as classic
=======  =====================================================  =============================  ======================

Channel numbers start at 1 in these files and at 0 here: see `ChannelMap`. Remote frames and error frames are
counted and skipped in all of them; whether a frame was sent or received, and the flags BRS and ESI of CAN FD, are not
read. Lines that python-can's own readers skip silently (in `.asc` and `.trc`: comments, events, and lines that do not
look like a frame) are counted in `LogCounts.other_lines`.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from decimal import Decimal
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, cast

from candaemon.can_io.logs.blf import read_blf
from candaemon.can_io.logs.candump import read_candump
from candaemon.can_io.logs.formats import open_log
from candaemon.can_io.logs.merge import LogBlock
from candaemon.can_io.logs.mf4 import read_mf4
from candaemon.can_io.logs.pcap import read_pcap
from candaemon.can_io.logs.stream import LONGEST_LINE, MOST_IN_VAIN, NO_CHANNEL, ChannelMap, LogBytes, LogCounts
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock

if TYPE_CHECKING:
    from typing import TextIO

    import can

_Reader: TypeAlias = "Callable[[LogBytes, LogCounts], Iterator[can.Message]]"

_BATCH = 1024  # frames

_PIECE = 1 << 16  # bytes
_SHOWN = 500  # bytes of a malformed line, before it is cut for a message

_ASC_BASE = re.compile(r"\s*base\s+(?:hex|dec)(?:\s+timestamps\s+(?:absolute|(relative)))?", re.IGNORECASE)
_ASC_TIME = re.compile(r"\s*\d{1,20}\.\d{1,20}(?=\s)", re.ASCII)

# What python-can's readers say of each line that they skip would flood a terminal; such lines are counted here.
logging.getLogger("can.io").setLevel(logging.CRITICAL)

_BAD_LINE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Exceptions of python-can's text readers on a malformed line."""


def read_log_blocks(path: Path, channels: Mapping[str, int] | ChannelMap, counts: LogCounts) -> Iterator[LogBlock]:
    """Read the data frames of a log, in the order of the file, in blocks: arrays for candump, lists for other formats.

    Frames may be out of order in time, as recorded. Malformed contents never raise: call `LogCounts.require_frames` at
    the end to refuse a log without frames.

    Args:
        path: the log.
        channels: bus index by channel name; the key `*` matches every channel without a key of its own. Frames of other
            channels are counted and skipped.
        counts: filled while reading.

    Raises:
        InputError: the file does not exist, cannot be opened, or has an unknown suffix.
    """
    resolved = channels if isinstance(channels, ChannelMap) else ChannelMap(channels)
    suffix, stream = open_log(path, counts)
    match suffix:
        case ".log":
            return read_candump(stream, resolved, counts)
        case ".blf":
            return read_blf(stream, resolved, counts)
        case ".pcap" | ".pcapng":
            return read_pcap(stream, resolved, counts)
        case ".mf4":
            return read_mf4(path, stream, resolved, counts)
    frames = _frames(_READERS[suffix](stream, counts), suffix, resolved, counts)
    return iter(lambda: list(islice(frames, _BATCH)), [])


def read_log(path: Path, channels: Mapping[str, int] | ChannelMap, counts: LogCounts) -> Iterator[Frame]:
    """Read a log frame by frame; see `read_log_blocks`."""
    return frames_of(read_log_blocks(path, channels, counts))


def frames_of(blocks: Iterable[LogBlock]) -> Iterator[Frame]:
    """Return the frames of blocks one by one."""
    return chain.from_iterable(block.frames() if isinstance(block, FrameBlock) else block for block in blocks)


def _frames(messages: Iterable[can.Message], suffix: str, channels: ChannelMap, counts: LogCounts) -> Iterator[Frame]:
    """Convert python-can's messages to frames; count those that are not data frames."""
    from candaemon.can_io.python_can import to_frame  # noqa: PLC0415 - python-can, which takes long to import

    first_channel = 1 if suffix == ".trc" else 0  # python-can's TRC reader, unlike the others, leaves it at 1
    for message in messages:
        channel = message.channel if suffix != ".csv" else None
        number = None if channel is None else int(cast("int", channel)) - first_channel
        bus = channels.numbered(number)
        if bus < 0:
            counts.note_other_channel(NO_CHANNEL if number is None else str(number))
        elif message.is_error_frame:
            counts.error_frames += 1
        elif message.is_remote_frame and (message.dlc or not message.is_fd):  # an empty CAN FD frame is none
            counts.remote += 1
        else:
            try:
                frame = to_frame(message, bus)
            except (ValueError, OverflowError) as error:
                counts.note_malformed(counts.lines, str(error))
                continue
            counts.frames += 1
            yield frame


class _TextLines:
    """The lines of a text log as python-can's readers expect them; counts lines and can insert one.

    A line that is too long is counted as malformed and not returned.

    Args:
        stream: the log's bytes.
        counts: `lines` and `other_lines` are counted: it is for the caller to tell which lines hold a frame.

    Attributes:
        last: the latest line.
        in_vain: lines since the latest one with a frame; set to 0 by the caller.
    """

    def __init__(self, stream: LogBytes, counts: LogCounts) -> None:
        self._lines = self._split(stream)
        self._counts = counts
        self._inserted: str | None = None
        self.last = ""
        self.in_vain = 0

    def insert(self, line: str) -> None:
        """Return `line` next; it is not counted."""
        self._inserted = line

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._inserted is not None:
            line, self._inserted = self._inserted, None
            return line
        self.last = next(self._lines)
        self._counts.lines += 1
        self._counts.other_lines += 1
        self.in_vain += 1
        return self.last

    def close(self) -> None:
        """Do nothing: the log is closed by who opened it."""

    def _split(self, stream: LogBytes) -> Iterator[str]:
        """Yield the lines, whatever they end in, each with a line feed."""
        rest, lost = b"", False
        while piece := stream.read1(_PIECE):
            text = rest + piece
            # a carriage return at the end may be half of a line end
            end = max(text.rfind(b"\n"), text.rfind(b"\r", 0, -1)) + 1
            rest = text[end:]
            for line in text[:end].splitlines():
                if lost or len(line) > LONGEST_LINE:
                    if not lost:
                        self._counts.note_bad_line(line[:_SHOWN].decode(errors="replace"))
                    lost = False
                else:
                    yield line.decode(errors="replace") + "\n"
                if self.in_vain > MOST_IN_VAIN:
                    self._counts.note_end(f"{self.in_vain:,} lines in a row without a frame: this is no CAN log")
                    return
            if len(rest) > LONGEST_LINE:
                if not lost:
                    self._counts.note_bad_line(rest[:_SHOWN].decode(errors="replace"))
                rest, lost = b"", True
        if rest and not lost:
            yield rest.decode(errors="replace")


class _AscLines(_TextLines):
    """The lines of an `.asc`, whose times python-can takes for absolute.

    Where the header says that they are relative, each counts from the event before, be that a frame or not.
    """

    def __init__(self, stream: LogBytes, counts: LogCounts) -> None:
        super().__init__(stream, counts)
        self._is_relative = False
        self._time_s = Decimal(0)

    def __next__(self) -> str:
        line = super().__next__()
        if base := _ASC_BASE.match(line):
            self._is_relative = base[1] is not None
        if not self._is_relative or (found := _ASC_TIME.match(line)) is None:
            return line
        self._time_s += Decimal(found[0])
        return f"{self._time_s:f}{line[found.end() :]}"


def _text_reader(name: str, header: str, make_lines: type[_TextLines] = _TextLines) -> _Reader:
    """Return a reader that skips lines which python-can cannot read.

    Args:
        name: of python-can's reader of a text file.
        header: end of a header for that reader, which expects one each time it starts.
        make_lines: what gives it the lines.
    """

    def read(stream: LogBytes, counts: LogCounts) -> Iterator[can.Message]:
        import can  # noqa: PLC0415 - it takes longer than to read most logs, and those of candump need none of it

        lines = make_lines(stream, counts)
        make: Callable[[TextIO], Iterable[can.Message]] = getattr(can, name)
        reader = make(cast("TextIO", lines))
        with stream:
            failed_at = counts.lines
            while True:  # ends: each round reads a line, or is the last
                try:
                    for message in reader:
                        counts.other_lines -= 1
                        lines.in_vain = 0
                        yield message
                except _BAD_LINE:
                    if counts.lines == failed_at:  # at the log's end, where it would fail forever
                        return
                    failed_at = counts.lines
                    # the reader stopped after the bad line and is restarted there
                    counts.other_lines -= 1
                    counts.note_malformed(counts.lines, lines.last)
                    lines.insert(header)
                else:
                    return

    return read


_READERS: dict[str, _Reader] = {
    ".asc": _text_reader("ASCReader", "no internal events logged\n", _AscLines),
    ".csv": _text_reader("CSVReader", "timestamp,arbitration_id,extended,remote,error,dlc,data\n"),
    ".trc": _text_reader("TRCReader", ";\n"),
}
