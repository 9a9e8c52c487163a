"""Recorded drives as far as their scans, for the windows of standing returns that calibration needs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.calibration.calibrator import GatheredWindow
from candaemon.calibration.drives import SensorFindings, findings
from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.reorder import ItemBlock, ReorderBuffer
from candaemon.can_io.time_range import WHOLE_DRIVE
from candaemon.config.calibration import CalibrationSettings
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import fingerprint
from candaemon.playback.recording_files import runs
from candaemon.playback.replay import channel_indices
from candaemon.playback.summary import doubts, received
from candaemon.printable import printable
from candaemon.radar.scan import Scan

logger = logging.getLogger(__name__)


class ScanPipeline(Pipeline):
    """The way of a frame as far as its scan: what stands is told without obstacles.

    Args:
        binding: the configuration; it calibrates.
        gathered: takes the windows of its scans.
    """

    def __init__(self, binding: Binding, gathered: list[GatheredWindow]) -> None:
        super().__init__(binding)
        if self.calibrator is not None:
            self.calibrator.gathered = gathered

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        self.schedule.coast_due_ns = now_ns + self._coast_after_ns
        if self.calibrator is not None:
            self.calibrator.learn(scan)
        return iter(())


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
        progress: called once a block of frames.

    Raises:
        InputError: there is no such log, or it holds no frame of the configured buses.
    """
    settings = binding.settings.model_copy(update={"calibration": CalibrationSettings()})
    reporting = replace(binding, loaded=replace(binding.loaded, config=settings))
    indices = channel_indices(binding, channels)
    gathered: list[GatheredWindow] = []
    for log in logs:
        counts = LogCounts()
        for run in runs(log, fingerprint(binding), fresh=True):
            for each in run.logs:
                check_log(each)
            pipeline = ScanPipeline(reporting, gathered)
            sequence = ReorderBuffer(round(settings.ordering_window * 1e9))
            blocks = DriveReader(indices, counts, WHOLE_DRIVE).consecutive(run.logs)
            items = _told(sequence.sequenced_blocks(blocks), counts, progress)
            for _ in chain(pipeline.run_blocks(items), pipeline.finish()):
                pass
            for doubt in doubts(received(pipeline)):
                logger.warning("%s: %s", printable(str(log)), doubt)
        counts.require_frames(log)
    return {sensor.name: findings(sensor, settings.ego, gathered) for sensor in binding.sensors}


def _told(
    blocks: Iterable[ItemBlock], counts: LogCounts, progress: Callable[[LogCounts], None] | None
) -> Iterator[ItemBlock]:
    """Pass blocks on, and tell each."""
    for block in blocks:
        yield block
        if progress is not None:
            progress(counts)
