"""Reads and writes candump logs (`candump -L`), with time stamps exact to the digit.

Time stamps are whole nanoseconds taken from the digits; no float is involved. They are written with 6 decimals where
the time is a whole microsecond, and with 9 otherwise. Flags of CAN FD (bit rate switch, error state) are ignored on
reading; the bit rate switch is always written, since live CAN FD frames are sent with it. What `candump` shows without
`-L` is read too: see `candump_screen`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon import compiled
from candaemon.arrays import Booleans, Bytes, Integers
from candaemon.can_io.logs.candump_screen import ADVICE_UNTIMED, ENDED_DIFFERENCES, ScreenLines
from candaemon.can_io.logs.stream import (
    EXAMPLES,
    LONGEST_LINE,
    MOST_IN_VAIN,
    UNCLAIMED,
    ChannelMap,
    LogBytes,
    LogCounts,
)
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_batch import FrameBatch
from candaemon.frames.frame_block import FD_LENGTHS, FrameBlock
from candaemon.frames.payload_table import TabledPayloads
from candaemon.frames.times import LATEST_NS

Digits: TypeAlias = npt.NDArray[np.uint16]
_Fields: TypeAlias = tuple[Integers, Integers, Integers, "Digits | Bytes", Booleans]
"""Seconds, fraction, identifier, data, and whether all of them are digits, of each line."""

_LINE = re.compile(
    rb"\((?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\) +(?P<channel>\S+) +"
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    rb"(?:(?P<fd>#[0-9A-Fa-f])?(?P<data>(?:[0-9A-Fa-f]{2})*)(?:_[0-9A-Fa-f])?|(?P<remote>[Rr][0-9A-Fa-f]?))"
    rb"(?: +[RrTt])?\s*"
)
_ERROR_FLAG = 0x2000_0000
_ID_29 = 0x1FFF_FFFF
_ID_11 = 0x7FF
_LAST_SECOND = LATEST_NS // 1_000_000_000 - 1
_LONGEST_SHAPE = 400  # characters; a CAN FD line has some 170 and its channel's name
_FEWEST_ROWS = 16  # from which numpy is faster
_MOST_SHAPES = 16  # of one length
_BAD = 0x100
_SHOWN = 500  # bytes of a malformed line, before it is cut for a message


def _digit_table(base: int) -> Digits:
    """Return the value of each ASCII digit, `_BAD` for any other character."""
    table = np.full(256, _BAD, np.uint16)
    for value, digit in enumerate("0123456789abcdef"[:base]):
        table[ord(digit)] = table[ord(digit.upper())] = value
    return table


def _pair_table(base: int) -> Digits:
    """Return the value of two ASCII digits, indexed by both as one little-endian number; `_BAD` for others."""
    digits = _digit_table(base)
    second, first = digits[:, None], digits[None, :]
    return np.where((first | second) >= _BAD, _BAD, first * base + second).astype(np.uint16).ravel()


_DIGIT = {base: _digit_table(base) for base in (10, 16)}
_PAIR = {base: _pair_table(base) for base in (10, 16)}


class ChunkDecoder:
    """Decodes the lines of a chunk of text into arrays with one row per line.

    Args:
        text: whole lines; the last one may lack its line end.
        channels: bus of each channel.
        counts: lines, frames and everything skipped are added to it.
    """

    def __init__(self, text: bytes, channels: ChannelMap, counts: LogCounts) -> None:
        self._text = text
        self._channels = channels
        self._counts = counts
        characters = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(characters == ord("\n"))
        if not text.endswith(b"\n"):
            ends = np.append(ends, len(text))
        self._starts = np.zeros_like(ends)
        self._starts[1:] = ends[:-1] + 1
        if b"\r" in text:
            ends -= (ends > self._starts) & (characters[ends - 1] == ord("\r"))
        self._ends = ends
        n = len(ends)
        self._first_line = counts.lines + 1
        counts.lines += n
        self._used = np.zeros(n, np.bool_)
        self._time = np.empty(n, np.int64)
        self._bus = np.empty(n, np.int16)
        self._id = np.empty(n, np.uint32)
        self._length = np.empty(n, np.uint8)
        self._fd = np.zeros(n, np.bool_)
        self._payload = np.zeros((n, 8), np.uint8)

    def decode(self) -> FrameBlock:
        """Decode every line and return the frames of claimed channels, in the order of their lines."""
        lengths = np.minimum(self._ends - self._starts, _LONGEST_SHAPE + 1).astype(np.uint16)
        order = np.argsort(lengths, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1)
        single = [self._decode_equally_long(rows, int(lengths[rows[0]])) for rows in groups if len(rows)]
        for row in sorted(row for rows in single for row in rows):
            self._decode_line(row)
        return self._block()

    def _block(self) -> FrameBlock:
        """Return the rows that hold a frame."""
        lines = np.flatnonzero(self._used)
        ticks = int(np.count_nonzero(self._bus[lines] < 0))
        self._counts.ticks += ticks
        self._counts.frames += len(lines) - ticks
        rows = slice(None) if len(lines) == len(self._used) else lines
        return FrameBlock(
            time_ns=self._time[rows],
            bus=self._bus[rows],
            can_id=self._id[rows],
            length=self._length[rows],
            fd=self._fd[rows],
            payload=self._payload[rows],
        )

    def _decode_equally_long(self, rows: Integers, length: int) -> list[int]:
        """Decode lines of one length, shape by shape; return the rows that remain to be decoded one by one."""
        single: list[int] = []
        if length == 0:
            self._counts.other_lines += len(rows)
            return single
        for _ in range(_MOST_SHAPES):
            if len(rows) < _FEWEST_ROWS or length > _LONGEST_SHAPE:
                break
            shape = _frame_shape(self._line(int(rows[0])))
            if shape is None:
                rows, malformed = self._without_copies(rows, length)
                single.extend(malformed)
            else:
                rows = self._decode_shape(shape, rows)
        single.extend(rows.tolist())
        return single

    def _without_copies(self, rows: Integers, length: int) -> tuple[Integers, list[int]]:
        """Take the first of equally long lines, which is no frame, and its copies from them; count most copies.

        Returns:
            the other lines, and those that are to be counted one by one.
        """
        line = self._line(int(rows[0])).strip()
        if _frame_shape(line) is not None:  # but for blanks before it
            return rows[1:], [int(rows[0])]
        lines = self._equally_long(rows, length)
        copies = lines == lines[0]
        first, *further = rows[copies].tolist()
        if not line:
            self._counts.other_lines += len(further)
            return rows[~copies], [first]
        self._counts.malformed += len(further[EXAMPLES:])
        return rows[~copies], [first, *further[:EXAMPLES]]

    def _equally_long(self, rows: Integers, length: int) -> npt.NDArray[np.void]:
        """Return the text of equally long lines (m,)."""
        # item i of this view is the text from character i on: the items overlap, nothing is copied
        places = np.ndarray((len(self._text) - length + 1,), f"V{length}", self._text, strides=(1,))
        return places[self._starts[rows]]

    def _line(self, row: int) -> bytes:
        """Return the text of a line."""
        return self._text[self._starts[row] : self._ends[row]]

    def _decode_shape(self, shape: re.Match[bytes], rows: Integers) -> Integers:
        """Decode those of equally long lines that have the shape of the first; return the others."""
        alike, fields = self._fields(shape, rows)
        others = rows[~alike]
        if len(others):
            rows = rows[alike]
        name = shape["channel"].decode(errors="replace")
        bus = self._channels.named(name)
        if bus == UNCLAIMED:
            self._counts.note_other_channel(name, len(rows))
            return others
        seconds, fraction, can_id, data, valid = fields()
        extended = len(shape["id"]) == 8
        valid &= (seconds <= _LAST_SECOND) & (extended or can_id <= _ID_11)
        if not valid.all():
            others = np.concatenate((others, rows[~valid]))
        frame = valid & (can_id & _ERROR_FLAG == 0)
        self._counts.error_frames += int(np.count_nonzero(valid & ~frame))
        if shape["remote"]:
            self._counts.remote += int(np.count_nonzero(frame))
            return others
        if not frame.all():
            rows, seconds, fraction, can_id, data = (a[frame] for a in (rows, seconds, fraction, can_id, data))
        self._used[rows] = True
        self._time[rows] = seconds * 1_000_000_000 + fraction * 10 ** (9 - len(shape["fraction"]))
        self._bus[rows] = bus
        self._id[rows] = can_id & _ID_29 | EXTENDED if extended else can_id
        self._length[rows] = data.shape[1]
        self._fd[rows] = shape["fd"] is not None
        self._put_payload(rows, data)
        return others

    def _fields(self, shape: re.Match[bytes], rows: Integers) -> tuple[Booleans, Callable[[], _Fields]]:
        """Return which of equally long lines have the shape of the first, and what reads the fields of those."""
        length, starts = shape.end(), self._starts[rows]
        if compiled.in_use:
            alike, numbers, payload, valid = compiled.kernels.frame_fields(
                self._text,
                starts,
                shape.string[:length],
                shape.span("seconds"),
                shape.span("fraction"),
                shape.span("id"),
                shape.span("data") if shape["data"] is not None else (length, length),
            )
            seconds, fraction, can_id = numbers
            return alike, lambda: (seconds, fraction, can_id, payload, valid)
        lines = self._equally_long(rows, length)
        alike = _same_between_fields(shape, lines)
        return alike, lambda: _read_fields(shape, lines[alike])

    def _put_payload(self, rows: Integers, data: Digits | Bytes) -> None:
        """Store the data bytes (m, size) of rows, in a wider array from the first long CAN FD frame on."""
        size = data.shape[1]
        if size > self._payload.shape[1]:
            self._payload = np.pad(self._payload, ((0, 0), (0, 64 - self._payload.shape[1])))
        width = self._payload.shape[1]
        if size == width:
            # one item per row: several times faster than column by column
            self._payload.view(f"V{width}")[:, 0][rows] = data.astype(np.uint8).view(f"V{width}")[:, 0]
        else:
            self._payload[rows, :size] = data

    def _decode_line(self, row: int) -> None:
        """Decode one line by the grammar."""
        line = self._line(row)
        too_long, line = len(line) > LONGEST_LINE, line.strip()
        match = None if too_long else _frame_shape(line)
        if match is None:
            if line or too_long:
                self._counts.note_malformed(self._first_line + row, line[:_SHOWN].decode(errors="replace"))
            else:
                self._counts.other_lines += 1
            return
        name = match["channel"].decode(errors="replace")
        bus = self._channels.named(name)
        can_id = int(match["id"], 16)
        extended = len(match["id"]) == 8
        if bus == UNCLAIMED:
            self._counts.note_other_channel(name)
        elif extended and can_id & _ERROR_FLAG:
            self._counts.error_frames += 1
        elif match["remote"]:
            self._counts.remote += 1
        else:
            data = bytes.fromhex(match["data"].decode())
            self._used[row] = True
            self._time[row] = int(match["seconds"]) * 1_000_000_000 + int(match["fraction"].ljust(9, b"0"))
            self._bus[row] = bus
            self._id[row] = can_id & _ID_29 | EXTENDED if extended else can_id
            self._length[row] = len(data)
            self._fd[row] = match["fd"] is not None
            self._put_payload(np.array([row]), np.frombuffer(data, np.uint8)[None, :].astype(np.uint16))


def _frame_shape(line: bytes) -> re.Match[bytes] | None:
    """Return the fields of a line; None where it is no valid CAN frame or its time is out of range."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    size = len(match["data"] or b"") // 2
    possible = (
        (size in FD_LENGTHS if match["fd"] else size <= 8)
        and (len(match["id"]) == 8 or int(match["id"], 16) <= _ID_11)
        and int(match["seconds"]) <= _LAST_SECOND
    )
    return match if possible else None


