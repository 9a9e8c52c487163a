"""Live buses that go away, come back, flood or are changed; through a port that does as it is told."""

from __future__ import annotations

import errno
import logging
import socket
import time
from collections.abc import Sequence

import can
import pytest
from can.interfaces.virtual import VirtualBus

from candaemon.can_io.live_bus import MOST, BusStateLog
from candaemon.can_io.live_buses import READ_LIMIT
from candaemon.can_io.open_port import PORTS
from candaemon.can_io.port import Controller, PortRequest
from candaemon.config.buses import BusSettings
from candaemon.frames.frame import Frame
from tests.support.live_buses import live, message, peer, read_all, turn_until, virtual

FLAKY = BusSettings(interface="flaky", channel="x")


class FlakyPort:
    """A port whose bus can be taken away; the other end of its socket makes it readable.

    Attributes:
        there: whether the bus exists.
        opened: times that it was opened.
        error: what reading raises where it does not exist.
        brings: how many frames it has.
        apart_ns: between two of them, by the index of the bus.
    """

    there = True
    opened = 0
    error: Exception = can.CanOperationError("Network is down")
    brings = 1
    apart_ns = (1, 1)
    controller: Controller = "active"

    def __init__(self, request: PortRequest) -> None:
        type(self).opened += 1
        if not self.there:
            raise OSError(errno.ENODEV, "No such device")
        self.index = request.index
        self.next = 0
        self.ours, self.theirs = socket.socketpair()
        self.theirs.send(b"\0")

    def fileno(self) -> int:
        return self.ours.fileno()

    def receive(self, limit: int) -> list[Frame]:
        if not self.there:
            raise self.error
        number = min(limit, self.brings)
        first, self.next = self.next, self.next + number
        return [Frame((first + k) * self.apart_ns[self.index], self.index, 0x123, b"") for k in range(number)]

    def send(self, frames: Sequence[Frame]) -> int:
        return len(frames)

    def check(self) -> None:
        if not self.there:
            raise self.error

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()
        raise OSError(errno.EBADF, "Bad file descriptor")


@pytest.fixture
def flaky(monkeypatch: pytest.MonkeyPatch) -> type[FlakyPort]:
    monkeypatch.setitem(PORTS, "flaky", FlakyPort)
    for name in ("there", "opened", "error", "brings", "apart_ns", "controller"):
        monkeypatch.setattr(FlakyPort, name, getattr(FlakyPort, name))
    return FlakyPort


def test_a_bus_that_goes_away_comes_back(flaky: type[FlakyPort], caplog: pytest.LogCaptureFixture) -> None:
    with live(FLAKY) as buses:
        buses.open()
        assert read_all(buses, 1)
        assert buses[0].state.up
        flaky.there = False
        assert turn_until(buses, lambda: not buses[0].state.up)
        down = buses[0].state
        assert "Network is down" in down.error
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        assert buses.read(0.5) == []
        assert 2 <= flaky.opened <= 5
        assert buses[0].state.since_ns == down.since_ns
        assert "No such device" in buses[0].state.error
        flaky.there = True
        assert turn_until(buses, lambda: buses[0].state.up)
        assert read_all(buses, 1)
        counts = buses[0].counts
        assert (counts.reconnects, counts.send_failed) == (1, 1)
    assert [record.message for record in caplog.records if "is down" in record.message] == [
        "bus 'bus0' is down: Network is down: it is opened again as soon as it can be"
    ]


def test_a_link_that_is_down_keeps_its_port(flaky: type[FlakyPort]) -> None:
    flaky.error = OSError(errno.ENETDOWN, "Network is down")
    with live(FLAKY) as buses:
        buses.open()
        for _ in range(3):
            assert read_all(buses, 1)
            flaky.there = False
            assert turn_until(buses, lambda: not buses[0].state.up)
            assert "ip link set x up" in buses[0].state.error
            flaky.there = True
            assert turn_until(buses, lambda: buses[0].state.up)
        assert (flaky.opened, buses[0].counts.reconnects) == (1, 3)


