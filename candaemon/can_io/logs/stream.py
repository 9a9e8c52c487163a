"""Common parts of all log readers: counters, the byte stream of a plain or compressed file, and the channel map."""

from __future__ import annotations

import io
import logging
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from candaemon.can_io.logs.compression import compression_by_content, compression_by_name, unpacked
from candaemon.errors import InputError
from candaemon.printable import printable

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

logger = logging.getLogger(__name__)

ANY_CHANNEL = "*"
"""Key of a channel mapping for every channel without a key of its own."""

NO_CHANNEL = "none"
"""Name in `LogCounts.other_channels` for the frames of a format without channels."""

TICK_CHANNEL = "tick"
"""Channel of a recording's ticks, lines with a time only: `(1533226488.434433) tick 000#`."""
TICK_BUS = -2
"""Bus index of ticks."""
UNCLAIMED = -1
"""Bus index of a channel that belongs to no bus."""

EXAMPLES: Final = 5
"""Malformed lines that are quoted."""
LONGEST_LINE: Final = 1 << 14
"""Bytes of a line of a text log; one with a frame has some 600 at most."""
MOST_IN_VAIN: Final = 1_000_000
"""Lines, or objects of a `.blf`, in a row without a frame of any kind, after which a file is taken for no log."""
MOST_OTHER_CHANNELS: Final = 64
"""Channels without a bus that are counted one by one."""
MOST_CHANNELS: Final = 256
"""Channels of a log that get a bus each where all are wanted."""
FURTHER_CHANNELS = "further channels"
"""Name in `LogCounts.other_channels` for all beyond these; no format has names with blanks."""

_LONGEST_NAME = 100
_TRAILING_NUMBER = re.compile(r"(\d+)$")
_CAN_NUMBER = re.compile(r"can(0|[1-9][0-9]{0,8})")
_SUMMED: Final = (
    "lines",
    "frames",
    "malformed",
    "remote",
    "error_frames",
    "ticks",
    "outside",
    "other_lines",
    "bytes_read",
    "bytes_total",
)
_summed: Final = attrgetter(*_SUMMED)


