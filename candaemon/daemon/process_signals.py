"""Signals as requests to the service, looked at between two iterations of its core loop."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Final, Self

_STOP: Final = (signal.SIGTERM, signal.SIGINT)
_REQUESTS: Final = (signal.SIGHUP, signal.SIGUSR1)


class ServiceSignals:
    """A context while which signals are requests to the service; for the main thread only.

    A handler in Python is interrupted by the next signal, which calls it again: signals that come fast enough exhaust
    the stack, and one that comes while a lock is held waits for it for ever. So a signal is noted by a method of dict,
    which nothing interrupts; signals of one kind that come before the next look are one.

    Until the service is ready, SIGTERM and SIGINT end the process at once: no bus is open, nothing is under way. What
    else comes is looked at when it is ready.
    """

    def __init__(self) -> None:
        self._noted: dict[int, FrameType | None] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.getsignal(number) for number in (*_STOP, *_REQUESTS)}
        for number in _STOP:
            signal.signal(number, _end_start)
        for number in _REQUESTS:
            signal.signal(number, self._noted.setdefault)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def served(
        self, *, stop: Callable[[], None], reload: Callable[[], None], mark: Callable[[], None]
    ) -> Callable[[], None]:
        """Note SIGTERM and SIGINT, too, from here on: the service is ready to serve.

        Args:
            stop: called for SIGTERM and SIGINT.
            reload: called for SIGHUP.
            mark: called for SIGUSR1.

        Returns:
            What looks for signals and makes those calls, in the thread that calls it.
        """
        for number in _STOP:
            signal.signal(number, self._noted.setdefault)
        requests = {signal.SIGTERM: stop, signal.SIGINT: stop, signal.SIGHUP: reload, signal.SIGUSR1: mark}

        def look() -> None:
            while self._noted:
                number, _ = self._noted.popitem()
                requests[signal.Signals(number)]()

        return look


def _end_start(number: int, _frame: FrameType | None) -> None:
    """End the process, wherever it is in its start: neither a lock that is held nor an `except` keeps it."""
    message = f"candaemon: stopped by {signal.Signals(number).name} before the service was ready\n"
    with suppress(OSError, ValueError):  # as of a full disk, or of a stream that is closed
        os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, message.encode("ascii"))
    os._exit(0)
