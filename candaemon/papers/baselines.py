"""The papers' plain Kalman filters, run on filterpy."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter

from candaemon.arrays import Floats


def linear(
    transition: Floats,
    noise: Floats,
    observation: Floats,
    measurement_noise: Floats,
    mean: Floats,
    covariance: Floats,
    measured: Floats,
) -> Floats:
    """Filter measurements with a Kalman filter of fixed matrices; each step predicts, then updates.

    Args:
        transition: F (D, D).
        noise: Q (D, D).
        observation: H (m, D).
        measurement_noise: R (m, m).
        mean: state before the first prediction, (D,) or (runs, D).
        covariance: its covariance (D, D).
        measured: (steps, runs, m).

    Returns:
        Estimates (steps, runs, D).
    """
    steps, runs, _ = measured.shape
    estimates = np.empty((steps, runs, len(transition)))
    state = np.broadcast_to(mean, (runs, len(transition)))
    for k, gain in enumerate(_gains(transition, noise, observation, measurement_noise, covariance, steps)):
        predicted = state @ transition.T
        state = predicted + (measured[k] - predicted @ observation.T) @ gain.T
        estimates[k] = state
    return estimates


def _gains(
    transition: Floats, noise: Floats, observation: Floats, measurement_noise: Floats, covariance: Floats, steps: int
) -> list[Floats]:
    """Return each step's gain (D, m): with fixed matrices it depends on no measurement, so that one filter has all."""
    filter_ = KalmanFilter(dim_x=len(transition), dim_z=len(observation))
    filter_.F, filter_.Q, filter_.H, filter_.R, filter_.P = (
        transition,
        noise,
        observation,
        measurement_noise,
        covariance,
    )
    gains = []
    for _ in range(steps):
        filter_.predict()
        filter_.update(np.zeros((len(observation), 1)))
        gains.append(filter_.K)
    return gains
