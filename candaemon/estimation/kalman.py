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
    x, y = position[..., 0] - mean[..., 0], position[..., 1] - mean[..., 1]
    a = covariance[..., 0, 0] + noise[..., 0, 0]
    b = covariance[..., 0, 1] + noise[..., 0, 1]
    d = covariance[..., 1, 1] + noise[..., 1, 1]
    determinant = a * d - b * b
    inverse = np.empty((*a.shape, 2, 2))
    np.divide(d, determinant, out=inverse[..., 0, 0])
    np.divide(a, determinant, out=inverse[..., 1, 1])
    inverse[..., 0, 1] = inverse[..., 1, 0] = b / -determinant
    nis = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
    cross = covariance[..., :, :2].copy()
    gain = np.matmul(cross, inverse)
    mean += gain[..., 0] * x[..., None]
    mean += gain[..., 1] * y[..., None]
    covariance -= np.matmul(gain, np.swapaxes(cross, -1, -2))
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
    cross = np.matmul(row[..., None, :], covariance[..., : row.shape[-1], :])[..., 0, :]
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
    x, y = mean[..., 0] - origin[..., 0], mean[..., 1] - origin[..., 1]
    vx, vy = mean[..., 2] - velocity[..., 0], mean[..., 3] - velocity[..., 1]
    distance = np.sqrt(x * x + y * y)
    nearest = np.maximum(distance, 1e-3)
    x /= nearest
    y /= nearest
    rate = x * vx + y * vy
    row = np.empty((*mean.shape[:-1], 4))
    far = np.maximum(distance, 1.0)
    row[..., 0] = (vx - rate * x) / far
    row[..., 1] = (vy - rate * y) / far
    row[..., 2] = x
    row[..., 3] = y
    return rate, row


def propagated(covariance: Floats, transition: Floats) -> Floats:
    """Return F P Fᵀ of symmetric covariances (n, D, D) for transitions (n or 1, D, D)."""
    if len(transition) > 1:
        each: Floats = np.matmul(np.matmul(transition, covariance), np.swapaxes(transition, -1, -2))
        return each
    # One F for all is two large products instead of 2 n small ones: P Fᵀ, and its transpose times Fᵀ.
    width = covariance.shape[-1]
    half = (covariance.reshape(-1, width) @ transition[0].T).reshape(-1, width, width)
    both: Floats = np.swapaxes(half, 1, 2).reshape(-1, width) @ transition[0].T
    return both.reshape(-1, width, width)


def symmetrise(covariance: Floats) -> None:
    """Make the covariances symmetric in place; without it the short update form diverges in some 1,000 cycles."""
    np.add(covariance, np.swapaxes(covariance, -1, -2), out=covariance)  # numpy sees the overlap and reads a copy
    covariance *= 0.5
