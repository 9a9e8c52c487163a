"""The HTTP server that Prometheus scrapes, bounded in all that a client could make it do.

The answer is prometheus_client's `MetricsHandler`; its `start_http_server` limits neither clients, time nor rate.
It listens on the loopback address alone, serves few clients at a time and answers at a limited rate: what it costs the
core loop stays small, whoever asks how often. A client that asks for nothing makes room for the next one, and all
have a limited time: idle connections keep no scrape out.
"""

from __future__ import annotations

import io
import logging
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from socketserver import TCPServer, ThreadingMixIn
from threading import Condition, Lock, Thread
from typing import Final, TypeAlias

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import MetricsHandler

from candaemon.status.prometheus_metrics import SnapshotCollector
from candaemon.status.snapshot import StatusSnapshot

logger = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"

MOST_SCRAPERS: Final = 8
"""Clients of the metrics endpoint that are served at a time."""
LONGEST_REQUEST: Final = 8 << 10
"""Bytes of a request, its headers included."""
REQUEST_S: Final = 2.0
"""s until a request must have come whole."""
ANSWER_S: Final = 5.0
"""s from then on until its answer must have been read."""

_BACKLOG: Final = 128
_ACCEPT_PACE_S: Final = 0.02
_ANSWER_PACE_S: Final = 0.1
_POLL_S: Final = 0.1

Request: TypeAlias = socket.socket | tuple[bytes, socket.socket]
Address: TypeAlias = tuple[str, int]
Ask: TypeAlias = Callable[[], StatusSnapshot]


@dataclass(slots=True)
class _Client:
    """How far a client is.

    Attributes:
        until_s: when it is hung up on, monotonic s.
        has_asked: whether its request has come whole.
        has_answer: whether it got the metrics.
    """

    until_s: float
    has_asked: bool = False
    has_answer: bool = False


class MetricsServer(ThreadingMixIn, TCPServer):
    """Serves the metrics, each client in a thread of its own.

    Args:
        port: on the loopback address; 0 takes any.
        ask: gives the snapshot of the moment; raises TimeoutError where there are none in time.
        count_unserved: called for each connection that ends without metrics, one at a time.

    Raises:
        OSError: the port cannot be had.
    """

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = _BACKLOG

    def __init__(self, port: int, ask: Ask, count_unserved: Callable[[], None]) -> None:
        self._clients: dict[Request, _Client] = {}  # in the order in which they came
        self._changed = Condition()
        self._count_unserved = count_unserved
        self._turn = Lock()
        self._next_accept_s = self._next_answer_s = 0.0
        self._stopping = False
        super().__init__((LOOPBACK, port), partial(_Handler, ask))
        self._thread = Thread(target=partial(self.serve_forever, _POLL_S), name="metrics", daemon=True)

    @property
    def port(self) -> int:
        """The port it listens at."""
        return int(self.socket.getsockname()[1])

    def start(self) -> None:
        """Start to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port; takes 0.3 s at most."""
        self._stopping = True
        self.shutdown()
        self.server_close()

    def verify_request(self, request: Request, client_address: Address) -> bool:  # noqa: ARG002 - the base class's
        """Wait for a place for a client; the first of those that have not asked for anything yet makes room."""
        time.sleep(max(self._next_accept_s - time.monotonic(), 0.0))
        self._next_accept_s = time.monotonic() + _ACCEPT_PACE_S
        with self._changed:
            if len(self._clients) >= MOST_SCRAPERS:
                silent = (each for each, client in self._clients.items() if not client.has_asked)
                _hang_up(next(silent, None))
            while len(self._clients) >= MOST_SCRAPERS and not self._stopping:
                self._changed.wait(_POLL_S)
                self.service_actions()
        return not self._stopping

    def process_request(self, request: Request, client_address: Address) -> None:
        """Serve a client in the background, for a limited time."""
        with self._changed:
            self._clients[request] = _Client(time.monotonic() + REQUEST_S)
        super().process_request(request, client_address)

    def wait_for_turn(self, request: Request) -> None:
        """Note that a client's request has come; wait until it is to be answered."""
        with self._changed:
            client = self._clients[request]
            client.has_asked, client.until_s = True, time.monotonic() + ANSWER_S
        with self._turn:
            time.sleep(max(self._next_answer_s - time.monotonic(), 0.0))
            self._next_answer_s = time.monotonic() + _ANSWER_PACE_S

    def note_answer(self, request: Request) -> None:
        """Note that a client got the metrics."""
        with self._changed:
            self._clients[request].has_answer = True

    def shutdown_request(self, request: Request) -> None:
        """Close a client's connection; count it if it got no metrics."""
        with self._changed:
            client = self._clients.pop(request, None)
            if client is None or not client.has_answer:
                self._count_unserved()
            self._changed.notify_all()
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Hang up on clients whose time is over."""
        now_s = time.monotonic()
        with self._changed:
            for request, client in self._clients.items():
                if now_s >= client.until_s:
                    _hang_up(request)

    def handle_error(self, request: Request, client_address: Address) -> None:  # noqa: ARG002 - the base class's
        """Log what went wrong with a client, unless it is only gone."""
        error = sys.exception()
        if not isinstance(error, OSError):
            logger.error("metrics: a scrape failed", exc_info=error)


def _hang_up(request: Request | None) -> None:
    """Let the thread that serves a client see its end."""
    if isinstance(request, socket.socket):
        with suppress(OSError):
            request.shutdown(socket.SHUT_RDWR)


class _BoundedInput(io.RawIOBase):
    """Reads from a client up to a limit, behind which its request ends.

    Args:
        source: what comes from it.

    Attributes:
        left: bytes until the limit.
        has_ended: whether the client's end was read.
    """

    def __init__(self, source: io.BufferedIOBase) -> None:
        self._source = source
        self.left = LONGEST_REQUEST + 1
        self.has_ended = False

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, room: memoryview) -> int:  # type: ignore[override]  # typeshed's Buffer has no length
        """Read what is there, at most as much as there is room."""
        chunk = self._source.read1(min(len(room), self.left))
        room[: len(chunk)] = chunk
        self.left -= len(chunk)
        self.has_ended |= not chunk
        return len(chunk)

    def close(self) -> None:
        """Close the source too."""
        self._source.close()
        super().close()


class _Handler(MetricsHandler):
    """Answers one request."""

    timeout = ANSWER_S
    server: MetricsServer

    def __init__(self, ask: Ask, request: socket.socket, client_address: Address, server: MetricsServer) -> None:
        self._ask = ask
        super().__init__(request, client_address, server)

    def setup(self) -> None:
        """Read no more than a request may have."""
        super().setup()
        self._input = _BoundedInput(self.rfile)
        self.rfile = io.BufferedReader(self._input)

    def do_GET(self) -> None:  # noqa: N802 - the base class's
        """Send the metrics, or say that the core loop gives none."""
        if self._input.left <= 0:
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, f"more than {LONGEST_REQUEST} bytes")
            return
        if self._input.has_ended:  # in the middle of its request, which would pass for one of HTTP/0.9
            return
        self.server.wait_for_turn(self.request)
        try:
            snapshot = self._ask()
        except TimeoutError:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "the core loop takes no turn")
            return
        registry = CollectorRegistry()
        registry.register(SnapshotCollector(snapshot))
        self.registry = registry
        super().do_GET()
        self.server.note_answer(self.request)
