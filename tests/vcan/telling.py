"""What a service tells of itself."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.beds.service import Service
from tests.beds.waiting import wait_until

_PATIENCE_S = 40.0
_SETTLING_S = 0.2
_BUSY_S = 0.3


class Telling:
    """A running service and its status socket.

    Args:
        service: the process.
        folder: of the socket: the service's RUNTIME_DIRECTORY.
    """

    def __init__(self, service: Service, folder: Path) -> None:
        self.service = service
        self._socket = folder / "status.sock"

    def status(self) -> dict[str, Any]:
        """Return its figures; wait where it serves as many as it does already."""
        while "service" not in (told := self._ask()):
            time.sleep(_BUSY_S)
        assert told["service"]["pid"] == self.service.pid
        return told

    def wait_until_told(
        self, condition: Callable[[dict[str, Any]], bool], expected: str, timeout_s: float = 60.0
    ) -> dict[str, Any]:
        """Return its figures as soon as a condition holds for them."""
        last: dict[str, Any] = {}

        def holds() -> bool:
            nonlocal last
            last = self.status()
            return condition(last)

        wait_until(holds, timeout_s, lambda: f"{expected}; {json.dumps(last)}")
        return last

    def wait_until_open(self) -> None:
        """Wait until it is up: the socket is made when the buses are open."""
        wait_until(self._socket.exists, 60.0, lambda: f"the status socket is there; {self.service.said}")

    def settled(self) -> dict[str, Any]:
        """Return its figures once all that was sent to it is taken."""
        before: dict[str, Any] = {}

        def unchanged(status: dict[str, Any]) -> bool:
            nonlocal before
            counts = {name: (bus["received"], bus["dropped"]["kernel_lost"]) for name, bus in status["buses"].items()}
            before, last = counts, before
            time.sleep(_SETTLING_S)
            return counts == last

        return self.wait_until_told(unchanged, "all is taken")

    def _ask(self) -> dict[str, Any]:
        """Return what it tells whoever connects."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(_PATIENCE_S)
            connection.connect(str(self._socket))
            with connection.makefile("r", encoding="utf-8") as lines:
                told: dict[str, Any] = json.loads(lines.readline())
                return told
