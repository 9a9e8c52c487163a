"""Reads and writes candump logs (`candump -L`), with time stamps exact to the digit.

Time stamps are whole nanoseconds taken from the digits; no float is involved. Written are 6 decimals where the time is
a whole microsecond, and 9 otherwise. Flags of CAN FD (bit rate switch, error state) are read and forgotten; written is
the bit rate switch, as CAN FD frames are sent live.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

from candaemon.bus.block import FrameBlock
from candaemon.bus.candumptext import ChunkDecoder
from candaemon.bus.frame import EXTENDED, Frame
from candaemon.bus.logstream import ChannelMap, LogBytes, LogCounts

CHUNK = 1 << 20
"""Bytes of text decoded at once. A line longer than that may be cut."""


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


def candump_line(frame: Frame, channel: str) -> str:
    """Return a frame as a line of `candump -L`, with its line end.

    Args:
        frame: the frame; its time must not be negative.
        channel: name of its bus.
    """
    time_ns, _, can_id, data, fd = frame
    seconds, fraction = divmod(time_ns, 1_000_000_000)
    microseconds, rest = divmod(fraction, 1000)
    digits = f"{fraction:09d}" if rest else f"{microseconds:06d}"
    identifier = f"{can_id & ~EXTENDED:08X}" if can_id & EXTENDED else f"{can_id:03X}"
    return f"({seconds:010d}.{digits}) {channel} {identifier}{'##1' if fd else '#'}{data.hex().upper()}\n"


def candump_text(frames: Sequence[Frame], channels: Sequence[str]) -> bytes:
    """Return frames as the text of `candump -L`; `channels` names the buses by index."""
    return "".join([candump_line(frame, channels[frame.bus]) for frame in frames]).encode()
