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
    """Give a socket a receive buffer for the configured traffic; warn where the kernel allows less.

    Args:
        receiving: the socket.
        request: which bus, how many frames/s it expects and for how long they are to be kept.
        frame_bytes: what a frame takes of the buffer, the kernel's book-keeping included.

    Raises:
        OSError: the kernel refuses.
    """
    settings = request.settings
    rate = settings.bitrate / FRAME_BITS if request.rate is None else request.rate
    wanted = int(settings.receive_buffer * rate * frame_bytes)
    given = receiving.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if wanted <= given:
        return
    half = wanted // 2 + 1  # the kernel doubles it
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, min(half, _MOST))
    given = receiving.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if given < wanted:
        logger.warning(
            "bus '%s': the kernel keeps %d frames (%.2f s) while the daemon is busy, expected %d (receive_buffer: "
            "%g s); set the sysctl net.core.rmem_max to %d or more, as config/sysctl.d/90-candaemon.conf does",
            request.name,
            given // frame_bytes,
            given / frame_bytes / rate,
            wanted // frame_bytes,
            settings.receive_buffer,
            half,
        )


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
