"""What a user without truth wants to know of a drive: what was read and lost, how far the tracks can be believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from candaemon.cycle import Cycle
from candaemon.evaluation.duplicates import DuplicateScore
from candaemon.evaluation.prediction import NisScore, PredictionScore, StationarySpeed
from candaemon.evaluation.runs import ObjectRuns
from candaemon.sensing.placement import Placer
from candaemon.tracking.obstacles import TENTATIVE

if TYPE_CHECKING:
    from candaemon.replayer import Replayed

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


_WAITED = 2.0  # s that predictions may wait for own motion


class DriveScore:
    """Figures of a drive without truth, cycle by cycle.

    Args:
        cycle_times: nominal cycle time of each sensor, s.
        horizons: of the predictions, s.
    """

    def __init__(self, cycle_times: Sequence[float], horizons: Sequence[float]) -> None:
        self._runs = ObjectRuns(cycle_times)
        self._owners: dict[int, dict[int, int]] = {}
        self._run_of: dict[tuple[int, int], Integers] = {}
        self._keep = len(cycle_times) * (round((max(horizons) + _WAITED) / min(cycle_times)) + 64)
        self.predictions = PredictionScore(horizons, cycle_times)
        self.stationary = StationarySpeed()
        self.nis = NisScore()
        self.duplicates = DuplicateScore()

    def add(self, cycle: Cycle) -> None:
        """Take one cycle."""
        obstacles = cycle.obstacles
        sure = obstacles.state > TENTATIVE
        if sure.any():
            self.duplicates.add(obstacles.x[sure], obstacles.y[sure], obstacles.vx[sure])
        if cycle.detections is not None and cycle.tracker is not None:
            self._add_scan(cycle)

    def _add_scan(self, cycle: Cycle) -> None:
        detections, obstacles, update = cycle.detections, cycle.obstacles, cycle.tracker and cycle.tracker.update
        if detections is None or not update:
            return
        known = np.isfinite(update.nis)
        self.nis.add(update.nis[known], update.freedom[known])
        new = detections.new | self._passed_on(cycle)
        run = self._runs.update(detections.sensor, detections.time_ns, detections.object_id, new)
        self._run_of[detections.sensor, detections.time_ns] = run[update.detection]
        if len(self._run_of) > self._keep:
            del self._run_of[next(iter(self._run_of))]
        self.predictions.measure(detections.sensor, detections.time_ns, run, detections.x, detections.y)
        measurement = detections.measurement
        if measurement.range_rate is None:
            return
        unit = measurement.position - measurement.origin
        unit = unit / np.maximum(np.hypot(unit[:, 0], unit[:, 1]), 1e-3)[:, None]
        closing = measurement.range_rate + unit @ measurement.velocity
        vx, vy = np.full((2, len(detections)), np.nan)
        rows = obstacles.used_row
        sure = obstacles.state[rows] > TENTATIVE
        vx[update.detection[sure]] = obstacles.vx[rows[sure]]
        vy[update.detection[sure]] = obstacles.vy[rows[sure]]
        self.stationary.add(detections.time_ns, run, closing, vx, vy)

    def _passed_on(self, cycle: Cycle) -> NDArray[np.bool_]:
        """Tell which detections have an id that stood for another obstacle in the scan before."""
        detections, obstacles, update = cycle.detections, cycle.obstacles, cycle.tracker and cycle.tracker.update
        changed = np.zeros(0 if detections is None else len(detections), dtype=np.bool_)
        if detections is None or not update:
            return changed
        owners = dict(zip(obstacles.used_object.tolist(), obstacles.id[obstacles.used_row].tolist(), strict=True))
        before = self._owners.get(detections.sensor, {})
        self._owners[detections.sensor] = owners
        for row, key in zip(update.detection.tolist(), obstacles.used_object.tolist(), strict=True):
            changed[row] = before.get(key, owners[key]) != owners[key]
        return changed

    def expect(self, sensor: int, time_ns: int, horizon: int, x: Floats, y: Floats) -> None:
        """Take the predictions that one scan's used detections gave for one horizon, in vehicle axes when due."""
        run = self._run_of.get((sensor, time_ns))
        if run is not None and len(run) == len(x):
            self.predictions.predict(sensor, time_ns, horizon, run, x, y)


