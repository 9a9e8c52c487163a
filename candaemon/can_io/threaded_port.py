"""A thread that reads a bus without a descriptor of its own, and a bounded queue that has one."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from threading import Event, Lock, Thread
from typing import Final, Protocol

from candaemon.can_io.port import Controller, PortCounts, port_errors
from candaemon.errors import BusError
from candaemon.frames.frame import Frame

CAPACITY: Final = 20_000
"""Frames that wait for the daemon at most: two seconds of a full 1 Mbit/s bus."""

_POLL_S = 0.05
_JOIN_S = 0.2
_BATCH = 256


class BlockingPort(Protocol):
    """A port whose `receive` waits. `receive` and `send` run in two threads at the same time."""

    def receive(self, limit: int, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for a frame; return it and those behind it. Raises `port_errors`."""

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one is refused; return how many were taken. Raises `port_errors`."""

    def close(self) -> None:
        """Close the bus. Raises `port_errors`."""


class ThreadedPort:
    """Makes a port of one whose `receive` waits.

    Args:
        port: the bus; closed with this.
        name: of the bus, which the thread gets.
        counts: frames that find no room are counted there.
        capacity: frames that wait at most.

    Attributes:
        controller: unknown, so always active.
    """

    controller: Controller = "active"

    def __init__(self, port: BlockingPort, name: str, counts: PortCounts, capacity: int = CAPACITY) -> None:
        self._port = port
        self._counts = counts
        self._capacity = capacity
        self._frames: list[Frame] = []
        self._error: Exception | None = None
        self._lock = Lock()
        self._ours, self._theirs = socket.socketpair()
        self._signalled = False
        self._closing = Event()
        self._closed = False
        self._thread = Thread(target=self._read, name=f"bus {name}", daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Return the descriptor that is readable while frames wait, or an error."""
        return self._ours.fileno()

    def receive(self, limit: int) -> list[Frame]:
        """Return the frames that wait, `limit` at most.

        Raises:
            port_errors, BusError: none waits, and none will: reading failed.
        """
        with self._lock:
            frames, self._frames = self._frames[:limit], self._frames[limit:]
            if self._error is not None and not frames:
                raise self._error
            if self._signalled and not self._frames and self._error is None:
                self._ours.recv(1)
                self._signalled = False
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one is refused; return how many were taken."""
        return self._port.send(frames)

    def check(self) -> None:
        """Do nothing: what fails shows when it is read."""

    def close(self) -> None:
        """End the thread, or leave a driver that does not come back alone with it; close the bus; count the unread."""
        self._closing.set()
        self._thread.join(_JOIN_S)
        self._ours.close()
        with self._lock:
            self._theirs.close()
            self._closed = True
            self._counts.unread += len(self._frames)
            self._frames = []
        self._port.close()

    def _read(self) -> None:
        """Read until asked to end, or the bus fails."""
        error: Exception = BusError("its reader has failed")
        try:
            while not self._closing.is_set():
                self._put(self._port.receive(_BATCH, _POLL_S))
        except port_errors() as reason:
            error = reason
        finally:
            with self._lock:
                self._error = error
                self._signal()

    def _put(self, frames: list[Frame]) -> None:
        """Append frames as far as there is room; count the others, and all where nobody reads any more."""
        if not frames:
            return
        with self._lock:
            if self._closed:
                self._counts.unread += len(frames)
                return
            room = self._capacity - len(self._frames)
            self._frames += frames[:room]
            self._counts.queue_full += max(len(frames) - room, 0)
            self._signal()

    def _signal(self) -> None:
        """Make the descriptor readable."""
        if not self._signalled and not self._closing.is_set():
            self._theirs.send(b"\0")
            self._signalled = True