def _same_between_fields(shape: re.Match[bytes], lines: npt.NDArray[np.void]) -> Booleans:
    """Return which lines (m,) equal the first one outside the time, the identifier and the data."""
    fields = [shape.span(name) for name in ("seconds", "fraction", "id", "data") if shape[name] is not None]
    edges = [0, *(edge for field in fields for edge in field), shape.end()]
    alike = np.ones(len(lines), np.bool_)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end > begin:
            between = np.dtype(
                {"names": ["text"], "formats": [f"S{end - begin}"], "offsets": [begin], "itemsize": shape.end()}
            )
            alike &= lines.view(between)["text"] == shape.string[begin:end]
    return alike


def _read_fields(shape: re.Match[bytes], lines: npt.NDArray[np.void]) -> _Fields:
    """Return the fields of lines (m,) of a shape; where a character is no digit they are anything, and not valid."""
    text, valid = lines.view(np.uint8).reshape(-1, shape.end()), np.ones(len(lines), np.bool_)
    seconds = _number(text, shape.span("seconds"), 10, valid)
    fraction = _number(text, shape.span("fraction"), 10, valid)
    can_id = _number(text, shape.span("id"), 16, valid)
    return seconds, fraction, can_id, _data(text, shape, valid), valid


def _number(text: Bytes, span: tuple[int, int], base: int, valid: Booleans) -> Integers:
    """Return the number in the columns `span` of each line; clear `valid` where these are not all digits."""
    begin, end = span
    odd = (end - begin) % 2
    pairs = _digits(_PAIR[base], text[:, begin + odd : end].view("<u2"), valid)
    weights = (base * base) ** np.arange(pairs.shape[1], dtype=np.int64)[::-1]
    values: Integers = pairs @ weights
    if odd:
        values += _digits(_DIGIT[base], text[:, begin : begin + 1], valid)[:, 0] * np.int64(base ** (end - begin - 1))
    return values


