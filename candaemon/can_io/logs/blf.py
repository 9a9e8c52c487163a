"""Reads `.blf`, Vector's binary logging format: frames that lie whole in it come out, whatever else is damaged.

A file is a header and *containers* of up to some 128 KiB, each compressed by itself. Their contents, one after another,
are a sequence of *objects*, one a message, which may lie across containers. All begin with the mark `LOBJ` and a header
with size and type. The layout follows python-can's `can.io.blf`, which the tests compare.

What is damaged is skipped to the next header that can be one, and counted as malformed with its place: a container that
cannot be decompressed loses its own objects, a wrong size none. A size that was read never decides alone how far is
skipped or how much is kept, so that memory is bounded.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from struct import Struct
from typing import Final, NamedTuple

from candaemon.can_io.logs.stream import MOST_IN_VAIN, ChannelMap, LogBytes, LogCounts
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_block import FD_LENGTHS
from candaemon.frames.times import nanoseconds

LONGEST_CONTAINER: Final = 16 << 20
"""Bytes of a container, packed and unpacked; usual are 128 KiB."""
LONGEST_OBJECT: Final = 1 << 20
"""Bytes of an object in a container; messages have 48 to some 200."""

_MARK = b"LOBJ"
_FILE_HEADER = Struct("<4sL8xQ16x8H16x")  # mark, header size, …, file size, …, start as a SYSTEMTIME
_HEADER = Struct("<4sHHLL")  # mark, header size, header version, object size, type
_MESSAGE_HEADER = Struct("<4sHHLLL4xQ")  # the same, and flags, time
_VERSION = Struct("<H")  # of a header
_PACKING = Struct("<H6xL")  # how a container is compressed, and its bytes when it is not
_CLASSIC = Struct("<HBBL8s")  # channel, flags, length, identifier, data
_FD = Struct("<HBBL5xBB5x64s")  # channel, flags, length code, identifier, flags of CAN FD, length, data
_FD_64 = Struct(
    "<BBBxL4xL18xBB4x"
)  # channel, length code, length, identifier, flags, direction, place of the extension
_ERROR = Struct("<H30x")  # channel

_NEAR = 8  # bytes in which the next mark lies, padding before it
_PIECE = 1 << 16
_CONTENT = 32  # where a container's content begins
_BODY_AT = {1: 32, 2: 40}  # where a message's body begins, by version of its header
_HEADER_SIZES = range(_HEADER.size, 65)
_LAST_TYPE = 1 << 12  # those in use go to some 130
_STORED, _DEFLATED = 0, 2
_TEN_MICROSECONDS = 1  # flag of a time in these; others are in nanoseconds
_TICKS_10_US, _TICKS_1_NS = 100_000, 1_000_000_000  # a second

_CAN_MESSAGE, _CONTAINER, _CAN_ERROR_EXT = 1, 10, 73
_CAN_MESSAGE2, _CAN_FD_MESSAGE, _CAN_FD_MESSAGE_64 = 86, 100, 101
_BODIES = {
    _CAN_MESSAGE: (_CLASSIC.size, 16),
    _CAN_MESSAGE2: (_CLASSIC.size, 16),
    _CAN_FD_MESSAGE: (_FD.size, 16),
    _CAN_FD_MESSAGE_64: (_FD_64.size, 128),
    _CAN_ERROR_EXT: (_ERROR.size, 16),
}
"""Least bytes behind the header, and the most beyond these, by type of message. Other types are not read."""

_EXTENDED_ID, _ID_29, _ID_11 = 0x8000_0000, 0x1FFF_FFFF, 0x7FF
_REMOTE, _IS_FD = 0x80, 0x1
_REMOTE_64, _IS_FD_64 = 0x10, 0x1000
_CLASSIC_BYTES = 8
_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes by length code."""


def read_blf(stream: LogBytes, channels: ChannelMap, counts: LogCounts) -> Iterator[list[Frame]]:
    """Yield the data frames of each container, in the order of the file.

    Args:
        stream: the log.
        channels: which bus a channel belongs to.
        counts: filled while reading; `lines` counts objects.
    """
    with stream:
        window = _BlfWindow(stream)
        if not window.fill(_FILE_HEADER.size):
            counts.note_bad_line("no BLF header: the file is too short")
            return
        mark, size, file_size, *start = _FILE_HEADER.unpack_from(window.buffer)
        if mark != b"LOGG":
            counts.note_bad_line(f"no BLF header: it begins with {mark!r}")
        known = mark == b"LOGG" and _FILE_HEADER.size <= size <= _PIECE
        window.drop(size if known and window.fill(size) else _FILE_HEADER.size)
        objects = _BlfObjects(_timestamp(start), channels, counts)
        for content in _contents(window, counts):
            frames = objects.read(content)
            if frames:
                yield frames
            if objects.in_vain > MOST_IN_VAIN:
                counts.note_end(f"{objects.in_vain:,} objects in a row without a frame: this is no CAN log")
                return
        objects.finish()
        if known and stream.delivered < file_size and not counts.truncated:
            counts.note_end(f"its header tells of {file_size} bytes, it has {stream.delivered}")


