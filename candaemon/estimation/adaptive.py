"""Innovation-based adaptive estimation (IAE) of a linear filter's noise, batched over tracks, section 3.2.

Source: Gao et al. 2016.

How large the innovations of the last N updates were tells how large the measurement noise is. The copy of the paper at
hand lost its equation numbers, inverses, sums and minus signs; here its equations are counted from (1), the state
equation, to (28), the interpolation, and the signs are put back.

The window holds the innovations as they came. Those that the chi-square test (17), (18) has corrected would tell it
that all is well: in a burst of 200 times the noise it would empty itself, and the sensor be locked out for good.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.kalman import predict, update

CHI_SQUARE = 7.879
"""What the square of a standard normal number exceeds once in 200 times: α = 0.005 at one degree of freedom."""
_TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, slots=True)
class Adapted:
    """What an innovation taught.

    Attributes:
        innovation: to update the state with, (m, d).
        noise: covariance of the measurement, R̂, (m, d, d).
        spread: covariance of the innovation, Ĉ, (m, d, d).
    """

    innovation: Floats
    noise: Floats
    spread: Floats


class NoiseEstimator(Protocol):
    """Learns a sensor's measurement noise from innovations, for each of n tracks."""

    def spawn(self, count: int) -> None:
        """Append tracks whose noise is the nominal one."""
        ...

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        ...

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats) -> Adapted:
        """Learn from an innovation of each of the given rows, before the filter's own update.

        Args:
            rows: (m,), each once.
            innovation: v = z − H x⁻, (m, d).
            predicted: H P⁻ Hᵀ (m, d, d), the prediction's share in its covariance.
        """
        ...


class InnovationWindow:
    """The last innovations of n tracks, in one ring a track.

    Args:
        size: N, how many.
        dimension: d of an innovation.
    """

    def __init__(self, size: int, dimension: int) -> None:
        self._ring: Floats = np.zeros((0, size, dimension))
        self._count: Indices = np.zeros(0, dtype=np.intp)

    def __len__(self) -> int:
        return len(self._ring)

    def spawn(self, count: int) -> None:
        """Append tracks that have seen nothing."""
        self._ring = np.concatenate([self._ring, np.zeros((count, *self._ring.shape[1:]))])
        self._count = np.concatenate([self._count, np.zeros(count, dtype=np.intp)])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self._ring, self._count = self._ring[rows], self._count[rows]

    def push(self, rows: Indices, innovation: Floats) -> None:
        """Take an innovation (m, d) of each of the given rows in the place of the oldest."""
        self._ring[rows, self._count[rows] % self._ring.shape[1]] = innovation
        self._count[rows] += 1

    def full(self, rows: Indices) -> Booleans:
        """Return whether the window of each row has filled, (m,)."""
        filled: Booleans = self._count[rows] >= self._ring.shape[1]
        return filled

    def covariance(self, rows: Indices) -> Floats:
        """Return Ĉ = (1/N) Σ v vᵀ of the rows (m, d, d); too small until the window is full.

        Source: Gao et al. 2016, eq. (14).
        """
        seen = self._ring[rows]
        spread: Floats = np.matmul(np.swapaxes(seen, 1, 2), seen) / self._ring.shape[1]
        return spread


def measurement_noise(spread: Floats, predicted: Floats, least: Floats) -> Floats:
    """Return R̂ = Ĉ − H P⁻ Hᵀ, its diagonal; no variance below the least.

    Source: Gao et al. 2016, eq. (15).

    A window of N tells a correlation to some 1/√N only, so that what lies off the diagonal is mostly chance.

    Args:
        spread: Ĉ (…, d, d).
        predicted: H P⁻ Hᵀ (…, d, d).
        least: variances (d,).
    """
    variance = np.diagonal(spread, axis1=-2, axis2=-1) - np.diagonal(predicted, axis1=-2, axis2=-1)
    return diagonal(np.maximum(variance, least))


def process_noise(noise: Floats, gain: Floats, spread: Floats, expected: Floats) -> Floats:
    """Return Q̂ = K Ĉ Kᵀ + P⁺ − Φ P Φᵀ, positive semidefinite.

    Source: Gao et al. 2016, eq. (16).

    With Φ P Φᵀ = P⁻ − Q and P⁻ − P⁺ = K S Kᵀ it is Q + K (Ĉ − S) Kᵀ. So it gives Q back where R̂ of (15) is in force,
    for then S = Ĉ: one Ĉ cannot tell both noises.

    Args:
        noise: Q of the last prediction (…, D, D).
        gain: K (…, D, d).
        spread: Ĉ (…, d, d).
        expected: S = H P⁻ Hᵀ + R (…, d, d).
    """
    estimate = noise + np.matmul(np.matmul(gain, spread - expected), np.swapaxes(gain, -1, -2))
    values, vectors = np.linalg.eigh(estimate)
    positive: Floats = np.matmul(vectors * np.maximum(values, 0.0)[..., None, :], np.swapaxes(vectors, -1, -2))
    return positive


