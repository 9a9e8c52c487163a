"""Requests with anything in them to the metrics' port: answered or hung up on, and the next scrape is served."""

from __future__ import annotations

import logging
import socket
from collections import Counter
from functools import cache, partial
from unittest.mock import patch

from candaemon.daemon.daemon import Daemon
from candaemon.status import metrics_http
from candaemon.status.metrics_http import MetricsServer
from candaemon.status.service_monitor import ServiceMonitor

from .campaign import binding
from .drawn import Drawn

_WORDS = (b"\r\n", b"\n", b"\r\n\r\n", b" ", b"GET", b"HEAD", b"POST", b"HTTP/1.1", b"HTTP/9.9", b"HTTP/0.9", b"/",
          b"//",
          b"?name[]=candaemon_cycles_total", b"?name[]=%00", b"%ff", b"..", b"Host: x\r\n", b"Content-Length: -1\r\n",
          b"Transfer-Encoding: chunked\r\n", b"Accept: application/openmetrics-text;version=1e9,*;q=x\r\n",
          b"Accept-Encoding: gzip\r\n", b"Connection: keep-alive\r\n", b"\0", b"\xff", b"A" * 3000)  # fmt: skip
_SOUND = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nAccept: text/plain\r\nConnection: close\r\n\r\n"
_LONGEST = 4_000_000
_PATIENCE_S = 20.0


def fuzz_http(data: bytes) -> Counter[str]:
    """Send a request; then one as Prometheus sends it."""
    drawn = Drawn(data)
    request = drawn.edited(_SOUND, _WORDS) if drawn.flag() else drawn.rest()
    server, failed = _served()
    answer = _asked(server.port, request)
    assert not failed.seen, f"a request failed: {failed.seen}"
    if answer and b"HTTP/" in request:
        assert answer.startswith((b"HTTP/", b"<!DOCTYPE", b"# HELP")), answer[:60]
    scraped = _asked(server.port, _SOUND)
    assert b" 200 " in scraped[:20], f"after {request[:60]!r} a scrape gets {scraped[:60]!r}"
    return Counter(answered=bool(answer), hung_up_on=not answer)


def _asked(port: int, request: bytes) -> bytes:
    """Return the answer to a request whose sender says no more."""
    answer = bytearray()
    with socket.create_connection(("127.0.0.1", port), _PATIENCE_S) as connection:
        try:
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
            while part := connection.recv(65_536):
                answer += part
                assert len(answer) < _LONGEST
        except (ConnectionError, BrokenPipeError):
            pass  # it hung up
    return bytes(answer)


class Failures(logging.Handler):
    """Keeps what was logged with an exception."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep an exception."""
        if record.exc_info:
            self.seen.append(f"{record.getMessage()}: {record.exc_info[1]!r}")


@cache
def _served() -> tuple[MetricsServer, Failures]:
    """Return a server that serves as fast as it is asked, and what it logs of failures."""
    failed = Failures()
    metrics_http.logger.addHandler(failed)
    daemon = Daemon(binding("demo"))
    meter = ServiceMonitor(daemon.pipeline.binding.settings.service.metrics)
    meter.on_start(daemon)
    for pace in ("_ACCEPT_PACE_S", "_ANSWER_PACE_S"):
        patch.object(metrics_http, pace, 0.0).start()
    server = MetricsServer(0, partial(meter.snapshot, daemon), lambda: None)
    server.start()
    return server, failed
