"""Live buses on real interfaces that go, come back, refuse and overflow."""

from __future__ import annotations

import resource
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from candaemon.can_io.live_buses import LiveBuses
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import Frame
from tests.beds.can_utils import background, cansend
from tests.beds.links import Link

SENTINEL = 0x7FF
PATIENCE_S = 30.0
"""Longest wait for what takes a moment: a busy machine leaves user-mode Linux none for seconds."""
PACED = """
import socket, struct, sys, time
interface, rate, seconds = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
out = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
out.bind((interface,))
start, sent = time.monotonic(), 0
while sent < rate * seconds:
    due = min(int((time.monotonic() - start) * rate), int(rate * seconds))
    for number in range(sent, due):
        out.send(struct.pack("=IB3xQ", 0x100 + number % 64, 8, number))
    sent = due
    time.sleep(0.005)
print(sent, time.monotonic() - start)
"""
"""Sends a counter at a rate, in a process of its own."""


@pytest.fixture
def live() -> Iterator[Callable[..., LiveBuses]]:
    """Open buses that are closed with the test."""
    with ExitStack() as closing:

        def opened(*channels: str, rate: float = 100.0, **settings: object) -> LiveBuses:
            buses = {each: BusSettings.model_validate({"channel": each, **settings}) for each in channels}
            made = closing.enter_context(LiveBuses(buses, clock=time.monotonic_ns, rates=dict.fromkeys(channels, rate)))
            made.open(strict=False)
            return made

        yield opened


def turn_until(buses: LiveBuses, condition: Callable[[], bool], patience_s: float = PATIENCE_S) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end, [(bus.state, bus.counts) for bus in buses]
        frames += buses.read(0.01)
    return frames


def heard(buses: LiveBuses, can_id: int) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + PATIENCE_S
    while not any(frame.can_id == can_id for frame in frames):
        assert time.monotonic() < end, [(bus.state, bus.counts) for bus in buses]
        frames += buses.read(0.01)
    return frames


def test_a_link_goes_down_and_up_twenty_times(vcan0: Link, live: Callable[..., LiveBuses]) -> None:
    buses = live(vcan0.name)
    counts = buses[0].counts
    for number in range(20):
        vcan0.down()
        turn_until(buses, lambda: not buses[0].state.up)
        assert "ip link set vcan0 up" in buses[0].state.error
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        vcan0.up()
        cansend(vcan0.name, f"{number + 1:03X}#")  # heard though nobody has looked at the link since
        assert [frame.can_id for frame in heard(buses, number + 1)] == [number + 1]
        turn_until(buses, lambda: buses[0].state.up)
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 1
    assert (counts.reconnects, counts.sent, counts.send_failed, counts.lost) == (20, 20, 20, 0)


def test_an_interface_is_deleted_and_made_again(vcan0: Link, live: Callable[..., LiveBuses]) -> None:
    buses = live(vcan0.name)
    for number in range(1, 4):
        cansend(vcan0.name, "100#")
        vcan0.delete()
        if number > 1:  # it is the sending that hears of it
            assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        assert [frame.can_id for frame in heard(buses, 0x100)] == [0x100]  # what had come before is not lost
        turn_until(buses, lambda: not buses[0].state.up)
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        turn_until(buses, lambda: "No such device" in buses[0].state.error)
        vcan0.add()
        turn_until(buses, lambda: buses[0].state.up)
        cansend(vcan0.name, "101#")
        assert [frame.can_id for frame in heard(buses, 0x101)] == [0x101]
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 1
        assert buses[0].counts.reconnects == number
    assert len(list(Path("/proc/self/fd").iterdir())) < 40


def test_an_interface_is_made_anew_between_two_readings(vcan0: Link, live: Callable[..., LiveBuses]) -> None:
    buses = live(vcan0.name)
    vcan0.delete()
    vcan0.add()
    turn_until(buses, lambda: buses[0].counts.reconnects == 1)
    cansend(vcan0.name, "101#")
    assert heard(buses, 0x101)


def test_a_missing_interface_is_awaited_without_work(
    make_link: Callable[..., Link], live: Callable[..., LiveBuses]
) -> None:
    buses = live("vcan7", "vcan8")
    assert [bus.state.up for bus in buses] == [False, False]
    worked = time.process_time()
    assert buses.read(2.0) == []
    assert time.process_time() - worked < 1.0  # a busy loop would take both seconds
    first = make_link("vcan7")
    turn_until(buses, lambda: buses[0].state.up)
    cansend(first.name, "123#")
    assert heard(buses, 0x123)[0].bus == 0
    assert not buses[1].state.up
    assert "ip link set vcan8 up" in buses[1].state.error


def test_a_full_transmit_queue_holds_nothing_up_and_the_newest_wins(
    vcan0: Link, live: Callable[..., LiveBuses], record_property: Callable[[str, object], None]
) -> None:
    buses, other = live(vcan0.name, send_timeout=5.0), live(vcan0.name)
    vcan0.queue("tbf", "rate", "100kbit", "burst", "200", "limit", "1600")
    longest = 0.0
    frames: list[Frame] = []
    for cycle in range(20):
        start = time.monotonic()
        buses.send(0, [Frame(0, 0, 0x100 + k, struct.pack("<Q", cycle)) for k in range(100)])
        longest = max(longest, time.monotonic() - start)
        assert buses[0].waiting <= 100
        assert buses.read(0.03) == []
        frames += other.read(0.0)
    counts = buses[0].counts
    assert counts.send_dropped > 100
    record_property("benchmark", f"longest send into a full queue {1e3 * longest:.1f} ms; goal 100 ms")
    assert longest < 5.0  # the time that it gives the queue
    assert counts.sent + counts.send_dropped + buses[0].waiting == 2000
    turn_until(buses, lambda: buses[0].waiting == 0)
    while come := other.read(0.3):
        frames += come
    assert counts.sent + counts.send_dropped == 2000
    assert len(frames) == counts.sent
    last = {frame.can_id: struct.unpack("<Q", frame.data)[0] for frame in frames}
    assert last == dict.fromkeys(range(0x100, 0x164), 19)