def _digits(table: Digits, characters: npt.NDArray[np.integer[Any]], valid: Booleans) -> Digits:
    """Return the table's value of each character or pair (m, k); clear `valid` in lines with any other character."""
    values = table.take(characters)
    if values.max(initial=0) >= _BAD:
        valid &= (values < _BAD).all(axis=1)
    return values


def _data(text: Bytes, shape: re.Match[bytes], valid: Booleans) -> Digits:
    """Return the data bytes (m, size) of each line; clear `valid` where they are not all hex digits."""
    begin, end = shape.span("data")
    if begin == end:
        return np.empty((len(text), 0), np.uint16)
    return _digits(_PAIR[16], text[:, begin:end].view("<u2"), valid)


CHUNK = 1 << 19
"""Bytes of text decoded at once, so that the arrays fit the processor's cache; more than `LONGEST_LINE`."""


def read_candump_blocks(
    path: Path, channels: ChannelMap, counts: LogCounts, *, chunk: int = CHUNK
) -> Iterator[FrameBlock]:
    """Read a candump log as arrays, one block per chunk of text, in the order of the file.

    Args:
        path: the log; `.gz` is decompressed.
        channels: which bus a channel belongs to; frames of other channels are counted and skipped.
        counts: filled while reading.
        chunk: bytes of text per block.

    Raises:
        InputError: the file does not exist or cannot be opened. Malformed contents are counted and never raise.
    """
    return read_candump(LogBytes(path, counts), channels, counts, chunk)


