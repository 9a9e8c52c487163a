"""What a port of SocketCAN works out for itself: filters, error frames, time stamps; the interface needs a bed."""

from __future__ import annotations

import socket
import struct
import time

import numpy as np
import pytest

from candaemon.can_io.port import Controller, PortCounts
from candaemon.can_io.recvmmsg import DatagramBatch
from candaemon.can_io.socketcan import count_error_frame, receive_filters
from candaemon.can_io.timestamps import HardwareClockOffset
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import EXTENDED

SECOND_NS = 1_000_000_000
MS_NS = 1_000_000


def test_a_filter_names_one_identifier_of_one_length() -> None:
    pairs = list(struct.iter_unpack("=II", receive_filters({0x210, 0x123 | EXTENDED})))
    assert pairs == [(0x210, 0xC000_07FF), (0x8000_0123, 0xDFFF_FFFF)]
    assert receive_filters(()) == b""


@pytest.mark.parametrize(
    ("classes", "detail", "before", "after", "counted"),
    [
        (0x002, 0x00, "active", "active", {"arbitration_lost": 1}),
        (0x020, 0x00, "passive", "passive", {"no_acknowledge": 1}),
        (0x004, 0x01, "active", "active", {"controller_overflows": 1}),
        (0x004, 0x04, "active", "warning", {"error_warning": 1}),
        (0x004, 0x08, "warning", "warning", {}),
        (0x204, 0x30, "warning", "passive", {"error_passive": 1}),
        (0x004, 0x40, "passive", "active", {}),
        (0x044, 0x20, "passive", "bus-off", {"bus_off": 1}),
        (0x100, 0x00, "bus-off", "active", {"restarts": 1}),
        (0x088, 0xFF, "warning", "warning", {}),
    ],
)
def test_error_frames(
    classes: int, detail: int, before: Controller, after: Controller, counted: dict[str, int]
) -> None:
    counts = PortCounts()
    data = bytes([0, detail, 0, 0, 0, 0, 0, 0])
    assert count_error_frame(0x2000_0000 | classes, data, counts, before) == after
    assert counts == PortCounts(error_frames=1, **counted)


def test_hardware_time_is_free_of_the_way_to_the_kernel() -> None:
    clock, delays = HardwareClockOffset(), np.random.default_rng(1).exponential(300_000.0, 20_000)
    worst, last = 0, 0
    for number in range(20_000):
        true_ns = 1_700_000_000 * SECOND_NS + number * MS_NS
        hardware_ns = (number * MS_NS * 1_000_050) // 1_000_000  # from its own start, 50 ppm fast
        kernel_ns = true_ns + 50_000 + int(delays[number])
        told = clock.system_ns(hardware_ns, kernel_ns)
        assert last <= told <= kernel_ns
        last = told
        if number > 100:
            worst = max(worst, abs(told - true_ns - 50_000))
    assert worst < 200_000


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_hardware_time_follows_a_step_of_the_clock(step_s: int) -> None:
    clock = HardwareClockOffset()
    for number in range(100):
        clock.system_ns(number * MS_NS, 10_000 * SECOND_NS + number * MS_NS)
    stepped_ns = (10_000 + step_s) * SECOND_NS
    assert clock.system_ns(100 * MS_NS, stepped_ns) == stepped_ns
    assert clock.system_ns(101 * MS_NS, stepped_ns + 5 * MS_NS) == stepped_ns + MS_NS


def test_many_datagrams_a_call() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        ours.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
        for number in range(7):
            theirs.send(bytes([number]) * (number + 1))
        datagrams = DatagramBatch(4, 8, 32)
        form = struct.Struct("@8s16xll")
        assert datagrams.receive(ours.fileno(), 100) == 4
        assert [size for size, _ in datagrams.lengths(4)] == [1, 2, 3, 4]
        assert datagrams.receive(ours.fileno(), 2) == 2
        records = list(datagrams.records(2, form))
        assert [
            (record[0][:size], control) for record, (size, control) in zip(records, datagrams.lengths(2), strict=True)
        ] == [
            (b"\4" * 5, 32),
            (b"\5" * 6, 32),
        ]
        assert all(abs(seconds - time.time()) < 60 for _, seconds, _ in records)
        assert datagrams.receive(ours.fileno(), 4) == 1
        assert datagrams.receive(ours.fileno(), 4) == 0
    with pytest.raises(OSError, match="descriptor"):
        datagrams.receive(-1, 4)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"options": {"receive_own_messages": True}}, "found receive_own_messages, expected none"),
        ({"reopen_first": 2.0}, "expected at least reopen_first"),
        ({"receive_buffer": 0}, "greater than 0"),
    ],
)
def test_settings_that_cannot_be(settings: dict[str, object], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        BusSettings.model_validate({"channel": "can0", **settings})
