"""Another configuration, loaded beside the running loop: whole or refused."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Final, TypeAlias

from candaemon.binding.bound import Binding
from candaemon.errors import CandaemonError
from candaemon.pipeline.pipeline import Pipeline

ReloadOutcome: TypeAlias = Pipeline | CandaemonError | OSError

_END_S: Final = 1.0
"""How long the end of the service waits for a load that is under way, s."""
_TURN_S: Final = 1e-4
"""How long the core loop waits, whenever it wants to go on, for a thread that loads, s; Python's default is 5 ms."""
_UNKNOWN: Final = CandaemonError("the load has ended without a result; the log tells where")


class Reloader:
    """Loads and binds a configuration in a thread, as often as it is requested.

    The core loop calls `outcome` between two iterations; what was requested during a load is loaded after it.

    Args:
        load: gives the binding, or raises `CandaemonError`.
        cancel: lets a load that is under way end soon.
    """

    def __init__(self, load: Callable[[], Binding], cancel: Callable[[], None] = lambda: None) -> None:
        self._load = load
        self._cancel = cancel
        self._wanted = Event()
        self._thread: Thread | None = None
        self._outcome: ReloadOutcome = _UNKNOWN

    def ask(self) -> None:
        """Request a load; for signal handlers and other threads."""
        self._wanted.set()

    def begin(self) -> bool:
        """Begin a load if one was requested and none is running; return whether one began."""
        if self._thread is not None or not self._wanted.is_set():
            return False
        self._wanted.clear()
        self._thread = Thread(target=self._run, name="reload", daemon=True)
        self._thread.start()
        return True

    def outcome(self) -> ReloadOutcome | None:
        """Return, once, what became of a load that has ended: a pipeline that has taken nothing, or why there is none.

        None while there is no result.
        """
        if self._thread is None or self._thread.is_alive():
            return None
        outcome, self._thread, self._outcome = self._outcome, None, _UNKNOWN
        return outcome

    def close(self) -> None:
        """End a load that is under way; its outcome is of no use any more."""
        self._cancel()
        if self._thread is not None:
            self._thread.join(_END_S)

    def _run(self) -> None:
        try:
            with _short_turns():
                self._outcome = Pipeline(self._load())
        except (CandaemonError, OSError) as error:
            self._outcome = error


@contextmanager
def _short_turns() -> Iterator[None]:
    """Let threads take turns more often while the context lasts, so that the core loop soon has its own."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_TURN_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)
