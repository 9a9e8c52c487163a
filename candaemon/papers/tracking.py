"""Filters over recorded positions, all Monte Carlo runs as one batch of tracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.estimators import ImmEstimatorSettings
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Imm
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.smoothing import Step, smooth
from candaemon.tracking.estimator_factory import make_imm

QUANTITIES = (
    ("position x", "m"),
    ("position y", "m"),
    ("velocity x", "m/s"),
    ("velocity y", "m/s"),
    ("acceleration x", "m/s²"),
    ("acceleration y", "m/s²"),
)
"""What is estimated, and its units, in the order of the reported state."""
_AT_REST = np.zeros(2)


def default_estimator() -> Imm:
    """Return the filter that the daemon uses where nothing else is configured."""
    return make_imm(ImmEstimatorSettings())


def follow(
    bank: FilterBank,
    dt: float,
    positions: Floats,
    noise: Floats,
    velocity: Floats,
    velocity_noise: Floats,
    before: Callable[[int, FilterBank], None] | None = None,
) -> Floats:
    """Track measured positions; the first one begins the tracks.

    Args:
        bank: of filters, without tracks.
        dt: s between two measurements.
        positions: (steps, runs, 2), m.
        noise: their covariance (2, 2), m².
        velocity: first velocity (2,) or (runs, 2), m/s.
        velocity_noise: its covariance (2, 2).
        before: called before each prediction with the index of the step that it leads to.

    Returns:
        Estimates (steps, runs, 6) of [x, y, vx, vy, ax, ay].
    """
    steps, runs, _ = positions.shape
    estimates = np.empty((steps, runs, 6))
    rows, direction = np.arange(runs), np.tile([1.0, 0.0], (runs, 1))
    spread = np.broadcast_to(noise, (runs, 2, 2))
    velocity = np.broadcast_to(velocity, (runs, 2))
    bank.spawn(positions[0], spread, velocity, np.broadcast_to(velocity_noise, (runs, 2, 2)))
    estimates[0] = bank.combined()[0]
    for k in range(1, steps):
        if before is not None:
            before(k, bank)
        bank.predict(dt, direction)
        bank.update(rows, Measurement(positions[k], spread, _AT_REST, _AT_REST))
        estimates[k] = bank.combined()[0]
    return estimates


def follow_smoothed(
    bank: FilterBank, lag_ns: int, dt: float, positions: Floats, noise: Floats, velocity: Floats, velocity_noise: Floats
) -> tuple[Floats, Floats, Floats]:
    """Track as `follow` does, and smooth what was tracked over a fixed lag.

    Args:
        bank: of filters, without tracks.
        lag_ns: how long an instant learns.
        dt: s between two measurements.
        positions: (steps, runs, 2), m.
        noise: their covariance (2, 2), m².
        velocity: first velocity (2,) or (runs, 2), m/s.
        velocity_noise: its covariance (2, 2).

    Returns:
        Filtered and smoothed estimates (steps, runs, 6) of [x, y, vx, vy, ax, ay], and the covariances of the smoothed
        ones (steps, runs, 6, 6).
    """
    steps: list[Step] = []

    def record(step: int, bank: FilterBank) -> None:
        mean, covariance = bank.combined()
        steps.append(Step(round((step - 1) * dt * 1e9), mean.copy(), covariance.copy(), bank.link))

    bank.linking = True
    estimates = follow(bank, dt, positions, noise, velocity, velocity_noise, record)
    record(len(positions), bank)
    return estimates, *smooth(steps, lag_ns)


def rmse(estimates: Floats, truth: Floats) -> Floats:
    """Return root mean square errors over steps and runs.

    Args:
        estimates: (steps, runs, components).
        truth: (steps, components).
    """
    return np.asarray(np.sqrt(np.square(estimates - truth[:, None]).mean(axis=(0, 1))))
