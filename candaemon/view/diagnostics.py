"""How the detections of a cycle fit the obstacles: NIS, innovations, probabilities of the models."""

from __future__ import annotations

from cmath import exp
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats, Indices
from candaemon.binding.bound import Binding
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.pipeline.cycle import Cycle
from candaemon.radar.detections import Detections
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.body_modes import MODE_NAMES
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.update import Update

_LONGEST_GAP_S: Final = 0.5
"""Longest time over which an expected place is carried on, s."""
_SOON_S: Final = 1e-3
"""Time ahead for which a tracker is asked for expected places, s: it divides by it."""
_Plane = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class DetectionFit:
    """How the detections of a cycle fit its n obstacles; NaN where nothing says so.

    Attributes:
        nis: normalised innovation squared over its degrees of freedom, all of an obstacle's detections together (n,).
        innovation_x, innovation_y: detection less expected place, vehicle axes, mean over its detections (n,), m.
        modes: probabilities of the models (n, M).
    """

    nis: Floats
    innovation_x: Floats
    innovation_y: Floats
    modes: Floats


@dataclass(frozen=True, slots=True)
class _NextPlace:
    """Where a detection is expected next: place and velocity in the local frame, and since when."""

    place: complex
    velocity: complex
    time_ns: int


class FitObserver:
    """Follows the cycles of a pipeline.

    A detection's innovation is its distance from where the same object of the same sensor was expected by the cycle
    before that used it.

    Args:
        models: the number of models of each obstacle; 0: their probabilities are not told.
    """

    def __init__(self, models: int) -> None:
        self._models = models
        self._expected: dict[tuple[int, int, int], _NextPlace] = {}

    def fit(self, cycle: Cycle) -> DetectionFit:
        """Return how a cycle fits; to be called right after it, before the next."""
        obstacles, n = cycle.obstacles, len(cycle.obstacles)
        modes = self._modes_of(cycle)
        nis = np.full(n, np.nan)
        tracker, detections, update = cycle.tracker, cycle.detections, cycle.update
        if tracker is None or detections is None or update is None:
            return DetectionFit(nis, nis, nis, modes)
        row_of = {
            (int(sensor), int(number)): int(row)
            for sensor, number, row in zip(
                obstacles.used_sensor, obstacles.used_object, obstacles.used_row, strict=True
            )
        }
        sensor = detections.sensor
        objects = detections.object_id[update.detection].tolist()
        rows = np.array([row_of.get((sensor, number), -1) for number in objects], np.intp)
        known = np.flatnonzero((rows >= 0) & np.isfinite(update.nis))
        total = np.bincount(rows[known], update.nis[known], n)
        freedom = np.bincount(rows[known], update.degrees_of_freedom[known], n)
        nis[freedom > 0] = total[freedom > 0] / freedom[freedom > 0]
        innovation = self._innovations(cycle, tracker, detections, update, rows)
        return DetectionFit(nis, innovation.real, innovation.imag, modes)

    def _innovations(
        self, cycle: Cycle, tracker: AnyTracker, detections: Detections, update: Update, rows: Indices
    ) -> _Plane:
        """Return the innovations, x + iy, and keep where the same objects are expected next.

        Args:
            cycle: the cycle.
            tracker: of the cycle.
            detections: of the cycle.
            update: what they updated.
            rows: of the obstacles that they updated (m,); −1: of none that is reported.
        """
        obstacles = cycle.obstacles
        innovation: _Plane = np.full(len(obstacles), complex(np.nan, np.nan))
        now_ns, turn = obstacles.time_ns, exp(-1j * cycle.pose.heading)
        (expected,) = tracker.expected_positions((_SOON_S,))
        position = detections.measurement.position
        sums: dict[int, list[complex]] = {}
        fresh: dict[tuple[int, int, int], _NextPlace] = {}
        for k in np.flatnonzero(rows >= 0).tolist():
            row, detection = int(rows[k]), int(update.detection[k])
            key = (detections.sensor, int(detections.object_id[detection]), int(obstacles.id[row]))
            before = self._expected.get(key)
            gap_s = 0.0 if before is None else (now_ns - before.time_ns) * 1e-9 - _SOON_S
            if before is not None and 0.0 < gap_s <= _LONGEST_GAP_S:
                measured = complex(position[detection, 0], position[detection, 1])
                sums.setdefault(row, []).append((measured - before.place - gap_s * before.velocity) * turn)
            fresh[key] = _NextPlace(
                complex(expected[k, 0], expected[k, 1]), complex(obstacles.ve[row], obstacles.vn[row]), now_ns
            )
        for row, values in sums.items():
            innovation[row] = sum(values) / len(values)
        kept = {key: each for key, each in self._expected.items() if now_ns - each.time_ns < _LONGEST_GAP_S * 1e9}
        self._expected = kept | fresh
        return innovation

    def _modes_of(self, cycle: Cycle) -> Floats:
        """Return the probabilities of the models; NaN for obstacles of another tracker than the cycle's."""
        obstacles = cycle.obstacles
        found = np.full((len(obstacles), self._models), np.nan)
        if self._models and cycle.tracker is not None:
            ids, probabilities = cycle.tracker.mode_probabilities()
            at = {int(identity): row for row, identity in enumerate(ids)}
            rows = [at.get(int(identity), -1) for identity in obstacles.id]
            known = [k for k, row in enumerate(rows) if row >= 0]
            if probabilities.shape[1] == self._models:
                found[known] = probabilities[[rows[k] for k in known]]
        return found


def mode_names(binding: Binding) -> tuple[str, ...]:
    """Return the names of the models of motion; none where there is one alone, or groups have different ones."""
    trackers = [binding.settings.tracker, *(group.tracker for group in binding.settings.groups.values())]
    if any(each.estimator != trackers[0].estimator for each in trackers):
        return ()
    estimator = trackers[0].estimator
    if isinstance(estimator, VehicleEstimatorSettings):
        return MODE_NAMES
    models = getattr(estimator, "models", ())
    return tuple(f"{k} {model.kind}" for k, model in enumerate(models, 1)) if len(models) > 1 else ()


def obstacle_columns(obstacles: Obstacles, fit: DetectionFit) -> dict[str, NDArray[Any]]:
    """Return obstacles as the columns of a picture."""
    names = ("id", "state", "x", "y", "vx", "vy", "ax", "ay", "sx", "sy", "age", "existence", "heading", "yaw_rate")
    more = ("length", "width", "center_x", "center_y")
    return {
        **{name: getattr(obstacles, name) for name in (*names, *more)},
        "sxy": obstacles.covariance[:, 0, 1],
        "class": obstacles.kind,
        "nis": fit.nis,
        "innovation_x": fit.innovation_x,
        "innovation_y": fit.innovation_y,
    }
