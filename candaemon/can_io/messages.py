"""Turns python-can's messages into frames and back."""

from __future__ import annotations

import can

from candaemon.frames.block import FD_LENGTHS
from candaemon.frames.frame import EXTENDED, Frame

_ID_29 = 0x1FFF_FFFF
_ID_11 = 0x7FF
_CLASSIC = 8
_NS_EXACT = 4_000_000.0
"""Seconds up to which a float tells one nanosecond from the next."""
_SECONDS_HELD = 9.2e9
"""Seconds whose nanoseconds fit 64 bits."""


def nanoseconds(seconds: float) -> int:
    """Return float seconds in nanoseconds, without the digits that the float made up.

    A float of seconds since 1970 holds steps of 0.24 µs, so it is rounded to the microsecond that was meant; one small
    enough to hold nanoseconds is rounded to these.

    Args:
        seconds: time stamp in s.

    Raises:
        ValueError: it is no number, or one that 64 bits of nanoseconds do not hold.
    """
    if not abs(seconds) < _SECONDS_HELD:
        raise ValueError(f"time stamp {seconds} s is out of range")
    if abs(seconds) < _NS_EXACT:
        return round(seconds * 1e9)
    return round(seconds * 1e6) * 1000


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
