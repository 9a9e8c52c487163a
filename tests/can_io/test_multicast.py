"""CAN over UDP multicast: what python-can sends and hears on the other side."""

from __future__ import annotations

import errno
import os
import re
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from candaemon.can_io.open_port import PORTS, open_port
from candaemon.can_io.port import PortCounts, PortRequest
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError
from candaemon.frames.frame import EXTENDED, Frame

msgpack = pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

from candaemon.can_io.udp_multicast import UdpMulticastPort  # noqa: E402  # not without msgpack

GROUP = "239.74.163.2"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        return int(free.getsockname()[1])


class Bench:
    """A group with a port of ours and a bus of python-can's on it."""

    def __init__(self, opened: ExitStack) -> None:
        self._opened = opened
        self.udp = free_port()
        self.port = self.open()
        self.other = opened.enter_context(
            can.Bus(interface="udp_multicast", channel=GROUP, port=self.udp, fd=True, ignore_config=True)
        )

    def open(
        self, *, index: int = 0, fd: bool = True, group: str = GROUP, receive_buffer: float = 1.0, **request: Any
    ) -> UdpMulticastPort:
        bus = BusSettings(
            interface="udp_multicast",
            channel=group,
            fd=fd,
            options={"port": self.udp},
            receive_buffer=receive_buffer,
        )
        self.counts = PortCounts()
        port = UdpMulticastPort(PortRequest("bench", index, bus, self.counts, **request))
        self._opened.callback(port.close)
        return port


@pytest.fixture
def bench() -> Iterator[Bench]:
    with ExitStack() as opened:
        try:
            bench = Bench(opened)
            bench.other.send(can.Message(arbitration_id=1, is_extended_id=False))
        except (can.CanError, OSError) as error:
            pytest.skip(f"no multicast on this machine: {error}")
        if not heard(bench.port, 1) or bench.other.recv(1.0) is None:
            pytest.skip("multicast datagrams do not come back on this machine")
        yield bench


def heard(port: UdpMulticastPort, expected: int, patience_s: float = 1.0) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + patience_s
    while len(frames) < expected and time.monotonic() < end:
        if select.select([port], [], [], 0.05)[0]:
            frames += port.receive(1000)
    return frames


def message(can_id: int = 0x123, data: bytes = b"\x01\x02", **flags: bool) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **{"is_extended_id": False, **flags})


def test_python_can_is_heard_with_the_kernels_time(bench: Bench) -> None:
    before_ns = time.time_ns()
    bench.other.send(message())
    bench.other.send(message(0x12345, is_extended_id=True))
    bench.other.send(message(0x7FF, bytes(64), is_fd=True))
    frames = heard(bench.port, 3)
    assert [frame[1:] for frame in frames] == [
        (0, 0x123, b"\x01\x02", False),
        (0, 0x12345 | EXTENDED, b"\x01\x02", False),
        (0, 0x7FF, bytes(64), True),
    ]
    times = [frame.time_ns for frame in frames]
    assert times == sorted(times)
    assert before_ns <= times[0] <= times[-1] <= time.time_ns()


def test_python_can_hears_what_is_sent_and_the_sender_does_not(bench: Bench) -> None:
    frames = [Frame(5 * 10**9, 0, 0x700, b"\x01"), Frame(0, 0, 5 | EXTENDED, bytes(12), True)]
    assert bench.port.send(frames) == 2
    got = [bench.other.recv(1.0), bench.other.recv(1.0)]
    assert [(m.arbitration_id, m.is_extended_id, bytes(m.data), m.is_fd, m.bitrate_switch) for m in got if m] == [
        (0x700, False, b"\x01", False, False),
        (5, True, bytes(12), True, True),
    ]
    bench.other.send(message())
    assert [frame.can_id for frame in heard(bench.port, 2, patience_s=0.2)] == [0x123]


def test_another_port_of_this_process_is_heard(bench: Bench) -> None:
    there = bench.open(index=3)
    assert bench.port.send([Frame(0, 0, 0x700, b"\x01")]) == 1
    assert [frame[1:] for frame in heard(there, 1)] == [(3, 0x700, b"\x01", False)]


def test_another_group_on_the_same_udp_port_is_not_heard(bench: Bench) -> None:
    elsewhere = bench.open(group="239.74.163.3")
    bench.other.send(message())
    assert heard(bench.port, 1)
    assert heard(elsewhere, 1, patience_s=0.1) == []


def test_a_bus_of_which_nothing_is_wanted_is_not_listened_to(bench: Bench) -> None:
    there = bench.open(ids=frozenset())
    bench.other.send(message())
    assert heard(bench.port, 1)
    assert heard(there, 1, patience_s=0.1) == []
    assert there.send([Frame(0, 0, 0x700, b"")]) == 1


