"""Live buses through python-can: reading, sending, loss and reconnection."""

from __future__ import annotations

import itertools
import socket
import time
from collections.abc import Callable, Sequence

import can
import pytest
from can.interfaces.virtual import channels as open_channels

from candaemon.bus import ports
from candaemon.bus.frame import EXTENDED, Frame
from candaemon.bus.live import FrameQueue, LiveBuses
from candaemon.bus.ports import PORTS, PortRequest
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError

_names = itertools.count()


def virtual(**options: str | float) -> BusSettings:
    return BusSettings(interface="virtual", channel=f"candaemon-test-{next(_names)}", options=options)


def live(*settings: BusSettings, capacity: int = 1000) -> LiveBuses:
    buses = {f"bus{index}": bus for index, bus in enumerate(settings)}
    return LiveBuses(buses, clock=time.monotonic_ns, capacity=capacity)


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


def wait_for(condition: Callable[[], bool], patience_s: float = 3.0) -> bool:
    end = time.monotonic() + patience_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    return condition()


def test_frames_of_two_buses_come_in_order_of_time() -> None:
    settings = virtual(), virtual()
    with live(*settings) as buses, peer(settings[0]) as first, peer(settings[1]) as second:
        buses.open()
        second.send(message(0x200, 1533226488.434433))
        first.send(message(0x12345, 2.0, bytes(8), is_extended_id=True))
        second.send(message(0x201, 1.0, bytes(64), is_fd=True))
        first.send(message(0x100, 1.0, is_remote_frame=True))
        first.send(message(0x100, 1.0, is_error_frame=True))
        assert wait_for(lambda: buses[0].counts.error_frames == 1 and buses[1].counts.received == 2)
        assert buses.read(1.0) == [
            Frame(1_000_000_000, 1, 0x201, bytes(64), True),
            Frame(2_000_000_000, 0, 0x12345 | EXTENDED, bytes(8)),
            Frame(1_533_226_488_434_433_000, 1, 0x200, b"\x01"),
        ]
        assert (buses[0].counts.received, buses[0].counts.remote) == (1, 1)
        assert buses.read(0.0) == []


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


def test_a_full_queue_drops_and_counts() -> None:
    settings = virtual()
    with live(settings, capacity=100) as buses, peer(settings) as other:
        buses.open()
        for i in range(250):
            other.send(message(timestamp=float(i)))
        counts = buses[0].counts
        assert wait_for(lambda: counts.received + counts.queue_full == 250)
        assert (counts.received, counts.queue_full) == (100, 150)
        assert [frame.time_ns // 10**9 for frame in buses.read(0.0)] == list(range(100))


def test_a_refused_frame_is_counted_with_those_behind_it() -> None:
    settings = virtual()
    with (
        live(settings) as buses,
        can.Bus(interface="virtual", channel=settings.channel, rx_queue_size=3, ignore_config=True),
    ):
        buses.open()
        assert buses.send(0, [Frame(0, 0, i, b"") for i in range(10)]) == 3
        assert (buses[0].counts.sent, buses[0].counts.send_failed) == (3, 7)


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
        (virtual(ignore_config=False), "bus 'bus1': cannot open virtual .*options"),
    ],
)
def test_a_bus_that_cannot_be_opened(settings: BusSettings, expected: str) -> None:
    good = virtual()
    with live(good, settings) as buses:
        with pytest.raises(BusError, match=expected):
            buses.open()
        assert good.channel not in open_channels


class FlakyPort:
    """A port whose bus can be taken away.

    Attributes:
        there: whether the bus exists.
        opened: times that it was opened.
    """

    there = True
    opened = 0

    def __init__(self, request: PortRequest) -> None:
        type(self).opened += 1
        if not self.there:
            raise OSError(19, "No such device")
        self.index = request.index

    def receive(self, timeout_s: float) -> list[Frame]:
        if not self.there:
            raise can.CanOperationError("Network is down")
        time.sleep(min(timeout_s, 0.01))
        return [Frame(1, self.index, 0x123, b"")]

    def send(self, frames: Sequence[Frame]) -> int:
        return len(frames) if self.there else 0

    def close(self) -> None:
        raise OSError(9, "Bad file descriptor")


@pytest.fixture
def flaky(monkeypatch: pytest.MonkeyPatch) -> type[FlakyPort]:
    monkeypatch.setitem(PORTS, "flaky", FlakyPort)
    monkeypatch.setattr(FlakyPort, "there", True)
    monkeypatch.setattr(FlakyPort, "opened", 0)
    return FlakyPort


def test_a_bus_that_goes_away_comes_back(flaky: type[FlakyPort], caplog: pytest.LogCaptureFixture) -> None:
    with live(BusSettings(interface="flaky", channel="x")) as buses:
        buses.open()
        assert read_all(buses, 1)
        assert buses[0].state.up
        flaky.there = False
        assert wait_for(lambda: not buses[0].state.up)
        down = buses[0].state
        assert "Network is down" in down.error
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        time.sleep(0.5)
        assert 2 <= flaky.opened <= 5
        assert buses[0].state.since_ns == down.since_ns
        assert "No such device" in buses[0].state.error
        flaky.there = True
        assert wait_for(lambda: buses[0].state.up)
        buses.read(0.0)
        assert read_all(buses, 1)
        counts = buses[0].counts
        assert (counts.reconnects, counts.send_failed) == (1, 1)
    assert [record.message for record in caplog.records if "is down" in record.message] == [
        "bus 'bus0' is down: Network is down; it is opened again as soon as it can be"
    ]


def test_a_missing_bus_is_awaited_where_that_is_asked_for(flaky: type[FlakyPort]) -> None:
    flaky.there = False
    with live(BusSettings(interface="flaky", channel="x")) as buses:
        buses.open(strict=False)
        time.sleep(0.15)
        assert not buses[0].state.up
        flaky.there = True
        assert read_all(buses, 1)
        assert buses[0].state.up


def test_a_reader_that_fails_shows(flaky: type[FlakyPort], monkeypatch: pytest.MonkeyPatch) -> None:
    def receive(_: FlakyPort, timeout_s: float) -> list[Frame]:
        raise RuntimeError(timeout_s)

    monkeypatch.setattr(flaky, "receive", receive)
    monkeypatch.setattr("threading.excepthook", lambda _: None)
    with live(BusSettings(interface="flaky", channel="x")) as buses:
        buses.open()
        assert wait_for(lambda: not buses[0].state.up)
        assert buses[0].state.error == "its reader has failed"


def test_the_queue_waits_no_longer_than_asked() -> None:
    start = time.monotonic()
    assert FrameQueue(10).take(0.05) == []
    assert 0.04 < time.monotonic() - start < 1.0


def test_kernel_filters() -> None:
    settings = BusSettings(channel="can0")
    request = PortRequest("radar", 0, settings, ports.BusCounts(), ids={0x210, 0x123 | EXTENDED})
    assert ports._filters(request) == [
        {"can_id": 0x210, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x123, "can_mask": 0x1FFF_FFFF, "extended": True},
    ]
    assert ports._filters(PortRequest("radar", 0, settings, ports.BusCounts(), ids=range(513))) is None
    assert ports._filters(PortRequest("radar", 0, virtual(), ports.BusCounts(), ids={1})) is None


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
