"""systemd's notification protocol, sd_notify(3): ready, status, watchdog, reloading, stopping.

A datagram socket and lines of text are all there is to it, and systemd keeps them stable: no library is needed.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections import deque
from collections.abc import Callable, MutableMapping
from typing import Final, Self

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.printable import printable
from candaemon.status.health_summary import HealthSummary
from candaemon.status.service_monitor import ServiceMonitor

logger = logging.getLogger(__name__)

_STATUS_S = 1.0
_OWED: Final = 16
"""Answers that wait for room in the manager's queue: the latest reload's end is that of all before."""


class SystemdNotifier:
    """Sends notifications to the service manager.

    Args:
        address: of its datagram socket, `@` at the beginning of an abstract one; empty: nothing is sent.
        watchdog_s: after which silence it ends the service; 0: never.
    """

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s
        self._address = f"\0{address[1:]}" if address.startswith("@") else address

    @classmethod
    def from_environment(cls, environment: MutableMapping[str, str] = os.environ) -> Self:
        """Take what the service manager left in the environment, out of it, so that no child speaks for us."""
        address = environment.pop("NOTIFY_SOCKET", "")
        period_us, pid = environment.pop("WATCHDOG_USEC", ""), environment.pop("WATCHDOG_PID", "")
        watched = period_us.isdecimal() and pid in ("", str(os.getpid()))
        return cls(address, int(period_us) * 1e-6 if watched else 0.0)

    def notify(self, **fields: str | int) -> bool:
        """Send fields such as `READY=1`; return whether they went out. Does not wait and does not raise."""
        if not self._address:
            return False
        message = "\n".join(f"{name}={printable(str(value))}" for name, value in fields.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
                manager.setblocking(False)
                manager.sendto(message.encode(), self._address)
        except OSError as error:
            logger.debug("the service manager was not told: %s", error)
            return False
        return True


class SystemdObserver(Observer):
    """Keeps the service manager informed; feeds its watchdog from iterations of the core loop and nothing else.

    Args:
        notifier: the way to it.
        meter: knows what was lost; it observes the same daemon.
        clock: monotonic seconds.
    """

    def __init__(
        self, notifier: SystemdNotifier, meter: ServiceMonitor, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._notifier = notifier
        self._clock = clock
        self._feed_s = notifier.watchdog_s / 2
        self._fed_s = self._status_s = clock()
        self._status = ""
        self._owed: deque[dict[str, str | int]] = deque(maxlen=_OWED)
        self._vitals = HealthSummary(meter, clock)

    def on_start(self, daemon: DaemonView) -> None:
        """Notify that the service is ready: a missing bus is opened later, while it runs."""
        self._ready(self._vitals.brief(daemon))

    def on_iteration(self, daemon: DaemonView) -> None:
        """Feed the watchdog when half of its period has passed; send the status when it has changed.

        What found the manager's queue full is sent again: the status within 1 s, all else in the next iteration. No
        status overtakes an answer that is owed, whose older one would then stay.
        """
        now_s = self._clock()
        if self._feed_s and now_s - self._fed_s >= self._feed_s and self._notifier.notify(WATCHDOG=1):
            self._fed_s = now_s
        self._pay()
        if not self._owed and now_s - self._status_s >= _STATUS_S:
            self._status_s = now_s
            status = self._vitals.brief(daemon)
            if status != self._status and self._notifier.notify(STATUS=status):
                self._status = status

    def on_reload_begin(self, _daemon: DaemonView) -> None:
        """Notify that a configuration is being loaded."""
        self._answer(RELOADING=1, MONOTONIC_USEC=time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Notify that the reload has ended, either way."""
        status = self._vitals.brief(daemon)
        if error:
            status += f"; reload refused: {error.partition(chr(10))[0]}"
        self._ready(status)

    def on_stop(self, _daemon: DaemonView) -> None:
        """Notify that the service stops."""
        self._notifier.notify(STOPPING=1, STATUS="stopped")

    def _ready(self, status: str) -> None:
        """Notify that the service is ready."""
        self._answer(READY=1, STATUS=status)

    def _answer(self, **fields: str | int) -> None:
        """Send what the manager waits for: it must not be lost, nor overtaken by what comes later."""
        self._owed.append(fields)
        self._pay()

    def _pay(self) -> None:
        """Send what is owed, as far as the manager's queue has room."""
        while self._owed and self._notifier.notify(**self._owed[0]):
            self._owed.popleft()
