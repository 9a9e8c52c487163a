"""The HTTP server of the page: a fixed table of files, one WebSocket, and who may have them.

Whoever reaches the loopback address may look, but no page of another site: its origin is not this one, and a name that
was rebound to this address is no host of it. On any other address a token is asked for besides.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import logging
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import resources
from typing import Final, Self
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from candaemon.errors import CandaemonError
from candaemon.view.connection_guard import ConnectionGuard, guarded
from candaemon.view.viewer import LONGEST_COMMAND, Show, ViewCounts, Viewer

logger = logging.getLogger(__name__)

MOST_VIEWERS: Final = 32
"""Browsers that look at a time."""
LONGEST_LINE: Final = 4096
"""Bytes of the request's first line, and of a header."""

FILES: Final = {
    "/": ("index.html", "text/html"),
    "/view.css": ("view.css", "text/css"),
    "/main.js": ("main.js", "text/javascript"),
    "/link.js": ("link.js", "text/javascript"),
    "/memory.js": ("memory.js", "text/javascript"),
    "/road.js": ("road.js", "text/javascript"),
    "/plots.js": ("plots.js", "text/javascript"),
    "/panels.js": ("panels.js", "text/javascript"),
    "/uplot/uPlot.iife.min.js": ("uplot/uPlot.iife.min.js", "text/javascript"),
    "/uplot/uPlot.min.css": ("uplot/uPlot.min.css", "text/css"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
"""All that can be asked for beside `/live`: file and media type by path."""

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer."""

_HEARTBEAT_S: Final = 20.0
_BACKLOG: Final = 64
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def _is_ours(record: logging.LogRecord) -> bool:
    """Return whether a record is of something else than a bad request or a lost connection, which are others' doing."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionError)


_requests_log: Final = logging.getLogger(f"{__name__}.requests")
_requests_log.addFilter(_is_ours)


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where the page is served.

    Attributes:
        host: address or name to listen at.
        port: to listen at; 0: any that is free.
        token: that a browser must know; empty where none is asked for.
    """

    host: str
    port: int
    token: str = ""

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Return whether an address or name is that of this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class PageServer:
    """Serves the page. An asynchronous context manager: it listens within.

    Args:
        show: what is shown.
        address: where.

    Attributes:
        counts: what was refused.
        port: that it listens at.

    Raises:
        CandaemonError: it cannot listen there.
    """

    def __init__(self, show: Show, address: PageAddress) -> None:
        self._show, self._address = show, address
        self.counts = ViewCounts()
        self.port = address.port
        self._guards: dict[asyncio.BaseTransport, ConnectionGuard] = {}
        self._viewers: set[web.WebSocketResponse] = set()
        folder = resources.files("candaemon.view") / "static"
        self._files = {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}
        self._runner: web.ServerRunner | None = None
        self._listening: asyncio.Server | None = None

    @property
    def url(self) -> str:
        """What to open in a browser, the token included."""
        host = self._address.host
        host = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, host)  # noqa: S104 - compared
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self._address.token}" if self._address.token else "")

    @property
    def viewers(self) -> int:
        """Browsers that look."""
        return len(self._viewers)

    async def __aenter__(self) -> Self:
        server = web.Server(
            self._answer,
            access_log=None,
            logger=_requests_log,
            max_line_size=LONGEST_LINE,
            max_field_size=LONGEST_LINE,
            keepalive_timeout=1.0,
            lingering_time=0.0,
        )
        self._runner = web.ServerRunner(server)
        await self._runner.setup()
        loop = asyncio.get_running_loop()
        try:
            self._listening = await loop.create_server(
                guarded(server, self._guards, self.counts), self._address.host, self._address.port, backlog=_BACKLOG
            )
        except OSError as error:
            await self._runner.cleanup()
            raise CandaemonError(
                f"cannot serve the page at {self._address.host} port {self._address.port}: {error.strerror or error}; "
                "expected an address of this machine and a free port: see --address and --port"
            ) from error
        self.port = self._listening.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        turned_away = ", ".join(f"{name} {count}" for name, count in asdict(self.counts).items() if count)
        if turned_away:
            logger.warning("the page turned away: %s", turned_away)
        if self._listening is not None:
            self._listening.close()
        for guard in list(self._guards.values()):
            guard.hang_up()
        if self._runner is not None:
            await self._runner.cleanup()

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer one request; the connection ends with it."""
        guard = None if request.transport is None else self._guards.get(request.transport)
        if guard is None:
            return self._refused(400, "no connection")
        guard.asked()
        if request.method != "GET":
            return self._refused(405, "only GET")
        if not self._is_own_host(request.host):
            return self._refused(421, "this is no host of this page")
        if request.path == "/live":
            return await self._live(request, guard)
        if request.path == "/" and not self._knows_token(request):
            return self._refused(
                403, "the token is missing or wrong: open the whole address that `candaemon view` printed"
            )
        if request.path not in self._files:
            return self._refused(404, "there is no such file")
        body, kind = self._files[request.path]
        answer = web.Response(body=body, content_type=kind, charset="utf-8", headers=HEADERS)
        answer.force_close()
        return answer

    async def _live(self, request: web.BaseRequest, guard: ConnectionGuard) -> web.StreamResponse:
        """Talk with a browser over a WebSocket."""
        if not self._knows_token(request):
            return self._refused(403, "the token is missing or wrong")
        if not self._is_own_origin(request):
            return self._refused(403, "a page of another origin may not look")
        if self.viewers >= MOST_VIEWERS:
            self.counts.crowded += 1
            return self._refused(503, f"{MOST_VIEWERS} browsers are looking already")
        ws = web.WebSocketResponse(
            heartbeat=_HEARTBEAT_S, max_msg_size=LONGEST_COMMAND + 1, compress=False, timeout=2.0
        )
        if not ws.can_prepare(request):
            return self._refused(400, "expected a WebSocket")
        await ws.prepare(request)
        guard.stays()
        self._viewers.add(ws)
        loop = asyncio.get_running_loop()
        try:
            with suppress(ConnectionError):
                await Viewer(ws, self._show, self.counts, guard.hang_up, loop.time).converse()
        finally:
            self._viewers.discard(ws)
        return ws

    def _refused(self, status: int, reason: str) -> web.Response:
        """Return an answer that says why there is none."""
        self.counts.refused += 1
        answer = web.Response(status=status, text=f"{reason}\n", headers=HEADERS)
        answer.force_close()
        return answer

    def _knows_token(self, request: web.BaseRequest) -> bool:
        """Return whether a request has the token, if one is asked for; takes equally long whatever is wrong in it."""
        given = request.query.get("token", "")
        return not self._address.token or hmac.compare_digest(
            given.encode(errors="replace"), self._address.token.encode()
        )

    def _is_own_host(self, host: str) -> bool:
        """Return whether a request means this server: not a name that someone else has rebound to its address."""
        name, _, port = host.rpartition(":") if not host.endswith("]") else (host, "", "80")
        if not name:
            name, port = host, "80"
        if port != str(self.port):
            return False
        name = name.strip("[]").lower()
        if is_loopback(name) or name == self._address.host.lower():
            return True
        if self._address.is_loopback:
            return False
        own = socket.gethostname().lower()
        with suppress(ValueError):
            return bool(ipaddress.ip_address(name))
        return name in {own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}

    def _is_own_origin(self, request: web.BaseRequest) -> bool:
        """Return whether a WebSocket is asked for by this page, or by no page at all."""
        origin = request.headers.get("Origin")
        if origin is None:
            return True
        with suppress(ValueError):
            parts = urlsplit(origin)
            return parts.scheme == "http" and parts.netloc.lower() == request.host.lower()
        return False