def test_no_more_than_asked_for_is_taken_at_once(bench: Bench) -> None:
    for _ in range(5):
        bench.other.send(message())
    time.sleep(0.05)
    assert [len(bench.port.receive(2)) for _ in range(4)] == [2, 2, 1, 0]


def test_a_full_receive_buffer_is_counted_with_the_next_frame(bench: Bench) -> None:
    there = bench.open(receive_buffer=0.01)
    for _ in range(3000):
        bench.other.send(message())
    time.sleep(0.05)
    kept = len(there.receive(10_000))
    assert 0 < kept < 3000
    bench.other.send(message(0x7FF))
    assert [frame.can_id for frame in heard(there, 1)] == [0x7FF]
    assert bench.counts.kernel_lost == 3000 - kept


def test_a_sender_faster_than_its_dbc_says_loses_nothing_that_the_kernel_can_keep(bench: Bench) -> None:
    there = bench.open(rate=1.0)
    for _ in range(400):  # the usual net.core.rmem_max has room for 512 of them, a socket that asks for none for 256
        bench.other.send(message())
    assert len(heard(there, 400)) == 400
    assert bench.counts.kernel_lost == 0


@pytest.mark.parametrize("look", ["check", "close"])
def test_what_is_lost_behind_the_last_frame_is_counted_without_another(bench: Bench, look: str) -> None:
    there = bench.open(receive_buffer=0.01)
    for _ in range(3000):
        bench.other.send(message())
    kept = 0
    if look == "check":
        kept = len(there.receive(10_000))
        assert 0 < kept < 3000
        there.check()
    else:
        there.close()
    counts = bench.counts
    assert kept + counts.kernel_lost + counts.unread == 3000
    assert counts.kernel_lost > 0


def test_what_a_closed_port_had_received_is_counted(bench: Bench) -> None:
    there = bench.open()
    for number in range(7):
        bench.other.send(message(data=bytes([number])))
    bench.other.send(message(is_remote_frame=True, data=b""))
    assert len(there.receive(3)) == 3
    there.close()
    assert (bench.counts.unread, bench.counts.remote, bench.counts.kernel_lost) == (4, 1, 0)


def test_a_receive_buffer_that_is_too_small_is_told_with_the_cure(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    bench.open(rate=1e7)
    (text,) = caplog.messages
    assert re.search(r"bus 'bench': the kernel keeps \d+ frames .*net\.core\.rmem_max to 6400000001 or more", text)


def test_what_is_no_data_frame_is_counted(bench: Bench) -> None:
    there = bench.open(fd=False)
    bench.other.send(message(is_remote_frame=True, data=b""))
    bench.other.send(message(is_error_frame=True))
    bench.other.send(message(is_fd=True, data=bytes(12)))
    bench.other.send(message())
    assert len(heard(there, 1)) == 1
    counts = bench.counts
    assert (counts.remote, counts.error_frames, counts.fd_unset, counts.malformed) == (1, 1, 1, 0)


def test_garbage_is_counted_and_the_rest_goes_on(bench: Bench) -> None:
    good: dict[str, object] = {
        "arbitration_id": 0x10,
        "is_extended_id": False,
        "is_remote_frame": False,
        "is_error_frame": False,
        "dlc": 2,
        "data": b"ab",
        "is_fd": False,
    }
    bad: list[dict[str, object]] = [
        {"arbitration_id": 0x800},
        {"arbitration_id": -1},
        {"arbitration_id": "16"},
        {"arbitration_id": 1 << 29, "is_extended_id": True},
        {"dlc": 3},
        {"data": 7},
        {"data": bytes(9), "dlc": 9},
        {"data": None},
    ]
    datagrams = [msgpack.packb(good | each) for each in bad]
    datagrams += [b"", b"\xc1", msgpack.packb([1, 2]), msgpack.packb({"data": b""}), msgpack.packb(good)[:-3]]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        for each in [*datagrams, msgpack.packb(good)]:
            sending.sendto(each, (GROUP, bench.udp))
        counts = bench.port._counts
        assert [frame[1:] for frame in heard(bench.port, 1)] == [(0, 0x10, b"ab", False)]
    assert counts.malformed == len(datagrams)


def test_of_a_flood_of_garbage_each_datagram_is_counted(bench: Bench) -> None:
    there = bench.open()
    garbage = [b"", b"\xc1", bytes(64), b"\x81\xa4data\xc0", bytes(3000)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        for number in range(20_000):
            sending.sendto(garbage[number % len(garbage)], (GROUP, bench.udp))
            if number % 500 == 0:
                assert there.receive(200) == []
    there.close()
    counts = bench.counts
    assert (counts.malformed + counts.kernel_lost, counts.unread) == (20_000, 0)
    assert counts.malformed > 0


MARK = b"\xa4data\xc4"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # what a port keeps makes no difference
@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from([0x10, 0x7FF, 0x6461_7461]),
            st.sampled_from([b"", b"\x01\x02", b"ab" + MARK, MARK + b"\x00", bytes(12)]),
            st.sampled_from([1.5, 2.5, *struct.unpack(">2d", b"a" + MARK + b"\x00" + MARK + b"\x02\x00")]),
            st.booleans(),
            st.integers(-20, 2),
        ),
        max_size=8,
    )
)
def test_a_datagram_of_a_known_kind_is_what_its_keys_say(
    bench: Bench, messages: list[tuple[int, bytes, float, bool, int]]
) -> None:
    for can_id, data, time_s, remote, cut in messages:
        told = pack_message(message(can_id, data, is_extended_id=can_id > 0x7FF, is_fd=len(data) > 8))
        told = msgpack.packb(msgpack.unpackb(told) | {"timestamp": time_s, "is_remote_frame": remote})
        content = told[:cut] if cut < 0 else told + bytes(cut)
        for _ in range(2):
            assert bench.port._frame(content, 7) == bench.port._read(content, 7)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # what a port keeps makes no difference