def test_a_controller_off_the_bus_is_awaited(flaky: type[FlakyPort], caplog: pytest.LogCaptureFixture) -> None:
    with live(FLAKY) as buses:
        buses.open()
        flaky.controller = "passive"
        assert turn_until(buses, lambda: buses[0].state.controller == "passive")
        assert buses[0].state.up
        flaky.controller = "bus-off"
        assert turn_until(buses, lambda: not buses[0].state.up)
        assert "restart-ms" in buses[0].state.error
        assert buses.send(0, [Frame(0, 0, 1, b"")]) == 0
        flaky.controller = "active"
        assert turn_until(buses, lambda: buses[0].state.up)
        assert (flaky.opened, buses[0].counts.reconnects, buses[0].counts.send_failed) == (1, 1, 1)
    assert sum("is down" in message for message in caplog.messages) == 1


def test_a_missing_bus_is_awaited_where_that_is_asked_for(
    flaky: type[FlakyPort], caplog: pytest.LogCaptureFixture
) -> None:
    flaky.there = False
    with live(FLAKY) as buses:
        buses.open(strict=False)
        assert ["tried again" in message for message in caplog.messages] == [True]
        assert buses.read(0.15) == []
        assert not buses[0].state.up
        flaky.there = True
        assert read_all(buses, 1)
        assert buses[0].state.up


def test_one_bus_that_floods_leaves_the_others_their_turn_and_the_order(flaky: type[FlakyPort]) -> None:
    flaky.brings = 10_000
    settings = virtual()
    with live(FLAKY, settings) as buses, peer(settings) as other:
        buses.open()
        other.send(message(timestamp=300e-9))
        other.send(message(timestamp=1000e-9))
        time.sleep(0.2)
        turns = [buses.read(0.0) for _ in range(6)]
    assert all(0 < len(turn) <= READ_LIMIT + 2 for turn in turns)
    frames = [frame for turn in turns for frame in turn]
    assert [frame.time_ns for frame in frames] == sorted(frame.time_ns for frame in frames)
    assert [frame.time_ns for frame in frames if frame.bus == 1] == [300, 1000]
    assert [frame.time_ns for frame in frames if frame.bus == 0] == list(range(6 * READ_LIMIT))


def test_buses_that_all_have_a_backlog_are_read_in_order(flaky: type[FlakyPort]) -> None:
    flaky.brings, flaky.apart_ns = 10_000, (2, 3)
    with live(FLAKY, FLAKY) as buses:
        buses.open()
        frames = [frame for _ in range(12) for frame in buses.read(0.0)]
        assert buses._ahead
        buses.close()
        buses.open()
        assert buses.read(0.0)
    times = [frame.time_ns for frame in frames]
    assert times == sorted(times)
    for bus, apart_ns in enumerate(flaky.apart_ns):
        mine = [frame.time_ns for frame in frames if frame.bus == bus]
        assert mine == list(range(0, apart_ns * len(mine), apart_ns))
        assert len(mine) > 3 * READ_LIMIT


def test_a_change_loses_nothing_that_has_come(flaky: type[FlakyPort]) -> None:
    flaky.brings = 10_000
    settings = virtual()
    with live(FLAKY, settings) as buses, peer(settings) as other:
        buses.open()
        for number in range(3):  # far ahead of what the flood has brought, so they are held back
            other.send(message(0x201 + number, timestamp=1.0 + number))
        time.sleep(0.2)
        assert all(frame.bus == 0 for frame in buses.read(0.0))
        other.send(message(0x204, timestamp=4.0))
        time.sleep(0.1)
        flaky.brings = 0
        buses.change({"bus1": settings})
        heard = [(frame.bus, frame.can_id) for frame in read_all(buses, 4, 0.5)]
    assert heard == [(0, 0x201 + number) for number in range(4)]


