"""The recorded drive: predictions of the radar's own later word, what stands, consistency, identities."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from candaemon.arrays import Booleans
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.reorder import ReorderBuffer
from candaemon.can_io.stray_times import StrayTimes
from candaemon.errors import InputError
from candaemon.evaluation.drive_score import DriveScore
from candaemon.evaluation.object_runs import ObjectRuns
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.predictions import PredictionQueue
from candaemon.playback.replay import HORIZONS
from candaemon.radar.detections import Detections
from candaemon.tracking.obstacles import TENTATIVE, Obstacles
from candaemon.tracking.update import Update
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.simulated_runs import bound
from tests.support.paths import DATA, ROOT
from tests.support.rav4 import of_points

LOGS: Final = {"toyota_rav4_ins": "drive_with_ins.log.gz", "toyota_rav4": "drive.log.gz"}
AHEAD: Final = {0.5: (0.20, 0.27), 1.0: (0.30, 0.37)}
"""m, the largest RMSE along and across, by horizon."""
STANDING: Final = (0.27, 0.45)
"""m/s, the largest RMS of what stands: along, in the plane."""
DUPLICATES: Final = 0.03
LONG: Final = 3.0
"""s, from which on a track of the radar counts."""


class ByRadar(DriveScore):
    """Scores whose runs are the tracks of the radar as it tells them, whatever ids the obstacles have."""

    def _id_reassigned(self, obstacles: Obstacles, detections: Detections, update: Update) -> Booleans:
        del obstacles, update
        return np.zeros(len(detections), dtype=np.bool_)


class IdChanges:
    """Counts the radar's tracks, and those over which the obstacle's id changes once it is confirmed.

    Before that its number is provisional: it may be found to be one that was lost sight of.

    Args:
        cycle_times: nominal cycle time of each sensor, s.
    """

    def __init__(self, cycle_times: list[float]) -> None:
        self._runs = ObjectRuns(cycle_times)
        self._span: dict[int, tuple[int, int]] = {}
        self._owners: dict[int, set[int]] = {}

    def add(self, cycle: Cycle) -> None:
        """Take a cycle."""
        detections, obstacles = cycle.detections, cycle.obstacles
        if detections is None:
            return
        run = self._runs.update(detections.sensor, detections.time_ns, detections.object_id, detections.new)
        for one in run.tolist():
            first, _ = self._span.get(one, (detections.time_ns, 0))
            self._span[one] = first, detections.time_ns
        run_of = dict(zip(detections.object_id.tolist(), run.tolist(), strict=True))
        for key, row in zip(obstacles.used_object.tolist(), obstacles.used_row.tolist(), strict=True):
            if obstacles.state[row] != TENTATIVE:
                self._owners.setdefault(run_of[key], set()).add(int(obstacles.id[row]))

    def result(self) -> tuple[int, int]:
        """Return how many tracks of the radar were long, and how many of those had several obstacles, or none."""
        long = [one for one, (first, last) in self._span.items() if (last - first) * 1e-9 >= LONG]
        return len(long), sum(len(self._owners.get(one, ())) != 1 for one in long)


def cycles_of_log(pipeline: Pipeline, log: Path) -> Iterator[Cycle]:
    """Yield the cycles of a log."""
    binding = pipeline.binding
    channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
    blocks = StrayTimes().removed(read_log_blocks(log, channels, LogCounts()))
    sequence = ReorderBuffer(round(binding.settings.ordering_window * 1e9))
    yield from pipeline.run_blocks(sequence.sequenced_blocks(blocks))
    yield from pipeline.finish()


def drive_findings(config: Path, tracker: tuple[tuple[str, Any], ...], most_cycles: int | None) -> Iterator[Finding]:
    """Yield the figures of the drive.

    Args:
        config: of a name of `LOGS`.
        tracker: settings in place of the configuration's; the key `default` drops those.
        most_cycles: that are run; None: all.
    """
    pipeline = Pipeline(bound(config, tracker))
    cycle_times = [sensor.settings.cycle_time for sensor in pipeline.binding.sensors]
    score, by_radar, ids = DriveScore(cycle_times, HORIZONS), ByRadar(cycle_times, HORIZONS), IdChanges(cycle_times)
    predictions = PredictionQueue(pipeline, HORIZONS, None, by_radar)
    for cycle in islice(cycles_of_log(pipeline, DATA / "rav4_drive" / LOGS[config.stem]), most_cycles):
        for each in (score, by_radar, ids):
            each.add(cycle)
        predictions.tell(predictions.add(cycle))
    predictions.tell(predictions.finish())
    for error in by_radar.predictions.result():
        along, across = AHEAD[error.horizon]
        yield Finding(f"{error.horizon:g} s ahead, along", error.x, most=along)
        yield Finding(f"{error.horizon:g} s ahead, across", error.y, most=across)
    stands = score.stationary.result()
    yield Finding("what stands, along", stands.vx, "m/s", most=STANDING[0])
    yield Finding("what stands, in the plane", stands.speed, "m/s", most=STANDING[1])
    yield Finding(
        "NIS", score.nis.mean, f"of {score.nis.expected:.3g}", 0.85 * score.nis.expected, 1.15 * score.nis.expected
    )
    yield Finding("innovations within their 95 % bound", 100 * score.nis.coverage, "%")
    yield Finding("duplicates", 100 * score.duplicates.share, "%", most=100 * DUPLICATES)
    long, changed = ids.result()
    yield Finding(f"tracks of the radar of {LONG:g} s whose id changes", changed, f"of {long}", most=0)


def run(effort: Effort, most_cycles: int | None = None) -> Iterator[Finding]:
    """Yield the figures of both configurations, with all defaults and by a tracker of points, or with others."""
    if not (DATA / "rav4_drive").is_dir():
        raise InputError(f"there is no recorded drive at {DATA / 'rav4_drive'}")
    with TemporaryDirectory() as folder:
        for config in LOGS:
            shipped = ROOT / "config" / f"{config}.yaml"
            variants = {"defaults": shipped, "points": of_points(config, Path(folder))}
            if effort.tracker:
                variants = {"--tracker": shipped}
            for name, path in variants.items():
                for one in drive_findings(path, effort.tracker, most_cycles):
                    yield Finding(f"{config}, {name}: {one.name}", one.value, one.unit, one.least, one.most)


RECORDED_DRIVE: Final = Experiment(
    "does it tell the recorded drive's radar what it will say?",
    (
        ("defaults, --tracker", "the configuration as it is; with the settings given"),
        ("points", "an `imm` for each reflection, set for this drive, which is nearly straight"),
        ("ahead", "RMSE of where a reflection is expected, beside where the radar places it then, vehicle axes"),
        ("tracks", f"of the radar, as its slots and flags tell; ahead: those of {LONG:g} s and more"),
        ("id", "of the confirmed obstacle that a track of the radar belongs to"),
        ("what stands", "RMS of obstacles whose speed along the line of sight is mostly below 1 m/s over ground"),
        ("duplicates", "confirmed obstacles with another within 3 m along, 1 m across and 1 m/s, share of samples"),
    ),
    1,
    run,
)
