"""Motions made of pieces of constant acceleration, what is measured of them, and the bound for who must track them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Floats
from candaemon.estimation.discretisation import white_axis

Pieces: TypeAlias = tuple[tuple[float, float], ...]
"""(duration s, acceleration m/s²) one after another."""


@dataclass(frozen=True, slots=True)
class ProfileMotion:
    """The truth at the instants dt, 2 dt, …; at time 0 the target is in the origin.

    Attributes:
        dt: s.
        state: (steps, 6) of [x, y, vx, vy, ax, ay]; the acceleration is that of the step that ends at the instant.
        opening: (steps, 2), whether that acceleration of each axis is another than a step before.
    """

    dt: float
    state: Floats
    opening: Booleans

    @property
    def time(self) -> Floats:
        """Instants (steps,), s."""
        return np.arange(1, len(self.state) + 1, dtype=np.float64) * self.dt

    def measured(self, deviation: float, runs: int, rng: np.random.Generator) -> Floats:
        """Return positions with white noise of a standard deviation (m) on each axis, (steps, runs, 2)."""
        positions: Floats = self.state[:, None, :2] + rng.normal(0.0, deviation, (len(self.state), runs, 2))
        return positions


def motion(dt: float, along_x: Pieces, along_y: Pieces, velocity: tuple[float, float] = (0.0, 0.0)) -> ProfileMotion:
    """Return a motion from the origin.

    Args:
        dt: s; the durations are multiples of it.
        along_x: accelerations of the axis.
        along_y: likewise, of the same total duration.
        velocity: m/s, at time 0.
    """
    acceleration = np.stack([_sampled(along_x, dt), _sampled(along_y, dt)], axis=1)
    after = velocity + np.cumsum(acceleration * dt, axis=0)
    position = np.cumsum((after - acceleration * dt / 2) * dt, axis=0)
    opening = np.diff(acceleration, axis=0, prepend=acceleration[:1]) != 0.0
    return ProfileMotion(dt, np.concatenate([position, after, acceleration], axis=1), opening)


def bound(motion: ProfileMotion, measured: Floats, deviation: float, spread: float) -> Floats:
    """Track each axis knowing when, and by how much on average, its acceleration changes, and no more of it.

    From one change to the next the Kalman filter's model is exact: constant acceleration without noise. At a change the
    acceleration becomes unknown again. No causal filter that begins with as much, and must find the changes itself,
    does better on average.

    Args:
        motion: the truth.
        measured: positions (steps, runs, 2), m, the first one a step after time 0.
        deviation: standard deviation of their noise, m.
        spread: standard deviation, of the position in m and of the velocity in m/s, of what is known of time 0; its
            mean is the truth. 0 for a bound of filters that start on the truth itself, whatever their P(0) says.

    Returns:
        Estimates (steps, runs, 6) of [x, y, vx, vy, ax, ay].
    """
    estimates = np.empty((*measured.shape[:2], 6))
    first_velocity = motion.state[0, 2:4] - motion.dt * motion.state[0, 4:]
    for axis in range(2):
        usual = float(np.square(motion.state[:, 4 + axis]).mean())
        mean = np.tile([0.0, first_velocity[axis], 0.0], (measured.shape[1], 1))
        covariance = np.diag([spread**2, spread**2, usual])
        informed = _informed(motion.dt, measured[..., axis], deviation**2, mean, covariance, motion.opening[:, axis])
        estimates[..., axis::2] = informed
    return estimates


def _informed(
    dt: float, measured: Floats, variance: float, mean: Floats, covariance: Floats, opening: Booleans
) -> Floats:
    """Filter an axis (steps, runs) from means (runs, 3), which share a covariance (3, 3), as `bound` says."""
    transition, usual = white_axis(dt, 0.0, order=2).transition, covariance[2, 2]
    estimates = np.empty((*measured.shape, 3))
    for k, positions in enumerate(measured):
        if opening[k]:
            mean = mean * (1.0, 1.0, 0.0)
            covariance[2], covariance[:, 2] = 0.0, 0.0
            covariance[2, 2] = usual
        mean, covariance = mean @ transition.T, transition @ covariance @ transition.T
        gain = covariance[:, 0] / (covariance[0, 0] + variance)
        mean = mean + (positions - mean[:, 0])[:, None] * gain
        covariance = covariance - np.outer(gain, covariance[0])
        estimates[k] = mean
    return estimates


def _sampled(pieces: Pieces, dt: float) -> Floats:
    """Return the acceleration of each step."""
    return np.concatenate([np.full(round(duration / dt), acceleration) for duration, acceleration in pieces])