@given(st.binary(max_size=200))
def test_any_bytes_are_a_frame_or_counted(bench: Bench, content: bytes) -> None:
    counts = bench.port._counts
    before = counts.malformed + counts.remote + counts.error_frames
    frame = bench.port._frame(content, 0)
    assert (frame is None) == (counts.malformed + counts.remote + counts.error_frames > before)


@pytest.mark.parametrize(
    "channel",
    ["no-group", "127.0.0.1"],
)
def test_what_cannot_be_opened(channel: str) -> None:
    bus = BusSettings(interface="udp_multicast", channel=channel)
    with pytest.raises(OSError):  # noqa: PT011 - the kernel's reasons differ
        UdpMulticastPort(PortRequest("bench", 0, bus, PortCounts()))


def test_a_group_that_no_interface_leads_to_is_told_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreachable(request: PortRequest) -> UdpMulticastPort:
        raise OSError(errno.ENETUNREACH, os.strerror(errno.ENETUNREACH))

    monkeypatch.setitem(PORTS, "udp_multicast", unreachable)  # a machine without a route cannot be had here
    bus = BusSettings(interface="udp_multicast", channel=GROUP)
    with pytest.raises(BusError, match=f"ip route add {GROUP}") as told:
        open_port(PortRequest("bench", 0, bus, PortCounts()))
    assert "pip install" not in str(told.value)


ALONE = ["unshare", "--user", "--map-root-user", "--net"]
WATCHED = """
import subprocess
import sys
from candaemon.can_io.port import PortCounts, PortRequest
from candaemon.can_io.udp_multicast import UdpMulticastPort
from candaemon.config.buses import BusSettings

def ip(*commands):
    for command in commands:
        subprocess.run(["ip", *command.split()], check=True)

def told():
    try:
        port.check()
    except OSError as error:
        print(error.errno)
    else:
        print("well")

PAIR = "link add {0}0 type veth peer name {0}1", "link set {0}0 up", "link set {0}1 up"
ip("link set lo up", *(each.format(name) for name in "ab" for each in PAIR))
ip("address add 10.0.0.1/24 dev a0", "address add 10.1.0.1/24 dev b0", "route add default via 10.0.0.9 dev a0 metric 9")
ip("-6 address add fd00::1/64 dev a0 nodad", "-6 route add multicast ff15::/16 dev a0 table local metric 1")
bus = BusSettings(interface="udp_multicast", channel=sys.argv[1])
port = UdpMulticastPort(PortRequest("bench", 0, bus, PortCounts()))
told()
ip("route add default via 10.1.0.9 dev b0 metric 5")  # as a wireless network does that comes up
told()
ip("route delete default dev b0", "route delete default dev a0")
told()
ip("link delete a0")
told()
ip(*(each.format("a") for each in PAIR), "address add 10.0.0.1/24 dev a0")
told()
"""


@pytest.mark.parametrize("group", [GROUP, "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"])
def test_only_an_interface_that_is_deleted_takes_the_group_along(group: str) -> None:
    """Its routes may change as they like: the kernel keeps to the interface by which the group was joined."""
    if subprocess.run([*ALONE, "ip", "link", "add", "a0", "type", "veth"], check=False, capture_output=True).returncode:
        pytest.skip("no network of its own can be made here, with veth interfaces (needs unshare, iproute2)")
    told = subprocess.run([*ALONE, sys.executable, "-c", WATCHED, group], check=True, capture_output=True, text=True)
    assert told.stdout.split() == ["well", "well", "well", str(errno.ENODEV), str(errno.ENODEV)]
