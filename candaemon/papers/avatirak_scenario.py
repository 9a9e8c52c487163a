"""Left turns: the true motion of the point that is tracked, and what the radars measure.

Source: Avatirak et al. 2012, eqs. (20) to (29).

Axes as the paper's: origin in the middle of the host's front bumper, x to the right, y forward. The host drives
straight ahead, so they do not turn, and a left turn is positive, counter-clockwise, in them too.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, pi

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.radial import radial

STEP = 200e-6
"""s between two measurements."""
SENSORS: Floats = np.array([(0.8, 0.0), (-0.8, 0.0)])
"""Positions of the two radars, m."""
FORWARD: Floats = np.array([0.0, 1.0])
"""Direction in which they look."""
DEVIATIONS: Floats = np.array([0.05, 0.02, 1.0])
"""Noise of range, range rate and range acceleration: m, m/s, m/s²."""
HOST: Floats = np.array([0.0, 21.0])
"""Velocity of the host, m/s."""

_LENGTH, _WIDTH = 4.0, 1.8
_FIRST_POINT = np.array([5.0, 10.0])


@dataclass(frozen=True, slots=True)
class LeftTurn:
    """A vehicle that turns left before the host from time 0 on.

    Attributes:
        speed: of its centre, m/s.
        radius: on which its centre turns, m.
        duration: s.
    """

    speed: float
    radius: float
    duration: float

    @property
    def time(self) -> Floats:
        """Times of the measurements, s, (steps,)."""
        return np.arange(1, round(self.duration / STEP) + 1, dtype=np.float64) * STEP

    def outline(self, corner: tuple[float, float]) -> Floats:
        """Return the true motion of a corner relative to the host.

        Args:
            corner: 1 or −1 each, to the right and to the front of the vehicle's centre.

        Returns:
            [x, y, vx, vy, ax, ay] at the times of the measurements, (steps, 6).
        """
        rate = self.speed / self.radius
        heading = pi / 2 + rate * self.time
        # The rear left corner, the nearest to the host, begins in the paper's point; the centre turns about `middle`.
        centre = _FIRST_POINT - _offset((-1, -1), np.array([pi / 2]))[0]
        middle = centre - (self.radius, 0.0)
        arm = self.radius * np.stack([np.sin(heading), -np.cos(heading)], axis=1) + _offset(corner, heading)
        position = middle + arm - HOST * self.time[:, None]
        velocity = rate * np.stack([-arm[:, 1], arm[:, 0]], axis=1) - HOST
        return np.concatenate([position, velocity, -(rate**2) * arm], axis=1)

    @property
    def truth(self) -> Floats:
        """The true motion of the tracked point, the rear left corner, relative to the host, (steps, 6)."""
        return self.outline((-1, -1))

    def measured(self, runs: int, rng: np.random.Generator, *, centripetal: bool = True) -> Floats:
        """Return [r, ṙ, r̈] with noise at both radars, (steps, runs, 2, 3).

        Args:
            runs: how many times.
            rng: of the noise.
            centripetal: see `radial`; without it r̈ is that of (26).
        """
        exact = radial(self.truth, SENSORS, centripetal=centripetal)[:, None]
        return exact + DEVIATIONS * rng.standard_normal((len(exact), runs, len(SENSORS), 3))


def _offset(corner: tuple[float, float], heading: Floats) -> Floats:
    """Return where a corner is, m from the vehicle's centre, (n, 2): ρ and θ of (20) to (22)."""
    right, front = corner[0] * _WIDTH / 2, corner[1] * _LENGTH / 2
    rho, phi = hypot(right, front), atan2(front, right)
    theta = heading + phi - pi / 2
    return np.stack([rho * np.cos(theta), rho * np.sin(theta)], axis=1)
