"""Avatirak et al. 2012's extended Kalman filter on ranges alone, (13) to (19), run on filterpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from candaemon.arrays import Floats


def range_ekf(
    ranges: Floats,
    sensors: Floats,
    deviation: float,
    dt: float,
    first: Floats,
    every: int,
    advance: Callable[[float], None],
) -> Floats:
    """Track targets of constant acceleration by their ranges: C of the paper, Q₁ = 0 and K[1|0] = I as printed.

    Source: Avatirak et al. 2012, eqs. (13), (14), (15), (16), (17), (18), (19).

    With no process noise the filter models the acceleration as constant, so that changes of it are its error.

    Args:
        ranges: measured (steps, runs, s), m.
        sensors: positions (s, 2), m.
        deviation: of a range, m.
        dt: s between two steps.
        first: [x, y, vx, vy, ax, ay] at the first step, (runs, 6), m, m/s, m/s².
        every: one estimate is returned for so many steps.
        advance: called with the share of the runs that was done since the last call.

    Returns:
        Estimates (steps // every, runs, 6), the first one of step `every` − 1.
    """
    steps, runs, count = ranges.shape
    transition = np.eye(6) + dt * np.eye(6, k=2) + dt**2 / 2 * np.eye(6, k=4)
    jacobian = np.zeros((count, 6))

    def predicted(state: Floats) -> Floats:
        return np.asarray(np.hypot(state[0] - sensors[:, 0], state[1] - sensors[:, 1]))

    def linearised(state: Floats) -> Floats:
        jacobian[:, :2] = (state[:2] - sensors) / predicted(state)[:, None]
        return jacobian

    estimates = np.empty((steps // every, runs, 6))
    for run in range(runs):
        ekf = ExtendedKalmanFilter(dim_x=6, dim_z=count)
        ekf.x, ekf.P, ekf.F = first[run].copy(), np.eye(6), transition
        ekf.Q, ekf.R = np.zeros((6, 6)), deviation**2 * np.eye(count)
        for step in range(1, steps):
            ekf.predict()
            ekf.update(ranges[step, run], linearised, predicted)
            if (step + 1) % every == 0:
                estimates[step // every, run] = ekf.x
        advance(1 / runs)
    return estimates
