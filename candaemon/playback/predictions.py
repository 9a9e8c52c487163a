"""Predictions of a replay: expected positions of the detections' reflections, in the vehicle axes of the due time."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from candaemon.arrays import Floats, Integers
from candaemon.evaluation.drive_score import DriveScore
from candaemon.evaluation.tables import PredictionWriter
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline

_LONGEST_WAIT_NS = 2_000_000_000


@dataclass(frozen=True, slots=True)
class _Pending:
    """Predictions of one cycle: (m, 2) positions in the local frame for each horizon."""

    time_ns: int
    sensor: int
    ids: Integers
    objects: Integers
    positions: list[Floats]


class PredictionQueue:
    """Predicts the position of each used detection's reflection; reports it once ego motion covers the due time.

    Args:
        pipeline: gives the trackers that predict, and the ego motion.
        horizons: s.
        writer: of the table; None: only scored.
        score: receives every prediction.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        horizons: Sequence[float],
        writer: PredictionWriter | None,
        score: DriveScore,
    ) -> None:
        self._pipeline = pipeline
        self._horizons = tuple(horizons)
        self._horizons_ns = [round(horizon * 1e9) for horizon in horizons]
        self._writer = writer
        self._score = score
        self._waiting: deque[_Pending] = deque()

    def add(self, cycle: Cycle) -> None:
        """Add one cycle's predictions, right after it."""
        tracker, detections, update = cycle.tracker, cycle.detections, cycle.update
        if tracker is not None and detections is not None and update is not None:
            obstacles = cycle.obstacles
            self._waiting.append(
                _Pending(
                    obstacles.time_ns,
                    detections.sensor,
                    obstacles.id[obstacles.used_row],
                    detections.object_id[update.detection],
                    [tracker.expected_positions(horizon) for horizon in self._horizons],
                )
            )

    def report(self, time_ns: int) -> None:
        """Report the predictions that are due by the time of the latest cycle's obstacles, once these are scored."""
        known_ns = self._pipeline.ego.known_until_ns
        # bounds the queue where ego motion has stopped
        latest_ns = max(known_ns, time_ns - _LONGEST_WAIT_NS)
        while self._waiting and self._waiting[0].time_ns + max(self._horizons_ns) <= latest_ns:
            self._report(self._waiting.popleft(), known_ns)

    def finish(self) -> None:
        """Report the remaining predictions that are due before the last sample of ego motion; discard the others."""
        known_ns = self._pipeline.ego.known_until_ns
        while self._waiting:
            self._report(self._waiting.popleft(), known_ns)

    def _report(self, waiting: _Pending, known_ns: int) -> None:
        for k, (horizon, horizon_ns) in enumerate(zip(self._horizons, self._horizons_ns, strict=True)):
            due_ns = waiting.time_ns + horizon_ns
            pose = self._pipeline.ego.pose(due_ns) if due_ns <= known_ns else None
            if pose is None:
                continue
            position = pose.to_vehicle(waiting.positions[k])
            self._score.add_predictions(waiting.sensor, waiting.time_ns, k, position[:, 0], position[:, 1])
            if self._writer is not None:
                self._writer.write_cycle(
                    waiting.time_ns, horizon, waiting.ids, waiting.objects, position[:, 0], position[:, 1]
                )