@pytest.mark.parametrize("left", ["closed", "changed"])
def test_what_is_held_back_when_its_bus_goes_is_counted(flaky: type[FlakyPort], left: str) -> None:
    flaky.brings = 10_000
    settings = virtual()
    with live(FLAKY, settings) as buses, peer(settings) as other:
        buses.open()
        for number in range(3):  # far ahead of what the flood has brought, so they are held back
            other.send(message(0x201 + number, timestamp=1.0 + number))
        time.sleep(0.2)
        assert all(frame.bus == 0 for frame in buses.read(0.0))
        counts = buses[1].counts
        assert counts.received == 3
        if left == "closed":
            buses.close()
        else:
            flaky.brings = 0
            buses.change({"bus0": FLAKY})
            assert read_all(buses, 1, 0.1) == []
    assert (counts.received, counts.unread) == (0, 3)


def test_what_was_sent_before_an_error_is_counted_as_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    took: list[int] = []

    def send(_: can.BusABC, sending: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0
        if len(took) == 3:
            raise OSError(errno.ENODEV, "No such device")
        took.append(sending.arbitration_id)

    settings = virtual()
    with live(settings) as buses:
        buses.open()
        monkeypatch.setattr(VirtualBus, "send", send)
        assert buses.send(0, [Frame(0, 0, k, b"") for k in range(5)]) == 3
        assert turn_until(buses, lambda: not buses[0].state.up)
        counts = buses[0].counts
        assert (took, counts.sent, counts.send_failed) == ([0, 1, 2], 3, 2)


def test_what_came_before_an_error_is_received(monkeypatch: pytest.MonkeyPatch) -> None:
    coming: list[can.Message | Exception] = [message(1), message(2), OSError(errno.ENODEV, "No such device")]

    def recv(_: can.BusABC, timeout: float | None = None) -> can.Message:
        assert timeout is not None
        each = coming.pop(0) if len(coming) > 1 else coming[0]
        if isinstance(each, Exception):
            raise each
        return each

    monkeypatch.setattr(VirtualBus, "recv", recv)
    with live(virtual()) as buses:
        buses.open()
        assert [frame.can_id for frame in read_all(buses, 2)] == [1, 2]
        assert turn_until(buses, lambda: "No such device" in buses[0].state.error)
        assert buses[0].counts.received == 2


def test_a_bus_that_flutters_does_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    notices = BusStateLog("radar")
    with caplog.at_level(logging.INFO):
        for k in range(6001):  # ten times a second for five minutes, ending down
            notices.update(k * 0.1, up=k % 2 == 1, error="bus-off")
        assert len(caplog.messages) <= 10 * MOST + MOST
        assert sum("bus-off" in text for text in caplog.messages) >= 5 * MOST // 2
        notices.update(700.0, up=False, error="bus-off")
        assert caplog.messages[-1] == "bus 'radar' is down: bus-off"
        before = len(caplog.messages)
        notices.update(701.0, up=False, error="bus-off")
        notices.update(702.0, up=True, error="")
    assert caplog.messages[before:] == ["bus 'radar' is up"]


def test_a_change_leaves_open_what_is_alike(flaky: type[FlakyPort]) -> None:
    first, second = virtual(), virtual()
    with live(FLAKY, first) as buses, peer(first) as other, peer(second) as further:
        buses.open()
        assert read_all(buses, 1)
        kept, counts = buses[0], buses[1].counts
        buses.change({"bus0": FLAKY, "bus1": second, "bus2": first})
        assert [bus.name for bus in buses] == ["bus0", "bus1", "bus2"]
        assert buses[0] is kept
        assert kept.state.up
        assert buses[1].counts is counts
        assert turn_until(buses, lambda: all(bus.state.up for bus in buses))
        flaky.brings = 0
        further.send(message(0x201))
        other.send(message(0x202))
        heard = {(frame.bus, frame.can_id) for frame in read_all(buses, 3, 0.3) if frame.bus}
        assert heard == {(1, 0x201), (2, 0x202)}
        assert flaky.opened == 1
        buses.change({"bus0": FLAKY}, ids={"bus0": {1}})
        assert turn_until(buses, lambda: buses[0].state.up)
        assert flaky.opened == 2
