"""The other side of the status socket: what an instance sends, read within limits, whoever it is that sends."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final

from candaemon.errors import InputError
from candaemon.printable import printable

LONGEST_LINE: Final = 4 << 20
"""Bytes of a status snapshot as a line of JSON; one of a hundred sensors has 200 kB."""
LINE_S: Final = 5.0
"""s until a line must have come whole; an instance sends one a second."""

_CHUNK: Final = 1 << 16


def snapshots(path: Path) -> Generator[dict[str, Any]]:
    """Yield the status snapshots that an instance sends.

    Args:
        path: of its status socket.

    Raises:
        InputError: it cannot be reached, has ended, hangs, or sends something else.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            connection.settimeout(LINE_S)
            connection.connect(os.fspath(path))
            for line in _lines(connection, path):
                yield _snapshot(line, path)
        except TimeoutError as error:
            raise InputError(
                f"the instance says nothing for {LINE_S:g} s: its core loop hangs; see its log", file=path
            ) from error
        except OSError as error:
            raise InputError(
                f"cannot connect: {error.strerror or error}; expected the status socket of a running instance",
                file=path,
            ) from error
    raise InputError("the instance has ended; see its log, `journalctl -u candaemon@NAME` for a service", file=path)


def _lines(connection: socket.socket, path: Path) -> Generator[bytes]:
    """Yield whole lines.

    Raises:
        TimeoutError: one does not come in time.
        InputError: one is too long.
        OSError: the connection is broken.
    """
    held = bytearray()
    end_s = time.monotonic() + LINE_S
    while True:
        connection.settimeout(max(end_s - time.monotonic(), 1e-3))
        chunk = connection.recv(_CHUNK)
        if not chunk:
            return
        begin = len(held)
        held += chunk
        while (length := held.find(b"\n", begin)) >= 0:
            yield bytes(held[:length])
            del held[: length + 1]
            begin, end_s = 0, time.monotonic() + LINE_S
        if len(held) > LONGEST_LINE:
            raise InputError(
                f"found a line of more than {LONGEST_LINE >> 20} MiB, expected the status socket of a running instance",
                file=path,
            )


def _snapshot(line: bytes, path: Path) -> dict[str, Any]:
    """Return the status snapshot of a line.

    Raises:
        InputError: the line holds none.
    """
    try:
        tree = json.loads(line)
    except (ValueError, RecursionError) as error:
        start = line[:40].decode(errors="replace").strip()
        raise InputError(f"found '{start}', expected the figures of a running instance", file=path) from error
    if not isinstance(tree, dict) or "service" not in tree:
        reason = printable(str(tree.get("error") or ""), 200) if isinstance(tree, dict) else ""
        raise InputError(f"no figures came: {reason or 'this is no status socket of candaemon'}", file=path)
    return tree
