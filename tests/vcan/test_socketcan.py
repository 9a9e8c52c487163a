"""The port of SocketCAN on a real interface: what it hears, stamps, counts and sends."""

from __future__ import annotations

import errno
import logging
import re
import select
import socket
import struct
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, closing

import pytest

from candaemon.can_io.open_port import open_port
from candaemon.can_io.port import PortCounts, PortRequest
from candaemon.can_io.recvmmsg import DatagramBatch
from candaemon.can_io.socketcan import SocketCanPort
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError
from candaemon.frames.frame import EXTENDED, Frame
from tests.beds.can_utils import cangen, cansend
from tests.beds.links import Link

SENTINEL = 0x7FF


class Heard:
    """A port, its counts, and what came out of it."""

    def __init__(self, port: SocketCanPort, counts: PortCounts) -> None:
        self.port = port
        self.counts = counts

    def frames(self, number: int = 1, patience_s: float = 5.0) -> list[Frame]:
        frames: list[Frame] = []
        end = time.monotonic() + patience_s
        while len(frames) < number and time.monotonic() < end:
            select.select([self.port], [], [], 0.1)
            frames += self.port.receive(1000)
        return frames

    def until(self, can_id: int) -> list[Frame]:
        frames: list[Frame] = []
        while not frames or frames[-1].can_id != can_id:
            come = self.frames()
            assert come, f"{can_id:X} has not come"
            frames += come
        return frames


@pytest.fixture
def listen() -> Iterator[Callable[..., Heard]]:
    """Open ports that are closed with the test."""
    with ExitStack() as closed:

        def listening(
            link: Link, ids: Collection[int] | None = None, rate: float | None = None, **settings: object
        ) -> Heard:
            counts = PortCounts()
            bus = BusSettings.model_validate({"channel": link.name, **settings})
            port = SocketCanPort(PortRequest("radar", 3, bus, counts, ids, rate))
            return Heard(closed.enter_context(closing(port)), counts)

        yield listening


def raw(link: Link) -> socket.socket:
    other = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    other.bind((link.name,))
    return other


@pytest.mark.parametrize("time_stamps", ["hardware", "kernel"])
def test_frames_come_with_the_time_of_the_kernel(vcan0: Link, listen: Callable[..., Heard], time_stamps: str) -> None:
    heard = listen(vcan0, time_stamps=time_stamps)
    time.sleep(0.05)  # the kernel begins to stamp a moment after it is asked to
    before_ns = time.time_ns()
    cansend(vcan0.name, "123#0102AB")
    cansend(vcan0.name, "12345678#")
    after_ns = time.time_ns()
    time.sleep(0.2)
    frames = heard.frames(2)
    assert [frame[1:] for frame in frames] == [
        (3, 0x123, b"\x01\x02\xab", False),
        (3, 0x12345678 | EXTENDED, b"", False),
    ]
    assert before_ns < frames[0].time_ns < frames[1].time_ns < after_ns
    assert any(frame.time_ns % 1000 for frame in frames)


def test_filters_spare_what_is_not_wanted(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0, ids={0x123, 0x456 | EXTENDED})
    nothing = listen(vcan0, ids=())
    everything = listen(vcan0, ids=range(513))
    sent = ["123#01", "00000123#02", "456#03", "00000456#04", "124#05", "123#R", "789#06", "123#07"]
    for frame in sent:
        cansend(vcan0.name, frame)
    assert [(frame.can_id, frame.data) for frame in heard.frames(3)] == [
        (0x123, b"\x01"),
        (0x456 | EXTENDED, b"\x04"),
        (0x123, b"\x07"),
    ]
    assert heard.counts.remote == 0
    assert len(everything.frames(7)) == 7
    assert everything.counts.remote == 1
    assert nothing.port.receive(10) == []


