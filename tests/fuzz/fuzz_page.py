"""Requests and WebSocket frames with anything in them to the view's port: refused, and the next one is served."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import Counter
from functools import cache
from threading import Event, Thread

from candaemon.view.page_server import PageAddress, PageServer
from tests.support.viewing import demo_pictures, show_of

from .drawn import Drawn
from .fuzz_http import Failures

_WORDS = (b"\r\n", b"\n", b"\r\n\r\n", b" ", b"GET", b"POST", b"HTTP/1.1", b"/live", b"/", b"//",
          b"/..%2f..%2fetc/passwd", b"?token=%00", b"%ff", b"..", b"Host: evil\r\n", b"Origin: http://evil\r\n",
          b"Origin: null\r\n", b"Content-Length: -1\r\n", b"Transfer-Encoding: chunked\r\n",
          b"Upgrade: websocket\r\n", b"Sec-WebSocket-Version: 99\r\n",
          b"Sec-WebSocket-Extensions: permessage-deflate\r\n", b"\0", b"\xff", b"A" * 5000)  # fmt: skip
_COMMANDS = (b'{"do":"seek","t":', b'{"do":"shown","n":', b'{"do":"step","by":', b'{"do":"play"}', b"NaN", b"1e999",
             b"}", b"[" * 500, b"-9999999999999999999")  # fmt: skip
_PATIENCE_S = 20.0
_PAUSE_S = 0.05
_LONGEST = 8_000_000


def fuzz_page(data: bytes) -> Counter[str]:
    """Send a request, or frames after a good handshake; then a request as a browser sends it."""
    drawn = Drawn(data)
    server, failed = _served()
    host = f"127.0.0.1:{server.port}".encode()
    sound = b"GET /main.js HTTP/1.1\r\nHost: " + host + b"\r\n\r\n"
    live = (
        b"GET /live HTTP/1.1\r\nHost: " + host + b"\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    if drawn.flag():
        request = live + _frame(drawn.edited(b'{"do":"pause"}', _COMMANDS)) + drawn.rest()
    else:
        request = drawn.edited(live if drawn.flag() else sound, _WORDS)
    answer = _asked(server.port, request, ends=True)
    assert not failed.seen, f"a request failed: {failed.seen}"
    assert b"root:" not in answer
    assert not answer or answer.startswith(b"HTTP/"), answer[:60]
    served = _asked(server.port, sound, ends=False)
    assert b" 200 " in served[:20], f"after {request[:60]!r} a browser gets {served[:60]!r}"
    return Counter(answered=bool(answer), hung_up_on=not answer, upgraded=b" 101 " in answer[:20])


def _frame(payload: bytes) -> bytes:
    """Return a masked text frame of WebSocket; the mask is 0."""
    length = len(payload)
    size = bytes([0x80 | length]) if length < 126 else b"\xfe" + (length & 0xFFFF).to_bytes(2, "big")
    return b"\x81" + size + bytes(4) + payload


def _asked(port: int, request: bytes, *, ends: bool) -> bytes:
    """Return the answer to a request.

    Args:
        port: of the server.
        request: as it is sent.
        ends: whether its sender says that no more will come, when nothing has come for a while.
    """
    answer = bytearray()
    with socket.create_connection(("127.0.0.1", port), _PATIENCE_S) as connection:
        try:
            connection.sendall(request)
            connection.settimeout(_PAUSE_S if ends else _PATIENCE_S)
            while True:
                try:
                    part = connection.recv(65_536)
                except TimeoutError:
                    connection.settimeout(_PATIENCE_S)
                    connection.shutdown(socket.SHUT_WR)
                    continue
                if not part:
                    break
                answer += part
                assert len(answer) < _LONGEST
        except (ConnectionError, BrokenPipeError):
            pass  # it hung up
    return bytes(answer)


@cache
def _served() -> tuple[PageServer, Failures]:
    """Return a server that runs in a thread of its own, and what is logged of failures."""
    failed = Failures()
    for name in ("candaemon.view", "aiohttp", "asyncio"):
        logging.getLogger(name).addHandler(failed)
    ready, found = Event(), list[PageServer]()

    async def serve() -> None:
        async with PageServer(show_of(demo_pictures()), PageAddress("127.0.0.1", 0)) as server:
            found.append(server)
            ready.set()
            await asyncio.Event().wait()

    Thread(target=lambda: asyncio.run(serve()), daemon=True).start()
    assert ready.wait(_PATIENCE_S)
    return found[0], failed
