"""Measurement noise by variational Bayes, batched over tracks.

Särkkä and Nummenmaa 2009, 'Recursive noise adaptive Kalman filtering by variational Bayesian approximations': each
variance has an inverse gamma density with α ← ρ α + 1/2 and β ← ρ β + E[(z − H x)²]/2; its estimate is β/α. Here α
stands at the value that it tends to, 1 / (2 (1 − ρ)), from the start: the stated noise counts like 1 / (1 − ρ)
measurements, and the variance itself is all the state there is:

    R ← ρ R + (1 − ρ) E[(z − H x)²],    E[(z − H x)²] = r² + H P⁺ Hᵀ,    r = R S⁻¹ v,    S = H P⁻ Hᵀ + R,

a fixed point in R, as r and P⁺ depend on it. It needs the innovation v and H P⁻ Hᵀ alone, so it comes before the
filter's own update. While the state is uncertain, S ≫ R, the expectation is R itself and nothing is learnt.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.noise_estimator import Adapted, diagonal

_ROUNDING = 1e-13


class VariationalNoise:
    """Variances of a sensor's measurement, uncorrelated, for n tracks.

    A `candaemon.estimation.noise_estimator.NoiseEstimator`.

    Args:
        nominal: variances as stated, (d,).
        forgetting: ρ, share of what is known that a measurement leaves.
        floor: smallest variance, as a multiple of the nominal one.
        ceiling: largest variance, as a multiple of the nominal one.
        iterations: of the fixed point.

    Attributes:
        variance: (n, d).
    """

    def __init__(
        self,
        nominal: Floats,
        forgetting: float = 0.97,
        *,
        floor: float = 0.01,
        ceiling: float = 1e4,
        iterations: int = 3,
    ) -> None:
        self._nominal = nominal
        self._forgetting = forgetting
        self._floor, self._ceiling = floor * nominal, ceiling * nominal
        self._iterations = iterations
        self.variance: Floats = np.zeros((0, len(nominal)))

    def __len__(self) -> int:
        return len(self.variance)

    def spawn(self, count: int) -> None:
        """Append tracks whose noise is the nominal one."""
        self.variance = np.concatenate([self.variance, np.tile(self._nominal, (count, 1))])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self.variance = self.variance[rows]

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats) -> Adapted:
        """Take an innovation of each of the rows; see `candaemon.estimation.noise_estimator.NoiseEstimator.observe`."""
        known = variance = self.variance[rows]
        for _ in range(self._iterations):
            expected = _expected_square(variance, innovation, predicted)
            variance = self._forgetting * known + (1.0 - self._forgetting) * expected
            variance = np.clip(variance, self._floor, self._ceiling)
        self.variance[rows] = variance
        noise = diagonal(variance)
        return Adapted(innovation, noise, predicted + noise)


def _expected_square(variance: Floats, innovation: Floats, predicted: Floats) -> Floats:
    """Return r² + H P⁺ Hᵀ of each component, (m, d), with H P⁺ Hᵀ = R − R S⁻¹ R, which a large S does not cancel."""
    spread = predicted + diagonal(variance)
    scale = np.sqrt(np.diagonal(spread, axis1=-2, axis2=-1))
    # Scaled, and lifted by what rounding takes: components that are uncertain together would make it singular.
    correlation = spread / scale[:, :, None] / scale[:, None, :] + _ROUNDING * np.eye(variance.shape[-1])
    inverse = np.linalg.inv(correlation)
    share = variance / scale
    residual = share * np.matmul(inverse, (innovation / scale)[:, :, None])[:, :, 0]
    posterior = variance - np.square(share) * np.diagonal(inverse, axis1=-2, axis2=-1)
    return np.asarray(np.square(residual) + np.maximum(posterior, 0.0))
