"""A sensor sees the near side of what it sees: what lies well before that is something else.

A motorcycle stops behind a car that stands, or someone crosses before it. Their range rate is that of the car, and they
are no farther from its rear than its front is. But the rear was the nearest that the car showed for seconds.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.body_filter import VELOCITY
from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import lengths


def detections_before(
    bodies: Bodies, mean: Floats, measurement: Measurement, left: Indices, extent: ReflectionSettings, time_ns: int
) -> Booleans:
    """Return which detections (m,) lie before the near side of which bodies (k,).

    Args:
        bodies: that are known.
        mean: states of their reflections (n, 4).
        measurement: of the scan.
        left: rows of the detections (m,).
        extent: how far before, and for how long the near side is known.
        time_ns: of the scan.
    """
    reflections = bodies.reflections
    shown = _known_for_long(bodies, extent, time_ns).take(reflections.body)
    shown &= reflections.sensor == measurement.sensor
    nearest = np.full(len(bodies), -np.inf)
    nearest[reflections.body[shown]] = np.inf
    np.minimum.at(nearest, reflections.body[shown], lengths(mean[shown, :2] - measurement.origin))
    distance = lengths(measurement.position[left] - measurement.origin)
    return np.asarray(nearest - distance[:, None] > extent.before)


def is_before(
    bodies: Bodies, young: int, old: int, origins: Mapping[int, Floats], extent: ReflectionSettings, time_ns: int
) -> bool:
    """Return whether a body lies before the near side of another one, for a sensor that has shown both.

    Args:
        bodies: with their reflections.
        young: row of the one.
        old: row of the other.
        origins: where the sensors are, by their number (2,), local frame, m.
        extent: as for detections.
        time_ns: of the cycle.
    """
    if not _known_for_long(bodies, extent, time_ns)[old]:
        return False
    reflections = bodies.reflections
    one, other = ((reflections.body == body).nonzero()[0] for body in (young, old))
    for sensor in np.intersect1d(reflections.sensor[one], reflections.sensor[other]).tolist():
        if sensor not in origins:
            continue
        near, far = (
            lengths(
                bodies.moments().shown[body, :2]
                + bodies.offsets(rows[reflections.sensor[rows] == sensor])
                - origins[sensor]
            ).min()
            for body, rows in ((young, one), (old, other))
        )
        if far - near > extent.before:
            return True
    return False


def _known_for_long(bodies: Bodies, extent: ReflectionSettings, time_ns: int) -> Booleans:
    """Return of which bodies the near side is known (k,); what drives may turn another one to us."""
    obstacles, velocity = bodies.obstacles, bodies.moments().mean[:, VELOCITY]
    slow = (velocity * velocity).sum(axis=1) < extent.course.speed**2
    old = time_ns - obstacles.first_ns > round(extent.course.apart_for * 1e9)
    return np.asarray(obstacles.confirmed & slow & old)