def test_what_no_queue_takes_is_given_up_in_time(
    vcan0: Link, live: Callable[..., LiveBuses], record_property: Callable[[str, object], None]
) -> None:
    buses = live(vcan0.name, send_timeout=0.1)
    vcan0.queue("tbf", "rate", "1kbit", "burst", "100", "limit", "160")
    buses.send(0, [Frame(0, 0, 0x100 + k, bytes(8)) for k in range(100)])
    start = time.monotonic()
    turn_until(buses, lambda: buses[0].waiting == 0)
    record_property("benchmark", f"frames given up after {time.monotonic() - start:.2f} s; asked .1 s, goal .5 s")
    assert buses[0].counts.send_dropped == 100 - buses[0].counts.sent > 50
    assert buses.drain(0.0)


def test_a_controller_off_the_bus_and_back(vcan0: Link, live: Callable[..., LiveBuses]) -> None:
    buses = live(vcan0.name)
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as controller:
        controller.bind((vcan0.name,))
        controller.send(struct.pack("=IB3x8s", 0x2000_0004, 8, b"\0\x20"))
        turn_until(buses, lambda: buses[0].state.controller == "passive")
        assert buses[0].state.up
        controller.send(struct.pack("=IB3x8s", 0x2000_0040, 8, b""))
        turn_until(buses, lambda: not buses[0].state.up)
        assert "restart-ms" in buses[0].state.error
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        controller.send(struct.pack("=IB3x8s", 0x2000_0100, 8, b""))
        turn_until(buses, lambda: buses[0].state.up)
    assert buses.send(0, [Frame(0, 0, 1, b"")]) == 1
    counts = buses[0].counts
    assert (counts.bus_off, counts.restarts, counts.error_passive, counts.send_failed) == (1, 1, 1, 1)


def test_a_controller_without_a_carrier_is_off_the_bus(live: Callable[..., LiveBuses]) -> None:
    def link(*words: str) -> str:
        return subprocess.run(["ip", "link", *words], capture_output=True, text=True, check=False).stderr

    refusal = link("add", "dev", "vx0", "type", "vxcan", "peer", "name", "vx1")
    if refusal:
        pytest.skip(f"no vxcan: {refusal}")
    try:
        link("set", "dev", "vx0", "up")  # its peer is down: no carrier, and no error frame tells of it
        buses = live("vx0")
        assert buses[0].state.up
        turn_until(buses, lambda: not buses[0].state.up)
        assert buses[0].state.controller == "bus-off"
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        link("set", "dev", "vx1", "up")
        turn_until(buses, lambda: buses[0].state.up)
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 1
        assert (buses[0].counts.bus_off, buses[0].counts.reconnects) == (1, 1)
    finally:
        link("delete", "dev", "vx0")


def test_a_flood_leaves_the_other_bus_its_turn_and_is_counted(
    vcan0: Link, vcan1: Link, live: Callable[..., LiveBuses]
) -> None:
    buses = live(vcan0.name, vcan1.name)
    with background("cangen", vcan0.name, "-g", "0", "-L", "8", "-I", "100"):
        for number in range(10):
            cansend(vcan1.name, f"{number:03X}#")
            assert heard(buses, number)
            time.sleep(0.05)
    turn_until(buses, lambda: buses.read(0.1) == [])
    cansend(vcan0.name, "7FF#")
    turn_until(buses, lambda: buses.read(0.1) == [])
    counts = buses[0].counts
    assert counts.received + counts.kernel_lost == vcan0.statistic("tx_packets")
    assert counts.kernel_lost > 0


def test_two_thousand_frames_a_second_are_all_heard(
    vcan0: Link, live: Callable[..., LiveBuses], record_property: Callable[[str, object], None]
) -> None:
    buses = live(vcan0.name, rate=2000.0)
    received, next_number, grown_kb = 0, 0, 0
    with subprocess.Popen(
        [sys.executable, "-S", "-c", PACED, vcan0.name, "2000", "30"], stdout=subprocess.PIPE, text=True
    ) as sender:
        while sender.poll() is None:
            frames = buses.read(0.1)
            for frame in frames:
                assert struct.unpack("=Q", frame.data)[0] == next_number
                next_number += 1
            received += len(frames)
            if received < 10_000:
                grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert sender.stdout is not None
        sent, took_s = sender.stdout.read().split()
    cansend(vcan0.name, "7FF#")
    received += len(heard(buses, SENTINEL)) - 1
    record_property("benchmark", f"{sent} frames sent and heard in {float(took_s):.1f} s; goal 30 s")
    assert (int(sent), received, buses[0].counts.kernel_lost) == (60_000, 60_000, 0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown_kb < 1024