def corrected(innovation: Floats, spread: Floats, chi_square: float = CHI_SQUARE) -> Floats:
    """Return innovations whose outlying components are drawn towards zero.

    Source: Gao et al. 2016, eqs. (17), (18).

    U = v²/Ĉ of a component; beyond χ² it becomes v exp(−(U − χ²)/χ²).

    Args:
        innovation: (…, d).
        spread: Ĉ (…, d, d).
        chi_square: χ², the largest U that is left as it is.
    """
    limit = chi_square * np.diagonal(spread, axis1=-2, axis2=-1)
    beyond = np.maximum(np.square(innovation) - limit, 0.0)
    # (U − χ²)/χ² = (v² − χ² Ĉ) / (χ² Ĉ); past 700 its exponential is nothing, and Ĉ may be nothing too.
    shrunk: Floats = innovation * np.exp(-beyond / np.maximum(np.maximum(limit, beyond / 700.0), _TINY))
    return shrunk


def diagonal(variance: Floats) -> Floats:
    """Return diagonal matrices (…, d, d) of variances (…, d)."""
    matrix: Floats = variance[..., None] * np.eye(variance.shape[-1])
    return matrix


class InnovationNoise:
    """Measurement noise from a window of innovations; a `NoiseEstimator`.

    Source: Gao et al. 2016, eqs. (13), (14), (15), (16), (17), (18).

    Until a track's window has filled its noise is the nominal one and its innovations stay as they are: at first they
    tell how little is known of the target.

    Args:
        nominal: variances of the measurement as stated, (d,).
        size: N, innovations in the window.
        least: smallest variance, as a share of the nominal one.
        chi_square: χ² of the correction.
        learning: False: R stays nominal, and Ĉ is learnt for the process noise alone.
    """

    def __init__(
        self,
        nominal: Floats,
        size: int = 30,
        *,
        least: float = 0.01,
        chi_square: float = CHI_SQUARE,
        learning: bool = True,
    ) -> None:
        self._nominal = diagonal(nominal)
        self._least = least * nominal
        self._chi_square = chi_square
        self._learning = learning
        self._window = InnovationWindow(size, len(nominal))

    def __len__(self) -> int:
        return len(self._window)

    def spawn(self, count: int) -> None:
        """Append tracks whose window is empty."""
        self._window.spawn(count)

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self._window.keep(rows)

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats) -> Adapted:
        """Take an innovation of each of the rows; see `NoiseEstimator.observe`."""
        self._window.push(rows, innovation)
        full = self._window.full(rows)[:, None]
        spread = np.where(full[:, :, None], self._window.covariance(rows), predicted + self._nominal)
        noise = np.broadcast_to(self._nominal, predicted.shape)
        if self._learning:
            noise = np.where(full[:, :, None], measurement_noise(spread, predicted, self._least), noise)
        return Adapted(np.where(full, corrected(innovation, spread, self._chi_square), innovation), noise, spread)


class AdaptiveFilter:
    """A linear Kalman filter of n tracks that learns its noise: the IAKF, its local filter on its own.

    Source: Gao et al. 2016.

    Rows are tracks; the state is the caller's, (D,), as are F, Q and H.

    Args:
        estimator: of the measurement noise, without tracks.
        process: whether the process noise is learnt too, (16); only where the measurement noise is not does that say
            anything. What is learnt comes on top of the Q that is told.

    Attributes:
        mean: (n, D).
        covariance: (n, D, D).
    """

    def __init__(self, estimator: NoiseEstimator, *, process: bool = False) -> None:
        self._estimator = estimator
        self._process = process
        self.mean: Floats = np.zeros((0, 0))
        self.covariance: Floats = np.zeros((0, 0, 0))
        self._learnt: Floats = np.zeros((0, 0, 0))

    def __len__(self) -> int:
        return len(self.mean)

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append tracks with means (k, D) and covariances (k, D, D)."""
        if not len(self):
            width = mean.shape[1]
            self.mean, self.covariance = np.zeros((0, width)), np.zeros((0, width, width))
            self._learnt = self.covariance
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, covariance])
        self._learnt = np.concatenate([self._learnt, np.zeros_like(covariance)])
        self._estimator.spawn(len(mean))

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self.mean, self.covariance, self._learnt = self.mean[rows], self.covariance[rows], self._learnt[rows]
        self._estimator.keep(rows)

    def predict(self, transition: Floats, noise: Floats) -> None:
        """Predict all tracks with F and Q, each (D, D) or (n, D, D).

        Source: Gao et al. 2016, eqs. (8), (9).

        With `process`, what is learnt is added once a prediction whatever its time step: it suits steps of one length.
        """
        predict(self.mean, self.covariance, transition, noise + self._learnt)

    def update(self, rows: Indices, measured: Floats, observation: Floats) -> Adapted:
        """Update the given rows with a measurement each.

        Source: Gao et al. 2016, eqs. (10), (11), (12), (13), (14), (15), (16), (17), (18).

        Args:
            rows: (m,), each once.
            measured: (m, d).
            observation: H (d, D).

        Returns:
            What was learnt.
        """
        mean, covariance = self.mean[rows], self.covariance[rows]
        predicted = observation @ covariance @ observation.T
        adapted = self._estimator.observe(rows, measured - mean @ observation.T, predicted)
        if self._process:
            expected = predicted + adapted.noise
            gain = covariance @ observation.T @ np.linalg.pinv(expected, hermitian=True)
            self._learnt[rows] = process_noise(self._learnt[rows], gain, adapted.spread, expected)
        update(mean, covariance, adapted.innovation, observation, adapted.noise)
        self.mean[rows], self.covariance[rows] = mean, covariance
        return adapted