def test_fd_frames(make_link: Callable[..., Link], listen: Callable[..., Heard]) -> None:
    link = make_link("vcan5", fd=True)
    heard, other, classic = listen(link, fd=True), listen(link, fd=True), listen(link)
    frames = [Frame(0, 3, 0x100, bytes(range(64)), True), Frame(0, 3, 0x1FFFFFFF | EXTENDED, bytes(8))]
    assert other.port.send(frames) == 2
    assert [frame[1:] for frame in heard.frames(2)] == [frame[1:] for frame in frames]
    assert [frame[1:] for frame in classic.frames()] == [frames[1][1:]]
    assert (classic.counts.fd_unset, heard.counts.fd_unset) == (1, 0)
    with raw(link) as odd:
        odd.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        odd.send(struct.pack("=IBB2x64s", 0x100, 9, 0, bytes(64)))
    cansend(link.name, "7FF#")
    assert [frame.can_id for frame in heard.until(SENTINEL)] == [SENTINEL]
    assert heard.counts.malformed == 1


def test_a_classic_interface_is_refused_for_fd(vcan0: Link) -> None:
    bus = BusSettings(channel=vcan0.name, fd=True)
    with pytest.raises(BusError, match=r"'vcan0': .*expected mtu 72"):
        open_port(PortRequest("radar", 0, bus, PortCounts()))


def test_own_frames_are_not_heard_those_of_others_are(vcan0: Link, listen: Callable[..., Heard]) -> None:
    one, other = listen(vcan0), listen(vcan0)
    assert one.port.send([Frame(0, 0, 0x100 + k, bytes(8)) for k in range(10)]) == 10
    assert [frame.can_id for frame in other.frames(10)] == list(range(0x100, 0x10A))
    assert one.port.receive(100) == []
    cansend(vcan0.name, "200#")
    assert [frame.can_id for frame in one.frames()] == [0x200]


def test_error_frames_tell_the_state_of_the_controller(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0, ids={1})
    told = [
        (0x004, 0x08, "warning"),
        (0x004, 0x20, "passive"),
        (0x004, 0x10, "passive"),
        (0x004, 0x01, "passive"),
        (0x022, 0x00, "passive"),
        (0x040, 0x00, "bus-off"),
        (0x100, 0x00, "active"),
        (0x040, 0x00, "bus-off"),
    ]
    with raw(vcan0) as controller:
        for classes, detail, expected in told:
            controller.send(struct.pack("=IB3x8s", 0x2000_0000 | classes, 8, bytes([0, detail])))
            assert heard.frames(patience_s=0.05) == []
            assert heard.port.controller == expected
        cansend(vcan0.name, "001#")
        assert len(heard.frames()) == 1
        assert heard.port.controller == "active"
    counts = heard.counts
    assert (counts.error_frames, counts.bus_off, counts.restarts) == (8, 2, 1)
    assert (counts.error_warning, counts.error_passive, counts.controller_overflows) == (1, 1, 1)
    assert (counts.no_acknowledge, counts.arbitration_lost) == (1, 1)


def test_the_receive_buffer_follows_the_rate(
    vcan0: Link, listen: Callable[..., Heard], caplog: pytest.LogCaptureFixture
) -> None:
    listen(vcan0, rate=300.0)
    assert not caplog.messages
    heard = listen(vcan0, rate=4000.0, receive_buffer=60.0)
    (message,) = caplog.messages
    found = re.search(r"keeps (\d+) frames .* expected 240000 .* net\.core\.rmem_max to (\d+) .*sysctl\.d", message)
    assert found is not None
    assert int(found[2]) == 4000 * 60 * 768 // 2 + 1
    assert caplog.records[0].levelno == logging.WARNING
    cangen(vcan0.name, "-g", "0", "-n", str(int(found[1]) + 300))
    cansend(vcan0.name, "7FF#")
    assert len(heard.frames(10_000, 0.5)) == pytest.approx(int(found[1]), abs=3)


def test_every_frame_that_overran_the_buffer_is_counted(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0, rate=1.0)
    total = 0
    for _ in range(5):
        before = vcan0.statistic("tx_packets")
        cangen(vcan0.name, "-g", "0", "-n", "2000", "-I", "i", "-L", "8")
        frames = heard.frames(10_000, 0.2)
        cansend(vcan0.name, "7FF#")
        frames += heard.frames()
        sent = vcan0.statistic("tx_packets") - before
        assert sent == 2001
        total += sent - len(frames)
        assert heard.counts.kernel_lost == total
    assert total > 0


