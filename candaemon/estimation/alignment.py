"""Sensors brought to one instant and into one set of axes: Gao et al. 2016, sections 3.4 and 3.5.

Its equations are counted as in `candaemon.estimation.innovation_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats


@dataclass(frozen=True, slots=True)
class Aligned:
    """Values at the instants asked for.

    Attributes:
        value: (n, d).
        extrapolated: whether the instant lies outside the three samples, (n,).
        limited: whether it lies farther outside than allowed, so that the value is that of the limit, (n,).
    """

    value: Floats
    extrapolated: Booleans
    limited: Booleans


def lagrange(times: Floats, values: Floats, instant: Floats, reach: float) -> Aligned:
    """Interpolate by the parabola through three samples; the samples need not be evenly spaced.

    Source: Gao et al. 2016, eq. (28).

    Past the samples the parabola goes on, and soon far from the truth; so it does only up to `reach`.

    Args:
        times: of the samples, rising, (n, 3), s.
        values: (n, 3, d), any unit.
        instant: of the fusion, (n,), s.
        reach: how long past the first or last sample is extrapolated, s.

    Raises:
        ValueError: times do not rise.
    """
    if not (np.diff(times, axis=1) > 0.0).all():
        raise ValueError("the times of the three samples must rise")
    earliest, latest = times[:, 0], times[:, 2]
    at = np.clip(instant, earliest - reach, latest + reach)
    weight = _weights(times, at)
    return Aligned(
        value=np.matmul(weight[:, None, :], values)[:, 0],
        extrapolated=(instant < earliest) | (instant > latest),
        limited=at != instant,
    )


def _weights(times: Floats, at: Floats) -> Floats:
    """Return the three Lagrange polynomials at the instants, (n, 3)."""
    t0, t1, t2 = times[:, 0], times[:, 1], times[:, 2]
    to0, to1, to2 = at - t0, at - t1, at - t2
    return np.stack(
        [
            to1 * to2 / ((t0 - t1) * (t0 - t2)),
            to0 * to2 / ((t1 - t0) * (t1 - t2)),
            to0 * to1 / ((t2 - t0) * (t2 - t1)),
        ],
        axis=-1,
    )


def mounting_rotation(deflection: float, pitch: float) -> Floats:
    """Return R, which turns sensor axes into the car's: R = R_z(φ) R_x(α), (3, 3).

    Source: Gao et al. 2016, eq. (27).

    The paper's axes: x transverse, to the right; y longitudinal, forward; z up. As printed it is no rotation, whatever
    signs were lost: the length of the last column is √2 cos α. What is meant is (sin φ sin α, −cos φ sin α, cos α).

    Args:
        deflection: φ about z, rad; positive: the sensor looks to the left of the car's y axis.
        pitch: α about x, rad; positive: it looks up.
    """
    (cos_phi, sin_phi), (cos_alpha, sin_alpha) = _cosine_sine(deflection), _cosine_sine(pitch)
    return np.array(
        (
            (cos_phi, -sin_phi * cos_alpha, sin_phi * sin_alpha),
            (sin_phi, cos_phi * cos_alpha, -cos_phi * sin_alpha),
            (0.0, sin_alpha, cos_alpha),
        )
    )


def mounted(points: Floats, rotation: Floats, position: Floats) -> Floats:
    """Return points in the car's axes.

    Source: Gao et al. 2016, eq. (26).

    Args:
        points: in the sensor's axes (…, 3), m.
        rotation: of the mounting (3, 3).
        position: of the sensor in the car's axes (3,), m.
    """
    placed: Floats = points @ rotation.T + position
    return placed


def _cosine_sine(angle: float) -> tuple[float, float]:
    return float(np.cos(angle)), float(np.sin(angle))
