"""Covariance intersection: fusion with estimates whose errors are correlated to an unknown degree; batched over tracks.

Source: Julier and Uhlmann 1997.

A sensor that filters by itself delivers tracks: their errors last from scan to scan, and a Kalman filter that takes
each for new information becomes ever surer of the same error. Here P⁻¹ = ω P₁⁻¹ + (1 − ω) Hᵀ R⁻¹ H, which is consistent
whatever the correlation is; ω is the one that leaves the least variance.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.kalman import update
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import MotionModel
from candaemon.estimation.sensor_noise import SensorNoise

_WEIGHTS = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98])
"""1 − ω, weights of the measurement that are tried."""
_HORIZON = 1.0
"""s, with which variances of the velocity count as those of a position."""


class IntersectionTracks(MomentBank):
    """A filter of one model that takes each detection by covariance intersection; rows are tracks.

    Args:
        model: the motion model.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
        jerk: standard deviation of a track's first jerk, m/s³.
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.
    """

    def __init__(
        self,
        model: MotionModel,
        *,
        acceleration: float,
        turn_rate: float,
        jerk: float,
        noise: SensorNoise | None = None,
    ) -> None:
        super().__init__([model], acceleration=acceleration, turn_rate=turn_rate, jerk=jerk, noise=noise)

    def _update_models(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        """Update with P/ω and R/(1 − ω), which is the intersection, for the ω that leaves the least variance."""
        if not len(rows):
            return np.zeros((0, 1)), np.zeros((0, 1))
        innovation, observation, noise = measurement.linearised(mean[:, 0])
        plain = update(mean[:, 0].copy(), covariance[:, 0].copy(), innovation, observation, noise)
        count, tries = len(rows), len(_WEIGHTS)
        weight = np.tile(_WEIGHTS, count)[:, None, None]
        state, spread = (np.repeat(each[:, 0], tries, axis=0) for each in (mean, covariance))
        spread /= 1.0 - weight
        update(
            state,
            spread,
            np.repeat(innovation, tries, axis=0),
            np.repeat(observation, tries, axis=0),
            np.repeat(noise, tries, axis=0) / weight,
        )
        variance = np.diagonal(spread, axis1=1, axis2=2)
        cost = (variance[:, :2].sum(axis=1) + _HORIZON**2 * variance[:, 2:4].sum(axis=1)).reshape(count, tries)
        best = np.arange(count) * tries + cost.argmin(axis=1)
        mean[:, 0], covariance[:, 0] = state[best], spread[best]
        return plain.nis[:, None], plain.log_likelihood[:, None]

    def _interact(self, dt: float) -> None:
        """Do nothing: there is one model."""

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Do nothing: there is one model."""
