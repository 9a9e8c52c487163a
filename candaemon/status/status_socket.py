"""The status socket: the status snapshot, a line of JSON a second, for whoever connects.

It is served in the core thread, between two iterations, without waiting. Where more clients come than are served, one
that does not read makes room for the newest, else the one that was served longest: idle clients keep nobody out. It
takes no requests, so it is open to every user of the machine.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import socket
import stat
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.snapshot import StatusSnapshot
from candaemon.status.socket_paths import is_listening, socket_path

logger = logging.getLogger(__name__)

MOST_CLIENTS: Final = 8
"""Clients of the status socket that are served at a time."""

_LOOK_S = 0.1
_LINE_S = 1.0
_FOR_ALL = stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP | stat.S_IROTH | stat.S_IWOTH
_MADE_ROOM = json.dumps({"error": f"more than {MOST_CLIENTS} clients came, this one made room"}).encode() + b"\n"
_SIOCOUTQ: Final = 0x5411
"""Linux: bytes that a socket has sent and the other side has not read."""


class StatusSocket(Observer):
    """Sends the snapshot to each client, at once and then every second.

    Where the socket cannot be made the service goes on without it, and says why in the log.

    Args:
        meter: takes the snapshots; it observes the same daemon.
        clock: monotonic seconds.

    Attributes:
        path: of the socket; None where there is none.
    """

    def __init__(self, meter: ServiceMonitor, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.path: Path | None = None
        self._meter = meter
        self._clock = clock
        self._listener: socket.socket | None = None
        self._identity: tuple[int, int] | None = None
        self._clients: list[socket.socket] = []
        self._look_s = self._line_s = 0.0

    def on_start(self, daemon: DaemonView) -> None:
        """Make the socket, in the place that the environment gives."""
        path = socket_path(daemon.pipeline.binding.loaded.path)
        if path is None:
            logger.warning(
                "no status socket, `candaemon status` will not find this instance: neither RUNTIME_DIRECTORY nor "
                "XDG_RUNTIME_DIR is set; set the latter to a folder of yours, such as /run/user/%d",
                os.getuid(),
            )
            return
        if is_listening(path):
            logger.warning("no status socket: another instance has %s; stop it, or give this one another name", path)
            return
        try:
            self._listener = _listener(path)
            self._identity = _identity(path)
        except OSError as error:
            logger.warning("no status socket: %s cannot be made: %s", path, error)
            return
        self.path = path

    def on_iteration(self, daemon: DaemonView) -> None:
        """Let clients in, and send what is due."""
        now_s = self._clock()
        if self._listener is None or now_s < self._look_s:
            return
        self._look_s = now_s + _LOOK_S
        due = self._let_in(self._listener)
        if now_s >= self._line_s:
            self._line_s = now_s + _LINE_S
            due = list(self._clients)
        if due:
            line = _line(self._meter.snapshot(daemon))
            for client in due:
                self._serve(client, line)

    def on_stop(self, daemon: DaemonView) -> None:  # noqa: ARG002 - the hook's signature
        """Hang up and remove the socket."""
        while self._clients:
            self._clients.pop().close()
        if self._listener is not None and self.path is not None:
            self._listener.close()
            self._listener = None
            if _identity(self.path) == self._identity:  # and not what another instance has made there since
                self.path.unlink(missing_ok=True)
                with suppress(OSError):  # the folder is systemd's
                    self.path.parent.rmdir()

    def _serve(self, client: socket.socket, line: bytes) -> None:
        """Send a line whole; hang up on a client that is gone or does not read, for half a line is none."""
        try:
            deaf = client.send(line) < len(line)
        except BlockingIOError:
            deaf = True
        except OSError:  # it has hung up
            self._drop(client)
            return
        if deaf:
            self._meter.clients.status_clients += 1
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._clients.remove(client)
        client.close()

    def _let_in(self, listener: socket.socket) -> list[socket.socket]:
        """Accept clients; return them. One of those before makes room where there are too many."""
        come = []
        for client in _accepted(listener):
            if len(self._clients) >= MOST_CLIENTS:
                self._make_room()
            self._clients.append(client)
            come.append(client)
        return come

    def _make_room(self) -> None:
        """Hang up on the first client that has not read what it was sent, else on the one that was served longest."""
        client = next(filter(_is_idle, self._clients), self._clients[0])
        with suppress(OSError):
            client.send(_MADE_ROOM)
        self._meter.clients.status_clients += 1
        self._drop(client)


def _listener(path: Path) -> socket.socket:
    """Make a socket that every user can connect to; one that an instance of this user left behind makes room.

    Nothing else is removed: no file, no link, no socket of another user.

    Raises:
        OSError: it cannot be made there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        there = path.lstat()
        if stat.S_ISSOCK(there.st_mode) and there.st_uid == os.geteuid():
            path.unlink()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        listener.bind(os.fspath(path))
        path.chmod(_FOR_ALL)
        listener.listen(MOST_CLIENTS)
    except OSError:
        listener.close()
        raise
    return listener


def _accepted(listener: socket.socket) -> Iterator[socket.socket]:
    """Yield clients that wait to be let in, as many as one look takes."""
    for _ in range(MOST_CLIENTS):
        try:
            client, _ = listener.accept()
        except OSError:  # nobody waits, or there is no descriptor left for whoever does
            return
        client.setblocking(False)
        yield client


def _is_idle(client: socket.socket) -> bool:
    """Return whether a client has not read what it was sent."""
    return bool(struct.unpack("i", fcntl.ioctl(client, _SIOCOUTQ, bytes(4)))[0])


def _identity(path: Path) -> tuple[int, int] | None:
    """Return device and inode of what is at a path; None where nothing is."""
    try:
        there = path.lstat()
    except OSError:
        return None
    return there.st_dev, there.st_ino


def _line(snapshot: StatusSnapshot) -> bytes:
    """Return a snapshot as a line of JSON."""
    return json.dumps(snapshot.tree(), allow_nan=False, separators=(",", ":")).encode() + b"\n"
