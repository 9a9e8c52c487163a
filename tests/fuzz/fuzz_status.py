"""What a foreign socket may send to `candaemon status`: shown without what a terminal obeys, or refused."""

from __future__ import annotations

import io
import json
import socket
from collections import Counter
from contextlib import redirect_stdout, suppress
from functools import cache
from threading import Thread
from typing import Any

from candaemon.cli.status import watch
from candaemon.daemon.daemon import Daemon
from candaemon.errors import InputError
from candaemon.status.service_monitor import ServiceMonitor

from .campaign import binding
from .drawn import Drawn
from .invariants import hold_printable
from .scratch import scratch

_WORDS = (b"\n", b"{", b"}", b"[", b"]", b'"', b":", b",", b"null", b"true", b"-1", b"1e999", b"NaN", b"Infinity",
          b"9" * 5000,
          b"[" * 5000, b'{"a":' * 3000, b"\\u001b[31m", b"\\u2028", b"\\ud800", b"\xff", b"\0", b"[bold]x[/]",
          b"[/nothing]")  # fmt: skip
_ODD: tuple[Any, ...] = (None, True, -1, 0, 1 << 70, 1e308, -0.5, "", "[bold]x[/]", "[/]", "\x1b[2J\x07",
                         "a\u2028b\u202e",
                         "\ud800", "x" * 5000, [], [1], {}, {"x": 1})  # fmt: skip
_MOST_REPEATED = 8


def fuzz_status(data: bytes) -> Counter[str]:
    """Connect to what sends some bytes, and show it once: for people, or for programs."""
    drawn = Drawn(data)
    form, for_programs = drawn.integer(0, 3), drawn.integer(0, 3) == 3
    line = _line()
    match form:
        case 0:
            sent = drawn.rest()
        case 1:
            sent = drawn.edited(line, _WORDS)
        case 2:
            sent = json.dumps(_with_other_values(json.loads(line), drawn)).encode() + b"\n"
        case _:
            sent = drawn.edited(line.rstrip(b"\n"), _WORDS) * drawn.integer(1, _MOST_REPEATED)
    with socket.socket(socket.AF_UNIX) as listener:
        path = scratch() / "status.sock"
        path.unlink(missing_ok=True)
        listener.bind(str(path))
        listener.listen(1)
        server = Thread(target=_serve, args=(listener, sent))
        server.start()
        shown = io.StringIO()
        try:
            with redirect_stdout(shown):
                watch(None, path, once=True, as_json=for_programs)
        except InputError as error:
            hold_printable(str(error))
            return Counter(refused=1)
        finally:
            server.join()
    hold_printable(shown.getvalue())
    return Counter(shown=1)


def _serve(listener: socket.socket, sent: bytes) -> None:
    client, _ = listener.accept()
    with client, suppress(OSError):  # it hung up
        client.sendall(sent)


def _with_other_values(tree: Any, drawn: Drawn) -> Any:
    """Return a snapshot with some values, keys or branches changed."""
    for _ in range(drawn.integer(1, 4)):
        at = tree
        while isinstance(at, dict) and at:
            key = drawn.choice(tuple(at))
            if not isinstance(at[key], dict) or not at[key] or drawn.integer(0, 5) == 0:
                match drawn.integer(0, 5):
                    case 0:
                        del at[key]
                    case 1:
                        at[drawn.choice(("[bold]x", "\x1b[31mred", "\ud800", ""))] = at.pop(key)
                    case _:
                        at[key] = drawn.choice(_ODD)
                break
            at = at[key]
    return tree


@cache
def _line() -> bytes:
    """Return what a service sends."""
    daemon = Daemon(binding("demo"))
    meter = ServiceMonitor(daemon.pipeline.binding.settings.service.metrics)
    meter.on_start(daemon)
    return json.dumps(meter.snapshot(daemon).tree()).encode() + b"\n"
