"""Frames as arrays: what offline work takes instead of one object a frame."""

from __future__ import annotations

import struct
from collections.abc import Iterator
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
    """Consecutive data frames of a log, in the order of its lines.

    Attributes:
        time_ns: int64 (n,), the log's time stamps.
        bus: int16 (n,), index of the bus.
        can_id: uint32 (n,), with `EXTENDED` set for a 29-bit identifier.
        length: uint8 (n,), payload length in bytes.
        fd: bool (n,), whether it is a CAN FD frame.
        payload: uint8 (n, 8), or (n, 64) where the block holds CAN FD; zeros after the length.
        line: int64 (n,), 1-based number of the line.
    """

    time_ns: Integers
    bus: npt.NDArray[np.int16]
    can_id: npt.NDArray[np.uint32]
    length: Bytes
    fd: Booleans
    payload: Bytes
    line: Integers

    def __len__(self) -> int:
        return len(self.time_ns)

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
