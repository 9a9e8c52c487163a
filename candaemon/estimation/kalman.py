"""Measurement updates of the Kalman filter, batched: m states at once, no matrix inverse.

A radar object is a position (two dimensions, correlated) and up to two speeds, each a scalar. The position is
updated jointly with the 2 × 2 inverse written out, the speeds one after another, linearised at the state so far.
Arrays are (…, D) for means and (…, D, D) for covariances with any leading shape; updates are in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a measurement fits its prediction.

    Attributes:
        nis: normalised innovation squared.
        log_likelihood: of the innovation.
    """

    nis: Floats
    log_likelihood: Floats


def update_position(mean: Floats, covariance: Floats, position: Floats, noise: Floats) -> Fit:
    """Update with a measured position.

    Args:
        mean: states (…, D), x and y first; changed in place.
        covariance: (…, D, D), changed in place.
        position: measured (…, 2), m, in the axes of the state.
        noise: its covariance (…, 2, 2).

    Returns:
        The fit before the update, two degrees of freedom.
    """
    innovation = position - mean[..., :2]
    s = covariance[..., :2, :2] + noise
    a, b, d = s[..., 0, 0], s[..., 0, 1], s[..., 1, 1]
    determinant = a * d - b * b
    inverse = np.empty_like(s)
    inverse[..., 0, 0], inverse[..., 1, 1] = d, a
    inverse[..., 0, 1] = inverse[..., 1, 0] = -b
    inverse /= determinant[..., None, None]
    weighted = np.matmul(inverse, innovation[..., None])
    nis = innovation[..., 0] * weighted[..., 0, 0] + innovation[..., 1] * weighted[..., 1, 0]
    cross = covariance[..., :, :2].copy()
    mean += np.matmul(cross, weighted)[..., 0]
    covariance -= np.matmul(np.matmul(cross, inverse), np.swapaxes(cross, -1, -2))
    return Fit(nis, -0.5 * (nis + np.log(determinant)) - LOG_2PI)


def update_scalar(mean: Floats, covariance: Floats, row: Floats, innovation: Floats, variance: Floats) -> Fit:
    """Update with one measured number.

    Args:
        mean: states (…, D), changed in place.
        covariance: (…, D, D), changed in place.
        row: the measurement's Jacobian over the first K components, (…, K).
        innovation: measured minus predicted (…).
        variance: of the measurement (…).

    Returns:
        The fit before the update, one degree of freedom.
    """
    cross = np.matmul(covariance[..., : row.shape[-1]], row[..., None])[..., 0]
    s = (row * cross[..., : row.shape[-1]]).sum(axis=-1) + variance
    gain = cross / s[..., None]
    mean += gain * innovation[..., None]
    covariance -= gain[..., :, None] * cross[..., None, :]
    nis = innovation**2 / s
    return Fit(nis, -0.5 * (nis + np.log(s) + LOG_2PI))


def line_of_sight(mean: Floats, origin: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    """Return the predicted range rate (…) and its Jacobian (…, 4) over x, y, vx, vy.

    Args:
        mean: states (…, D).
        origin: the sensor's position (…, 2), m, in the axes of the state.
        velocity: the sensor's velocity over ground (…, 2), m/s.
    """
    offset = mean[..., :2] - origin
    distance = np.sqrt((offset * offset).sum(axis=-1, keepdims=True))
    unit = offset / np.maximum(distance, 1e-3)
    relative = mean[..., 2:4] - velocity
    rate = (unit * relative).sum(axis=-1)
    row = np.empty((*mean.shape[:-1], 4))
    row[..., :2] = (relative - rate[..., None] * unit) / np.maximum(distance, 1.0)
    row[..., 2:] = unit
    return rate, row


def symmetrise(covariance: Floats) -> None:
    """Make the covariances symmetric in place; without it the short update form diverges in some 1,000 cycles."""
    covariance += np.swapaxes(covariance, -1, -2).copy()
    covariance *= 0.5
