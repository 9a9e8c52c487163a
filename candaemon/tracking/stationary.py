"""Stationary obstacles, from whose detections ego motion learns its biases.

A stationary object shows the vehicle's speed by its range rate, and a wrong yaw rate by its drift: where the heading
turns too fast by e, a point at distance x ahead seems to move sideways by e·x. The drift is taken from the measured
points themselves over a span of time, since a filter that expects little lateral motion hides it.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field
from math import hypot

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import BiasSettings
from candaemon.ego.motion import StationaryReturns
from candaemon.ego.pose import EgoPose
from candaemon.radar.detections import Detections
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.obstacles import CONFIRMED, Obstacles


@dataclass(slots=True)
class DriftAnchor:
    """Where a stationary point was first measured, which its apparent drift is measured from.

    Attributes:
        obstacle: identity of its obstacle.
        first_ns: time of that measurement.
        last_ns: time of the latest one.
        position: first measured (2,), local frame, m.
        swept: distance ahead times time since, m·s.
    """

    obstacle: int
    first_ns: int
    last_ns: int
    position: Floats
    swept: float = 0.0

    def validate(self) -> None:
        """Refuse a position that is none.

        Raises:
            ValueError: it has other than two coordinates.
        """
        if self.position.shape != (2,):
            raise ValueError(f"a position of the shape {self.position.shape}, expected (2,)")


@dataclass(slots=True)
class StationaryWatchState:
    """What a stationary watch remembers.

    Attributes:
        anchors: of each point, by its sensor's number and that sensor's object id.
        pruned_ns: when points that are no longer measured were last removed.
    """

    anchors: dict[tuple[int, int], DriftAnchor] = field(default_factory=dict)
    pruned_ns: int = 0


class StationaryWatch:
    """Watches the detections of stationary obstacles.

    Args:
        settings: what counts as stationary, and how long a drift is watched.
        compensated: numbers of the sensors whose range rates are over ground: from those ego motion's own speed was
            taken off again, and says nothing of itself.

    Attributes:
        state: all that it remembers.
    """

    def __init__(self, settings: BiasSettings, compensated: Container[int] = ()) -> None:
        self._settings, self._compensated = settings, compensated
        self._span_ns = round(settings.drift_time * 1e9)
        self.state = StationaryWatchState()

    def returns(
        self, detections: Detections, tracker: AnyTracker, obstacles: Obstacles, pose: EgoPose
    ) -> StationaryReturns | None:
        """Return what this cycle's detections of stationary obstacles say of ego motion; None where none does."""
        if detections.time_ns - self.state.pruned_ns > self._span_ns:
            self._prune(detections.time_ns)
        measurement, update, settings = detections.measurement, tracker.update, self._settings
        ego_speed = hypot(pose.ve, pose.vn)
        if measurement.range_rate is None or update is None or ego_speed < settings.least_own_speed:
            return None
        stationary = (
            (obstacles.state == CONFIRMED)
            & (np.abs(obstacles.vx) < settings.stationary_speed)
            & (np.abs(obstacles.vy) < settings.stationary_speed)
            & (obstacles.x > settings.least_distance)
        )
        rows = np.flatnonzero(stationary[obstacles.used_row])
        if not len(rows):
            return None
        seen = update.detection[rows]
        unit = measurement.position[seen] - measurement.origin
        unit = unit / np.hypot(unit[:, 0], unit[:, 1])[:, None]
        cosine = unit @ (measurement.velocity / ego_speed)
        ahead = cosine > settings.least_cosine
        speeds: tuple[tuple[float, float], ...] = ()
        if detections.sensor not in self._compensated:
            told = ahead & (obstacles.age[obstacles.used_row[rows]] > settings.least_age)
            speeds = tuple(zip((-measurement.range_rate[seen[told]]).tolist(), cosine[told].tolist(), strict=True))
        drifts = tuple(
            drift
            for row, i in zip(rows[ahead], seen[ahead], strict=True)
            if (drift := self._drift(int(obstacles.id[obstacles.used_row[row]]), int(i), detections, pose)) is not None
        )
        return StationaryReturns(detections.time_ns, ego_speed, speeds, drifts)

    def _prune(self, time_ns: int) -> None:
        """Remove the points that were not measured for a span."""
        state, span_ns = self.state, self._span_ns
        state.anchors = {key: each for key, each in state.anchors.items() if time_ns - each.last_ns <= span_ns}
        state.pruned_ns = time_ns

    def _drift(self, obstacle: int, i: int, detections: Detections, pose: EgoPose) -> tuple[float, float] | None:
        """Follow one point; return its sideways motion, m, and distance × time, m·s, once it was watched for a span."""
        if not detections.identified:
            return None
        key = (detections.sensor, int(detections.object_id[i]))
        position, now_ns = detections.measurement.position[i], detections.time_ns
        anchors = self.state.anchors
        anchor = anchors.get(key)
        gap_ns = 0 if anchor is None else now_ns - anchor.last_ns
        if anchor is None or anchor.obstacle != obstacle or detections.new[i] or gap_ns > self._span_ns:
            anchors[key] = DriftAnchor(obstacle, now_ns, now_ns, position)
            return None
        anchor.swept += float(detections.x[i]) * gap_ns * 1e-9
        anchor.last_ns = now_ns
        if now_ns - anchor.first_ns < self._span_ns:
            return None
        anchors[key] = DriftAnchor(obstacle, now_ns, now_ns, position)
        moved = position - anchor.position
        return float(moved[1] * np.cos(pose.heading) - moved[0] * np.sin(pose.heading)), anchor.swept
