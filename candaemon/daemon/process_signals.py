"""Signals as requests to the service."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def handle_signals(*, stop: Callable[[], None], reload: Callable[[], None], mark: Callable[[], None]) -> Iterator[None]:
    """Pass signals on while the context lasts; for the main thread only.

    Args:
        stop: called on SIGTERM and SIGINT.
        reload: called on SIGHUP.
        mark: called on SIGUSR1.
    """
    handlers = {signal.SIGTERM: stop, signal.SIGINT: stop, signal.SIGHUP: reload, signal.SIGUSR1: mark}

    def handle(number: int, _frame: FrameType | None) -> None:
        handlers[signal.Signals(number)]()

    before = {number: signal.signal(number, handle) for number in handlers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
