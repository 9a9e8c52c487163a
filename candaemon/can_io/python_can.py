"""python-can: its messages as frames and back, and a port for every interface that has none of its own here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can

from candaemon.can_io.port import PortRequest, port_errors
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_block import FD_LENGTHS
from candaemon.frames.times import nanoseconds

_ID_29 = 0x1FFF_FFFF
_ID_11 = 0x7FF
_CLASSIC = 8


def to_frame(message: can.Message, bus: int) -> Frame:
    """Return a data frame of python-can as a `Frame`.

    Args:
        message: a data message; one of more than 8 bytes is taken for CAN FD even where the flag is missing.
        bus: index of the bus it came from.

    Raises:
        ValueError: the identifier, the length or the time stamp is out of what CAN can hold.
    """
    can_id = message.arbitration_id
    data = bytes(message.data)
    size = len(data)
    if not 0 <= can_id <= (_ID_29 if message.is_extended_id else _ID_11):
        raise ValueError(f"identifier {can_id:#x} is out of range")
    if size not in FD_LENGTHS or size < message.dlc <= _CLASSIC:
        raise ValueError(f"{size} data bytes, where the length code is {message.dlc}")
    if message.is_extended_id:
        can_id |= EXTENDED
    return Frame(nanoseconds(message.timestamp), bus, can_id, data, message.is_fd or size > _CLASSIC)


def to_message(frame: Frame, channel: int | str | None = None) -> can.Message:
    """Return a frame as a message of python-can; CAN FD frames switch their bit rate.

    Args:
        frame: the frame.
        channel: what python-can shall call its bus; log writers take it.
    """
    return can.Message(
        timestamp=frame.time_ns / 1_000_000_000,
        arbitration_id=frame.can_id & _ID_29,
        is_extended_id=bool(frame.can_id & EXTENDED),
        channel=channel,
        data=frame.data,
        is_fd=frame.fd,
        bitrate_switch=frame.fd,
    )


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
        self._counts, self._fd = request.counts, settings.fd
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
            try:
                message = self._bus.recv(0)
            except port_errors():
                if frames:  # an error that lasts comes again
                    return frames
                raise
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
            except (OSError, ValueError):
                if sent:  # what fails for good fails again
                    return sent
                raise
        return len(frames)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _take(self, message: can.Message, frames: list[Frame]) -> None:
        """Append a data message's frame; count another."""
        if message.is_error_frame:  # its content differs by interface
            self._counts.error_frames += 1
        elif message.is_remote_frame:
            self._counts.remote += 1
        else:
            try:
                frame = to_frame(message, self._index)
            except (ValueError, OverflowError):
                self._counts.malformed += 1
                return
            if frame.fd and not self._fd:
                self._counts.fd_unset += 1
            else:
                frames.append(frame)


def _rates(settings: BusSettings) -> dict[str, Any]:
    """Return the arguments about CAN FD and bit rates that an interface takes."""
    if settings.interface == "virtual":
        return {}
    if settings.fd:
        return {"fd": True, "bitrate": settings.bitrate, "data_bitrate": settings.data_bitrate}
    return {"bitrate": settings.bitrate}
