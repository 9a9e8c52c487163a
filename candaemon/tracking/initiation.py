"""How tracks begin: as a reflection of a known obstacle, or as an obstacle of its own."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.kalman import line_of_sight, update_scalar
from candaemon.estimation.measurement import Projection
from candaemon.radar.detections import Detections
from candaemon.tracking.reflections import to_travel_axes
from candaemon.tracking.track_store import TrackStore


class TrackInitiation:
    """Begins reflections and obstacles.

    Args:
        settings: of the tracker.
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._merge = settings.reflections.merge
        self._near = settings.reflections
        self._first_speed = settings.lifecycle.first_speed

    def bear(self, free: Indices, detections: Detections, pose: EgoPose, tracks: TrackStore) -> None:
        """Begin a reflection for each free detection, in their order.

        Args:
            free: rows of the detections.
            detections: the scan.
            pose: own pose; what begins is taken to travel as the vehicle heads until its course is known.
            tracks: what lives.
        """
        heading = np.array([np.cos(pose.heading), np.sin(pose.heading)])
        velocity, spread = self._first_velocity(detections, heading)
        for row in free.tolist():
            at = slice(row, row + 1)
            position, noise = detections.measurement.position[at], detections.measurement.noise[at]
            owner, like = self._kin(row, detections, tracks) if self._merge else (-1, -1)
            if owner < 0:
                owner = tracks.add_obstacle(detections.time_ns, heading)
                tracks.estimator.spawn(position, noise, velocity[at], spread[at])
            else:
                tracks.estimator.clone(np.array([like]), position, noise)
            tracks.add_reflection(owner, detections.sensor, int(detections.object_id[row]), detections.time_ns)

    def _first_velocity(self, detections: Detections, heading: Floats) -> tuple[Floats, Floats]:
        """Return first velocities over ground (n, 2) and their covariances (n, 2, 2).

        Before any speed is measured a target may do what traffic does: much along our own heading, little across it.
        That guess is corrected by each speed that the sensor gives.
        """
        measurement, n = detections.measurement, len(detections)
        across = np.array([-heading[1], heading[0]])
        prior = self._first_speed.along**2 * np.outer(heading, heading)
        prior += self._first_speed.across**2 * np.outer(across, across)
        velocity, covariance = np.zeros((n, 2)), np.tile(prior, (n, 1, 1))
        speeds = list(measurement.projections)
        if measurement.range_rate is not None and measurement.range_rate_variance is not None:
            unit = measurement.position - measurement.origin
            unit = unit / np.maximum(np.hypot(unit[:, 0], unit[:, 1]), 1e-3)[:, None]
            along_sight = measurement.range_rate + unit @ measurement.velocity
            speeds.append(Projection(unit, along_sight, measurement.range_rate_variance))
        for speed in speeds:
            innovation = speed.value - (speed.direction * velocity).sum(axis=1)
            known = np.isfinite(innovation)
            row = np.where(known[:, None], speed.direction, 0.0)
            update_scalar(velocity, covariance, row, np.where(known, innovation, 0.0), speed.variance)
        return velocity, covariance

    def _kin(self, row: int, detections: Detections, tracks: TrackStore) -> tuple[int, int]:
        """Return the obstacle that a detection is one more reflection of, and its nearest reflection; or −1, −1."""
        if not len(tracks.reflections):
            return -1, -1
        near, measurement = self._near, detections.measurement
        mean, _ = tracks.states()
        owner, direction = tracks.reflections.obstacle, tracks.direction
        place = to_travel_axes(measurement.position[row] - mean[:, :2], direction)
        reach = to_travel_axes(measurement.position[row] - tracks.reference()[owner], direction)
        close = (
            (np.abs(place[:, 0]) < near.along)
            & (np.abs(place[:, 1]) < near.across)
            & (np.abs(reach[:, 0]) < near.extent)
            & (np.abs(reach[:, 1]) < 2 * near.across)
        )
        if measurement.range_rate is not None and np.isfinite(measurement.range_rate[row]):
            rate, _ = line_of_sight(mean, measurement.origin, measurement.velocity)
            close &= np.abs(rate - measurement.range_rate[row]) < near.speed
        for speed in measurement.projections:
            if np.isfinite(speed.value[row]):
                differs = np.abs(mean[:, 2:4] @ speed.direction[row] - speed.value[row])
                close &= differs < near.speed + 2 * np.sqrt(speed.variance[row])
        if not close.any():
            return -1, -1
        distance = np.where(close, (place[:, 0] / near.along) ** 2 + (place[:, 1] / near.across) ** 2, np.inf)
        like = int(distance.argmin())
        return int(owner[like]), like
