"""Recorded drives through the pipeline, for the windows of standing returns that calibration needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.calibration.calibrator import GatheredWindow
from candaemon.calibration.drives import SensorFindings, findings
from candaemon.can_io.logs.stream import LogCounts
from candaemon.config.calibration import CalibrationSettings
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.replay import ReplayRequest, replay


def calibrate(
    binding: Binding,
    logs: Sequence[Path],
    channels: dict[str, str],
    progress: Callable[[LogCounts], None] | None = None,
) -> dict[str, SensorFindings]:
    """Return what drives show of each sensor, by its name.

    Args:
        binding: the configuration, bound to its DBC files.
        logs: of the drives.
        channels: additional channel names in the logs: channel → bus.
        progress: called once a cycle.

    Raises:
        InputError: there is no such log, or it holds no frame of the configured buses.
    """
    settings = binding.settings.model_copy(update={"calibration": CalibrationSettings()})
    reporting = replace(binding, loaded=replace(binding.loaded, config=settings))
    gathered: list[GatheredWindow] = []

    def gather(pipeline: Pipeline) -> None:
        if pipeline.calibrator is not None:
            pipeline.calibrator.gathered = gathered

    for log in logs:
        replay(reporting, ReplayRequest(log, channels=channels, fresh=True), progress, begun_with=gather)
    return {sensor.name: findings(sensor, settings.ego, gathered) for sensor in binding.sensors}
