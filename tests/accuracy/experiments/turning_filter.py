"""An extended Kalman filter of constant turn rate and velocity, for many runs and process noises at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.measurement import Measurement, line_of_sight

GRID: Final = tuple(product((0.2, 0.5, 1.0, 2.0, 4.0), (0.1, 0.2, 0.5, 1.0, 2.0)))
"""Standard deviations of acceleration (m/s²) and of the turn rate's change (rad/s²), each even over a step."""
SPEED_LIMIT: Final = 0.5
"""m/s, below which the axis is taken for that of this speed: it has no meaning at rest."""


class TurningFilters:
    """Filters each run's measurements, with every process noise of `GRID`.

    State [x, y, speed, heading, turn rate]. It begins with the first two positions of one sensor.

    Args:
        times: of the measurements (n,), s.
        measurements: for each time those of all runs, one detection each, of the same sensor; sensors take turns.

    Attributes:
        states: [x, y, vx, vy] after each measurement (n, runs, grid, 4); NaN before it begins.
    """

    def __init__(self, times: Floats, measurements: Sequence[Sequence[Measurement]]) -> None:
        runs = len(measurements[0])
        self.states = np.full((len(times), runs, len(GRID), 4), math.nan)
        q = np.array(GRID) ** 2
        self._q = np.tile(q, (runs, 1))
        begins = 2
        first, second = ([each.position[0] for each in measurements[k]] for k in (0, begins))
        self._begin(np.array(first), np.array(second), float(times[begins] - times[0]), measurements[begins])
        for k in range(begins, len(times)):
            if k > begins:
                self._predict(float(times[k] - times[k - 1]))
                self._update(measurements[k])
            speed, heading = self._mean[:, 2], self._mean[:, 3]
            told = np.stack([*self._mean[:, :2].T, speed * np.cos(heading), speed * np.sin(heading)], axis=1)
            self.states[k] = told.reshape(runs, len(GRID), 4)

    def _begin(self, first: Floats, second: Floats, dt: float, told: Sequence[Measurement]) -> None:
        """Begin at the second position with the velocity from the first."""
        moved = (second - first) / dt
        speed, heading = np.hypot(*moved.T), np.arctan2(moved[:, 1], moved[:, 0])
        noise = np.array([each.noise[0] for each in told])
        spread = np.sqrt(np.trace(noise, axis1=1, axis2=2)) / dt
        mean = np.stack([*second.T, speed, heading, np.zeros(len(speed))], axis=1)
        covariance = np.zeros((len(speed), 5, 5))
        covariance[:, :2, :2] = noise
        covariance[:, 2, 2] = spread**2
        covariance[:, 3, 3] = np.minimum(spread / np.maximum(speed, SPEED_LIMIT), 1.0) ** 2
        covariance[:, 4, 4] = 0.3**2
        self._mean, self._covariance = (np.repeat(each, len(GRID), axis=0) for each in (mean, covariance))

    def _predict(self, dt: float) -> None:
        """Move on an arc by its chord: along the middle heading, as long as the chord of the arc's angle."""
        _, _, speed, heading, turn = self._mean.T
        half = 0.5 * turn * dt
        middle = heading + half
        c, s = np.cos(middle), np.sin(middle)
        chord = np.sinc(half / math.pi) * dt
        # d(sin h / h)/dh, its series where h is small
        small = np.abs(half) < 1e-3
        safe = np.where(small, 1.0, half)
        slope = np.where(small, -half / 3.0, (np.cos(safe) - np.sin(safe) / safe) / safe)
        by_turn = 0.5 * dt * dt * slope * speed
        f = np.tile(np.eye(5), (len(speed), 1, 1))
        f[:, 0, 2], f[:, 1, 2] = chord * c, chord * s
        f[:, 0, 3], f[:, 1, 3] = -chord * speed * s, chord * speed * c
        f[:, 0, 4] = by_turn * c - 0.5 * dt * chord * speed * s
        f[:, 1, 4] = by_turn * s + 0.5 * dt * chord * speed * c
        f[:, 3, 4] = dt
        g = np.zeros((len(speed), 5, 2))
        g[:, 0, 0], g[:, 1, 0], g[:, 2, 0] = 0.5 * dt * dt * np.cos(heading), 0.5 * dt * dt * np.sin(heading), dt
        g[:, 3, 1], g[:, 4, 1] = 0.5 * dt * dt, dt
        self._mean = self._mean + np.stack(
            [chord * speed * c, chord * speed * s, np.zeros_like(speed), turn * dt, np.zeros_like(speed)], axis=1
        )
        noise = (g * self._q.reshape(-1, 1, 2)) @ np.swapaxes(g, 1, 2)
        self._covariance = f @ self._covariance @ np.swapaxes(f, 1, 2) + noise

    def _update(self, told: Sequence[Measurement]) -> None:
        """Take one detection a run."""
        grid = len(GRID)
        heading, speed = self._mean[:, 3], self._mean[:, 2]
        c, s = np.cos(heading), np.sin(heading)
        plane = np.stack([*self._mean[:, :2].T, speed * c, speed * s], axis=1)
        parts = [np.repeat(np.array([each.position[0] for each in told]), grid, axis=0) - plane[:, :2]]
        f = 2 + (told[0].range_rate is not None)
        h, r = np.zeros((len(plane), f, 5)), np.zeros((len(plane), f, f))
        h[:, 0, 0] = h[:, 1, 1] = 1.0
        r[:, :2, :2] = np.repeat(np.array([each.noise[0] for each in told]), grid, axis=0)
        if f == 3:
            expected, row = line_of_sight(plane, told[0].origin, told[0].velocity)
            rate = np.array([0.0 if each.range_rate is None else each.range_rate[0] for each in told])
            parts.append((np.repeat(rate, grid) - expected)[:, None])
            h[:, 2, :2] = row[:, :2]
            h[:, 2, 2] = row[:, 2] * c + row[:, 3] * s
            h[:, 2, 3] = speed * (row[:, 3] * c - row[:, 2] * s)
            r[:, 2, 2] = 0.0 if told[0].range_rate_variance is None else told[0].range_rate_variance[0]
        across = self._covariance @ np.swapaxes(h, 1, 2)
        gain = across @ np.linalg.inv(h @ across + r)
        self._mean = self._mean + (gain @ np.concatenate(parts, axis=1)[:, :, None])[:, :, 0]
        rest = np.eye(5) - gain @ h
        self._covariance = rest @ self._covariance @ np.swapaxes(rest, 1, 2) + gain @ r @ np.swapaxes(gain, 1, 2)
