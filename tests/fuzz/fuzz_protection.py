"""Checksums, end-to-end profiles and the monitor of counters and rates, with any settings and frames."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from candaemon.config.protection import E2eSettings
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.protection.checksums import FrameProtector, Kind, Protector
from candaemon.protection.e2e import E2eProtector
from candaemon.protection.monitor import UNWATCHED, FrameFaults, FrameMonitor, FrameMonitorSettings

from .drawn import Drawn

_KINDS: tuple[Kind, ...] = ("toyota", "honda", "xor", "additive", "crc8_sae_j1850")
_E2E: TypeAdapter[Any] = TypeAdapter(E2eSettings)
_IDS = (0x123, 0, 0x7FF, 0x98FF_1234)


def fuzz_protection(data: bytes) -> Counter[str]:
    """Seal and verify a payload, change a bit of it, and monitor a sequence of frames."""
    drawn = Drawn(data)
    message = MessageSpec("M", drawn.choice(_IDS), drawn.choice((8, 1, 2, 3, 4, 5, 12, 16, 64)), ())
    try:
        protector = _e2e(drawn, message) if drawn.flag() else _checksum(drawn, message)
    except (ConfigError, ValidationError):
        return Counter(refused=1)
    payload = drawn.taken(message.length).ljust(message.length, b"\0")
    if isinstance(protector, E2eProtector) and protector.counter(payload) >= protector.header.counter_values:
        return Counter(refused=1)  # profiles 1 and 11 know no counter 15
    sealed = protector.seal(message.can_id, payload)
    assert len(sealed) == message.length
    assert protector.verify(message.can_id, sealed)
    table = np.frombuffer(payload, np.uint8).reshape(1, -1).copy()
    protector.fill(np.array([message.can_id]), table)
    assert table.tobytes() == sealed, "filled at once it is another checksum"
    bit = drawn.integer(0, 8 * message.length - 1)
    damaged = bytearray(sealed)
    damaged[bit // 8] ^= 1 << bit % 8
    if not _has_other_data_id(protector, sealed, bytes(damaged)):
        assert not protector.verify(message.can_id, bytes(damaged)), f"bit {bit} of {sealed.hex()} is not protected"
    for length in range(message.length):
        assert not protector.verify(message.can_id, sealed[:length])
    return _monitored(drawn, protector, message)


def _checksum(drawn: Drawn, message: MessageSpec) -> FrameProtector:
    kind = drawn.choice(_KINDS)
    bits = 4 if kind == "honda" else drawn.choice((8, 8, 8, 4, 16))
    signal = SignalSpec("sum", bits * drawn.integer(0, 8 * message.length // bits), bits)
    told = MessageSpec("M", message.can_id, message.length, (signal,))
    return Protector(kind, [told], "sum")


def _e2e(drawn: Drawn, message: MessageSpec) -> FrameProtector:
    number = drawn.choice((1, 2, 5, 11))
    given: dict[str, Any] = {"profile": number}
    if number == 2:
        given["data_id_list"] = tuple(drawn.taken(16).ljust(16, b"\x01"))
    else:
        given |= {"data_id": drawn.integer(0, 0xFFFF), "offset": drawn.integer(0, 61)}
    if number in (1, 11):
        given["data_id_mode"] = drawn.choice(("both", "nibble", "alternating", "low"))
    return E2eProtector(_E2E.validate_python(given), [message], [0])


def _has_other_data_id(protector: FrameProtector, sealed: bytes, damaged: bytes) -> bool:
    """Return whether damage changed the counter that chooses the data id: one CRC in 256 is that of both."""
    if not isinstance(protector, E2eProtector) or protector.counter(sealed) == protector.counter(damaged):
        return False
    settings = protector.profile
    return settings.profile == 2 or (settings.profile == 1 and settings.data_id_mode == "alternating")


def _monitored(drawn: Drawn, protector: FrameProtector, message: MessageSpec) -> Counter[str]:
    """Hold that every frame is admitted or counted under one cause."""
    plan = FrameMonitorSettings(
        protector=protector if drawn.flag() else None,
        counter=(lambda payload: payload[0] & 15) if drawn.flag() else None,
        counter_values=drawn.integer(2, 20),
        max_step=drawn.integer(1, 20),
        settle=drawn.integer(1, 15),
        use_jumps=drawn.flag(),
        timeout_ns=drawn.choice((UNWATCHED, 1, 10_000_000)),
        spacing_ns=drawn.choice((0, 1_000_000)),
        slack_ns=drawn.choice((0, 500_000)),
    )
    faults = FrameFaults()
    monitor = FrameMonitor(plan, faults)
    admitted, seen, time_ns = 0, 0, 0
    while drawn:
        time_ns += drawn.integer(0, 255) * 50_000
        payload = drawn.taken(message.length).ljust(message.length, b"\0")
        payload = protector.seal(message.can_id, payload) if drawn.flag() else payload
        admitted += monitor.admits(message.can_id, payload, time_ns)
        seen += 1
    assert admitted + faults.failed == seen, faults
    assert min(faults.lost, faults.timeouts) >= 0
    return Counter(admitted=admitted, failed=faults.failed)
