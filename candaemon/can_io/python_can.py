"""Buses that python-can opens: every interface that has no port of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can

from candaemon.can_io.messages import to_frame, to_message
from candaemon.can_io.port import PortRequest
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import Frame


class PythonCanPort:
    """A bus opened through python-can, whose errors reach the caller. Receiving waits: `ReaderPort` is for that.

    Args:
        request: what to open.

    Raises:
        can.CanError, OSError, ValueError, ImportError, NotImplementedError, TypeError: python-can cannot open it so.
    """

    def __init__(self, request: PortRequest) -> None:
        settings = request.settings
        self._index = request.index
        self._counts = request.counts
        # what a python-can configuration file on this machine says must not change the daemon
        self._bus = can.Bus(
            channel=settings.channel,
            interface=settings.interface,
            ignore_config=True,
            receive_own_messages=False,
            **{**_rates(settings), **settings.options},
        )

    def receive(self, limit: int, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for a frame; return it and those that wait behind it, `limit` messages at most.

        Raises:
            can.CanError, OSError, ValueError: the bus is gone.
        """
        frames: list[Frame] = []
        message = self._bus.recv(timeout_s)
        for _ in range(limit - 1):
            if message is None:
                return frames
            self._take(message, frames)
            message = self._bus.recv(0)
        if message is not None:
            self._take(message, frames)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one is refused; return how many were taken.

        Raises:
            OSError, ValueError: the bus is gone.
        """
        for sent, frame in enumerate(frames):
            try:
                self._bus.send(to_message(frame), timeout=0)
            except can.CanError:  # full, or gone: the latter shows when it is read
                return sent
        return len(frames)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _take(self, message: can.Message, frames: list[Frame]) -> None:
        """Append a data message's frame; count another."""
        if message.is_error_frame:  # what it tells is each interface's own
            self._counts.error_frames += 1
        elif message.is_remote_frame:
            self._counts.remote += 1
        else:
            try:
                frames.append(to_frame(message, self._index))
            except (ValueError, OverflowError):
                self._counts.malformed += 1


def _rates(settings: BusSettings) -> dict[str, Any]:
    """Return the arguments about CAN FD and bit rates that an interface takes."""
    if settings.interface == "virtual":
        return {}
    if settings.fd:
        return {"fd": True, "bitrate": settings.bitrate, "data_bitrate": settings.data_bitrate}
    return {"bitrate": settings.bitrate}