def test_what_is_lost_behind_the_last_frame_is_counted_by_the_next_look(
    vcan0: Link, listen: Callable[..., Heard]
) -> None:
    heard = listen(vcan0, rate=1.0)
    cangen(vcan0.name, "-g", "0", "-n", "2000", "-I", "i", "-L", "8")
    heard.port.check()  # before what the buffer holds is read
    frames = heard.frames(10_000, 0.2)
    assert heard.counts.kernel_lost == 2000 - len(frames) > 0
    cansend(vcan0.name, "7FF#")
    assert len(heard.frames()) == 1
    assert heard.counts.kernel_lost == 2000 - len(frames)
    cangen(vcan0.name, "-g", "0", "-n", "2000", "-I", "i", "-L", "8")
    frames += heard.frames(10_000, 0.2)
    heard.port.close()
    assert heard.counts.kernel_lost == 4000 - len(frames)


def test_what_a_closed_port_had_received_is_counted(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0, rate=2000.0)
    cangen(vcan0.name, "-g", "0", "-n", "300", "-I", "i", "-L", "8")
    read = len(heard.port.receive(100))
    heard.port.close()
    assert (read + heard.counts.unread, heard.counts.kernel_lost) == (300, 0)
    assert heard.counts.unread > 100
    down = listen(vcan0, rate=1.0)
    cangen(vcan0.name, "-g", "0", "-n", "2000", "-I", "i", "-L", "8")
    vcan0.down()  # the socket reports that before what is in its buffer
    down.port.close()
    assert down.counts.unread + down.counts.kernel_lost == 2000
    assert min(down.counts.unread, down.counts.kernel_lost) > 0


def test_an_error_behind_some_frames_comes_after_them(
    vcan0: Link, listen: Callable[..., Heard], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = listen(vcan0, rate=2000.0)
    cangen(vcan0.name, "-g", "0", "-n", "100", "-I", "i", "-L", "8")
    receive = DatagramBatch.receive

    def then_down(batch: DatagramBatch, descriptor: int, limit: int) -> int:
        number = receive(batch, descriptor, limit)
        if number == 64:
            vcan0.down()
        return number

    monkeypatch.setattr(DatagramBatch, "receive", then_down)
    frames = heard.port.receive(100)
    with pytest.raises(OSError, match="down"):
        heard.port.receive(100)
    assert len(frames) + len(heard.port.receive(100)) == 100


def test_a_thousand_frames_take_few_calls(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0, rate=2000.0)
    cangen(vcan0.name, "-g", "0", "-n", "500", "-I", "i", "-L", "8", "-D", "i")
    assert len(heard.port.receive(128)) == 128
    rest = heard.port.receive(1000)
    assert len(rest) == 372
    times = [frame.time_ns for frame in rest]
    assert times == sorted(times)


def test_an_interface_that_goes_says_so_and_keeps_what_came(vcan0: Link, listen: Callable[..., Heard]) -> None:
    heard = listen(vcan0)
    cansend(vcan0.name, "123#")
    vcan0.down()
    with pytest.raises(OSError, match="down") as caught:
        heard.port.receive(10)
    assert caught.value.errno == errno.ENETDOWN
    assert len(heard.port.receive(10)) == 1
    with pytest.raises(OSError, match="down"):
        heard.port.check()
    with pytest.raises(OSError, match="down"):
        heard.port.send([Frame(0, 0, 1, b"")])
    vcan0.up()
    heard.port.check()
    cansend(vcan0.name, "124#")
    assert [frame.can_id for frame in heard.frames()] == [0x124]
    vcan0.delete()
    vcan0.add()
    with pytest.raises(OSError, match="anew"):
        heard.port.check()


def test_a_link_that_comes_up_while_it_is_opened_does_not_seem_to_go_down_again(
    vcan0: Link, listen: Callable[..., Heard], monkeypatch: pytest.MonkeyPatch
) -> None:
    bind = socket.socket.bind

    def bind_just_before_it_is_up(self: socket.socket, address: tuple[str]) -> None:
        bind(self, address)
        vcan0.up()

    vcan0.down()
    monkeypatch.setattr(socket.socket, "bind", bind_just_before_it_is_up)
    with pytest.raises(OSError, match="down"):
        listen(vcan0)
    vcan0.up()
    assert listen(vcan0).port.receive(10) == []
