"""Live buses through python-can: reading, sending, loss and reconnection."""

from __future__ import annotations

import socket
import time
from threading import Thread
from types import SimpleNamespace

import can
import pytest
from can.interfaces.virtual import channels as open_channels

from candaemon.can_io import threaded_port as reader
from candaemon.can_io.python_can import PythonCanPort
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError
from candaemon.frames.frame import EXTENDED, Frame
from tests.support.live_buses import live, message, peer, read_all, turn_until, virtual


def test_frames_of_two_buses_come_in_order_of_time() -> None:
    settings = virtual(), virtual(fd=True)
    with live(*settings) as buses, peer(settings[0]) as first, peer(settings[1]) as second:
        buses.open()
        second.send(message(0x200, 1533226488.434433))
        first.send(message(0x12345, 2.0, bytes(8), is_extended_id=True))
        second.send(message(0x201, 1.0, bytes(64), is_fd=True))
        first.send(message(0x100, 1.0, is_remote_frame=True))
        first.send(message(0x100, 1.0, is_error_frame=True))
        time.sleep(0.3)
        assert buses.read(1.0) == [
            Frame(1_000_000_000, 1, 0x201, bytes(64), True),
            Frame(2_000_000_000, 0, 0x12345 | EXTENDED, bytes(8)),
            Frame(1_533_226_488_434_433_000, 1, 0x200, b"\x01"),
        ]
        counts = buses[0].counts
        assert (counts.received, counts.remote, counts.error_frames) == (1, 1, 1)
        assert buses.read(0.0) == []


def test_fd_frames_on_a_bus_without_fd_are_counted_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        for k in range(2):
            for data in (bytes(12), b"\x02"):
                other.send(message(0x201, float(k), data, is_fd=True))
            other.send(message(0x200, float(k)))
        assert [frame.can_id for frame in read_all(buses, 2)] == [0x200, 0x200]
        assert turn_until(buses, lambda: bool(caplog.messages))
        assert not turn_until(buses, lambda: len(caplog.messages) > 1, 1.5)
        assert (buses[0].counts.fd_unset, buses[0].counts.received) == (4, 2)
    (told,) = caplog.messages
    assert told == "bus 'bus0': CAN FD frames come and are not read; give buses.bus0 fd: true, and reload"


def test_frames_that_were_stamped_when_they_were_read_stay_before_those_that_came_after_them() -> None:
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        for i, stamp in enumerate((1.5004, 1.5005, 1.5001, 1.5002, 9.0, 2.0)):
            other.send(message(i, stamp))
        time.sleep(0.3)
        heard = buses.read(1.0)
        assert [frame.can_id for frame in heard] == [0, 1, 2, 3, 5, 4]
        assert [round(frame.time_ns / 1e5) for frame in heard] == [15001, 15001, 15001, 15002, 20000, 90000]


def test_sent_frames_are_heard_by_others_only() -> None:
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        assert buses.send(0, [Frame(0, 0, 0x700, b"\x01"), Frame(0, 0, 0x1234 | EXTENDED, bytes(12), True)]) == 2
        heard = [other.recv(1.0), other.recv(1.0)]
        assert [(m.arbitration_id, m.is_extended_id, bytes(m.data), m.is_fd) for m in heard if m] == [
            (0x700, False, b"\x01", False),
            (0x1234, True, bytes(12), True),
        ]
        assert buses.read(0.2) == []
        assert (buses[0].counts.sent, buses[0].counts.send_failed) == (2, 0)


