"""The receive buffer of a socket: room for the configured traffic while the daemon is busy."""

from __future__ import annotations

import logging
import socket
from typing import Final

from candaemon.bus.ports import PortRequest

logger = logging.getLogger(__name__)

FRAME_BITS: Final = 111
"""A classic frame of 8 bytes without stuff bits: a full bus has no more of them a second."""

_MOST: Final = (1 << 30) - 1
"""No kernel gives more than twice this."""


def make_room(receiving: socket.socket, request: PortRequest, frame_bytes: int) -> None:
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
