"""Ego pose at an instant, and what is seen from it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import cos, sin

import numpy as np

from candaemon.arrays import Floats


class EgoStatus(IntEnum):
    """How reliable ego motion is; the numbers are those on the wire. Initialising: biases are being learnt."""

    LOST = 0
    DEAD_RECKONING = 1
    VALID = 2
    INITIALISING = 3


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class EgoPose:
    """Pose and motion of the vehicle axes in the local frame at one instant.

    Attributes:
        time_ns: the instant.
        east, north: position of the rear axle's centre, m.
        heading: yaw of the vehicle's x axis from east, positive to the left, rad.
        ve, vn: velocity over ground of the rear axle's centre, m/s.
        yaw_rate: positive to the left, rad/s.
        speed_variance: of each velocity component, (m/s)².
        status: how reliable it is.
        heading_variance: of the heading against true north, rad²; 0 where the frame turns with the heading's error.
    """

    time_ns: int
    east: float
    north: float
    heading: float
    ve: float
    vn: float
    yaw_rate: float
    speed_variance: float
    status: EgoStatus
    heading_variance: float = 0.0

    @property
    def rotation(self) -> Floats:
        """Rotation from vehicle axes to those of the local frame, 2 × 2."""
        c, s = cos(self.heading), sin(self.heading)
        return np.array([[c, -s], [s, c]])

    @property
    def velocity_covariance(self) -> Floats:
        """Covariance of its velocity over ground in vehicle axes, 2 × 2, (m/s)²: a wrong heading turns it."""
        c, s = cos(self.heading), sin(self.heading)
        x, y = c * self.vn - s * self.ve, -(c * self.ve + s * self.vn)
        speed, turn = self.speed_variance, self.heading_variance
        both = turn * (x * y)
        return np.array([[speed + turn * (x * x), both], [both, speed + turn * (y * y)]])

    def place(self, x: float, y: float) -> tuple[Floats, Floats]:
        """Return where a point fixed to the vehicle is in the local frame (2,), and its velocity over ground (2,)."""
        c, s = cos(self.heading), sin(self.heading)
        east, north = c * x - s * y, s * x + c * y
        position = np.array([self.east + east, self.north + north])
        velocity = np.array([self.ve - self.yaw_rate * north, self.vn + self.yaw_rate * east])
        return position, velocity

    def to_vehicle(self, points: Floats) -> Floats:
        """Return local-frame points (n, 2) in vehicle axes."""
        return np.asarray((points - np.array([self.east, self.north])) @ self.rotation)

    def velocity_in_vehicle_axes(self) -> tuple[float, float]:
        """Return the velocity over ground of the rear axle's centre along x and y of the vehicle, m/s."""
        c, s = cos(self.heading), sin(self.heading)
        return c * self.ve + s * self.vn, c * self.vn - s * self.ve