@dataclass(slots=True)
class LogCounts:
    """Counts of a log reader; updated while reading, up to one chunk ahead of the frames it has returned.

    Of several logs that are read as one, the values are sums, taken over from a part `of_one` each.

    Attributes:
        lines: lines of a text log, objects of a `.blf`, records of an `.mf4`, packets and blocks of a capture. Each is
            one of what follows: `lines` is the sum of `frames`, `malformed`, `remote`, `error_frames`, `ticks`,
            `outside`, `other_lines` and the values of `other_channels`.
        frames: data frames passed on.
        malformed: lines that are not a valid frame.
        examples: the first few malformed lines, as "line N: text", after the log's name and a comma if it is a part.
        remote: remote frames, skipped.
        error_frames: error frames, skipped.
        ticks: lines with a time only, passed on.
        outside: frames and ticks outside of the range of time that is asked for.
        other_lines: lines that hold no frame by their kind: blank, headers, comments, events. Among them are those
            that python-can does not recognise in `.asc` and `.trc`.
        other_channels: frames of each channel that belongs to no bus, skipped; those of too many channels together.
        truncated: whether the file ends early.
        stream_error: reason of an early end (truncated compressed stream, read error), else empty.
        advice: what to do about what a reader does not take, else empty.
        bytes_read: position in the file on disk, compressed or not; for a progress bar.
        bytes_total: size of that file; 0 of a pipe.
        tells: whether oddities are logged.
        log: name of the log of which these are a part, else empty.
    """

    lines: int = 0
    frames: int = 0
    malformed: int = 0
    examples: list[str] = field(default_factory=list)
    remote: int = 0
    error_frames: int = 0
    ticks: int = 0
    outside: int = 0
    other_lines: int = 0
    other_channels: dict[str, int] = field(default_factory=dict)
    truncated: bool = False
    stream_error: str = ""
    advice: str = ""
    bytes_read: int = 0
    bytes_total: int = 0
    tells: bool = True
    log: str = ""
    _taken: tuple[int, ...] = (0,) * len(_SUMMED)

    def of_one(self, log: Path) -> LogCounts:
        """Return counts of one of several logs, to be given to `take_over` again and again while it is read."""
        return LogCounts(
            examples=self.examples, other_channels=self.other_channels, tells=self.tells, log=printable(str(log))
        )

    def take_over(self, part: LogCounts) -> None:
        """Add what a part has counted since it was taken over last."""
        values = _summed(part)
        for name, value, taken in zip(_SUMMED, values, part._taken, strict=True):
            if value != taken:
                setattr(self, name, getattr(self, name) + value - taken)
        part._taken = values
        self.truncated |= part.truncated
        self.stream_error = self.stream_error or part.stream_error
        self.advice = self.advice or part.advice

    def note_malformed(self, line: int, text: str) -> None:
        """Count a malformed line; store and log the first few.

        Args:
            line: 1-based number of the line.
            text: the line, or the reason.
        """
        self.malformed += 1
        if len(self.examples) >= EXAMPLES:
            return
        of_log = f"{self.log}, " if self.log else ""
        example = f"{of_log}line {line}: {text[:500].strip()[:80]!r}"
        self.examples.append(example)
        last = "; further ones are only counted" if len(self.examples) == EXAMPLES else ""
        self._tell("not a CAN frame, skipped: %s%s", example, last)

    def note_bad_line(self, text: str) -> None:
        """Count a line, or an object of a `.blf`, that is malformed; `text` is the line, or the reason."""
        self.lines += 1
        self.note_malformed(self.lines, text)

    def note_other_channel(self, channel: str, frames: int = 1) -> None:
        """Count frames of a channel that belongs to no bus."""
        found, channel = self.other_channels, channel[:_LONGEST_NAME]
        if channel not in found and len(found) >= MOST_OTHER_CHANNELS:
            channel = FURTHER_CHANNELS
        found[channel] = found.get(channel, 0) + frames

    def note_end(self, reason: str) -> None:
        """Record that the file ended early."""
        self.truncated = True
        self.stream_error = reason
        self._tell("%s ends early: %s; what came before it is used", self.log or "the log", reason)

    def note_advice(self, advice: str) -> None:
        """Record, and tell once, what to do about what is not read."""
        if not self.advice:
            self.advice = advice
            self._tell("%s%s", f"{self.log}: " if self.log else "", advice)

    def _tell(self, text: str, *words: str) -> None:
        """Log what a user should know."""
        if self.tells:
            logger.warning(text, *words)

    def require_frames(self, path: Path) -> None:
        """Raise if a log, read to its end, held neither a frame nor a tick.

        Args:
            path: the log, for the message.

        Raises:
            InputError: there was none; the message says what was found instead, and what to do.
        """
        if self.frames or self.ticks:
            return
        found = [f"{self.malformed} malformed"] if self.malformed else []
        found += [f"{self.remote} remote"] if self.remote else []
        found += [f"{self.error_frames} error frames"] if self.error_frames else []
        found += [f"{self.outside} outside of the range of time"] if self.outside else []
        listed = sorted(self.other_channels.items(), key=lambda item: -item[1])
        found += [f"{count} of channel '{name}'" for name, count in listed[:EXAMPLES]]
        found += [f"{len(listed) - EXAMPLES} more channels"] if len(listed) > EXAMPLES else []
        found += [f"the file ends early ({self.stream_error})"] if self.stream_error else []
        text = f"not one usable frame in {self.lines} lines"
        text += f": {', '.join(found)}" if found else ""
        text += f"; first, {self.examples[0]}" if self.examples else ""
        if self.advice:
            text += f"; {self.advice}"
        elif self.outside:
            text += "; check the range of time"
        elif self.other_channels:
            text += "; give a bus that channel as its log_channel, or replay with --map CHANNEL=BUS"
        else:
            text += "; expected a recorded CAN log, such as `candump -L` writes"
        raise InputError(text, file=path)


class ChannelMap:
    """Maps the channels of a log to buses.

    A channel is looked up by its exact name. The *numbered* channels of `.asc`, `.blf` and `.trc` count from 0 here, as
    python-can does (channel 1 in the file is `0`): a number is looked up as a name, then as the number that the names
    of exactly one bus end in, so that 0 finds `can0`, and last as `ANY_CHANNEL`. Frames of a format without channels
    belong to `ANY_CHANNEL`, or else to the only bus. `TICK_CHANNEL` maps to `TICK_BUS`.

    Args:
        channels: bus index by channel name; several names may map to one bus.
    """

    def __init__(self, channels: Mapping[str, int]) -> None:
        self._by_name = {name: bus for name, bus in channels.items() if name != ANY_CHANNEL}
        self._by_name[TICK_CHANNEL] = TICK_BUS
        buses = set(channels.values())
        self._any = channels.get(ANY_CHANNEL, UNCLAIMED)
        self._unnamed = self._any if self._any >= 0 or len(buses) != 1 else buses.pop()
        ends: dict[int, set[int]] = {}
        for name, bus in self._by_name.items():
            number = channel_number(name)
            if number is not None:
                ends.setdefault(number, set()).add(bus)
        self._by_number = {number: next(iter(claimed)) for number, claimed in ends.items() if len(claimed) == 1}

    def named(self, channel: str) -> int:
        """Return the bus of a named channel, `UNCLAIMED` if it has none."""
        return self._by_name.get(channel, self._any)

    def numbered(self, channel: int | None) -> int:
        """Return the bus of a numbered channel, or of a frame without one; `UNCLAIMED` if it has none."""
        if channel is None:
            return self._unnamed
        bus = self._by_name.get(str(channel))
        return self._by_number.get(channel, self._any) if bus is None else bus


