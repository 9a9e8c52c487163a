"""From sensor axes to the ground: the objects of a scan as detections in the level frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from candaemon.config.sensors import FieldOfView, Mount, SensorSettings
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.sensing.detections import Detections
from candaemon.sensing.pose import EgoPose
from candaemon.sensing.scan import Scan

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class View:
    """What a sensor can see, from where it is mounted.

    Attributes:
        mount: its pose in vehicle axes.
        field: range and opening angle.
    """

    mount: Mount
    field: FieldOfView

    def sees(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points in vehicle axes (n, 2) it sees."""
        x, y = points[:, 0] - self.mount.x, points[:, 1] - self.mount.y
        azimuth = np.remainder(np.arctan2(y, x) - radians(self.mount.yaw_deg) + np.pi, 2 * np.pi) - np.pi
        distance = np.hypot(x, y)
        near_enough = (distance > self.field.min_range) & (distance < self.field.range)
        return np.asarray(near_enough & (np.abs(azimuth) < radians(self.field.azimuth_deg)))


class Mounting:
    """Turns the scans of one sensor into detections.

    Args:
        settings: of the sensor.
        quantities: rows of `Scan.values`.
    """

    def __init__(self, settings: SensorSettings, quantities: tuple[str, ...]) -> None:
        row = {name: i for i, name in enumerate(quantities)}
        noise = settings.noise
        self._mount = settings.mount
        self._yaw = radians(settings.mount.yaw_deg)
        self._polar = settings.signals.polar
        first, second = ("range", "azimuth") if self._polar else ("x", "y")
        self._first, self._second = row[first], row[second]
        self._first_variance = (noise.range or noise.x or 0.0) ** 2
        self._second_variance = (radians(noise.azimuth_deg) if noise.azimuth_deg else noise.y or 0.0) ** 2
        self._range_rate = row.get("range_rate")
        self._range_rate_variance = (noise.range_rate or 0.0) ** 2
        self._velocity = [
            (row[name], axis, deviation**2)
            for name, axis, deviation in (("vx", 0, noise.vx), ("vy", 1, noise.vy))
            if deviation is not None
        ]
        self._turning = settings.rates == "of_position"

    def detections(self, scan: Scan, pose: EgoPose) -> Detections:
        """Return the scan's objects as seen from the pose, which is that of the scan's instant."""
        mount, values = self._mount, scan.values
        a, b = values[self._first], values[self._second]
        yaw = pose.heading + self._yaw
        noise = np.empty((len(a), 2, 2))
        if self._polar:
            direction = b + yaw
            c, s = np.cos(direction), np.sin(direction)
            offset = _plane(a * c, a * s)
            self._spread(noise, c, s, self._first_variance, self._second_variance * a * a)
        else:
            c0, s0 = cos(yaw), sin(yaw)
            offset = _plane(a * c0 - b * s0, a * s0 + b * c0)
            self._spread(noise, c0, s0, self._first_variance, self._second_variance)
        origin, velocity = pose.place(mount.x, mount.y)
        position = offset + origin
        known = self._range_rate is not None
        n = len(a)
        measurement = Measurement(
            position,
            noise,
            origin,
            velocity,
            values[self._range_rate] if known else None,
            np.full(n, self._range_rate_variance + pose.speed_variance) if known else None,
            self._projections(scan, pose, offset, velocity, yaw),
            scan.sensor,
        )
        place = pose.to_vehicle(position)
        return Detections(scan.time_ns, scan.sensor, scan.object_id, scan.new, measurement, place[:, 0], place[:, 1])

    @staticmethod
    def _spread(
        noise: Floats, c: Floats | float, s: Floats | float, along: Floats | float, across: Floats | float
    ) -> None:
        """Fill covariances of variances along and across a direction."""
        noise[:, 0, 0] = along * c * c + across * s * s
        noise[:, 1, 1] = along * s * s + across * c * c
        noise[:, 0, 1] = noise[:, 1, 0] = (along - across) * c * s

    def _projections(
        self, scan: Scan, pose: EgoPose, offset: Floats, velocity: Floats, yaw: float
    ) -> tuple[Projection, ...]:
        """Return what the velocity signals say of the velocity over ground."""
        if not self._velocity:
            return ()
        # A rate of position in turning axes lacks what the turning adds: ω × offset.
        own = np.broadcast_to(velocity, offset.shape)
        if self._turning:
            own = own + pose.yaw_rate * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
        out = []
        for row, axis, variance in self._velocity:
            turned = yaw + (np.pi / 2 if axis else 0.0)
            unit = np.array([cos(turned), sin(turned)])
            direction = np.broadcast_to(unit, offset.shape)
            out.append(
                Projection(
                    direction, scan.values[row] + own @ unit, np.full(len(offset), variance + pose.speed_variance)
                )
            )
        return tuple(out)


def _plane(x: Floats, y: Floats) -> Floats:
    """Put components (n,) side by side, (n, 2)."""
    both = np.empty((len(x), 2))
    both[:, 0], both[:, 1] = x, y
    return both
