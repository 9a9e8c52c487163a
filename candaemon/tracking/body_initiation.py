"""Initiation of bodies and of their reflections from detections that belong to nothing known."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, exp, isfinite, sin, sqrt

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.config.tracker import TrackerSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.kalman import update_scalar
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.radar.detections import Detections
from candaemon.tracking.body_association import Association, beside
from candaemon.tracking.body_modes import CRUISING, FREE, MANOEUVRING, SLIDING, STANDING, TURNING
from candaemon.tracking.body_sizes import CAR_LENGTH, CAR_WIDTH
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import to_travel_axes

_FIRST_SHARE = np.array([0.3, 0.15, 0.1, 0.15, 0.01, 0.29])  # of the modes, in their order
_LEAST_SHARE, _MOST_STANDING = 1e-3, 0.9
_STANDING_SPREAD = 0.1  # m/s


class BodyInitiation:
    """Initiates bodies and reflections.

    Args:
        settings: of the tracker.
        estimator: of the bodies' filter.
    """

    def __init__(self, settings: TrackerSettings, estimator: VehicleEstimatorSettings) -> None:
        self._extent = settings.reflections
        self._first_speed = settings.lifecycle.first_speed
        self._estimator = estimator

    def initiate(
        self, left: Indices, association: Association, detections: Detections, pose: EgoPose, bodies: Bodies
    ) -> None:
        """Initiate a reflection for each detection of a known body, and bodies for the rest, in their order.

        Args:
            left: rows of the detections that are of no known reflection.
            association: of the scan; the rows of what is initiated are entered.
            detections: the scan.
            pose: ego pose.
            bodies: to which they are added.
        """
        measurement, heading = detections.measurement, np.array([cos(pose.heading), sin(pose.heading)])
        known = len(bodies)
        for row in left.tolist():
            body = int(association.body[row])
            if body < 0 and len(bodies) > known and self._extent.merge:
                mean, _ = bodies.reflection_states()
                body = int(beside(bodies, mean, measurement, np.array([row]), self._extent, detections.time_ns)[0])
            if body < 0:
                body = self._add_body(row, detections, heading, bodies)
                offset = np.zeros(2)
            else:
                apart = measurement.position[row] - bodies.moments().shown[body, :2]
                offset = to_travel_axes(apart, bodies.obstacles.axis[body])
            association.body[row] = body
            key = int(detections.object_id[row]) if detections.identified else None
            association.reflection[row] = bodies.add_reflection(
                body, detections.sensor, key, detections.time_ns, offset
            )

    def _add_body(self, row: int, detections: Detections, heading: Floats, bodies: Bodies) -> int:
        """Add a body that a detection shows first; return its row."""
        measurement = detections.measurement
        along, across = self._first_speed.along, self._first_speed.across
        speeds = _speeds(row, measurement)
        modes: list[tuple[Floats, Floats]] = [(np.zeros(2), np.zeros((2, 2)))] * len(_FIRST_SHARE)
        driving = self._first_velocity(speeds, heading, along, across)
        modes[CRUISING] = modes[MANOEUVRING] = modes[TURNING] = modes[SLIDING] = driving
        modes[FREE] = self._first_velocity(speeds, heading, along, max(across, 0.4 * along))
        modes[STANDING] = np.zeros(2), np.eye(2) * _STANDING_SPREAD**2
        at = slice(row, row + 1)
        bodies.filter.spawn(
            measurement.position[at],
            measurement.noise[at],
            np.stack([mean for mean, _ in modes])[None],
            np.stack([covariance for _, covariance in modes])[None],
            _first_shares(speeds, _unmeasured(heading, along, across))[None],
        )
        told = np.nan if detections.heading is None else float(detections.heading[row])
        if isfinite(told):
            axis = np.array([cos(told), sin(told)])
        else:
            axis = -heading if float(modes[CRUISING][0] @ heading) < 0.0 else heading
        ahead = self._estimator.backing.speed if isfinite(told) else 0.0
        return bodies.add(detections.time_ns, axis, CAR_LENGTH, CAR_WIDTH, ahead)

    @staticmethod
    def _first_velocity(
        speeds: Sequence[Projection], heading: Floats, along: float, across: float
    ) -> tuple[Floats, Floats]:
        """Return a first velocity over ground (2,) and its covariance (2, 2).

        The prior is what traffic does: fast along the vehicle's heading, slow across it. Each speed that the sensor
        measured updates it.
        """
        mean, covariance = np.zeros((1, 2)), _unmeasured(heading, along, across)[None]
        for speed in speeds:
            innovation = speed.value - (speed.direction * mean).sum(axis=1)
            update_scalar(mean, covariance, speed.direction, innovation, speed.variance)
        return mean[0], covariance[0]


def _speeds(row: int, measurement: Measurement) -> list[Projection]:
    """Return the speeds over ground that were measured of one detection, one entry each."""
    at = slice(row, row + 1)
    speeds = [Projection(part.direction[at], part.value[at], part.variance[at]) for part in measurement.projections]
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        sight = measurement.position[at] - measurement.origin
        unit = sight / np.maximum(np.hypot(sight[:, 0], sight[:, 1]), 1e-3)[:, None]
        along_sight = measurement.range_rate[at] + unit @ measurement.velocity
        speeds.append(Projection(unit, along_sight, measurement.range_rate_variance[at]))
    return [speed for speed in speeds if np.isfinite(speed.value[0])]


def _unmeasured(heading: Floats, along: float, across: float) -> Floats:
    """Return the covariance (2, 2) of the velocity of what moves, before anything was measured of it, (m/s)²."""
    left = np.array([-heading[1], heading[0]])
    return np.asarray(along**2 * np.outer(heading, heading) + across**2 * np.outer(left, left))


def _first_shares(speeds: Sequence[Projection], driving: Floats) -> Floats:
    """Return the first probabilities of the modes: what has a speed hardly stands, what has none most likely does.

    Args:
        speeds: that were measured.
        driving: covariance (2, 2) of the velocity of what moves, before them, (m/s)².
    """
    shares = _FIRST_SHARE.copy()
    odds = shares[STANDING] / (1.0 - shares[STANDING])
    for speed in speeds:
        value, variance = float(speed.value[0]), float(speed.variance[0])
        still = variance + _STANDING_SPREAD**2
        moving = variance + float((speed.direction @ driving @ speed.direction.T)[0, 0])
        if moving > still:  # at range 0 a speed has no direction, and tells nothing
            odds *= sqrt(moving / still) * exp(-0.5 * value * value * (1.0 / still - 1.0 / moving))
    stands = min(max(odds / (1.0 + odds), _LEAST_SHARE), _MOST_STANDING)
    shares *= (1.0 - stands) / (1.0 - shares[STANDING])
    shares[STANDING] = stands
    return np.asarray(shares)
