"""What crosses the pipeline's border: frames and ticks."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from functools import partial
from typing import Final, NamedTuple, cast

EXTENDED = 0x8000_0000
"""Set in `Frame.can_id` for a 29-bit identifier, as SocketCAN's CAN_EFF_FLAG."""


class Frame(NamedTuple):
    """One CAN data frame. A tuple, because hundreds of thousands a second are made.

    Attributes:
        time_ns: receive time, integer nanoseconds, from the kernel or the log.
        bus: index of the bus in the configuration's order; negative where it only tells how late it is.
        can_id: identifier, with `EXTENDED` set for a 29-bit one.
        data: payload, 0 to 8 bytes, or up to 64 for CAN FD.
        fd: whether it is a CAN FD frame.
    """

    time_ns: int
    bus: int
    can_id: int
    data: bytes
    fd: bool = False


make_frame: Final = cast("Callable[[tuple[int, int, int, bytes, bool]], Frame]", partial(tuple.__new__, Frame))
"""Makes a frame of the tuple of its fields. Frame(…) and Frame._make(…) are Python calls; this one stays in C."""


def frames_at(time_ns: int, bus: int, payloads: Iterable[tuple[int, bytes]], fd_ids: Container[int]) -> list[Frame]:
    """Return the frames of one instant.

    Args:
        time_ns: of all.
        bus: index, of all.
        payloads: CAN id and payload of each.
        fd_ids: the identifiers of CAN FD frames.
    """
    return [make_frame((time_ns, bus, can_id, data, can_id in fd_ids)) for can_id, data in payloads]


class Tick(NamedTuple):
    """It is this late: lets a silent sensor time out without a frame.

    Attributes:
        time_ns: the time, in the clock of the frames.
    """

    time_ns: int
