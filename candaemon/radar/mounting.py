"""From sensor axes to the ground: the objects of a scan as detections in the local frame.

Where a plane vector is a complex number, x + iy, a turn is a product, and (n,) of them are (n, 2) in memory.
"""

from __future__ import annotations

from cmath import exp
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import cos, inf, radians, sin
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, ComplexPlane, Floats
from candaemon.config.sensors import FieldOfView, Mount, SensorSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.radar.detections import Detections
from candaemon.radar.scan import Scan

NEAREST: Final = 1e-9
"""m; what is nearer is in no direction."""
NO_DIRECTION: Final = 1.0
"""rad, standard deviation of the direction that a sensor of ranges alone does not tell."""


@dataclass(frozen=True, slots=True)
class SensorView:
    """What a sensor can see, from where it is mounted.

    Attributes:
        mount: its pose in vehicle axes.
        field: range and opening angle.
        sensor: its number; −1: of no scan in particular.
        look: in which look it sees that; −1 where it has none.
    """

    mount: Mount
    field: FieldOfView
    sensor: int = -1
    look: int = -1

    @property
    def yaw(self) -> float:
        """Direction of its middle from the vehicle's x axis, rad."""
        return radians(self.mount.yaw_deg + self.field.yaw_deg)

    @property
    def area(self) -> float:
        """Area of the field of view, m²."""
        return radians(self.field.azimuth_deg) * (
            self.field.range**2 - min(self.field.min_range, self.field.range) ** 2
        )

    def sees(self, points: Floats) -> Booleans:
        """Return which points in vehicle axes (n, 2) it sees."""
        x, y = points[:, 0] - self.mount.x, points[:, 1] - self.mount.y
        bearing, distance, field = np.arctan2(y, x), np.hypot(x, y), self.field
        opening = radians(field.azimuth_deg)
        if compiled.in_use:
            limits = opening, field.min_range, field.range
            return compiled.kernels.within_field(bearing, distance, self.yaw, *limits, np.pi)
        azimuth = np.remainder(bearing - self.yaw + np.pi, 2 * np.pi) - np.pi
        near_enough = (distance > field.min_range) & (distance < field.range)
        return np.asarray(near_enough & (np.abs(azimuth) < opening))


def sensor_views(settings: SensorSettings, sensor: int = -1) -> dict[int, SensorView]:
    """Return what a sensor can see, by the number of its look; −1 where a scan has none."""
    return {look: SensorView(settings.mount, view, sensor, look) for look, view in settings.views.items()}


def in_look(views: Iterable[SensorView], detections: Detections, points: Floats) -> Booleans:
    """Return which points in vehicle axes (n, 2) lie where the look of a scan can see; all where it has none."""
    looking = [each for each in views if (each.sensor, each.look) == (detections.sensor, detections.look)]
    if detections.look < 0 or not looking:
        return np.ones(len(points), dtype=np.bool_)
    return seen_by_any(looking, points)


def seen_by_any(views: Sequence[SensorView], points: Floats) -> Booleans:
    """Return which points in vehicle axes (n, 2) at least one of some views, not none, sees."""
    seen = views[0].sees(points)
    for view in views[1:]:
        seen |= view.sees(points)
    return seen


