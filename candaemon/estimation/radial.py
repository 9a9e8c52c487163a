"""Range, range rate and range acceleration of one target at one sensor, and the filter over them.

Source: Avatirak et al. 2012.

State order along the line of sight [r, ṙ, r̈]: m, m/s, m/s², positive away from the sensor. Points of the plane are
[x, y, vx, vy, ax, ay] in any axes in which the sensors rest; in vehicle axes, which may turn, velocity and acceleration
are the first and second derivatives of the coordinates.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.discretisation import white_axis
from candaemon.estimation.kalman import LOG_2PI, Fit, propagated, symmetrise

_NEAREST = 1e-3
"""m, below which a line of sight has no direction."""
_LEAST_VARIANCE = 1e-200
"""Of an innovation, SI units: what is known exactly and measured exactly divides by it, and does not change."""


def radial(state: Floats, sensors: Floats, *, centripetal: bool = True) -> Floats:
    """Return what each sensor measures of moving points.

    Source: Avatirak et al. 2012, eqs. (23), (24), (25), (26).

    Args:
        state: [x, y, vx, vy, ax, ay] (…, 6), relative to the axes of the sensors.
        sensors: positions (s, 2), m.
        centripetal: with the term v⊥²/r of the range acceleration, v⊥ the speed across the line of sight, which (26)
            leaves out. Without it r̈ is not the derivative of ṙ: by 8 m/s² where a target crosses at 9 m/s in 10 m.

    Returns:
        [r, ṙ, r̈] of each sensor (…, s, 3).
    """
    distance, line, velocity, acceleration = _along(state, sensors)
    rate = (line * velocity).sum(axis=-1)
    across = velocity - rate[..., None] * line
    pull = (line * acceleration).sum(axis=-1)
    if centripetal:
        pull = pull + (across**2).sum(axis=-1) / np.maximum(distance, _NEAREST)
    return np.stack([distance, rate, pull], axis=-1)


def radial_jacobian(state: Floats, sensors: Floats, *, centripetal: bool = True) -> Floats:
    """Return the derivatives of `radial` over [x, y, vx, vy, ax, ay], (…, s, 3, 6)."""
    distance, line, velocity, acceleration = _along(state, sensors)
    reach = np.maximum(distance, _NEAREST)[..., None]
    rate = (line * velocity).sum(axis=-1, keepdims=True)
    across = velocity - rate * line
    jacobian = np.zeros((*line.shape[:-1], 3, 6))
    jacobian[..., 0, :2] = jacobian[..., 1, 2:4] = jacobian[..., 2, 4:] = line
    jacobian[..., 1, :2] = across / reach
    jacobian[..., 2, :2] = (acceleration - (line * acceleration).sum(axis=-1, keepdims=True) * line) / reach
    if centripetal:
        jacobian[..., 2, :2] -= (2 * rate * across + (across**2).sum(axis=-1, keepdims=True) * line) / reach**2
        jacobian[..., 2, 2:4] = 2 * across / reach
    return jacobian


def _along(state: Floats, sensors: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return distance (…, s), unit line of sight (…, s, 2), velocity and acceleration (…, 1, 2)."""
    offset = state[..., None, :2] - sensors
    distance = np.sqrt((offset**2).sum(axis=-1))
    return distance, offset / np.maximum(distance, _NEAREST)[..., None], state[..., None, 2:4], state[..., None, 4:6]


class ModifiedLinearKalman:
    """The modified linear Kalman filter (MLKF), batched: a row is one target at one sensor.

    Source: Avatirak et al. 2012, eq. (1) to (7).

    State order [r, ṙ, r̈], all three measured (C = I), no process noise (Q₁ = 0). F holds T²/2 where the paper prints
    T². What keeps the filter from falling asleep is the modification D of the covariance. As printed, D subtracts
    e^K33 from K33, which is less than e^K33 whatever its value: the first update leaves a negative variance. A floor
    serves its purpose instead, K33 := max(K33, floor): the acceleration stays so unknown that it can change.

    Args:
        floor: smallest variance of the range acceleration after an update, (m/s²)². The larger, the quicker the filter
            follows a change of acceleration, and the noisier it is.

    Attributes:
        mean: (n, 3).
        covariance: K (n, 3, 3).
    """

    def __init__(self, *, floor: float = 0.3) -> None:
        self._floor = floor
        self.mean: Floats = np.zeros((0, 3))
        self.covariance: Floats = np.zeros((0, 3, 3))

    def __len__(self) -> int:
        return len(self.mean)

    def spawn(self, mean: Floats, covariance: Floats | None = None) -> None:
        """Append k rows.

        Args:
            mean: first [r, ṙ, r̈] (k, 3), such as the first measurement.
            covariance: (k, 3, 3) or (3, 3); None: the unit matrix, K[1|0] of the paper.
        """
        first = np.broadcast_to(np.eye(3) if covariance is None else covariance, (len(mean), 3, 3))
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, first])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self.mean, self.covariance = self.mean[rows], self.covariance[rows]

    def predict(self, dt: float) -> None:
        """Predict all rows by dt (s): (1) and (2).

        Source: Avatirak et al. 2012, eqs. (1), (2).
        """
        f = white_axis(dt, 0.0, order=2).transition
        self.mean = self.mean @ f.T
        self.covariance = propagated(self.covariance, f[None])

    def update(self, rows: Indices, measured: Floats, variance: Floats) -> Fit:
        """Update with measurements: (3) to (7).

        Source: Avatirak et al. 2012, eqs. (3), (4), (5), (6), (7).

        Args:
            rows: (m,) rows, each at most once.
            measured: y = [r, ṙ, r̈] (m, 3); NaN where one was not measured.
            variance: of the three, the diagonal of Q₂, (3,) or (m, 3).

        Returns:
            The fit before the update (m,), three degrees of freedom, fewer where something was not measured.
        """
        mean, covariance = self.mean[rows], self.covariance[rows]
        variance = np.broadcast_to(variance, measured.shape)
        known = np.isfinite(measured)
        nis, log_likelihood = np.zeros(len(rows)), np.zeros(len(rows))
        # 64 rows: 0.9 ms, `kalman.update` 2.3 ms (2.4 times as long).
        for k in range(3):  # Q₂ is diagonal: one after another is the joint update, with no inverse
            seen = known[:, k]
            cross = covariance[:, k].copy()
            s = np.maximum(cross[:, k] + variance[:, k], _LEAST_VARIANCE)
            gain = cross / s[:, None] * seen[:, None]
            innovation = np.where(seen, measured[:, k] - mean[:, k], 0.0)
            mean += gain * innovation[:, None]
            covariance -= gain[:, :, None] * cross[:, None, :]
            # what is measured becomes K − G C K without a difference, which would round off all of a good measurement
            covariance[:, k] = covariance[:, :, k] = np.where(seen[:, None], gain * variance[:, k, None], cross)
            fit = innovation**2 / s
            nis += fit
            log_likelihood -= np.where(seen, 0.5 * (fit + np.log(s) + LOG_2PI), 0.0)
        symmetrise(covariance)
        covariance[:, 2, 2] = np.maximum(covariance[:, 2, 2], self._floor)
        self.mean[rows], self.covariance[rows] = mean, covariance
        return Fit(nis, log_likelihood)
