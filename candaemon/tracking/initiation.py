"""Track initiation: as one more reflection of a tracked obstacle, or as an obstacle of its own."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.kalman import update_scalar
from candaemon.estimation.measurement import Projection, line_of_sight
from candaemon.radar.detections import Detections
from candaemon.tracking.reflections import to_travel_axes
from candaemon.tracking.track_store import TrackStore


class TrackInitiation:
    """Initiates reflections and obstacles.

    Args:
        settings: of the tracker.
    """

    def __init__(self, settings: TrackerSettings) -> None:
        self._merge = settings.reflections.merge
        self._extent = settings.reflections
        self._first_speed = settings.lifecycle.first_speed

    def initiate(self, unassociated: Indices, detections: Detections, pose: EgoPose, tracks: TrackStore) -> None:
        """Initiate a reflection for each unassociated detection, in their order.

        Args:
            unassociated: rows of the detections.
            detections: the scan.
            pose: ego pose; a new obstacle is taken to travel as the vehicle heads until its course is known.
            tracks: to which they are added.
        """
        heading = np.array([np.cos(pose.heading), np.sin(pose.heading)])
        velocity, spread = self._first_velocity(detections, heading)
        for row in unassociated.tolist():
            at = slice(row, row + 1)
            position, noise = detections.measurement.position[at], detections.measurement.noise[at]
            owner, nearest = self._parent(row, detections, tracks) if self._merge else (-1, -1)
            if owner < 0:
                owner = tracks.add_obstacle(detections.time_ns, heading)
                tracks.estimator.spawn(position, noise, velocity[at], spread[at])
            else:
                tracks.estimator.clone(np.array([nearest]), position, noise)
            key = int(detections.object_id[row]) if detections.identified else None
            tracks.add_reflection(owner, detections.sensor, key, detections.time_ns)

    def _first_velocity(self, detections: Detections, heading: Floats) -> tuple[Floats, Floats]:
        """Return first velocities over ground (n, 2) and their covariances (n, 2, 2).

        The prior is what traffic does: fast along the vehicle's heading, slow across it. Each speed that the sensor
        measured updates it.
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

    def _parent(self, row: int, detections: Detections, tracks: TrackStore) -> tuple[int, int]:
        """Return the obstacle that a detection is one more reflection of, and its nearest reflection; or −1, −1."""
        if not len(tracks.reflections):
            return -1, -1
        extent, measurement = self._extent, detections.measurement
        mean, _ = tracks.states()
        owner, direction = tracks.reflections.obstacle, tracks.direction
        place = to_travel_axes(measurement.position[row] - mean[:, :2], direction)
        reach = to_travel_axes(measurement.position[row] - tracks.reference_points()[owner], direction)
        close = (
            (np.abs(place[:, 0]) < extent.along)
            & (np.abs(place[:, 1]) < extent.across)
            & (np.abs(reach[:, 0]) < extent.extent)
            & (np.abs(reach[:, 1]) < 2 * extent.across)
        )
        if measurement.range_rate is not None and np.isfinite(measurement.range_rate[row]):
            rate, _ = line_of_sight(mean, measurement.origin, measurement.velocity)
            close &= np.abs(rate - measurement.range_rate[row]) < extent.speed
        for speed in measurement.projections:
            if np.isfinite(speed.value[row]):
                differs = np.abs(mean[:, 2:4] @ speed.direction[row] - speed.value[row])
                close &= differs < extent.speed + 2 * np.sqrt(speed.variance[row])
        if not close.any():
            return -1, -1
        distance = np.where(close, (place[:, 0] / extent.along) ** 2 + (place[:, 1] / extent.across) ** 2, np.inf)
        nearest = int(distance.argmin())
        return int(owner[nearest]), nearest