def summarise(replayed: Replayed) -> dict[str, Any]:
    """Return the figures of a replay, ready for JSON. The keys are stable.

    ==================  ==============================================================================
    `log`               frames read, lines that are none, remote and error frames, other channels
    `buses`             per bus: frames, used, spare (nobody asks), unknown (no DBC entry), short
    `sensors`           per sensor: frames by fate, objects left out by cause, scans, incomplete and discarded scans,
                        frames missing
    `own_motion`        frames of own motion refused, by cause
    `clock`             steps back that were rebased; frames whose time was raised because they came late; reordered
    `cycles`            told, coasting (every sensor silent), dropped for want of own motion
    `tracks`            detections given and used, obstacles begun, confirmed, merged, slot jumps
    `nis`               mean, expected, coverage of the 95 % quantile, samples
    `predictions`       per horizon: RMSE of x and y in m against the sensor's own later word
    `stationary`        RMS over ground of what stands: vx, plane speed, m/s
    `duplicates`        share of confirmed samples with another one within 3 m, 1 m and 1 m/s
    `output`            frames sent, values that had to be saturated
    `gnss`              only with `ego.gnss`: fixes told and by fate, RMS distance of the used ones from where they were
                        expected, one standard deviation of the last placement, m
    `seconds`           of the log
    ==================  ==============================================================================
    """
    pipeline, log, score = replayed.pipeline, replayed.log, replayed.score
    binding, counts = pipeline.binding, pipeline.counts
    tracked = [asdict(tracker.counts) for tracker in pipeline.trackers]
    still = score.stationary.result()
    return {
        "log": {
            "frames": log.frames,
            "lines": log.lines,
            "malformed": log.malformed,
            "examples": log.examples,
            "remote": log.remote,
            "error_frames": log.error_frames,
            "other_channels": dict(sorted(log.other_channels.items())),
            "truncated": log.truncated,
        },
        "buses": {
            bus.name: {**asdict(each), "used": each.used} for bus, each in zip(binding.buses, counts.buses, strict=True)
        },
        "sensors": {
            sensor.name: asdict(assembler.counts)
            for sensor, assembler in zip(binding.sensors, pipeline.assemblers, strict=True)
        },
        "own_motion": {"short": counts.own_motion_short, **asdict(counts.own_motion)},
        "clock": {
            "backward_steps": replayed.sequence.backward_steps,
            "late": replayed.sequence.late,
            "reordered": replayed.sequence.reordered,
        },
        "cycles": {
            "told": counts.cycles,
            "coasting": counts.coasting_cycles,
            "without_ego": counts.without_ego,
        },
        "tracks": {key: sum(each[key] for each in tracked) for key in tracked[0]},
        "nis": {
            "mean": _rounded(score.nis.mean),
            "expected": _rounded(score.nis.expected),
            "coverage_95": _rounded(score.nis.coverage),
            "samples": score.nis.samples,
        },
        "predictions": [
            {"horizon": row.horizon, "x": _rounded(row.x), "y": _rounded(row.y), "samples": row.samples}
            for row in score.predictions.result()
        ],
        "stationary": {
            "vx": _rounded(still.vx),
            "speed": _rounded(still.speed),
            "samples": still.samples,
            "runs": still.runs,
        },
        "duplicates": {"share": _rounded(score.duplicates.share), "samples": score.duplicates.samples},
        "output": {"frames": counts.sent, "saturated": pipeline.saturated},
        **({} if pipeline.placer is None else {"gnss": _placing(pipeline.placer)}),
        "seconds": _rounded((replayed.last_ns - replayed.first_ns) * 1e-9),
    }


def _placing(placer: Placer) -> dict[str, Any]:
    """Return what became of the fixes."""
    counts = placer.counts
    return {
        "fixes": counts.fixes,
        "invalid": counts.invalid,
        "unplaced": counts.unplaced,
        "rejected": counts.rejected,
        "restarts": counts.restarts,
        "innovation_rms": _rounded(counts.innovation_rms),
        "deviation": _rounded(placer.deviation),
    }


def _rounded(value: float) -> float | None:
    """Return a figure with six decimals; None where there is none, for JSON knows no NaN."""
    return round(value, 6) if np.isfinite(value) else None
