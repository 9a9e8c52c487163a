"""The modified linear Kalman filter (MLKF) for tracks in the plane, along the line of sight of the sensor that sees.

Source: Avatirak et al. 2012.

The paper filters range, range rate and range acceleration of each radar and finds direction and motion across by the
trilateration of two radars. A radar that tells the azimuth finds the direction alone, so beside the filter along the
line of sight there is a linear one across it. Both are the axes of one state over ground, so that own motion is taken
out and a line of sight that turns, or another sensor's, carries over what is known in the other's direction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.estimator_state import RadialTracksState
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.measurement_update import correct, take_speed
from candaemon.estimation.motion_models import ACCELERATION, POSITION, LinearModel
from candaemon.estimation.sensor_noise import SensorNoise

_UNIT = 1.0 + 1e-9
"""Longest line of sight of a state that is set."""


class RadialTracks(MomentBank):
    """The MLKF along each line of sight and a Kalman filter of constant acceleration across it; rows are tracks.

    Source: Avatirak et al. 2012, eqs. (1), (2), (3), (4), (5), (6), (7), (11).

    State order [x, y, vx, vy, ax, ay], local frame, SI units. On a line of sight that keeps its direction the state
    along it is that of `ModifiedLinearKalman`: no process noise, and a floor under the variance of the acceleration.
    The range rate, the sensor's own speed taken out, is the component of the velocity along the line, (11), which is
    linear; so each sensor that sees a track adds an equation of (11) to one state, and two that stand apart determine
    the velocity. What the line's direction, and so the range rate, owes to an uncertain position counts as noise.

    Args:
        floor: smallest variance of the acceleration along the line of sight after an update, (m/s²)².
        noise: power of the white noise on the acceleration across the line of sight, (m/s³)²/Hz. Until a track's first
            update, when no line of sight is known, it drives all directions.
        acceleration: standard deviation of a track's first acceleration, m/s².
        sensor_noise: estimates how noisy each track's detections are; None: they are as noisy as stated.
    """

    _state: RadialTracksState

    def __init__(
        self, *, floor: float, noise: float, acceleration: float, sensor_noise: SensorNoise | None = None
    ) -> None:
        self._floor = floor
        model = LinearModel(2, (0.0, noise))
        super().__init__([model], acceleration=acceleration, turn_rate=0.0, jerk=0.0, noise=sensor_noise)

    def predict(self, dt: float, direction: Floats) -> None:
        """Predict all tracks by dt (s), (1) and (2), with Q₁ = 0 along the line of sight of the latest update.

        Source: Avatirak et al. 2012, eqs. (1), (2).
        """
        del direction  # of travel, which the filter does not know
        super().predict(dt, self._state.line)

    def combined(self) -> tuple[Floats, Floats]:
        """Return the mean (n, 6) and the covariance (n, 6, 6), the floor applied."""
        covariance = self.covariance[:, 0].copy()
        self._lift(covariance)
        return self.mean[:, 0], covariance

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        super().keep(rows)
        self._state.line = self._state.line[rows]

    def _empty(self) -> RadialTracksState:
        return RadialTracksState(*self._empty_weights(), *self._empty_moments(), np.zeros((0, 2)))

    def _hand_down(self) -> None:
        super()._hand_down()
        line = self._state.line
        if not (np.hypot(line[:, 0], line[:, 1]) <= _UNIT).all():
            raise ValueError("a line of sight is no unit vector")

    def _append(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        super()._append(mean, covariance, probability)
        self._state.line = np.concatenate([self._state.line, np.zeros((len(mean), 2))])

    def _update_models(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        """Update with position and velocities, then with the range rate, (3) to (7) without D."""
        nis, log_likelihood = correct(mean, covariance, replace(measurement, range_rate=None))
        rate, row = line_of_sight(mean, measurement.origin, measurement.velocity)
        line = row[..., 2:]
        if measurement.range_rate is not None and measurement.range_rate_variance is not None:
            innovation, variance = measurement.range_rate[:, None] - rate, measurement.range_rate_variance[:, None]
            turn = row[..., POSITION]
            variance = variance + np.einsum("...i,...ij,...j->...", turn, covariance[..., POSITION, POSITION], turn)
            row[..., POSITION] = 0.0
            d_nis, d_log = take_speed(mean, covariance, row, innovation, variance)
            nis, log_likelihood = nis + d_nis, log_likelihood + d_log
        self._state.line[rows] = line[:, 0]
        return nis, log_likelihood

    def _predict_model(self, j: int, dt: float, direction: Floats) -> Floats:
        # Here, not in the update, so that a smoother takes what the floor adds for noise between the two instants.
        self._lift(self.covariance[:, j])
        return super()._predict_model(j, dt, direction)

    def _lift(self, covariance: Floats) -> None:
        """Raise in place the variances along the lines of sight of (n, 6, 6) to the floor: D of (7)."""
        line, acceleration = self._state.line, covariance[:, ACCELERATION, ACCELERATION]
        variance = np.einsum("ni,nij,nj->n", line, acceleration, line)
        lack = np.maximum(self._floor - variance, 0.0)
        acceleration += (lack[:, None] * line)[:, :, None] * line[:, None, :]

    def _interact(self, dt: float) -> None:
        """Do nothing: there is one model."""

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Do nothing: there is one model."""
