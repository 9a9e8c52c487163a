"""Reads and writes candump logs (`candump -L`), with time stamps exact to the digit.

Time stamps are whole nanoseconds taken from the digits; no float is involved. Written are 6 decimals where the time is
a whole microsecond, and 9 otherwise. Flags of CAN FD (bit rate switch, error state) are read and forgotten; written is
the bit rate switch, as CAN FD frames are sent live.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain
from pathlib import Path

from candaemon.bus.block import FrameBlock
from candaemon.bus.candumptext import ChunkDecoder
from candaemon.bus.frame import EXTENDED, Frame
from candaemon.bus.logstream import ChannelMap, LogBytes, LogCounts

CHUNK = 1 << 19
"""Bytes of text decoded at once: what is computed of them fits the cache. A line longer than that may be cut."""


def read_candump_blocks(
    path: Path, channels: ChannelMap, counts: LogCounts, *, chunk: int = CHUNK
) -> Iterator[FrameBlock]:
    """Read a candump log as arrays, a block a chunk of text, in the order of the file.

    Args:
        path: the log; `.gz` is decompressed.
        channels: which bus a channel belongs to; frames of no bus are counted and left out.
        counts: filled while reading.
        chunk: bytes of text a block.

    Raises:
        InputError: the file is not there or cannot be opened. What it holds never raises.
    """
    return _blocks(LogBytes(path, counts), channels, counts, chunk)


def read_candump(path: Path, channels: ChannelMap, counts: LogCounts) -> Iterator[Frame]:
    """Read a candump log frame by frame; otherwise as `read_candump_blocks`."""
    return chain.from_iterable(block.frames() for block in read_candump_blocks(path, channels, counts))


def _blocks(stream: LogBytes, channels: ChannelMap, counts: LogCounts, chunk: int) -> Iterator[FrameBlock]:
    """Cut the stream at line ends and decode what lies between."""
    with stream:
        rest = b""
        for piece in stream.chunks(chunk):
            end = piece.rfind(b"\n") + 1
            if end == 0 and len(rest) < chunk:
                rest += piece
                continue
            end = end or len(piece)
            text = b"".join((rest, memoryview(piece)[:end]))
            rest = piece[end:]
            yield ChunkDecoder(text, channels, counts).decode()
        if rest:
            malformed = counts.malformed
            yield ChunkDecoder(rest, channels, counts).decode()
            if counts.malformed > malformed and not counts.truncated:
                counts.note_end("its last line is cut short")


def candump_text(frames: Iterable[Frame], channels: Sequence[str]) -> bytes:
    """Return frames as the text of `candump -L`.

    Args:
        frames: the frames; no time may be negative.
        channels: names of the buses, by index.
    """
    lines = []
    stamp, stamp_ns, stamp_bus = "", -1, -1
    for time_ns, bus, can_id, data, fd in frames:
        # the frames of a cycle share their time
        if time_ns != stamp_ns or bus != stamp_bus:
            stamp, stamp_ns, stamp_bus = _stamp(time_ns, channels[bus]), time_ns, bus
        lines.append(f"{stamp}{_identifier(can_id, fd)}{data.hex().upper()}\n")
    return "".join(lines).encode()


def _stamp(time_ns: int, channel: str) -> str:
    """Return what precedes the identifier."""
    seconds, fraction = divmod(time_ns, 1_000_000_000)
    microseconds, rest = divmod(fraction, 1000)
    digits = f"{fraction:09d}" if rest else f"{microseconds:06d}"
    return f"({seconds:010d}.{digits}) {channel} "


@lru_cache(maxsize=4096)
def _identifier(can_id: int, fd: bool) -> str:
    """Return the identifier, and what parts it from the data."""
    digits = f"{can_id & ~EXTENDED:08X}" if can_id & EXTENDED else f"{can_id:03X}"
    return f"{digits}{'##1' if fd else '#'}"
