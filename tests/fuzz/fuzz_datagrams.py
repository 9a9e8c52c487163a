"""Datagrams of a multicast group with any content: each becomes a frame that CAN knows, or is counted as what it is."""

from __future__ import annotations

import socket
from collections import Counter
from functools import cache
from typing import Any

import msgpack

from candaemon.can_io.port import PortCounts, PortRequest
from candaemon.can_io.udp_multicast import UdpMulticastPort
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import EXTENDED
from candaemon.frames.frame_block import FD_LENGTHS

from .drawn import Drawn

_GROUP = "239.74.165.2"
_MOST = 16
_LONGEST = 5000
_ODD: tuple[Any, ...] = (None, True, False, 0, 1, -1, 8, 9, 64, 65, 0x7FF, 0x800, 0x1FFF_FFFF, 1 << 29, 1 << 63,
                         -(1 << 63),
                         0.5, float("nan"), float("inf"), "", "x", b"", b"12345678", bytes(9), bytes(64), bytes(65), [],
                         [1], {}, {1: 2}, msgpack.ExtType(1, b"x"), msgpack.Timestamp(1))  # fmt: skip
_WORDS = (b"\xc0", b"\xc1", b"\x80", b"\x90", b"\xc4\xff", b"\xc6\x7f\xff\xff\xff", b"\xdd\x7f\xff\xff\xff",
          b"\xdf\x7f\xff\xff\xff", b"\xa4data", b"\xa3dlc", b"\x91" * 600, b"\xd4\x00\x00", b"\xc7\x7f")  # fmt: skip
_SOUND: dict[Any, Any] = {
    "timestamp": 1.5,
    "arbitration_id": 0x260,
    "is_extended_id": False,
    "is_remote_frame": False,
    "is_error_frame": False,
    "channel": None,
    "dlc": 8,
    "data": bytes(range(8)),
    "is_fd": False,
    "bitrate_switch": False,
    "error_state_indicator": False,
}


def fuzz_datagrams(data: bytes) -> Counter[str]:
    """Send some datagrams to a port, and take what it makes of them."""
    group = _group()
    if group is None:
        return Counter(without_multicast=1)
    port, counts, sender = group
    drawn, before, frames, sent = Drawn(data), _counted(counts), 0, 0
    while drawn and sent < _MOST:
        sender.send(_datagram(drawn)[:_LONGEST])
        sent += 1
        for frame in port.receive(10):
            frames += 1
            assert frame.can_id <= (EXTENDED | 0x1FFF_FFFF if frame.can_id & EXTENDED else 0x7FF), hex(frame.can_id)
            assert type(frame.data) is bytes
            assert len(frame.data) <= 8 or (frame.fd and len(frame.data) in FD_LENGTHS), frame.data.hex()
            assert frame.time_ns > 0
    skipped = _counted(counts) - before
    assert frames + skipped.total() == sent, (frames, skipped, sent)
    return Counter(datagrams=sent, frames=frames) + skipped


def _counted(counts: PortCounts) -> Counter[str]:
    return Counter(
        malformed=counts.malformed,
        fd_unset=counts.fd_unset,
        remote=counts.remote,
        error_frames=counts.error_frames,
        kernel_lost=counts.kernel_lost,
    )


def _datagram(drawn: Drawn) -> bytes:
    """Return a frame's map with other values, keys or bytes, or anything."""
    form = drawn.integer(0, 3)
    if form == 0:
        return drawn.taken(drawn.integer(0, 60))
    message = dict(_SOUND)
    for _ in range(drawn.integer(0, 3)):
        key = drawn.choice(tuple(_SOUND))
        match drawn.integer(0, 4):
            case 0:
                message.pop(key, None)
            case 1:
                message[drawn.choice(("x", b"data", 1, None))] = drawn.choice(_ODD)
            case 2:
                message["data"] = drawn.taken(drawn.integer(0, 70))
            case _:
                message[key] = drawn.choice(_ODD)
    packed: bytes = msgpack.packb(message)
    return packed if form > 1 else drawn.edited(packed, _WORDS)


@cache
def _group() -> tuple[UdpMulticastPort, PortCounts, socket.socket] | None:
    """Return a port and what sends to it; None where this machine has no multicast."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        udp = int(free.getsockname()[1])
    counts = PortCounts()
    settings = BusSettings(interface="udp_multicast", channel=_GROUP, fd=True, options={"port": udp})
    try:
        port = UdpMulticastPort(PortRequest("fuzzed", 0, settings, counts))
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sender.connect((_GROUP, udp))
        sender.send(msgpack.packb(_SOUND))
    except OSError:
        return None
    return (port, counts, sender) if port.receive(1) else None