class Mounting:
    """Turns the scans of one sensor into detections.

    Args:
        settings: of the sensor.
        quantities: rows of `Scan.values`.
        longest: the greatest length that its signal can tell, m.
    """

    def __init__(self, settings: SensorSettings, quantities: tuple[str, ...], longest: float = inf) -> None:
        row = {name: i for i, name in enumerate(quantities)}
        noise = settings.noise
        self._mount = settings.mount
        self._yaw = radians(settings.mount.yaw_deg)
        self._polar = settings.signals.polar
        first, second = ("range", "azimuth") if self._polar else ("x", "y")
        self._first, self._second = row[first], row.get(second)
        self._first_variance = (noise.range or noise.x or 0.0) ** 2
        self._second_variance = (radians(noise.azimuth_deg) if noise.azimuth_deg else noise.y or NO_DIRECTION) ** 2
        self._length, self._width, self._heading = (row.get(name) for name in ("length", "width", "heading"))
        self._range_rate = row.get("range_rate")
        self._range_rate_variance = (noise.range_rate or 0.0) ** 2
        self._velocity = [
            (row[name], axis, deviation**2)
            for name, axis, deviation in (("vx", 0, noise.vx), ("vy", 1, noise.vy))
            if deviation is not None
        ]
        self._turning, self._relative = settings.rates == "of_position", settings.rates != "absolute"
        self._compensated = settings.range_rates == "absolute"
        self._identified = settings.identified
        self._longest = longest

    def detections(self, scan: Scan, pose: EgoPose, turned: float = 0.0) -> Detections:
        """Return the scan's objects as seen from a pose.

        Args:
            scan: of the sensor.
            pose: at the scan's instant.
            turned: by how much the sensor is turned to the left beyond its configured mounting, rad.
        """
        mount, values = self._mount, scan.values
        a = values[self._first]
        b = np.zeros(len(a)) if self._second is None else values[self._second]  # of a range: straight ahead
        yaw = pose.heading + self._yaw + turned
        if self._polar:
            offset, noise = _polar_points(a, b + yaw, self._first_variance, self._second_variance)
        else:
            offset = _components(_plane(a, b) * exp(1j * yaw))
            noise = _noise(len(a), cos(yaw), sin(yaw), self._first_variance, self._second_variance)
        origin, velocity = pose.place(mount.x, mount.y)
        position, x, y = _placed(offset, origin, pose)
        known = self._range_rate is not None
        rate = values[self._range_rate] if known else None
        if rate is not None and self._compensated:  # what the sensor added for its own motion is taken off again
            along = offset[:, 0] * velocity[0] + offset[:, 1] * velocity[1]
            rate = rate - along / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), NEAREST)
        measurement = Measurement(
            position,
            noise,
            origin,
            velocity,
            rate,
            _same(len(a), self._range_rate_variance + pose.speed_variance) if known else None,
            self._projections(scan, pose, offset, velocity, yaw),
            scan.sensor,
        )
        return Detections(
            scan.time_ns,
            scan.sensor,
            scan.object_id,
            scan.new,
            measurement,
            x,
            y,
            None if self._length is None else values[self._length],
            None if self._width is None else values[self._width],
            None if self._heading is None else np.remainder(values[self._heading] + (yaw + np.pi), 2 * np.pi) - np.pi,
            self._identified,
            scan.look,
            self._longest,
        )

    def _projections(
        self, scan: Scan, pose: EgoPose, offset: Floats, velocity: Floats, yaw: float
    ) -> tuple[Projection, ...]:
        """Return what the velocity signals say of the velocity over ground."""
        if not self._velocity:
            return ()
        # A rate of position in turning axes lacks what the turning adds: ω × offset.
        mount_velocity = np.broadcast_to(velocity if self._relative else np.zeros(2), offset.shape)
        if self._turning:
            mount_velocity = mount_velocity + pose.yaw_rate * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
        out = []
        for row, axis, variance in self._velocity:
            turned = yaw + (np.pi / 2 if axis else 0.0)
            unit = np.array([cos(turned), sin(turned)])
            direction = np.broadcast_to(unit, offset.shape)
            out.append(
                Projection(
                    direction,
                    scan.values[row] + mount_velocity @ unit,
                    _same(len(offset), variance + pose.speed_variance),
                )
            )
        return tuple(out)


def _plane(x: Floats, y: Floats) -> ComplexPlane:
    plane = np.empty(len(x), np.complex128)
    plane.real, plane.imag = x, y
    return plane


def _components(plane: ComplexPlane) -> Floats:
    """Return x and y side by side, (n, 2), of the same memory."""
    return plane.view(np.float64).reshape(-1, 2)


def _polar_points(
    distance: Floats, angle: Floats, range_variance: float, angle_variance: float
) -> tuple[Floats, Floats]:
    """Return points (n, 2) at distances and angles, and their covariances (n, 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    if compiled.in_use:
        return compiled.kernels.polar_points(distance, c, s, range_variance, angle_variance)
    noise = _noise(len(distance), c, s, range_variance, angle_variance * distance * distance)
    return np.stack([distance * c, distance * s], axis=1), noise


def _placed(offset: Floats, origin: Floats, pose: EgoPose) -> tuple[Floats, Floats, Floats]:
    """Return points at offsets (n, 2) from an origin (2,), local frame (n, 2), and x, y in vehicle axes (n,)."""
    c, s = cos(pose.heading), sin(pose.heading)
    if compiled.in_use:
        return compiled.kernels.placed(offset, origin, pose.east, pose.north, c, s)
    position = offset + origin
    east, north = position[:, 0] - pose.east, position[:, 1] - pose.north
    return position, east * c + north * s, north * c - east * s


def _noise(n: int, c: Floats | float, s: Floats | float, along: float, across: Floats | float) -> Floats:
    """Return covariances (n, 2, 2) of variances along and across a direction."""
    noise = np.empty((n, 2, 2))
    along_c, along_s, across_c, across_s = along * c, along * s, across * c, across * s
    noise[:, 0, 0] = along_c * c + across_s * s
    noise[:, 1, 1] = along_s * s + across_c * c
    noise[:, 0, 1] = noise[:, 1, 0] = (along_c - across_c) * s
    return noise


def _same(n: int, value: float) -> Floats:
    """Return a number n times; `np.full` takes three times as long."""
    same = np.empty(n)
    same.fill(value)
    return same
