"""Filters over recorded positions, all Monte Carlo runs as one batch of tracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from candaemon.config.estimators import ImmEstimatorSettings
from candaemon.estimation.bank import Bank
from candaemon.estimation.imm import Imm
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.models import ACCELERATION, TURN, CoordinatedTurn, LinearModel
from candaemon.tracking.estimators import make_imm

Floats = NDArray[np.float64]

QUANTITIES = (
    ("position x", "m"),
    ("position y", "m"),
    ("velocity x", "m/s"),
    ("velocity y", "m/s"),
    ("acceleration x", "m/s²"),
    ("acceleration y", "m/s²"),
)
"""What is estimated, and its units, in the order of the told state."""
_AT_REST = np.zeros(2)


def default_estimator() -> Imm:
    """Return the filter that the daemon uses where nothing else is configured."""
    return make_imm(ImmEstimatorSettings())


def follow(
    bank: Bank,
    dt: float,
    positions: Floats,
    noise: Floats,
    velocity: Floats,
    velocity_noise: Floats,
    before: Callable[[int, Bank], None] | None = None,
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


def clairvoyant(
    dt: float,
    positions: Floats,
    noise: Floats,
    velocity: Floats,
    velocity_noise: Floats,
    *,
    acceleration: float,
    turn_rate: float | None,
    opening: NDArray[np.bool_],
) -> Floats:
    """Track as a filter would that is told the instants at which the manoeuvre changes, and nothing else of it.

    Between them its model is exact and has no noise: constant acceleration, or constant speed and turn rate. At them
    the manoeuvre becomes unknown again. No causal filter that must find the instants itself does better on average.

    Args:
        dt: s between two measurements.
        positions: (steps, runs, 2), m.
        noise: their covariance (2, 2), m².
        velocity: first velocity (2,) or (runs, 2), m/s.
        velocity_noise: its covariance (2, 2).
        acceleration: standard deviation of the accelerations that the target takes, m/s².
        turn_rate: standard deviation of the turn rates, rad/s, where the target turns; None: it accelerates.
        opening: (steps,), whether the manoeuvre changes between the step before and this one.

    Returns:
        Estimates (steps, runs, 6).
    """
    model = LinearModel(2, (0.0, 0.0)) if turn_rate is None else CoordinatedTurn(0.0, 0.0)
    imm = Imm([model], switch_rate=1.0, acceleration=acceleration, turn_rate=turn_rate or 1.0)

    def before(step: int, bank: Bank) -> None:
        if not opening[step]:
            return
        if turn_rate is None:
            _forget(bank, ACCELERATION, acceleration)
        else:
            _forget(bank, slice(TURN, TURN + 1), turn_rate)

    return follow(imm, dt, positions, noise, velocity, velocity_noise, before)


def rmse(estimates: Floats, truth: Floats) -> Floats:
    """Return root mean square errors over steps and runs.

    Args:
        estimates: (steps, runs, components).
        truth: (steps, components).
    """
    return np.asarray(np.sqrt(np.square(estimates - truth[:, None]).mean(axis=(0, 1))))


def _forget(bank: Bank, block: slice, deviation: float) -> None:
    """Make components unknown but for their deviation, with nothing left that ties them to the others."""
    bank.covariance[:, :, block, :] = 0.0
    bank.covariance[:, :, :, block] = 0.0
    width = bank.mean[:, :, block].shape[-1]
    bank.mean[:, :, block] = 0.0
    bank.covariance[:, :, block, block] = deviation**2 * np.eye(width)
