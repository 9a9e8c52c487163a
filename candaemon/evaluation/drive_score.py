"""How good a drive's tracks are without a truth: predictions, NIS, what stands, duplicates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.evaluation.duplicates import DuplicateScore
from candaemon.evaluation.prediction import NisScore, PredictionScore, StationarySpeed
from candaemon.evaluation.runs import ObjectRuns
from candaemon.pipeline.cycle import Cycle
from candaemon.tracking.obstacles import TENTATIVE

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
        self.nis.add(update.nis[known], update.degrees_of_freedom[known])
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

    def _passed_on(self, cycle: Cycle) -> Booleans:
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
