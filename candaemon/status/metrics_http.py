"""The HTTP server that Prometheus scrapes, bounded in all that a client could make it do.

The answer is prometheus_client's `MetricsHandler`; its `start_http_server` limits neither clients, time nor rate.
It listens on the loopback address alone, serves few clients at a time, closes a connection that takes long, and takes
connections at a limited rate: what it costs the core loop stays small, whoever asks how often.
"""

from __future__ import annotations

import logging
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from socketserver import TCPServer, ThreadingMixIn
from threading import Lock, Thread
from typing import TypeAlias

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import MetricsHandler

from candaemon.status.prometheus_metrics import SnapshotCollector
from candaemon.status.snapshot import StatusSnapshot

logger = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"

_MOST_CLIENTS = 4
_CLIENT_S = 5.0
_PACE_S = 0.1
_POLL_S = 0.2

Request: TypeAlias = socket.socket | tuple[bytes, socket.socket]
Address: TypeAlias = tuple[str, int]
Ask: TypeAlias = Callable[[], StatusSnapshot]


class MetricsServer(ThreadingMixIn, TCPServer):
    """Serves the metrics, each client in a thread of its own.

    Args:
        port: on the loopback address; 0 takes any.
        ask: gives the snapshot of the moment; raises TimeoutError where there are none in time.

    Raises:
        OSError: the port cannot be had.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, port: int, ask: Ask) -> None:
        self._until: dict[Request, float] = {}
        self._lock = Lock()
        self._next_s = 0.0
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
        self.shutdown()
        self.server_close()

    def verify_request(self, request: Request, client_address: Address) -> bool:  # noqa: ARG002 - the base class's
        """Refuse a client where too many are served already; one that comes soon after another waits for a moment."""
        time.sleep(max(self._next_s - time.monotonic(), 0.0))
        self._next_s = time.monotonic() + _PACE_S
        with self._lock:
            return len(self._until) < _MOST_CLIENTS

    def process_request(self, request: Request, client_address: Address) -> None:
        """Serve a client in the background, for a limited time."""
        with self._lock:
            self._until[request] = time.monotonic() + _CLIENT_S
        super().process_request(request, client_address)

    def shutdown_request(self, request: Request) -> None:
        """Close a client's connection."""
        with self._lock:
            self._until.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Hang up on clients whose time is over."""
        now_s = time.monotonic()
        with self._lock:
            for request, until_s in self._until.items():
                if now_s >= until_s and isinstance(request, socket.socket):
                    with suppress(OSError):
                        request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Request, client_address: Address) -> None:  # noqa: ARG002 - the base class's
        """Log what went wrong with a client, unless it is only gone."""
        error = sys.exception()
        if not isinstance(error, OSError):
            logger.error("metrics: a scrape failed", exc_info=error)


class _Handler(MetricsHandler):
    """Answers one request."""

    timeout = _CLIENT_S

    def __init__(self, ask: Ask, request: socket.socket, client_address: Address, server: MetricsServer) -> None:
        self._ask = ask
        super().__init__(request, client_address, server)

    def do_GET(self) -> None:  # noqa: N802 - the base class's
        """Send the metrics, or say that the core loop gives none."""
        try:
            snapshot = self._ask()
        except TimeoutError:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "the core loop takes no turn")
            return
        registry = CollectorRegistry()
        registry.register(SnapshotCollector(snapshot))
        self.registry = registry
        super().do_GET()