class EveryChannel(ChannelMap):
    """Gives each channel of a log a bus of its own, in the order in which they come; numbered channels as `can0`.

    Attributes:
        names: of the buses, by index.
    """

    def __init__(self) -> None:
        super().__init__({})
        self.names: list[str] = []
        self._buses = {TICK_CHANNEL: TICK_BUS}

    def named(self, channel: str) -> int:
        """Return the bus of a channel; `UNCLAIMED` where there are too many."""
        bus = self._buses.get(channel)
        if bus is None:
            if len(self.names) >= MOST_CHANNELS:
                return UNCLAIMED
            bus = self._buses[channel] = len(self.names)
            self.names.append(channel)
        return bus

    def numbered(self, channel: int | None) -> int:
        """Return the bus of a numbered channel, or of a frame without one."""
        return self.named(f"can{channel or 0}")


def channel_number(name: str) -> int | None:
    """Return the number that a channel's name ends in: 0 of `can0`."""
    match = _TRAILING_NUMBER.search(name)
    return None if match is None else int(match[1])


def can_number(name: str) -> int | None:
    """Return the number of a channel that is called as a numbered one is read: 0 of `can0`, None of `vcan0`."""
    match = _CAN_NUMBER.fullmatch(name)
    return None if match is None else int(match[1])


STANDARD_INPUT: Final = Path("/dev/stdin")
"""The log that comes through standard input."""
_PIPE = 1 << 16
"""Bytes that a pipe holds: a read that returns fewer has emptied it."""


class _CountedFile(io.FileIO):
    """A file that counts the bytes read of it, be it a pipe or not."""

    def __init__(self, file: Path | int, counts: LogCounts) -> None:
        super().__init__(file, closefd=not isinstance(file, int))
        self._counts = counts

    def readinto(self, buffer: WriteableBuffer, /) -> int | None:
        """Read into a buffer; return how many bytes."""
        size = super().readinto(buffer)
        self._counts.bytes_read += size or 0
        return size


class LogBytes(io.RawIOBase):
    """The bytes of a log, decompressed as its name says; reports its position in the counts.

    A truncated or damaged compressed stream ends early: everything decompressed until then is returned, and the reason
    is recorded in the counts.

    Args:
        path: the file; `STANDARD_INPUT` need not be there by that name.
        counts: receives the size, the position and the reason of an early end.
        by_content: whether the file's first bytes tell how it is compressed, not its name.

    Attributes:
        delivered: decompressed bytes returned so far.
        is_plain: whether the file's bytes are the log's.

    Raises:
        InputError: the file does not exist, cannot be opened, or needs a library that is not installed.
    """

    def __init__(self, path: Path, counts: LogCounts, *, by_content: bool = False) -> None:
        self._counts = counts
        self._ended = False
        self._held = b""
        self.delivered = 0
        try:
            self._file = io.BufferedReader(_CountedFile(0 if path == STANDARD_INPUT else path, counts))
            size = os.fstat(self._file.fileno()).st_size
            head = self._file.peek(1) if by_content else b""
        except FileNotFoundError:
            raise InputError("there is no such log; check the path", file=path) from None
        except OSError as error:
            raise InputError(f"the log cannot be opened: {error.strerror}", file=path) from error
        self._flows = not self._file.seekable()
        counts.bytes_total += 0 if self._flows else size
        compression = compression_by_content(head) if by_content else compression_by_name(path)
        self.is_plain = not compression
        try:
            self._source = unpacked(self._file, compression, path)
        except InputError:
            self._file.close()
            raise

    def peek(self) -> bytes:
        """Return the next bytes without going on, at least one unless the log ends here."""
        if not self._held:
            self._held = self._read1(_PIPE)
        return self._held

    def read1(self, size: int) -> bytes:
        """Return up to `size` bytes, b"" at the end."""
        if self._held:
            piece, self._held = self._held[:size], self._held[size:]
        else:
            piece = self._read1(size)
        self.delivered += len(piece)
        return piece

    def _read1(self, size: int) -> bytes:
        if self._ended:
            return b""
        try:
            return self._source.read1(size)
        except (EOFError, OSError, zlib.error) as error:
            self._counts.note_end(str(error))
            self._ended = True
            return b""

    def chunks(self, size: int) -> Iterator[bytes]:
        """Yield the content in chunks of at least `size` bytes, the last one shorter; of a pipe, what there is."""
        pieces: list[bytes] = []
        collected = 0
        while piece := self.read1(size):
            pieces.append(piece)
            collected += len(piece)
            if collected >= size or (self._flows and len(piece) < _PIPE):
                yield b"".join(pieces)
                pieces.clear()
                collected = 0
        if pieces:
            yield b"".join(pieces)

    def readable(self) -> bool:
        """Return True: the stream is readable."""
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Fill `buffer` with one read; return the number of bytes."""
        target = memoryview(buffer).cast("B")
        piece = self.read1(len(target))
        target[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            self._source.close()
            self._file.close()
        super().close()