def read_candump(stream: LogBytes, channels: ChannelMap, counts: LogCounts, chunk: int = CHUNK) -> Iterator[FrameBlock]:
    """Split the stream of a candump log at line ends and decode the chunks; see `read_candump_blocks`."""
    with stream:
        rest, lost, vain, screen = b"", False, 0, ScreenLines()
        for piece in stream.chunks(chunk):
            if lost:  # the rest of a line that was too long
                begin = piece.find(b"\n") + 1
                lost = not begin
                piece = piece[begin:] if begin else b""
            end = piece.rfind(b"\n") + 1
            if end:
                lines, malformed, blank = counts.lines, counts.malformed, counts.other_lines
                text = screen.logged(b"".join((rest, memoryview(piece)[:end])))
                if screen.are_differences:
                    counts.note_end(ENDED_DIFFERENCES)
                    return
                if screen.untimed:
                    counts.note_advice(ADVICE_UNTIMED)
                yield ChunkDecoder(text, channels, counts).decode()
                read = counts.lines - lines
                vain = vain + read if read == counts.malformed - malformed + counts.other_lines - blank else 0
                if vain > MOST_IN_VAIN:
                    counts.note_end(f"{vain:,} lines in a row without a frame: this is no CAN log")
                    return
                rest = b""
            rest += piece[end:]
            if len(rest) > LONGEST_LINE:
                counts.note_bad_line(rest[:_SHOWN].decode(errors="replace"))
                rest, lost = b"", True
        if rest:
            malformed = counts.malformed
            yield ChunkDecoder(screen.logged(rest), channels, counts).decode()
            if counts.malformed > malformed and not counts.truncated:
                counts.note_end("its last line is cut short")


