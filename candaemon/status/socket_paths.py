"""Where a running service's status socket lies, and which services run."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

SYSTEM = Path("/run/candaemon")
"""Folder of the instances that systemd runs."""
SOCKET = "status.sock"


def socket_path(config: Path) -> Path | None:
    """Return where the service of a configuration puts its status socket.

    Args:
        config: the YAML file; its stem names the instance.

    Returns:
        A path below systemd's runtime directory of the unit, else below the user's; None where there is neither.
    """
    given = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]  # a unit may have several
    if given:
        return Path(given) / SOCKET
    users = _of_user()
    return None if users is None else users / config.stem / SOCKET


def running_instances() -> dict[str, Path]:
    """Return the socket of each instance that runs on this machine, by the instance's name."""
    return {path.parent.name: path for path in _sockets() if is_listening(path)}


def is_listening(path: Path) -> bool:
    """Return whether a process listens at a socket; one that died leaves its file behind."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(os.fspath(path))
        except (BlockingIOError, PermissionError):  # too many wait there already, or it belongs to another user
            return True
        except OSError:
            return False
    return True


def _of_user() -> Path | None:
    """Return the folder of the instances that this user runs by hand."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    return Path(base) / "candaemon" if base else None


def _sockets() -> Iterator[Path]:
    """Yield the socket files there are; what systemd runs comes last, so that it wins an equal name."""
    for folder in (_of_user(), SYSTEM):
        if folder is not None and folder.is_dir():
            yield from sorted(folder.glob(f"*/{SOCKET}"))
