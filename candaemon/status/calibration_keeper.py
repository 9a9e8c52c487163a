"""Keeps what the service learnt of its sensors in its state folder, and begins with it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from candaemon.calibration import kept
from candaemon.daemon.observer import DaemonView, Observer
from candaemon.errors import CandaemonError

logger = logging.getLogger(__name__)

INTERVAL_S: Final = 300.0
"""s between two writes while the service runs; it writes once more at its end."""


class CalibrationKeeper(Observer):
    """Reads the file at the start and writes it now and then; what fails is logged, and the service goes on.

    Args:
        folder: state folder of the service.
        clock: monotonic seconds.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = folder / kept.NAME
        self._clock = clock
        self._due_s = clock() + INTERVAL_S

    def on_start(self, daemon: DaemonView) -> None:
        """Begin with what is kept."""
        calibrator = daemon.pipeline.calibrator
        if calibrator is None:
            return
        try:
            begun = kept.begin(self._path, calibrator, daemon.binding)
        except CandaemonError as error:
            logger.error("%s", error)  # noqa: TRY400 - a traceback does not help the user
            return
        if begun.used:
            logger.info("%s: calibration of %s goes on", self._path, ", ".join(begun.used))
        if begun.changed:
            logger.warning(
                "%s: calibration of %s begins anew, for settings have changed", self._path, ", ".join(begun.changed)
            )

    def on_iteration(self, daemon: DaemonView) -> None:
        """Write the file when it is due."""
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = now_s + INTERVAL_S
            self._write(daemon)

    def on_stop(self, daemon: DaemonView) -> None:
        """Write the file."""
        self._write(daemon)

    def _write(self, daemon: DaemonView) -> None:
        calibrator = daemon.pipeline.calibrator
        if calibrator is None or not any(map(calibrator.is_known, range(len(daemon.binding.sensors)))):
            return
        try:
            kept.write(self._path, calibrator, daemon.binding)
        except CandaemonError as error:
            logger.error("%s", error)  # noqa: TRY400 - as above
