"""How full a bus is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

STUFFING: Final = 0.068
"""Stuff bits per bit that may be followed by one, on typical payloads: an 8-byte frame then takes 117.7 bits."""
NOMINAL_BITS: Final = {False: 47, True: 67}
"""Bits of a classic frame without data, by whether its identifier is extended, intermission included."""
STUFFABLE_BITS: Final = {False: 34, True: 54}
"""Those of them that may be stuffed."""
FD_SLOW_BITS: Final = {False: 29, True: 48}
"""Bits of a CAN FD frame at the nominal rate."""
FD_SLOW_STUFFABLE: Final = {False: 17, True: 36}
FD_CHECK_BITS: Final = {False: 28, True: 33}
"""Stuff count, CRC, its fixed stuff bits and its delimiter, by whether there are over 16 bytes of data."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """Frames of one kind on a bus.

    Attributes:
        rate: frames a second.
        length: payload bytes.
        extended: whether the identifier has 29 bits.
        fd: whether they are CAN FD frames with bit rate switch.

    """

    rate: float
    length: int
    extended: bool = False
    fd: bool = False


def frame_time(traffic: Traffic, bitrate: int, data_bitrate: int, stuffing: float = STUFFING) -> float:
    """Seconds that one frame takes, with the intermission after it.

    Args:
        traffic: the kind of frame.
        bitrate: nominal bit rate, bit/s.
        data_bitrate: CAN FD data phase bit rate, bit/s.
        stuffing: stuff bits per bit that may be followed by one; 0 for the least time.

    """
    data = 8 * traffic.length
    if not traffic.fd:
        bits = NOMINAL_BITS[traffic.extended] + data + stuffing * (STUFFABLE_BITS[traffic.extended] + data)
        return bits / bitrate
    slow = FD_SLOW_BITS[traffic.extended] + stuffing * FD_SLOW_STUFFABLE[traffic.extended]
    stuffable = 5 + data
    fast = stuffable * (1 + stuffing) + FD_CHECK_BITS[traffic.length > 16]
    return slow / bitrate + fast / data_bitrate


def bus_load(traffic: Iterable[Traffic], bitrate: int, data_bitrate: int = 2_000_000) -> float:
    """Share of a bus's time that traffic takes; 1 is a full bus.

    Args:
        traffic: every kind of frame on it.
        bitrate: nominal bit rate, bit/s.
        data_bitrate: CAN FD data phase bit rate, bit/s.

    """
    return sum(each.rate * frame_time(each, bitrate, data_bitrate) for each in traffic)
