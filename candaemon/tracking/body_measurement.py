"""One measurement a body from all its detections of a scan."""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.estimation.body_rates import BodyRates
from candaemon.estimation.measurement import Measurement, Projection

_FINITE = 1e-12
_LEAST_VARIANCE = 1e-4  # m²; an angle's noise is none at range 0, and no place is known better


def of_bodies(
    measurement: Measurement,
    body: Indices,
    offset: Floats,
    spread: Floats,
    speed_share: float,
    arm: Floats | None = None,
) -> tuple[Indices, Measurement, BodyRates | None]:
    """Return the detected bodies, ascending, what their leading reflections would have measured, and the range rates.

    Positions are brought to the leading reflection by the known offsets and weighted with their information; components
    of the velocity are those of one rigid body and averaged with theirs. Range rates are left as they are: each has a
    line of sight of its own.

    Args:
        measurement: m detections.
        body: row of the body of each (m,).
        offset: of the reflections from the leading one (m, 2), local frame, m.
        spread: variance of each component of the offsets (m,), m².
        speed_share: times the stated variance that speeds are taken to have.
        arm: of the reflections, as in `BodyRates`.
    """
    if compiled.in_use:
        rows, first, group, position, covariance = compiled.kernels.measure_bodies(
            body, measurement.position, measurement.noise, offset, spread, _LEAST_VARIANCE
        )
    else:
        rows, first, group, position, covariance = _places(measurement, body, offset, spread)

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(group, values, len(rows)), dtype=np.float64)

    def averaged(value: Floats, variance: Floats) -> tuple[Floats, Floats]:
        weight = np.where(np.isfinite(value), 1.0 / variance, 0.0)
        weights = total(weight)
        known = weights > _FINITE
        mean = np.full(len(rows), np.nan)
        mean[known] = total(np.where(weight > 0.0, value, 0.0) * weight)[known] / weights[known]
        return mean, speed_share / np.maximum(weights, _FINITE)

    projections = tuple(
        Projection(part.direction[first], *averaged(part.value, part.variance)) for part in measurement.projections
    )
    combined = Measurement(
        position,
        covariance,
        measurement.origin,
        measurement.velocity,
        projections=projections,
        sensor=measurement.sensor,
    )
    if measurement.range_rate is None or measurement.range_rate_variance is None:
        return rows, combined, None
    told = measurement.range_rate, measurement.range_rate_variance
    rates = BodyRates(*told, group, offset, spread, measurement.origin, measurement.velocity, speed_share, arm)
    return rows, combined, rates


def _places(
    measurement: Measurement, body: Indices, offset: Floats, spread: Floats
) -> tuple[Indices, Indices, Indices, Floats, Floats]:
    """Return places as the bodies' leading reflections would have shown them.

    Returns:
        The bodies detected (m,), ascending; the first detection of each; which of those bodies each detection is of;
        places (m, 2), m, and their covariances (m, 2, 2).
    """
    rows, first, group = np.unique(body, return_index=True, return_inverse=True)
    noise = measurement.noise.copy()
    noise[:, 0, 0] += spread + _LEAST_VARIANCE
    noise[:, 1, 1] += spread + _LEAST_VARIANCE
    a, b, d = noise[:, 0, 0], noise[:, 0, 1], noise[:, 1, 1]
    determinant = a * d - b * b
    place = measurement.position - offset

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(group, values, len(rows)), dtype=np.float64)

    xx, xy, yy = total(d / determinant), total(-b / determinant), total(a / determinant)
    ix = total((d * place[:, 0] - b * place[:, 1]) / determinant)
    iy = total((a * place[:, 1] - b * place[:, 0]) / determinant)
    information = xx * yy - xy * xy
    covariance = np.stack([yy, -xy, -xy, xx], axis=1).reshape(-1, 2, 2) / information[:, None, None]
    position = np.stack([yy * ix - xy * iy, xx * iy - xy * ix], axis=1) / information[:, None]
    return rows, first, group, position, covariance
