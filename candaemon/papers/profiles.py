"""Motions made of pieces of constant acceleration, what is measured of them, and the bound for who must track them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from candaemon.papers.tracking import clairvoyant

Floats = NDArray[np.float64]

Pieces: TypeAlias = tuple[tuple[float, float], ...]
"""(duration s, acceleration m/s²) one after another."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The truth at the instants dt, 2 dt, …; at time 0 the target is in the origin.

    Attributes:
        dt: s.
        state: (steps, 6) of [x, y, vx, vy, ax, ay]; the acceleration is that of the step that ends at the instant.
        opening: (steps, 2), whether that acceleration of each axis is another than a step before.
    """

    dt: float
    state: Floats
    opening: NDArray[np.bool_]

    @property
    def time(self) -> Floats:
        """Instants (steps,), s."""
        return np.arange(1, len(self.state) + 1, dtype=np.float64) * self.dt

    def measured(self, deviation: float, runs: int, rng: np.random.Generator) -> Floats:
        """Return positions with white noise of a standard deviation (m) on each axis, (steps, runs, 2)."""
        positions: Floats = self.state[:, None, :2] + rng.normal(0.0, deviation, (len(self.state), runs, 2))
        return positions


def motion(dt: float, along_x: Pieces, along_y: Pieces, velocity: tuple[float, float] = (0.0, 0.0)) -> Motion:
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
    return Motion(dt, np.concatenate([position, after, acceleration], axis=1), opening)


def bound(motion: Motion, measured: Floats, deviation: float, velocity: Floats, speed_spread: float) -> Floats:
    """Track each axis as one who is told when, and by how much on average, its acceleration changes: `clairvoyant`.

    Args:
        motion: the truth.
        measured: positions (steps, runs, 2), m.
        deviation: standard deviation of their noise, m.
        velocity: first velocity (2,), m/s.
        speed_spread: its standard deviation, m/s.

    Returns:
        Estimates (steps, runs, 6).
    """
    estimates = np.empty((*measured.shape[:2], 6))
    for axis in range(2):
        estimates[..., axis::2] = clairvoyant(
            motion.dt,
            measured,
            deviation**2 * np.eye(2),
            velocity,
            speed_spread**2 * np.eye(2),
            acceleration=float(np.sqrt(np.square(motion.state[:, 4 + axis]).mean())),
            turn_rate=None,
            opening=motion.opening[:, axis],
        )[..., axis::2]
    return estimates


def _sampled(pieces: Pieces, dt: float) -> Floats:
    """Return the acceleration of each step."""
    return np.concatenate([np.full(round(duration / dt), acceleration) for duration, acceleration in pieces])