def _timestamp(systemtime: Sequence[int]) -> float:
    """Return a SYSTEMTIME as seconds since 1970; 0 where it is none."""
    year, month, _, day, hour, minute, second, millisecond = systemtime
    try:
        return datetime(year, month, day, hour, minute, second, millisecond * 1000, tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0


def _header_at(data: bytes | bytearray, at: int, longest: int) -> tuple[int, int]:
    """Return size and type of the object whose header is at `at`; (0, 0) where that can be none."""
    if len(data) < at + _HEADER.size:
        return 0, 0
    mark, header_size, _, size, kind = _HEADER.unpack_from(data, at)
    if mark != _MARK or header_size not in _HEADER_SIZES or not 0 < kind < _LAST_TYPE:
        return 0, 0
    # a container is known by its content, whatever size it says
    return (size, kind) if kind == _CONTAINER or header_size <= size <= longest else (0, 0)


class _BlfWindow:
    """The part of a stream that is looked at.

    Attributes:
        buffer: its bytes.
        place: offset of the first one in the file.
    """

    def __init__(self, stream: LogBytes) -> None:
        self._stream = stream
        self.buffer = bytearray()
        self.place = 0

    def fill(self, size: int) -> bool:
        """Look at `size` bytes; return whether there are so many."""
        while len(self.buffer) < size:  # ends: no piece is empty
            piece = self._stream.read1(_PIECE)
            if not piece:
                return False
            self.buffer += piece
        return True

    def drop(self, size: int) -> None:
        """Go on behind the first `size` bytes."""
        size = min(size, len(self.buffer))
        del self.buffer[:size]
        self.place += size

    def header(self, at: int) -> tuple[int, int]:
        """Return size and type of the object that begins at `at`; (0, 0) where none can begin."""
        self.fill(at + _HEADER.size)
        return _header_at(self.buffer, at, LONGEST_CONTAINER)

    def next_to(self, end: int) -> int:
        """Return where an object or the file's end follows another one's end, padding between; −1 where none does."""
        if not _HEADER.size <= end <= 2 * LONGEST_CONTAINER:
            return -1
        if not self.fill(end + _NEAR) and len(self.buffer) >= end and self.buffer.find(_MARK, end) < 0:
            return len(self.buffer)
        at = self.buffer.find(_MARK, end, end + _NEAR)
        return at if at >= 0 and self.header(at)[0] else -1

    def is_end(self, end: int) -> bool:
        """Return whether a container or the file's end follows at `end`."""
        at = self.next_to(end)
        return at >= 0 and (at == len(self.buffer) or self.header(at)[1] == _CONTAINER)

    def find_container(self, begin: int) -> int:
        """Return where the first container from `begin` on begins; −1 if none does within the longest."""
        at = begin
        while self.fill(at + _HEADER.size) and at < begin + LONGEST_CONTAINER:  # ends: `at` increases
            found = self.buffer.find(_MARK, at)
            if found >= 0 and self.header(found)[1] == _CONTAINER:
                return found
            at = found + 1 if found >= 0 else len(self.buffer) - len(_MARK) + 1
        return -1

    def drop_to_container(self, begin: int) -> int:
        """Go on at the first container from `begin` on, or at the file's end; return the bytes left behind."""
        place = self.place
        self.drop(begin)
        while self.fill(1):  # ends: each round drops bytes
            found = self.find_container(0)
            self.drop(found if found >= 0 else len(self.buffer))
            if found >= 0:
                break
        return self.place - place


class _BlfContainer(NamedTuple):
    """What a container holds.

    Attributes:
        content: its objects.
        end: where it ends, by its content.
        is_whole: whether the file does not end in it.
    """

    content: bytes
    end: int
    is_whole: bool = True


class _BlfDamageError(Exception):
    """A container's content cannot be had; says why."""


def _contents(window: _BlfWindow, counts: LogCounts) -> Iterator[bytes | None]:
    """Yield the content of each container; None where something is lost."""
    while window.fill(_HEADER.size):  # ends: each round drops a header, or what is none
        size, kind = window.header(0)
        if kind == _CONTAINER:
            yield from _content(window, size, counts)
            continue
        place = window.place
        end = window.next_to(size) if kind else -1
        if end >= 0:  # an object beside the containers
            window.drop(end)
            counts.lines += 1
            counts.other_lines += 1
        else:
            counts.note_bad_line(f"{window.drop_to_container(1)} bytes at byte {place} are no object")
            yield None


def _content(window: _BlfWindow, size: int, counts: LogCounts) -> Iterator[bytes | None]:
    """Yield a container's content and go on behind it.

    Args:
        window: begins with the container.
        size: of the container, as its header has it.
        counts: of the log.
    """
    place = window.place
    try:
        container = _unpacked(window, size)
    except _BlfDamageError as error:
        if window.is_end(size):
            window.drop(window.next_to(size))
        else:
            window.drop_to_container(_HEADER.size)
        counts.note_bad_line(f"the container at byte {place} {error}; {window.place - place} bytes are skipped")
        yield None
        return
    yield container.content
    end = container.end
    if not container.is_whole:
        window.drop(len(window.buffer))
        counts.note_end(f"the container at byte {place} is cut short")
    elif end != size:
        behind = window.next_to(size) if size > end and window.is_end(size) else -1  # nobody forbids to leave room
        if behind < 0:
            counts.note_bad_line(f"the container at byte {place} has {end} bytes, not {size} as it says; it is used")
        window.drop(max(behind, window.next_to(end), end))
    else:
        window.drop(max(window.next_to(end), end))


def _unpacked(window: _BlfWindow, size: int) -> _BlfContainer:
    """Unpack the container that the window begins with.

    Raises:
        _BlfDamageError: it is damaged, or too long.
    """
    if not window.fill(_CONTENT):
        return _BlfContainer(b"", len(window.buffer), is_whole=False)
    method, length = _PACKING.unpack_from(window.buffer, _HEADER.size)
    if method == _STORED:
        # the size is there twice; where one is wrong, another container shows which
        sizes = [end for end in (size, _CONTENT + length) if window.is_end(end)]
        end = max(sizes) if sizes else window.find_container(_CONTENT)
        if end < 0 and size == _CONTENT + length and window.next_to(size) >= 0:
            end = size
        if end < 0 and len(window.buffer) > LONGEST_CONTAINER:
            raise _BlfDamageError("has no end")
        whole = end >= 0
        return _BlfContainer(bytes(window.buffer[_CONTENT : end if whole else None]), end, whole)
    if method != _DEFLATED:
        raise _BlfDamageError(f"is compressed by the unknown method {method}")
    return _inflated(window, size)


def _inflated(window: _BlfWindow, size: int) -> _BlfContainer:
    """Decompress the container that the window begins with; its own end counts, not the size that was read.

    Raises:
        _BlfDamageError: it cannot be decompressed, or is too long.
    """
    pieces: list[bytes] = []
    inflater, at, length = zlib.decompressobj(), _CONTENT, 0
    while not inflater.eof:  # ends: `at` or `length` increases, and both have a limit
        if not window.fill(at + 1):
            return _BlfContainer(b"".join(pieces), at, is_whole=False)
        if at > size and window.is_end(size):
            raise _BlfDamageError("does not end where the next one begins")
        packed = bytes(window.buffer[at : at + _PIECE])
        try:
            piece = inflater.decompress(packed, LONGEST_CONTAINER + 1 - length)
        except zlib.error as error:
            raise _BlfDamageError(f"cannot be decompressed ({error})") from None
        at += len(packed) - len(inflater.unconsumed_tail) - len(inflater.unused_data)
        length += len(piece)
        pieces.append(piece)
        if max(at, length) > LONGEST_CONTAINER:
            raise _BlfDamageError(f"holds more than {LONGEST_CONTAINER:,} bytes")
    return _BlfContainer(b"".join(pieces), at)


class _BlfObjects:
    """Reads the objects that containers hold.

    Args:
        start_s: time of the log's start, s.
        channels: which bus a channel belongs to.
        counts: of the log.

    Attributes:
        in_vain: objects since the last message.
    """

    def __init__(self, start_s: float, channels: ChannelMap, counts: LogCounts) -> None:
        self._start_s = start_s
        self._channels = channels
        self._counts = counts
        self._rest = b""
        self._is_lost = False
        self.in_vain = 0

    def read(self, content: bytes | None) -> list[Frame]:
        """Read a container's content, up to an object that goes on in the next one.

        Args:
            content: None where a container is lost.
        """
        frames: list[Frame] = []
        counts = self._counts
        if content is None:
            if self._rest and not self._is_lost:
                counts.note_bad_line("an object goes on in a container that is lost")
            self._rest, self._is_lost = b"", True  # the next one may begin with the end of an object
            return frames
        data = self._rest + content
        at = least = 0  # where the next object should begin, and where it can at the earliest
        while True:  # ends: `at` increases
            mark = data.find(_MARK, at, at + _NEAR)
            if mark < 0 and len(data) < at + _NEAR:
                break
            if mark >= 0 and len(data) < mark + _HEADER.size:
                at = mark
                break
            size, kind = _header_at(data, mark, LONGEST_OBJECT) if mark >= 0 else (0, 0)
            if not size:
                at = least = self._next(data, max(least, mark + 1), at)
                continue
            body, most_more = _BODIES.get(kind, (0, LONGEST_OBJECT))
            (version,) = _VERSION.unpack_from(data, mark + 6)
            begin = mark + _BODY_AT.get(version, _HEADER.size)
            if body and mark + size - begin - body > most_more:  # the size is wrong, the message may be right
                size = begin + body - mark
            if len(data) < mark + size:
                at = mark
                break
            self._is_lost = False
            self.in_vain = 0 if body else self.in_vain + 1
            try:
                if not body:
                    counts.other_lines += 1
                elif (frame := self._frame(data, mark, begin, size, kind)) is not None:
                    frames.append(frame)
                counts.lines += 1
            except ValueError as error:
                counts.note_bad_line(str(error))
            at = mark + size
            least = begin + body if body else mark + 1
        self._rest = data[at:]
        return frames

    def finish(self) -> None:
        """Note what is left at the log's end."""
        if len(self._rest) >= _NEAR and not self._is_lost and not self._counts.truncated:
            self._counts.note_end("its last object is cut short")

    def _next(self, data: bytes, begin: int, at: int) -> int:
        """Return where the next object begins that can be one, from `begin` on, where none begins at `at`."""
        found = begin
        while True:  # ends: `found` increases
            found = data.find(_MARK, found)
            if found < 0 or len(data) < found + _HEADER.size or _header_at(data, found, LONGEST_OBJECT)[0]:
                break
            found += 1
        if not self._is_lost:
            self._counts.note_bad_line(f"{max(found, at) - at} bytes among the objects are none")
        if found < 0:
            self._is_lost = True
            return max(len(data) - len(_MARK) + 1, begin)
        return found

    def _frame(self, data: bytes, mark: int, begin: int, size: int, kind: int) -> Frame | None:
        """Return the frame of a message; None, and counted, if it is a remote or error frame, or of no bus.

        Args:
            data: objects.
            mark: where the object begins.
            begin: where its body begins.
            size: of the object.
            kind: its type.

        Raises:
            ValueError: the object is too short, or identifier, length or time is out of what CAN can hold.
        """
        counts = self._counts
        _, header_size, version, _, _, flags, ticks = _MESSAGE_HEADER.unpack_from(data, mark)
        if version not in _BODY_AT or mark + size < begin + _BODIES[kind][0]:
            raise ValueError(f"a message of {size} bytes and header version {version}")
        if kind in (_CAN_MESSAGE, _CAN_MESSAGE2):
            channel, of_message, length, can_id, payload = _CLASSIC.unpack_from(data, begin)
            payload, fd, remote = payload[:length], False, of_message & _REMOTE
        elif kind == _CAN_FD_MESSAGE_64:
            channel, code, size_used, can_id, of_message, _, extension = _FD_64.unpack_from(data, begin)
            place = begin + _FD_64.size
            there = min(size_used, (extension or size) - header_size - _FD_64.size)
            payload = data[place : place + max(there, 0)].ljust(size_used, b"\0")
            length, fd, remote = _LENGTHS[min(code, 15)], bool(of_message & _IS_FD_64), of_message & _REMOTE_64
        elif kind == _CAN_FD_MESSAGE:
            channel, of_message, code, can_id, of_fd, size_used, payload = _FD.unpack_from(data, begin)
            payload, length, fd = payload[:size_used], _LENGTHS[min(code, 15)], bool(of_fd & _IS_FD)
            remote = of_message & _REMOTE
        else:
            (channel,) = _ERROR.unpack_from(data, begin)
        bus = self._channels.numbered(channel - 1)
        if bus < 0:
            counts.note_other_channel(str(channel - 1))
            return None
        if kind == _CAN_ERROR_EXT:
            counts.error_frames += 1
            return None
        if remote:
            counts.remote += 1
            return None
        extended = can_id & _EXTENDED_ID
        can_id &= _ID_29
        used = len(payload)
        if can_id > _ID_11 and not extended:
            raise ValueError(f"identifier {can_id:#x} is out of range")
        if used not in FD_LENGTHS or used < length <= _CLASSIC_BYTES:
            raise ValueError(f"{used} data bytes, where the length code is {length}")
        # through floats, as python-can has it: a microsecond that it has written is read as that
        time_ns = nanoseconds(ticks / (_TICKS_10_US if flags == _TEN_MICROSECONDS else _TICKS_1_NS) + self._start_s)
        counts.frames += 1
        return Frame(time_ns, bus, can_id | EXTENDED if extended else can_id, payload, fd or used > _CLASSIC_BYTES)
