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
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon.bus.block import FrameBlock
from candaemon.bus.candumptext import ChunkDecoder
from candaemon.bus.frame import EXTENDED, Frame
from candaemon.bus.instant import Instant
from candaemon.bus.logstream import ChannelMap, LogBytes, LogCounts

Text: TypeAlias = npt.NDArray[np.uint8]

_HEX = np.array([int.from_bytes(f"{value:02X}".encode(), "little") for value in range(256)], "<u2")
"""The two digits of each byte, as one number."""

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
    if isinstance(frames, Instant):
        return _instant_text(frames, channels)
    lines = []
    stamp, stamp_ns, stamp_bus = "", -1, -1
    for time_ns, bus, can_id, data, fd in frames:
        # the frames of a cycle share their time
        if time_ns != stamp_ns or bus != stamp_bus:
            stamp, stamp_ns, stamp_bus = _stamp(time_ns, channels[bus]), time_ns, bus
        lines.append(f"{stamp}{_identifier(can_id, fd)}{data.hex().upper()}\n")
    return "".join(lines).encode()


def _instant_text(frames: Instant, channels: Sequence[str]) -> bytes:
    """Return frames of one instant as text, without making one of them."""
    if not frames:
        return b""
    stamp, fd_ids = _stamp(frames.time_ns, channels[frames.bus]), frames.fd_ids
    can_ids, payloads = tuple([can_id for can_id, _ in frames.payloads]), [data for _, data in frames.payloads]
    if not fd_ids and set(map(len, payloads)) == {8}:
        heads = _heads(can_ids, len(stamp.encode()))
        if heads is not None:
            return _filled(heads, stamp.encode(), b"".join(payloads))
    return "".join(
        [f"{stamp}{_identifier(can_id, can_id in fd_ids)}{data.hex().upper()}\n" for can_id, data in frames.payloads]
    ).encode()


def _filled(heads: Text, stamp: bytes, payloads: bytes) -> bytes:
    """Return lines of eight bytes of data each, of which all else is there, with their stamp and their data."""
    lines = heads.copy()
    lines[:, : len(stamp)] = np.frombuffer(stamp, np.uint8)
    lines[:, -17:-1] = _HEX.take(np.frombuffer(payloads, np.uint8)).view(np.uint8).reshape(-1, 16)
    return lines.tobytes()


@lru_cache(maxsize=64)
def _heads(can_ids: tuple[int, ...], before: int) -> Text | None:
    """Return lines (n, characters) with identifiers and ends, a stamp before; None where their lengths differ."""
    heads = [_identifier(can_id, False).encode() for can_id in can_ids]
    size = len(heads[0])
    if any(len(head) != size for head in heads):
        return None
    lines = np.zeros((len(heads), before + size + 17), np.uint8)
    lines[:, before:-17] = np.frombuffer(b"".join(heads), np.uint8).reshape(-1, size)
    lines[:, -1] = ord("\n")
    return lines


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
