"""The filters that Han et al. 2015 compares, and one that it mentions: each axis by itself, and an IMM in the plane."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.axis_filter import AxisFilter
from candaemon.estimation.discretisation import white_axis
from candaemon.estimation.imm import Imm
from candaemon.estimation.motion_models import CurrentStatistical, LinearModel
from candaemon.papers.baselines import linear

CA_NOISE = 1e-3
"""(m/s³)²/Hz, of the CA model."""
STATISTICAL = (CurrentStatistical(0.4, 4.0, 0.0), CurrentStatistical(0.4, 0.4, 0.0))
"""The CS model along x and along y: α 0.4 1/s; a_max 1.25 times the constant acceleration of section 3.2, and more."""


def constant_acceleration(dt: float, variance: float, measured: Floats) -> Floats:
    """Filter with the CA model on filterpy, from X(0) = 0 and P(0) = I (23).

    Args:
        dt: s.
        variance: of the noise of a measured position, m².
        measured: (steps, runs, 2), m.

    Returns:
        Estimates (steps, runs, 6) of [x, y, vx, vy, ax, ay].
    """
    steps, runs, _ = measured.shape
    axis, observation = white_axis(dt, CA_NOISE, order=2), np.eye(1, 3)
    either = measured.reshape(steps, 2 * runs, 1)  # the axes differ in what is measured alone
    estimates = linear(axis.transition, axis.noise, observation, np.array([[variance]]), np.zeros(3), np.eye(3), either)
    return _interleaved(estimates.reshape(steps, runs, 2, 3))


def current_statistical(dt: float, variance: float, measured: Floats) -> Floats:
    """Filter with the CS model (14) to (29), from X(0) = 0 and P(0) = I; see `constant_acceleration`."""
    steps, runs, _ = measured.shape
    estimates = np.empty((steps, runs, 2, 3))
    for axis, model in enumerate(STATISTICAL):
        one = AxisFilter(model)
        one.spawn(np.zeros((runs, 3)), np.tile(np.eye(3), (runs, 1, 1)))
        for k in range(steps):
            one.predict(dt)
            one.update(measured[k, :, axis], variance)
            estimates[k, :, axis] = one.mean
    return _interleaved(estimates)


def three_models() -> Imm:
    """Return an IMM of constant velocity, constant acceleration and changing acceleration, without tracks."""
    models = [LinearModel(1, (1e-3, 1e-3)), LinearModel(2, (1e-3, 1e-3)), LinearModel(2, (5.0, 5.0))]
    return Imm(models, switch_rate=0.03, acceleration=3.0)


def variances(acceleration: Floats) -> Floats:
    """Return σ² of (20) along x and y for estimated accelerations, (…, 2) both."""
    return np.stack([model.variance(acceleration[..., axis]) for axis, model in enumerate(STATISTICAL)], axis=-1)


def _interleaved(per_axis: Floats) -> Floats:
    """Turn (steps, runs, axis, derivative) into [x, y, vx, vy, ax, ay], (steps, runs, 6)."""
    steps, runs = per_axis.shape[:2]
    return np.asarray(np.swapaxes(per_axis, -2, -1).reshape(steps, runs, 6))
