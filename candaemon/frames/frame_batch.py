"""Frames of one instant to be sent, made into `Frame`s only where they are needed one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from typing import overload

from candaemon.frames.frame import Frame, frames_at


class FrameBatch(Sequence[Frame]):
    """The frames that one cycle sends on one bus.

    A log takes them as they are, in half of the time.

    Args:
        time_ns: of all.
        bus: index, of all.
        payloads: CAN id and payload of each.
        fd_ids: the identifiers of CAN FD frames.
    """

    __slots__ = ("bus", "fd_ids", "payloads", "time_ns")

    def __init__(
        self, time_ns: int, bus: int, payloads: Sequence[tuple[int, bytes]], fd_ids: AbstractSet[int] = frozenset()
    ) -> None:
        self.time_ns = time_ns
        self.bus = bus
        self.payloads = payloads
        self.fd_ids = fd_ids

    def __len__(self) -> int:
        return len(self.payloads)

    def __iter__(self) -> Iterator[Frame]:
        return iter(frames_at(self.time_ns, self.bus, self.payloads, self.fd_ids))

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...

    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        if isinstance(index, slice):
            return FrameBatch(self.time_ns, self.bus, self.payloads[index], self.fd_ids)
        can_id, data = self.payloads[index]
        return Frame(self.time_ns, self.bus, can_id, data, can_id in self.fd_ids)
