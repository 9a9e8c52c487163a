"""A log as arrays by bus and identifier: what came, when, and with which bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from candaemon.arrays import Bytes, Floats, Indices, Integers
from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import NO_CHANNEL, LogCounts
from candaemon.can_io.time_range import WHOLE_DRIVE
from candaemon.dbc.types import MessageSpec
from candaemon.errors import InputError
from candaemon.frames.frame_block import FrameBlock, block_of, joined_blocks

MOST_FRAMES: Final = 2_000_000
"""Frames of a log that are looked at, from its beginning: ten minutes of two full buses."""


@dataclass(frozen=True, slots=True)
class Stream:
    """The frames of one identifier on one channel, n of them.

    Attributes:
        time: (n,) s since the log's first frame.
        order: (n,) place in the log.
        length: (n,) payload bytes.
        payload: (n, 8 or 64) zeros behind the length.
        fd: whether a CAN FD frame is among them.
    """

    time: Floats
    order: Indices
    length: Bytes
    payload: Bytes
    fd: bool

    def of(self, message: MessageSpec) -> Stream:
        """Return the frames that are as long as a message, its payload cut to it."""
        enough = self.length >= message.length
        payload = self.payload[enough]
        if payload.shape[1] < message.length:
            payload = np.pad(payload, ((0, 0), (0, message.length - payload.shape[1])))
        return Stream(
            self.time[enough],
            self.order[enough],
            self.length[enough],
            np.ascontiguousarray(payload[:, : message.length]),
            self.fd,
        )


@dataclass(frozen=True, slots=True)
class LogTraffic:
    """A log.

    Attributes:
        logs: its files.
        channels: names.
        streams: by channel's index and identifier.
        seconds: duration.
        counts: of the reader.
    """

    logs: tuple[Path, ...]
    channels: tuple[str, ...]
    streams: Mapping[tuple[int, int], Stream]
    seconds: float
    counts: LogCounts

    @property
    def log(self) -> Path:
        """The first of its files."""
        return self.logs[0]

    def channel_of(self, messages: tuple[MessageSpec, ...]) -> int | None:
        """Return the channel on which most frames of some messages are as long as these; None where none came."""
        found = np.zeros(len(self.channels), np.int64)
        for message in messages:
            for channel in range(len(self.channels)):
                stream = self.streams.get((channel, message.can_id))
                if stream is not None:
                    # a stranger's message that has this identifier by chance is seldom as long
                    found[channel] += int(np.count_nonzero(stream.length == message.length))
        return int(found.argmax()) if found.any() else None

    def stream(self, channel: int, message: MessageSpec) -> Stream | None:
        """Return a message's frames on a channel, None where none came that is long enough."""
        stream = self.streams.get((channel, message.can_id))
        if stream is None:
            return None
        fitting = stream.of(message)
        return fitting if len(fitting.time) else None


def read_traffic(logs: Sequence[Path], buses: Mapping[str, int] | None = None, most: int = MOST_FRAMES) -> LogTraffic:
    """Read a log into arrays.

    Args:
        logs: in any format that a replay reads; several are one drive.
        buses: index by the channel's name; streams are of these indices then. Default: each channel for itself.
        most: frames that are read at most, from its beginning.

    Raises:
        InputError: there is no such log, or no data frame in it.
    """
    counts = LogCounts()
    for log in logs:
        check_log(log)
    for _ in chain.from_iterable(read_log_blocks(log, {}, counts) for log in logs):
        pass
    channels = tuple(sorted(counts.other_channels))
    if not channels:
        counts.require_frames(logs[0])
        raise InputError("not one data frame in it, expected a recorded CAN log", file=logs[0])
    known = {name: index for index, name in enumerate(channels) if name != NO_CHANNEL} or {"*": 0}
    counts, blocks, read = LogCounts(), [], 0
    reader = DriveReader(known if buses is None else buses, counts, WHOLE_DRIVE)
    for block in reader.by_time(logs):
        blocks.append(block if isinstance(block, FrameBlock) else block_of(block))
        read += len(block)
        if read >= most:
            break
    blocks = [block for block in blocks if len(block)]
    if not blocks:
        return LogTraffic(tuple(logs), channels, {}, 0.0, counts)
    joined = joined_blocks(blocks)
    joined = joined.rows(np.flatnonzero(joined.bus >= 0))
    if not len(joined):
        return LogTraffic(tuple(logs), channels, {}, 0.0, counts)
    return LogTraffic(tuple(logs), channels, _streams(joined), float(np.ptp(joined.time_ns)) * 1e-9, counts)


def _streams(block: FrameBlock) -> dict[tuple[int, int], Stream]:
    """Return frames by their bus and identifier."""
    key: Integers = block.bus.astype(np.int64) << 32 | block.can_id
    order = np.argsort(key, kind="stable")
    edges = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
    time = (block.time_ns - block.time_ns[0]) * 1e-9
    streams = {}
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        rows = order[begin:end]
        name = int(key[rows[0]])
        streams[name >> 32, name & 0xFFFF_FFFF] = Stream(
            time[rows], rows, block.length[rows], block.payload[rows], bool(block.fd[rows].any())
        )
    return streams
