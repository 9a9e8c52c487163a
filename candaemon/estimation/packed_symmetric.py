"""Symmetric matrices by their upper triangles, one a column: what is done to all of them is one operation.

F P Fᵀ of every P is one matrix product, and no P can lose its symmetry.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats


class PackedSymmetric:
    """The upper triangle of D × D matrices, row by row: T = D (D + 1) / 2 entries.

    Args:
        size: D.

    Attributes:
        entries: T.
        place: entry of each element, (D, D).
        row, column: of each entry (T,).
        diagonal: entries of the diagonal (D,).
    """

    def __init__(self, size: int) -> None:
        self.row, self.column = np.triu_indices(size)
        self.entries = len(self.row)
        self.place = np.empty((size, size), dtype=np.intp)
        self.place[self.row, self.column] = self.place[self.column, self.row] = np.arange(self.entries)
        self.diagonal = self.place.diagonal().copy()
        self._mirrored = np.where(self.row == self.column, 0.0, 1.0)
        # Where F[i, k] F[j, m] and F[i, m] F[j, k] lie in the outer product of a flat F with itself.
        i, j, k, m = self.row[:, None], self.column[:, None], self.row, self.column
        self._direct = (i * size + k) * size**2 + j * size + m
        self._crossed = (i * size + m) * size**2 + j * size + k

    def pack(self, matrices: Floats) -> Floats:
        """Return the triangles (T, n) of matrices (n, D, D)."""
        return np.asarray(matrices[:, self.row, self.column].T)

    def unpack(self, triangles: Floats) -> Floats:
        """Return the matrices (n, D, D) of triangles (T, n)."""
        size = len(self.place)
        return np.ascontiguousarray(triangles.take(self.place.ravel(), axis=0).T).reshape(-1, size, size)

    def product(self, vectors: Floats) -> Floats:
        """Return the triangles (…, T, n) of v vᵀ for vectors (…, D, n)."""
        return np.asarray(vectors.take(self.row, axis=-2) * vectors.take(self.column, axis=-2))

    def propagation(self, transition: Floats) -> Floats:
        """Return the matrix (T, T) that takes the triangle of P to that of F P Fᵀ, for F (D, D)."""
        products = np.multiply.outer(transition.ravel(), transition.ravel()).ravel()
        return np.asarray(products.take(self._direct) + products.take(self._crossed) * self._mirrored)
