"""The queues of a live bus: frames that wait to be sent, and those that a reader thread has for us."""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from candaemon.can_io import open_port as opening
from candaemon.can_io.open_port import PORTS, BackgroundOpening
from candaemon.can_io.port import Port, PortCounts, PortRequest
from candaemon.can_io.threaded_port import ThreadedPort
from candaemon.can_io.tx_queue import TxQueue
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError
from candaemon.frames.frame import Frame
from tests.support.live_buses import virtual


def frame(can_id: int, content: int = 0) -> Frame:
    return Frame(0, 0, can_id, bytes([content]))


steps = st.lists(st.tuples(st.lists(st.integers(0, 9), max_size=8), st.integers(0, 6)), max_size=12)


@given(steps, st.integers(1, 12))
def test_every_frame_is_sent_or_dropped_once_and_the_newest_wins(
    steps: list[tuple[list[int], int]], capacity: int
) -> None:
    queue = TxQueue(capacity, 3.5)
    put = dropped = 0
    sent: list[Frame] = []
    for cycle, (ids, room) in enumerate(steps):
        dropped += queue.expire(float(cycle))
        dropped += queue.put([frame(can_id, cycle) for can_id in ids], float(cycle))
        put += len(ids)
        assert len(queue) <= capacity
        waiting = {each.can_id: each.data[0] for each in queue.frames if each.can_id in ids}
        assert set(waiting.values()) <= {cycle}
        assert all(cycle - each.data[0] <= 3.5 for each in queue.frames)
        sent += queue.frames[:room]
        queue.remove_first(min(room, len(queue)))
        assert len(sent) + dropped + len(queue) == put
    order = [each.data[0] for each in sent]
    assert order == sorted(order)


class SlowPort:
    """A driver that gives frames as told, and may never come back."""

    def __init__(self, batches: Sequence[list[Frame] | Exception]) -> None:
        self.batches = list(batches)
        self.hangs = threading.Event()
        self.comes_back = threading.Event()
        self.late: list[Frame] = []
        self.closed = False

    def receive(self, limit: int, timeout_s: float) -> list[Frame]:
        assert limit > 0 < timeout_s
        if not self.batches:
            self.hangs.set()
            self.comes_back.wait(20.0)
            return self.late
        batch = self.batches.pop(0)
        if isinstance(batch, Exception):
            raise batch
        return batch

    def send(self, frames: Sequence[Frame]) -> int:
        return len(frames)

    def close(self) -> None:
        self.closed = True


def is_readable(port: ThreadedPort, timeout_s: float = 0.0) -> bool:
    return bool(select.select([port], [], [], timeout_s)[0])


def test_a_reader_is_readable_while_something_waits() -> None:
    slow = SlowPort([[frame(k) for k in range(5)], [frame(5)]])
    counts = PortCounts()
    port = ThreadedPort(slow, "slow", counts, capacity=5)
    assert slow.hangs.wait(20.0)
    assert is_readable(port)
    assert [each.can_id for each in port.receive(3)] == [0, 1, 2]
    assert is_readable(port)
    assert [each.can_id for each in port.receive(3)] == [3, 4]
    assert not is_readable(port)
    assert port.receive(3) == []
    assert counts.queue_full == 1
    start = time.monotonic()
    port.close()
    assert time.monotonic() - start < 10.0  # though the driver does not come back for twice as long
    assert slow.closed
    slow.comes_back.set()


def test_what_a_closed_reader_had_received_is_counted() -> None:
    slow = SlowPort([[frame(k) for k in range(8)]])
    counts = PortCounts()
    port = ThreadedPort(slow, "slow", counts, capacity=6)
    assert slow.hangs.wait(20.0)
    slow.late = [frame(9)]  # with which it comes back after the closing has given up on it
    read = len(port.receive(2))
    port.close()
    assert counts.unread == 4
    slow.comes_back.set()
    end = time.monotonic() + 10.0
    while read + counts.lost < 9 and time.monotonic() < end:
        time.sleep(0.01)
    assert (read, counts.queue_full, counts.unread) == (2, 2, 5)


def test_the_frames_before_an_error_come_first() -> None:
    port = ThreadedPort(SlowPort([[frame(1)], OSError(19, "No such device")]), "slow", PortCounts())
    assert is_readable(port, 20.0)
    assert len(port.receive(10)) == 1
    assert is_readable(port, 20.0)
    for _ in range(2):
        with pytest.raises(OSError, match="No such device"):
            port.receive(10)
    port.close()


def request(settings: BusSettings) -> PortRequest:
    return PortRequest("bus", 0, settings, PortCounts())


def wait(opened: BackgroundOpening) -> None:
    end = time.monotonic() + 3.0
    while not opened.is_over() and time.monotonic() < end:
        time.sleep(0.005)
    assert opened.is_over()


def test_opening_takes_its_time_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    go = threading.Event()
    ports: list[Port] = []

    def slowly(request: PortRequest) -> Port:
        assert go.wait(3.0)
        ports.append(opening.open_through_python_can(request))
        return ports[-1]

    monkeypatch.setitem(PORTS, "virtual", slowly)
    wanted, unwanted = BackgroundOpening(request(virtual())), BackgroundOpening(request(virtual()))
    assert not wanted.is_over()
    unwanted.abandon()
    go.set()
    wait(wanted)
    wait(unwanted)
    assert wanted.port().fileno() >= 0
    wanted.abandon()
    assert [port.fileno() for port in ports] == [-1, -1]


def test_opening_that_fails_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = BackgroundOpening(request(BusSettings(interface="no_such_thing", channel="x")))
    wait(missing)
    with pytest.raises(BusError, match="expected one of python-can's interfaces"):
        missing.port()

    def broken(_: PortRequest) -> Port:
        raise KeyError("a driver's own fault")

    monkeypatch.setitem(PORTS, "virtual", broken)
    monkeypatch.setattr("threading.excepthook", lambda _: None)
    failed = BackgroundOpening(request(virtual()))
    wait(failed)
    with pytest.raises(BusError, match="opening it has failed"):
        failed.port()
