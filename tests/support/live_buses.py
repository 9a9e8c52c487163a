"""Virtual buses for the tests of live ones: ours, and the other side."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import can

from candaemon.can_io.live_buses import LiveBuses
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import Frame

_numbers = itertools.count()


def virtual(*, fd: bool = False, **options: str | float) -> BusSettings:
    return BusSettings(interface="virtual", channel=f"candaemon-test-{next(_numbers)}", fd=fd, options=options)


def live(*settings: BusSettings) -> LiveBuses:
    buses = {f"bus{index}": bus for index, bus in enumerate(settings)}
    return LiveBuses(buses, clock=time.monotonic_ns)


def peer(settings: BusSettings) -> can.BusABC:
    return can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, preserve_timestamps=True)


def message(can_id: int = 0x123, timestamp: float = 1.5, data: bytes = b"\x01", **flags: bool) -> can.Message:
    return can.Message(
        arbitration_id=can_id,
        timestamp=timestamp,
        data=data,
        **{"is_extended_id": False, **flags},
    )


def read_all(buses: LiveBuses, expected: int, patience_s: float = 3.0) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + patience_s
    while len(frames) < expected and time.monotonic() < end:
        frames += buses.read(0.05)
    return frames


def turn_until(buses: LiveBuses, condition: Callable[[], bool], patience_s: float = 3.0) -> bool:
    """Read the buses, whatever comes, until a condition holds."""
    end = time.monotonic() + patience_s
    while not condition() and time.monotonic() < end:
        buses.read(0.005)
    return condition()
