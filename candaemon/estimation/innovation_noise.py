"""Innovation-based adaptive estimation (IAE) of the measurement noise, batched over tracks, section 3.2.

Source: Gao et al. 2016.

The size of the innovations of the last N updates shows the size of the measurement noise. The copy of the paper at hand
lost its equation numbers, inverses, sums and minus signs; here its equations are counted from (1), the state equation,
to (28), the interpolation, and the signs are put back.

The window holds the innovations as they came. If it held those that the chi-square test (17), (18) has corrected, it
would find a noise that is too small: in a burst of 200 times the noise it would empty itself, and the sensor be locked
out for good.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.noise_estimator import Adapted, diagonal

CHI_SQUARE = 7.879
"""What the square of a standard normal number exceeds once in 200 times: α = 0.005 at one degree of freedom."""
_TINY = np.finfo(np.float64).tiny


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

    A window of N gives a correlation to some 1/√N only, so that what lies off the diagonal is mostly chance.

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
    for then S = Ĉ: one Ĉ cannot give both noises.

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


class InnovationNoise:
    """Measurement noise from a window of innovations; a `NoiseEstimator`.

    Source: Gao et al. 2016, eqs. (13), (14), (15), (16), (17), (18).

    Until a track's window has filled its noise is the nominal one and its innovations stay as they are: at first they
    show how uncertain the target's state is.

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
