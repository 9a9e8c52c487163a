"""Covariance and information matrices factorised, singular ones too, batched over any leading shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats, Indices

_NOTHING = 8 * float(np.finfo(np.float64).eps)
"""Eigenvalue, a row of the scaled matrix, up to which there is nothing but rounding."""


@dataclass(frozen=True, slots=True)
class PsdFactor:
    """Positive semidefinite matrices A = D V Λ Vᵀ D, (…, m, m).

    Attributes:
        scale: diagonal of D (…, m), the square roots of A's, 1 where that is 0.
        axes: V (…, m, m), orthonormal columns.
        shares: square roots of Λ (…, m), ascending; 0 where A has nothing but rounding.
    """

    scale: Floats
    axes: Floats
    shares: Floats

    @property
    def root(self) -> Floats:
        """B (…, m, m) with A = B Bᵀ; as many of its columns are zero as A lacks rank."""
        return self.scale[..., :, None] * self.axes * self.shares[..., None, :]

    @property
    def inverse(self) -> Floats:
        """G (…, m, m) with A⁻¹ = Gᵀ G, where A is singular a generalised inverse: A Gᵀ G A = A."""
        return self._inverse_shares[..., :, None] * np.swapaxes(self.axes, -1, -2) / self.scale[..., None, :]

    @property
    def _inverse_shares(self) -> Floats:
        return np.divide(1.0, self.shares, out=np.zeros_like(self.shares), where=self.shares > 0.0)

    @property
    def rank(self) -> Indices:
        """Rank of A (…)."""
        return np.asarray((self.shares > 0.0).sum(axis=-1))

    @property
    def log_determinant(self) -> Floats:
        """Logarithm (…) of |A|, of the part of A that is not singular."""
        shares = np.where(self.shares > 0.0, self.shares, 1.0)
        return np.asarray(2.0 * np.log(shares * self.scale).sum(axis=-1))


def factorise(matrix: Floats) -> PsdFactor:
    """Factorise symmetric positive semidefinite matrices.

    Rows and columns are scaled to a diagonal of one first: a range in metres and a turn rate in radians, or the
    variances of a component that is known and of one that is not, may be a hundred orders of magnitude apart.

    Args:
        matrix: A, (…, m, m); only its lower triangle is read.

    Raises:
        numpy.linalg.LinAlgError: an entry is not finite.
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 0.0))
    scale[scale == 0.0] = 1.0
    # Divided twice: the product of two scales may leave the range of a double.
    values, axes = np.linalg.eigh(matrix / scale[..., :, None] / scale[..., None, :])
    values[values < _NOTHING * matrix.shape[-1]] = 0.0
    return PsdFactor(scale, axes, np.sqrt(values))
