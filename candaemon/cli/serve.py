"""The service of `candaemon run`: core loop, recording and status put together."""

from __future__ import annotations

import faulthandler
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from candaemon.binding.bound import Binding
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import Observer
from candaemon.daemon.process_signals import ServiceSignals
from candaemon.daemon.reload import Reloader
from candaemon.daemon.service_config import load_service_config
from candaemon.daemon.service_log import (
    LogFormatObserver,
    RepetitionFilter,
    configure_logging,
    log_uncaught_exceptions,
)
from candaemon.daemon.trial_load import TriedConfig
from candaemon.recording.recorder import Recorder
from candaemon.status.calibration_keeper import CalibrationKeeper
from candaemon.status.fault_log import FaultLogger
from candaemon.status.health_summary import StatusLogger
from candaemon.status.metrics_endpoint import MetricsEndpoint
from candaemon.status.sd_notify import SystemdNotifier, SystemdObserver
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.status_socket import StatusSocket

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServeRequest:
    """Settings of the service from the command line.

    Attributes:
        config_path: the YAML file; a reload reads it again.
        record: folder of the recording; None: as configured.
        status: s between status lines, 0: none; None: as configured.
        log: form of the log's lines; None: as configured.
        shadow: whether nothing is sent.
    """

    config_path: Path
    record: Path | None = None
    status: float | None = None
    log: Literal["text", "json"] | None = None
    shadow: bool = False


def serve(request: ServeRequest, signals: ServiceSignals) -> None:
    """Serve until SIGTERM or SIGINT; SIGHUP loads the configuration again.

    Args:
        request: the configuration file and the command line's settings.
        signals: those that come to the process.

    Raises:
        ConfigError: the configuration cannot be used; no bus is opened then.
        InputError: the folder of the recording cannot be used.
    """
    notifier = SystemdNotifier.from_environment()
    repetitions = RepetitionFilter()
    configure_logging(request.log or "text", repetitions=repetitions)
    log_uncaught_exceptions()
    binding = load_service_config(request.config_path)
    configure_logging(request.log or binding.settings.service.log, repetitions=repetitions)
    if binding.warnings:
        logger.warning("%s; `candaemon check` shows all %d warnings", binding.warnings[0], len(binding.warnings))
    tried = TriedConfig(request.config_path)
    reloader = Reloader(tried.load, tried.cancel)
    if request.shadow:
        logger.warning("shadow: obstacles are tracked and recorded, and none is sent")
    observers = list(_observers(binding, request, notifier, repetitions))
    daemon = Daemon(binding, observers=observers, reloader=reloader, shadow=request.shadow)
    faulthandler.enable()  # systemd's watchdog ends a hanging loop with SIGABRT; the log then shows where it hung
    look = signals.served(stop=daemon.stop, reload=daemon.reload, mark=daemon.mark)
    with daemon:
        daemon.run(look)


def _observers(
    binding: Binding, request: ServeRequest, notifier: SystemdNotifier, repetitions: RepetitionFilter
) -> Iterator[Observer]:
    """Yield the observers that command line, configuration and systemd request; each after those that it reads."""
    recording = _recording(binding, request)
    meter = ServiceMonitor(
        binding.settings.service.metrics,
        recording=recording.counts if recording is not None else None,
        log=repetitions,
    )
    if recording is not None:
        yield recording
    yield meter
    state_folder, *_ = os.environ.get("STATE_DIRECTORY", "").split(":")
    if state_folder:
        yield CalibrationKeeper(Path(state_folder))
    yield StatusSocket(meter)
    yield MetricsEndpoint(meter)
    yield LogFormatObserver(request.log, repetitions)
    yield StatusLogger(request.status, meter, shadow=request.shadow)
    yield FaultLogger()
    yield SystemdObserver(notifier, meter)


def _recording(binding: Binding, request: ServeRequest) -> Recorder | None:
    """Return the recorder, if recording is requested."""
    settings = binding.settings.service.recording
    if request.record is None and not settings.enabled:
        return None
    return Recorder(settings, request.record or _state_folder(binding) / "recording", binding)


def _state_folder(binding: Binding) -> Path:
    """Return the state folder that systemd assigns to the service."""
    folder, *_ = os.environ.get("STATE_DIRECTORY", "").split(":")
    if not folder:
        raise binding.loaded.error(
            ("service", "recording", "enabled"),
            "there is no folder to record into; a unit with StateDirectory= gives one, or `run --record DIR`",
        )
    return Path(folder)