def candump_text(frames: Iterable[Frame], channels: Sequence[str]) -> bytes:
    """Return frames as the text of `candump -L`.

    Args:
        frames: the frames; no time may be negative.
        channels: names of the buses, by index.
    """
    if isinstance(frames, FrameBatch):
        return _batch_text(frames, channels)
    lines = []
    stamp, stamp_ns, stamp_bus = "", -1, -1
    for time_ns, bus, can_id, data, fd in frames:
        # the frames of a cycle share their time
        if time_ns != stamp_ns or bus != stamp_bus:
            stamp, stamp_ns, stamp_bus = _stamp(time_ns, channels[bus]), time_ns, bus
        lines.append(f"{stamp}{_identifier(can_id, fd)}{data.hex().upper()}\n")
    return "".join(lines).encode()


def _batch_text(frames: FrameBatch, channels: Sequence[str]) -> bytes:
    """Return a frame batch as text, without creating `Frame` objects."""
    if not frames:
        return b""
    stamp, fd_ids = _stamp(frames.time_ns, channels[frames.bus]), frames.fd_ids
    if compiled.in_use:
        start, payloads = stamp.encode(), frames.payloads
        if fd_ids or not isinstance(payloads, TabledPayloads):
            return compiled.kernels.frame_lines(start, list(payloads), fd_ids, EXTENDED)
        lines = [compiled.kernels.table_lines(start, each.can_id, each.payload, EXTENDED) for each in payloads.tables]
        return b"".join([compiled.kernels.frame_lines(start, payloads.first, fd_ids, EXTENDED), *lines])
    return "".join(
        [f"{stamp}{_identifier(can_id, can_id in fd_ids)}{data.hex().upper()}\n" for can_id, data in frames.payloads]
    ).encode()


def _stamp(time_ns: int, channel: str) -> str:
    """Return time stamp and channel, the text before the identifier."""
    seconds, fraction = divmod(time_ns, 1_000_000_000)
    microseconds, rest = divmod(fraction, 1000)
    digits = f"{fraction:09d}" if rest else f"{microseconds:06d}"
    return f"({seconds:010d}.{digits}) {channel} "


@lru_cache(maxsize=4096)
def _identifier(can_id: int, fd: bool) -> str:
    """Return the identifier and the separator before the data."""
    digits = f"{can_id & ~EXTENDED:08X}" if can_id & EXTENDED else f"{can_id:03X}"
    return f"{digits}{'##1' if fd else '#'}"
