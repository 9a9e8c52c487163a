"""The kernel's receive buffer of a socket: how much it holds, and how many frames found no room in it."""

from __future__ import annotations

import logging
import socket
import struct
from typing import Final

from candaemon.can_io.port import PortCounts, PortRequest

logger = logging.getLogger(__name__)

FRAME_BITS: Final = 111
"""A classic frame of 8 bytes without stuff bits: a full bus has no more of them a second."""

SO_RXQ_OVFL: Final = 40
"""Socket option of Linux that Python has no name for: a datagram comes with the count of those dropped before it."""

_SO_MEMINFO: Final = 55
_MEMORY: Final = struct.Struct("@32xI")
"""SO_MEMINFO: the last of its numbers is the count of SO_RXQ_OVFL."""
_MOST: Final = (1 << 30) - 1
"""No kernel gives more than twice this."""


def size_receive_buffer(receiving: socket.socket, request: PortRequest, frame_bytes: int) -> None:
    """Give a socket a receive buffer for a full bus; warn where the kernel allows less than the configured traffic.

    A sender may be faster than its DBC says, and a buffer takes no memory before frames wait in it.

    Args:
        receiving: the socket.
        request: which bus, how many frames/s it expects and for how long they are to be kept.
        frame_bytes: what a frame takes of the buffer, the kernel's book-keeping included.

    Raises:
        OSError: the kernel refuses.
    """
    settings = request.settings
    full = settings.bitrate / FRAME_BITS
    rate = full if request.rate is None else request.rate
    needed, wanted = (int(settings.receive_buffer * each * frame_bytes) for each in (rate, max(rate, full)))
    given = receiving.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if given < wanted:
        receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, min(_half(wanted), _MOST))
        given = receiving.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if given < needed:
        logger.warning(
            "bus '%s': the kernel keeps %d frames (%.2f s) while the daemon is busy, expected %d (receive_buffer: "
            "%g s); set the sysctl net.core.rmem_max to %d or more, as config/sysctl.d/90-candaemon.conf does",
            request.name,
            given // frame_bytes,
            given / frame_bytes / rate,
            needed // frame_bytes,
            settings.receive_buffer,
            _half(needed),
        )


def _half(size: int) -> int:
    """Return what to ask for, as the kernel doubles it."""
    return size // 2 + 1


class ReceiveDrops:
    """Counts each frame that found no room once, whether a later frame or a look at the socket reports it first.

    Args:
        receiving: the socket.
        counts: `kernel_lost` is counted there.

    Attributes:
        in_all: those known of, in the kernel's 32 bits.
    """

    __slots__ = ("_counts", "_receiving", "in_all")

    def __init__(self, receiving: socket.socket, counts: PortCounts) -> None:
        self._receiving = receiving
        self._counts = counts
        self.in_all = 0

    def note(self, in_all: int) -> None:
        """Take over what a frame came with; one that came before the last look knows of fewer.

        Args:
            in_all: frames dropped before it, since the socket is there.
        """
        more = (in_all - self.in_all) & 0xFFFF_FFFF
        if more < 1 << 31:
            self._counts.kernel_lost += more
            self.in_all = in_all

    def look(self) -> None:
        """Count what was dropped up to now, behind the last frame too; nothing on a kernel before 4.12."""
        try:
            memory = self._receiving.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMORY.size)
            self.note(int(_MEMORY.unpack(memory)[0]))
        except (OSError, struct.error):
            return