def test_a_full_queue_drops_and_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader.ThreadedPort.__init__, "__defaults__", (100,))
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        for i in range(250):
            other.send(message(timestamp=float(i)))
        counts = buses[0].counts
        end = time.monotonic() + 20.0
        while counts.queue_full < 150 and time.monotonic() < end:
            time.sleep(0.01)
        assert [frame.time_ns // 10**9 for frame in buses.read(0.0)] == list(range(100))
        assert (counts.received, counts.queue_full, counts.lost) == (100, 150, 150)


def test_what_is_refused_waits_and_newer_frames_take_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    ahead_s = 0.0
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + ahead_s)
    monkeypatch.setattr("candaemon.can_io.live_buses.time", clock)
    settings = virtual().model_copy(update={"send_timeout": 1000.0})
    with (
        live(settings) as buses,
        can.Bus(interface="virtual", channel=settings.channel, rx_queue_size=3, ignore_config=True) as other,
    ):
        buses.open()
        assert buses.send(0, [Frame(0, 0, i, b"\x01") for i in range(10)]) == 3
        assert buses[0].waiting == 7
        assert buses.send(0, [Frame(0, 0, i, b"\x02") for i in range(9)]) == 0
        counts = buses[0].counts
        assert (counts.sent, counts.send_dropped, buses[0].waiting) == (3, 6, 10)
        heard = [other.recv(0.0) for _ in range(3)]
        assert turn_until(buses, lambda: counts.sent == 6, 20.0)
        heard += [other.recv(0.0) for _ in range(3)]
        assert [(m.arbitration_id, m.data[0]) for m in heard if m] == [(0, 1), (1, 1), (2, 1), (9, 1), (0, 2), (1, 2)]
        assert turn_until(buses, lambda: counts.sent == 9, 20.0)
        assert (counts.send_dropped, buses[0].waiting) == (6, 4)
        ahead_s = 1001.0
        assert turn_until(buses, lambda: not buses[0].waiting, 20.0)
        assert (counts.sent, counts.send_dropped, counts.send_failed) == (9, 10, 0)
        assert counts.unsent == 10


def test_draining_waits_for_room() -> None:
    settings = virtual()
    with (
        live(settings) as buses,
        can.Bus(interface="virtual", channel=settings.channel, rx_queue_size=3, ignore_config=True) as other,
    ):
        buses.open()
        buses.send(0, [Frame(0, 0, i, b"") for i in range(6)])
        assert not buses.drain(0.01)
        heard = [other.recv(0.0) for _ in range(3)]
        assert None not in heard
        assert buses.drain(20.0)
        assert buses[0].counts.sent == 6


