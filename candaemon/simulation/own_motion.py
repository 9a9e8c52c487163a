"""What the ego's own sensors say: an INS on earth, or wheels and a yaw rate sensor."""

from __future__ import annotations

import math

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.simulation.actor_motion import TrueMotion
from candaemon.simulation.scenario import EgoStart, OwnMotion

_SEMI_MAJOR = 6_378_137.0
_ECCENTRICITY_SQUARED = 6.694_379_990_14e-3
_CRAWL = 0.5
"""m/s under which a path's curvature is told as 0."""


def geodetic(east: Floats, north: Floats, start: EgoStart) -> tuple[Floats, Floats]:
    """Return latitude and longitude in degrees of level positions in m, WGS 84.

    North is measured along the origin's meridian, east along the point's own parallel; the radii of curvature are
    those of the origin: millimetres per kilometre off the geodesic.
    """
    latitude = math.radians(start.latitude)
    squared = 1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    meridian = _SEMI_MAJOR * (1 - _ECCENTRICITY_SQUARED) / squared**1.5
    normal = _SEMI_MAJOR / math.sqrt(squared)
    latitudes = latitude + north / meridian
    return np.degrees(latitudes), start.longitude + np.degrees(east / (normal * math.cos(latitude)))


class Drift:
    """Errors that change slowly: first-order Gauss-Markov processes, continued from call to call.

    Args:
        deviation: standard deviation of each, shape (n,).
        step: s between two values.
        time: s, correlation time.
        random: generator to draw from.

    """

    def __init__(self, deviation: Floats, step: float, time: float, random: np.random.Generator) -> None:
        self._deviation, self._random = deviation, random
        self._keep = math.exp(-step / time)
        self._last = deviation * random.standard_normal(len(deviation))

    def next(self, count: int) -> Floats:
        """Return the next errors, shape (n, count)."""
        spread = self._deviation * math.sqrt(1 - self._keep**2)
        draws = self._random.standard_normal((count, len(spread))) * spread
        errors = np.empty((len(spread), count))
        last = self._last
        for k in range(count):
            last = self._keep * last + draws[k]
            errors[:, k] = last
        self._last = last
        return errors


def ins_values(motion: TrueMotion, errors: Floats, settings: InsSettings, start: EgoStart) -> dict[str, Floats]:
    """Return what an INS tells, by the names of `InsSignals`; SI, angles in radians, n instants.

    Args:
        motion: of the ego, level axes.
        errors: of velocity north and east (m/s), heading and yaw rate (rad, rad/s), shape (4, n).
        settings: the lever arm is where it measures.
        start: the origin on earth.

    """
    arm = complex(settings.lever_arm.x, settings.lever_arm.y) * np.exp(1j * motion.yaw)
    position = motion.position + arm
    velocity = motion.velocity + 1j * motion.yaw_rate * arm + errors[1] + 1j * errors[0]
    latitude, longitude = geodetic(position.real, position.imag, start)
    speed = np.abs(velocity)
    yaw_rate = motion.yaw_rate + errors[3]
    return {
        "latitude": np.radians(latitude),
        "longitude": np.radians(longitude),
        "velocity_north": velocity.imag,
        "velocity_east": velocity.real,
        "speed": speed,
        "heading": np.mod(math.pi / 2 - motion.yaw + errors[2], 2 * math.pi),
        "yaw_rate": yaw_rate,
        "valid": np.ones_like(speed),
        "curvature": np.where(speed > _CRAWL, yaw_rate / np.maximum(speed, _CRAWL), 0.0),
    }


def odometry_values(motion: TrueMotion, settings: OdometrySettings, own: OwnMotion) -> dict[str, Floats]:
    """Return what wheels, speedometer and yaw rate sensor tell, by the names of `OdometrySignals`, n instants.

    SI; biases and factors are in it, noise is not. The wheels are those of the rear axle.
    """
    speed = np.real(motion.velocity * np.exp(-1j * motion.yaw))
    inward = settings.track_width / 2 * motion.yaw_rate
    return {
        "left_wheels": own.speed_factor * (speed - inward),
        "right_wheels": own.speed_factor * (speed + inward),
        "speed": own.speed_factor * speed + own.speed_offset,
        "yaw_rate": motion.yaw_rate + math.radians(own.yaw_rate_bias_deg),
    }
