"""Limits what connections cost before they have said anything: their number, and how long each may take to ask."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from candaemon.view.viewer import ViewCounts

MOST_CONNECTIONS: Final = 64
"""Connections to the view's port at a time; further ones are hung up on."""
ASK_S: Final = 5.0
"""s until the request of a connection must have come whole."""
ANSWER_S: Final = 30.0
"""s from then on until its answer must have been read, unless it is a WebSocket's."""


class ConnectionGuard(asyncio.Protocol):
    """Stands between a connection and the protocol that serves it.

    Args:
        inner: serves it.
        open_ones: all guards of connections that are open.
        counts: of the server.
    """

    def __init__(
        self, inner: asyncio.Protocol, open_ones: dict[asyncio.BaseTransport, ConnectionGuard], counts: ViewCounts
    ) -> None:
        self._inner, self._open, self._counts = inner, open_ones, counts
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._is_refused = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to wait for the request; refuse a connection beyond the limit."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - the server listens on a stream socket
        self._transport = transport
        if len(self._open) >= MOST_CONNECTIONS:
            self._is_refused = True
            self._counts.crowded += 1
            transport.abort()
            return
        self._open[transport] = self
        self._wait(ASK_S)
        self._inner.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Pass on what has come."""
        if not self._is_refused:
            self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        """Pass on that no more will come."""
        return None if self._is_refused else self._inner.eof_received()

    def pause_writing(self) -> None:
        """Pass on that the other side does not read."""
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that it reads again."""
        self._inner.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass on that the connection is gone."""
        if self._is_refused:
            return
        self._stop()
        if self._transport is not None:
            self._open.pop(self._transport, None)
        self._inner.connection_lost(exc)

    def asked(self) -> None:
        """Begin to wait for the answer to be read: the request has come whole."""
        self._wait(ANSWER_S)

    def stays(self) -> None:
        """Wait no longer: it is a WebSocket, which has rules of its own."""
        self._stop()

    def hang_up(self) -> None:
        """End the connection at once, whatever is still to be sent."""
        if self._transport is not None:
            self._transport.abort()

    def _wait(self, seconds: float) -> None:
        self._stop()
        self._timer = asyncio.get_running_loop().call_later(seconds, self._expire)

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _expire(self) -> None:
        self._counts.stalled += 1
        self.hang_up()


def guarded(
    make: Callable[[], asyncio.Protocol], open_ones: dict[asyncio.BaseTransport, ConnectionGuard], counts: ViewCounts
) -> Callable[[], ConnectionGuard]:
    """Return a maker of protocols that puts a guard before each."""
    return lambda: ConnectionGuard(make(), open_ones, counts)