def test_closing_is_quick_and_leaves_nothing_open() -> None:
    settings = virtual(), virtual(), virtual()
    buses = live(*settings)
    buses.open()
    start = time.monotonic()
    buses.close()
    assert time.monotonic() - start < 1.0
    assert settings[0].channel not in open_channels
    assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
    buses.close()


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            BusSettings(interface="no_such_thing", channel="x"),
            "bus 'bus1': cannot open no_such_thing 'x': .*expected one of .*socketcan",
        ),
        (BusSettings(channel="nocan9"), "bus 'bus1': cannot open socketcan 'nocan9': .*ip link set nocan9 up"),
        (
            BusSettings(interface="socketcand", channel="can0"),
            "bus 'bus1': cannot open socketcand 'can0': it needs the options 'host' and 'port'; check buses.bus1",
        ),
    ],
)
def test_a_bus_that_cannot_be_opened(settings: BusSettings, expected: str) -> None:
    good = virtual()
    with live(good, settings) as buses:
        with pytest.raises(BusError, match=expected):
            buses.open()
        assert good.channel not in open_channels


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (TypeError("KvaserBus.__init__() got an unexpected keyword argument 'bitrat'"), "it takes no option 'bitrat'"),
        (ValueError("bitrate 1 is too small"), "python-can says: bitrate 1 is too small"),
        (can.CanInitializationError(), "python-can says: CanInitializationError"),
    ],
)
def test_what_a_driver_says_of_its_options_is_told_in_words(
    monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    def bus(**_options: object) -> can.BusABC:
        raise error

    monkeypatch.setattr("candaemon.can_io.python_can.can.Bus", bus)
    settings = BusSettings(interface="kvaser", channel="0", options={"bitrat": 1})
    with live(settings) as buses, pytest.raises(BusError) as raised:
        buses.open()
    assert str(raised.value) == (
        f"bus 'bus0': cannot open kvaser '0': {told}; check buses.bus0.channel and buses.bus0.options, "
        "and that the interface's driver is installed"
    )


def test_a_driver_that_is_not_installed_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def bus(**_options: object) -> can.BusABC:
        raise NameError("name 'canGetNumberOfChannels' is not defined")

    monkeypatch.setattr("candaemon.can_io.python_can.can.Bus", bus)
    with live(BusSettings(interface="kvaser", channel="0", reopen_first=0.01)) as buses:
        buses.open(strict=False)
        assert buses.read(0.1) == []
        assert "canGetNumberOfChannels" in buses[0].state.error
    assert len([text for text in caplog.messages if "driver is installed" in text]) == 1


def test_a_reader_that_fails_shows_and_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def receive(_: PythonCanPort, limit: int, timeout_s: float) -> list[Frame]:
        raise RuntimeError(timeout_s)

    monkeypatch.setattr("threading.excepthook", lambda _: None)
    with monkeypatch.context() as broken, live(virtual()) as buses:
        broken.setattr(PythonCanPort, "receive", receive)
        buses.open()
        assert turn_until(buses, lambda: "its reader has failed" in buses[0].state.error)
        broken.undo()
        assert turn_until(buses, lambda: buses[0].state.up)


def test_eight_thousand_frames_a_second_are_all_heard() -> None:
    settings = virtual()
    rate, seconds = 8000, 5
    messages = [message(0x100 + k % 64, k * 1e-3, bytes(8)) for k in range(rate * seconds)]

    def send(other: can.BusABC) -> None:
        start, sent = time.monotonic(), 0
        while sent < len(messages):
            due = min(int((time.monotonic() - start) * rate), len(messages))
            for each in messages[sent:due]:
                other.send(each)
            sent = due
            time.sleep(0.005)

    with live(settings) as buses, peer(settings) as other:
        buses.open()
        sender = Thread(target=send, args=(other,))
        sender.start()
        frames = read_all(buses, len(messages), 3.0 * seconds)
        sender.join()
        assert len(frames) == len(messages)
        assert [frame.time_ns for frame in frames] == [k * 1_000_000 for k in range(len(messages))]
        assert buses[0].counts.lost == 0


def test_reading_waits_no_longer_than_asked_and_idles() -> None:
    with live(virtual()) as buses:
        buses.open()
        start, worked = time.monotonic(), time.thread_time()
        assert buses.read(0.25) == []
        assert 0.24 < time.monotonic() - start < 1.0
        assert time.thread_time() - worked < 0.02


def test_what_comes_soon_after_a_reading_is_read_together() -> None:
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        other.send(message(1, 1.0))
        assert len(read_all(buses, 1)) == 1

        def send() -> None:
            for k in range(3):
                time.sleep(0.02)
                other.send(message(2 + k, 2.0 + k))

        sender, start = Thread(target=send), time.monotonic()
        sender.start()
        frames = buses.read(1.0, coalescing_s=0.2)
        assert 0.1 < time.monotonic() - start < 0.9
        sender.join()
        assert [frame.can_id for frame in frames] == [2, 3, 4]


def test_what_comes_long_after_a_reading_or_too_late_is_not_waited_for() -> None:
    settings = virtual()
    with live(settings) as buses, peer(settings) as other:
        buses.open()
        other.send(message(1, 1.0))
        start = time.monotonic()
        assert len(buses.read(1.0, coalescing_s=0.5)) == 1  # nothing was read before
        time.sleep(0.1)
        other.send(message(2, 2.0))
        assert len(buses.read(1.0, coalescing_s=0.1)) == 1
        other.send(message(3, 3.0))
        time.sleep(0.05)  # its thread takes it
        assert len(buses.read(0.0, coalescing_s=0.5)) == 1
        assert time.monotonic() - start < 0.4


@pytest.fixture
def multicast() -> BusSettings:
    pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = int(free.getsockname()[1])
    settings = BusSettings(interface="udp_multicast", channel="239.74.163.2", fd=True, options={"port": port})
    try:
        with can.Bus(interface="udp_multicast", channel=settings.channel, port=port, ignore_config=True) as probe:
            probe.send(message())
            if probe.recv(1.0) is None:
                pytest.skip("multicast datagrams do not come back on this machine")
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this machine: {error}")
    return settings


def test_udp_multicast(multicast: BusSettings) -> None:
    frames = [Frame(0, 0, 0x700 + i, bytes([i]) * 8) for i in range(20)] + [Frame(0, 0, 5 | EXTENDED, bytes(64), True)]
    with live(multicast) as here, live(multicast) as there:
        here.open()
        there.open()
        assert here.send(0, frames) == 21
        heard = read_all(there, 21)
        assert [frame[1:] for frame in heard] == [frame[1:] for frame in frames]
        assert all(abs(frame.time_ns - time.time_ns()) < 60 * 10**9 for frame in heard)
        assert there.send(0, frames[:1]) == 1
        assert [frame[1:] for frame in read_all(here, 1)] == [frames[0][1:]]
        assert here.read(0.2) == []
