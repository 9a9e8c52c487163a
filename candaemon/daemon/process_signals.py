"""Signals as requests to the service, looked at between two iterations of its core loop."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def handle_signals(
    *, stop: Callable[[], None], reload: Callable[[], None], mark: Callable[[], None]
) -> Iterator[Callable[[], None]]:
    """Note signals while the context lasts; for the main thread only.

    A handler in Python is interrupted by the next signal, which calls it again: signals that come fast enough exhaust
    the stack, and one that comes while a lock is held waits for it for ever. So a signal is noted by a method of dict,
    which nothing interrupts; signals of one kind that come before the next look are one.

    Args:
        stop: called for SIGTERM and SIGINT.
        reload: called for SIGHUP.
        mark: called for SIGUSR1.

    Yields:
        what looks for signals and makes those calls, in the thread that calls it.
    """
    requests = {signal.SIGTERM: stop, signal.SIGINT: stop, signal.SIGHUP: reload, signal.SIGUSR1: mark}
    noted: dict[int, FrameType | None] = {}

    def look() -> None:
        while noted:
            number, _ = noted.popitem()
            requests[signal.Signals(number)]()

    before = {number: signal.signal(number, noted.setdefault) for number in requests}
    try:
        yield look
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
