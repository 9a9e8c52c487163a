"""Measurement updates of tracks by a radar's detections: in covariance form and in information form."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation import information
from candaemon.estimation.kalman import update_position, update_scalar
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.motion_models import VELOCITY


def correct(mean: Floats, covariance: Floats, measurement: Measurement) -> tuple[Floats, Floats]:
    """Update k tracks under M models as extended Kalman filters do, in place: the position, then speed by speed.

    Returns:
        NIS and log likelihood, (k, M) each.
    """
    fit = update_position(mean, covariance, measurement.position[:, None], measurement.noise[:, None])
    nis, log_likelihood = fit.nis, fit.log_likelihood
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        rate, row = line_of_sight(mean, measurement.origin, measurement.velocity)
        d_nis, d_log = take_speed(
            mean, covariance, row, measurement.range_rate[:, None] - rate, measurement.range_rate_variance[:, None]
        )
        nis, log_likelihood = nis + d_nis, log_likelihood + d_log
    for part in measurement.projections:
        row = np.zeros((*mean.shape[:2], 4))
        row[:, :, 2:] = part.direction[:, None]
        speed = (row[:, :, 2:] * mean[:, :, VELOCITY]).sum(axis=-1)
        d_nis, d_log = take_speed(mean, covariance, row, part.value[:, None] - speed, part.variance[:, None])
        nis, log_likelihood = nis + d_nis, log_likelihood + d_log
    return nis, log_likelihood


def take_speed(
    mean: Floats, covariance: Floats, row: Floats, innovation: Floats, variance: Floats
) -> tuple[Floats, Floats]:
    """Update with one speed; where it was not measured (NaN), change nothing and fit perfectly.

    Args:
        mean: states (k, M, D), changed in place.
        covariance: (k, M, D, D), changed in place.
        row: Jacobian over [x, y, vx, vy], (k, M, 4).
        innovation: measured minus predicted, m/s; broadcasts to (k, M).
        variance: of the measurement, (m/s)²; likewise.

    Returns:
        NIS and log likelihood, (k, M) each.
    """
    known = np.isfinite(innovation)
    if not known.all():
        row = np.where(known[..., None], row, 0.0)
        innovation = np.where(known, innovation, 0.0)
    fit = update_scalar(mean, covariance, row, innovation, variance)
    return fit.nis, np.where(known, fit.log_likelihood, 0.0)


def inform(mean: Floats, covariance: Floats, measurement: Measurement) -> tuple[Floats, Floats]:
    """Update k tracks under M models as nonlinear information filters do, in place.

    Source: Kim and Hong 2004, eq. (17).

    All parts of a detection are linearised at the prediction. A component that a model lacks has no variance, and so
    learns nothing.

    Returns:
        NIS and log likelihood, (k, M) each.
    """
    k, m, d = mean.shape
    state, spread = mean.reshape(-1, d), covariance.reshape(-1, d, d)
    fit = information.update(state, spread, *measurement.take(np.repeat(np.arange(k), m)).linearised(state))
    mean[...], covariance[...] = state.reshape(mean.shape), spread.reshape(covariance.shape)
    return fit.nis.reshape(k, m), fit.log_likelihood.reshape(k, m)
