"""Live buses: a reader thread each, one bounded queue for all, and reconnection without end.

A bus that goes away is closed and opened again after 0.1 s, then twice as long each time, up to 5 s; until then what is
sent to it counts as `send_failed`. The waiting starts over once it has delivered steadily. Nothing here ends because a
bus does; its state and its counters tell.

Time stamps are those of python-can: float seconds, rounded as `messages.nanoseconds` says.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from threading import Condition, Event, Thread
from types import TracebackType
from typing import Self

from candaemon.bus.frame import Frame
from candaemon.bus.ports import PORT_ERRORS, BusCounts, Port, PortRequest, open_port
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError

logger = logging.getLogger(__name__)

CAPACITY = 20_000
"""Frames that wait for the daemon at most: two seconds of a full 1 Mbit/s bus."""

_POLL_S = 0.1
_FIRST_DELAY_S = 0.1
_LONGEST_DELAY_S = 5.0
_STEADY_BATCHES = 50
_CLOSE_S = 0.9


@dataclass(frozen=True, slots=True)
class BusState:
    """Whether a bus is there.

    Attributes:
        up: whether it is open and can be read.
        since_ns: since when, in the clock given to `LiveBuses`.
        error: why it is down; empty where it is up.
    """

    up: bool
    since_ns: int
    error: str = ""


class FrameQueue:
    """Frames of all buses on their way to the daemon; bounded.

    Args:
        capacity: frames held at most.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._frames: list[Frame] = []
        self._filled = Condition()

    def put(self, frames: Sequence[Frame]) -> int:
        """Append frames as far as there is room; return how many found none."""
        with self._filled:
            room = self._capacity - len(self._frames)
            self._frames.extend(frames[:room])
            self._filled.notify()
        return max(len(frames) - room, 0)

    def take(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for frames; return all there are, ordered by time."""
        with self._filled:
            if not self._frames:
                self._filled.wait(timeout_s)
            frames, self._frames = self._frames, []
        frames.sort(key=itemgetter(0))
        return frames


class LiveBus:
    """One configured bus, read by a thread of its own.

    Args:
        request: which bus.
        queue: where its frames go.
        clock: gives nanoseconds; for `BusState.since_ns` alone.

    Attributes:
        name: the bus's name in the configuration.
        counts: what it carried and lost.
        state: whether it is there.
    """

    def __init__(self, request: PortRequest, queue: FrameQueue, clock: Callable[[], int]) -> None:
        self.name = request.name
        self.counts = request.counts
        self.state = BusState(False, clock(), "not opened yet")
        self._request = request
        self._queue = queue
        self._clock = clock
        self._port: Port | None = None
        self._closing = Event()
        self._thread = Thread(target=self._read, name=f"bus {self.name}", daemon=True)

    def open(self) -> None:
        """Open the bus.

        Raises:
            BusError: it cannot be opened; says why and what to do.
        """
        self._port = open_port(self._request)
        self.state = BusState(True, self._clock())

    def start(self) -> None:
        """Start to read; opens the bus where it is not open, and again whenever it goes away."""
        self._thread.start()

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames; return how many were sent. The others are counted."""
        port = self._port
        sent = 0 if port is None else port.send(frames)
        self.counts.sent += sent
        self.counts.send_failed += len(frames) - sent
        return sent

    def stop(self) -> None:
        """Ask the reader to end; does not wait."""
        self._closing.set()

    def join(self, timeout_s: float) -> None:
        """Wait up to `timeout_s` s for the reader to end, and close the bus."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        self._close_port()

    def _read(self) -> None:
        """Read until asked to end; reconnect as often as it takes."""
        try:
            self._read_and_reconnect()
        finally:
            self._close_port()
            if not self._closing.is_set():
                self.state = BusState(False, self._clock(), "its reader has failed")

    def _read_and_reconnect(self) -> None:
        delay_s = _FIRST_DELAY_S
        steady = 0
        while not self._closing.is_set():
            try:
                frames = self._receive()
            except (BusError, *PORT_ERRORS) as error:
                self._go_down(error)
                self._closing.wait(delay_s)
                delay_s = min(2 * delay_s, _LONGEST_DELAY_S)
                steady = 0
                continue
            if not self.state.up:
                self._come_up()
            steady += 1
            if steady == _STEADY_BATCHES:
                delay_s = _FIRST_DELAY_S
            if frames:
                dropped = self._queue.put(frames)
                self.counts.queue_full += dropped
                self.counts.received += len(frames) - dropped

    def _receive(self) -> list[Frame]:
        """Return the frames of a short while; open the bus first where it is not."""
        if self._port is None:
            self._port = open_port(self._request)
        return self._port.receive(_POLL_S)

    def _come_up(self) -> None:
        """Note that the bus is back."""
        self.state = BusState(True, self._clock())
        self.counts.reconnects += 1
        logger.info("bus '%s' is up", self.name)

    def _go_down(self, error: Exception) -> None:
        """Close the bus and note why."""
        self._close_port()
        if self.state.up:
            logger.warning("bus '%s' is down: %s; it is opened again as soon as it can be", self.name, error)
            self.state = BusState(False, self._clock(), str(error))
        else:
            self.state = BusState(False, self.state.since_ns, str(error))

    def _close_port(self) -> None:
        """Close the bus if it is open; what fails then is of no use to anyone."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(*PORT_ERRORS):
                port.close()


class LiveBuses:
    """All buses of a configuration. A context manager: leaving it closes them.

    Args:
        buses: settings by name; the order gives the indices that frames carry.
        clock: gives nanoseconds, for `BusState.since_ns`.
        ids: identifiers wanted of a bus, with `EXTENDED`, by its name; all of a bus that it leaves out. An interface
            that can filter spares the others, so that they are not even counted.
        capacity: frames that wait at most.
    """

    def __init__(
        self,
        buses: Mapping[str, BusSettings],
        *,
        clock: Callable[[], int],
        ids: Mapping[str, Collection[int]] | None = None,
        capacity: int = CAPACITY,
    ) -> None:
        self._queue = FrameQueue(capacity)
        wanted = ids or {}
        self._buses = tuple(
            LiveBus(PortRequest(name, index, settings, BusCounts(), wanted.get(name)), self._queue, clock)
            for index, (name, settings) in enumerate(buses.items())
        )

    def __getitem__(self, index: int) -> LiveBus:
        return self._buses[index]

    def __len__(self) -> int:
        return len(self._buses)

    def open(self, *, strict: bool = True) -> None:
        """Open every bus and start to read.

        Args:
            strict: whether a bus that cannot be opened is an error; otherwise it is tried again in the background.

        Raises:
            BusError: strict, and a bus cannot be opened; none is left open then.
        """
        if strict:
            try:
                for bus in self._buses:
                    bus.open()
            except BusError:
                self.close()
                raise
        for bus in self._buses:
            bus.start()

    def read(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for frames; return all that have come, ordered by time."""
        return self._queue.take(timeout_s)

    def send(self, bus: int, frames: Sequence[Frame]) -> int:
        """Send frames on the bus of that index; return how many were sent. The others are counted."""
        return self._buses[bus].send(frames)

    def close(self) -> None:
        """Close every bus; takes a second at most."""
        for bus in self._buses:
            bus.stop()
        for bus in self._buses:
            bus.join(_CLOSE_S / len(self._buses))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
