"""Predictions of a replay: expected positions of the detections' reflections, in the vehicle axes of the due time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from candaemon.arrays import Floats, Integers
from candaemon.evaluation.drive_score import DriveScore
from candaemon.evaluation.tables import PredictionWriter
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline

_LONGEST_WAIT_NS = 2_000_000_000


@dataclass(slots=True)  # made each cycle
class _Pending:
    """Predictions of one cycle: (m, 2) positions in the local frame for each horizon."""

    time_ns: int
    sensor: int
    ids: Integers
    objects: Integers
    positions: list[Floats]


@dataclass(slots=True)  # made each cycle
class Predicted:
    """Predictions of one cycle for one horizon, of which ego motion covers the due time.

    Attributes:
        time_ns: they were made at.
        sensor: whose detections' reflections are predicted, by index.
        horizon: index of the horizon.
        ids: of the obstacles (m,).
        objects: the sensor's numbers of the detections (m,).
        position: expected, in the vehicle axes of the due time, m (m, 2).
    """

    time_ns: int
    sensor: int
    horizon: int
    ids: Integers
    objects: Integers
    position: Floats


class PredictionQueue:
    """Predicts the position of each used detection's reflection, and places it once ego motion covers the due time.

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

    def add(self, cycle: Cycle) -> list[Predicted]:
        """Add one cycle's predictions, right after it; return those due: to `write`, and to `tell` after its score."""
        tracker, detections, update = cycle.tracker, cycle.detections, cycle.update
        if tracker is not None and detections is not None and update is not None:
            obstacles = cycle.obstacles
            self._waiting.append(
                _Pending(
                    obstacles.time_ns,
                    detections.sensor,
                    obstacles.id[obstacles.used_row],
                    detections.object_id[update.detection],
                    tracker.expected_positions(self._horizons),
                )
            )
        known_ns = self._pipeline.ego.known_until_ns
        # bounds the queue where ego motion has stopped
        latest_ns = max(known_ns, cycle.obstacles.time_ns - _LONGEST_WAIT_NS)
        due: list[Predicted] = []
        while self._waiting and self._waiting[0].time_ns + max(self._horizons_ns) <= latest_ns:
            due += self._placed(self._waiting.popleft(), known_ns)
        return due

    def finish(self) -> list[Predicted]:
        """Return the remaining predictions that are due before the last sample of ego motion; discard the others."""
        known_ns = self._pipeline.ego.known_until_ns
        due = [placed for waiting in self._waiting for placed in self._placed(waiting, known_ns)]
        self._waiting.clear()
        return due

    def tell(self, due: Iterable[Predicted]) -> None:
        """Score predictions; the cycles up to the one that they came with are scored before."""
        for each in due:
            x, y = each.position.T
            self._score.add_predictions(each.sensor, each.time_ns, each.horizon, x, y)

    def write(self, due: Iterable[Predicted]) -> None:
        """Write predictions to the table, if there is one."""
        if self._writer is not None:
            self._writer.write_cycles(
                [(each.time_ns, self._horizons[each.horizon], each.ids, each.objects, each.position) for each in due]
            )

    def _placed(self, waiting: _Pending, known_ns: int) -> Iterator[Predicted]:
        """Yield the predictions of a cycle in the vehicle axes of their due times, as far as ego motion is known."""
        for k, horizon_ns in enumerate(self._horizons_ns):
            due_ns = waiting.time_ns + horizon_ns
            pose = self._pipeline.ego.pose(due_ns) if due_ns <= known_ns else None
            if pose is not None:
                position = pose.to_vehicle(waiting.positions[k])
                yield Predicted(waiting.time_ns, waiting.sensor, k, waiting.ids, waiting.objects, position)
