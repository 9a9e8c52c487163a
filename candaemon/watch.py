"""`candaemon status`: what a running service tells of itself, from its status socket."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import Any

from candaemon import terminal
from candaemon.errors import InputError
from candaemon.service.places import running
from candaemon.watch_view import LiveView, sheets

_PATIENCE_S = 5.0


def watch(instance: str | None, path: Path | None, *, once: bool, as_json: bool) -> None:
    """Show what an instance does: live on a terminal until it ends, else once.

    Args:
        instance: NAME of candaemon@NAME, or stem of the configuration's file; None: the only one that runs.
        path: the instance's status socket, if it is elsewhere.
        once: show it once and end.
        as_json: print the line of JSON as it came, once.

    Raises:
        InputError: no such instance runs, several do and none is named, or it has ended or hangs.
    """
    with closing(_lines(_found(instance) if path is None else path)) as lines:
        if as_json:
            line = next(lines)
            _read(line)
            print(line, end="")
        elif once or not sys.stdout.isatty():
            terminal.print_sheets(sheets(_read(next(lines))))
        else:
            with LiveView() as view:
                for line in lines:
                    view.show(_read(line))


def _found(instance: str | None) -> Path:
    """Return the socket of an instance that runs."""
    there = running()
    listed = ", ".join(sorted(there)) or "none"
    start = "start one with `systemctl start candaemon@NAME` or `candaemon run CONFIG`"
    if instance is not None:
        if instance not in there:
            raise InputError(f"no instance '{instance}' runs; running: {listed}; {start}, or give --socket PATH")
        return there[instance]
    match list(there.values()):
        case [only]:
            return only
        case []:
            raise InputError(f"no instance runs; {start}, or give --socket PATH")
        case _:
            raise InputError(f"several instances run: {listed}; name one: candaemon status NAME")


def _lines(path: Path) -> Generator[str]:
    """Yield what an instance sends, line by line.

    Raises:
        InputError: it cannot be reached, has ended, or sends nothing.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_PATIENCE_S)
        try:
            connection.connect(os.fspath(path))
            with connection.makefile("r", encoding="utf-8") as stream:
                yield from stream
        except TimeoutError as error:
            raise InputError(
                f"the instance says nothing for {_PATIENCE_S:g} s: its core loop hangs; see its log", file=path
            ) from error
        except OSError as error:
            raise InputError(
                f"cannot connect: {error.strerror or error}; expected the status socket of a running instance",
                file=path,
            ) from error
    raise InputError("the instance has ended; see its log, `journalctl -u candaemon@NAME` for a service", file=path)


def _read(line: str) -> dict[str, Any]:
    """Return the figures of a line.

    Raises:
        InputError: it has none.
    """
    try:
        tree = json.loads(line)
    except ValueError as error:
        raise InputError(f"found '{line[:40].strip()}', expected the figures of a running instance") from error
    if not isinstance(tree, dict) or "service" not in tree:
        reason = tree.get("error") if isinstance(tree, dict) else None
        raise InputError(f"no figures came: {reason or 'this is no status socket of candaemon'}")
    return tree
