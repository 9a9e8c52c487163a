"""Another configuration, loaded beside the running loop: whole or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread
from typing import Final, TypeAlias

import can

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import CandaemonError
from candaemon.pipeline.pipeline import Pipeline

ReloadOutcome: TypeAlias = Pipeline | CandaemonError | OSError

_UNKNOWN: Final = CandaemonError("the load has ended without a result; the log tells where")


class Reloader:
    """Loads and binds a configuration in a thread, as often as it is requested.

    The core loop calls `outcome` between two iterations; what was requested during a load is loaded after it.

    Args:
        load: gives the binding, or raises `CandaemonError`.
    """

    def __init__(self, load: Callable[[], Binding]) -> None:
        self._load = load
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

    def _run(self) -> None:
        try:
            self._outcome = Pipeline(self._load())
        except (CandaemonError, OSError) as error:
            self._outcome = error


def load_service_config(path: Path) -> Binding:
    """Load a configuration that can be served.

    Raises:
        ConfigError: it cannot be used, or a bus has an interface that python-can does not know.
    """
    binding = bind(load_config(path))
    for bus in binding.buses:
        if bus.settings.interface not in can.VALID_INTERFACES:
            raise binding.loaded.error(
                ("buses", bus.name, "interface"),
                f"found '{bus.settings.interface}', expected an interface of python-can: "
                f"{', '.join(sorted(can.VALID_INTERFACES))}",
            )
    return binding
