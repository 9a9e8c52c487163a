"""Frames as arrays: what offline work takes instead of one object a frame."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat, starmap
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Bytes, Indices, Integers
from candaemon.frames.frame import Frame

FD_LENGTHS = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))
"""Payload lengths in bytes that CAN FD can carry."""


@dataclass(frozen=True, slots=True)
class FrameBlock:
    """Consecutive data frames of a log.

    Attributes:
        time_ns: int64 (n,), the log's time stamps.
        bus: int16 (n,), index of the bus.
        can_id: uint32 (n,), with `EXTENDED` set for a 29-bit identifier.
        length: uint8 (n,), payload length in bytes.
        fd: bool (n,), whether it is a CAN FD frame.
        payload: uint8 (n, 8), or (n, 64) where the block holds CAN FD; zeros after the length.
    """

    time_ns: Integers
    bus: npt.NDArray[np.int16]
    can_id: npt.NDArray[np.uint32]
    length: Bytes
    fd: Booleans
    payload: Bytes

    def __len__(self) -> int:
        return len(self.time_ns)

    def rows(self, rows: Indices | slice) -> FrameBlock:
        """Return some of its frames, in that order."""
        return FrameBlock(
            self.time_ns[rows],
            self.bus[rows],
            self.can_id[rows],
            self.length[rows],
            self.fd[rows],
            np.ascontiguousarray(self.payload[rows]),
        )

    def payloads(self, rows: Indices) -> list[bytes]:
        """Return the payloads of some rows, each as long as it is."""
        width = self.payload.shape[1]
        records = np.empty((len(rows), 1 + width), np.uint8)
        records[:, 0], records[:, 1:] = self.length[rows], self.payload[rows]
        # "p" takes the length's byte and gives that many of the payload's
        return [data for (data,) in struct.iter_unpack(f"{width + 1}p", records.tobytes())]

    def frames(self) -> Iterator[Frame]:
        """Return the frames one by one."""
        width = self.payload.shape[1]
        records = np.rec.fromarrays(
            [self.time_ns, self.bus, self.can_id, self.length, self.payload.view(f"V{width}").ravel(), self.fd],
            dtype=f"i8,i2,u4,u1,V{width},?",
        )
        # "p" takes the length's byte and gives that many of the payload's
        fields = struct.iter_unpack(f"=qhI{width + 1}p?", records)
        # Frame(…) and Frame._make(…) are Python calls; this one stays in C
        return starmap(cast("Any", tuple.__new__), zip(repeat(Frame), fields, strict=False))


def block_of(frames: Sequence[Frame]) -> FrameBlock:
    """Return frames as a block."""
    length = np.array([len(frame.data) for frame in frames], np.uint8)
    width = 8 if length.max(initial=0) <= 8 else 64
    payload = b"".join([frame.data.ljust(width, b"\0") for frame in frames])
    return FrameBlock(
        time_ns=np.array([frame.time_ns for frame in frames], np.int64),
        bus=np.array([frame.bus for frame in frames], np.int16),
        can_id=np.array([frame.can_id for frame in frames], np.uint32),
        length=length,
        fd=np.array([frame.fd for frame in frames], np.bool_),
        payload=np.frombuffer(payload, np.uint8).reshape(-1, width),
    )


def joined_blocks(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Return blocks, one after another, as one."""
    width = max(block.payload.shape[1] for block in blocks)
    return FrameBlock(
        time_ns=np.concatenate([block.time_ns for block in blocks]),
        bus=np.concatenate([block.bus for block in blocks]),
        can_id=np.concatenate([block.can_id for block in blocks]),
        length=np.concatenate([block.length for block in blocks]),
        fd=np.concatenate([block.fd for block in blocks]),
        payload=np.concatenate(
            [np.pad(block.payload, ((0, 0), (0, width - block.payload.shape[1]))) for block in blocks]
        ),
    )
