"""The step that rigid bodies take in every mode, by its blocks: most of the Jacobian F is zero or the identity.

Arrays have the components of the state first and the bodies last: what is done to a component is then done to all
bodies at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats

_WIDTH = 8
_UPPER = np.triu_indices(_WIDTH, 1)


@dataclass(frozen=True, slots=True)
class BodyTransition:
    """F of n bodies in M modes, of the state's position p, velocity v, w = [ω, a] and bias b.

    [p⁺ − p, v⁺] = gain · [v, w]; w and b decay.

    Attributes:
        gain: (4, 4, M, n).
        decay: of both components of w (2, M).
        fade: of b (n,).
    """

    gain: Floats
    decay: Floats
    fade: Floats

    def apply(self, columns: Floats) -> None:
        """Multiply columns (8, k, M, n) by F from the left, in place."""
        after = self.gain[:, 0, None] * columns[2]
        for at in range(1, 4):
            after += self.gain[:, at, None] * columns[2 + at]
        columns[:2] += after[:2]
        columns[2:4] = after[2:]
        columns[4:6] *= self.decay[:, None, :, None]
        columns[6:] *= self.fade

    def propagate(self, covariance: Floats) -> None:
        """Make F P Fᵀ of covariances P (8, 8, M, n), in place; they stay symmetric to the last bit."""
        self.apply(covariance)
        self.apply(np.swapaxes(covariance, 0, 1))
        symmetrise_upper(covariance)

    def dense(self) -> Floats:
        """Return F (8, 8, M, n)."""
        matrix = np.zeros((_WIDTH, _WIDTH, *self.gain.shape[2:]))
        for at in range(_WIDTH):
            matrix[at, at] = 1.0
        self.apply(matrix)
        return matrix


def symmetrise_upper(covariance: Floats) -> None:
    """Make matrices (8, 8, …) symmetric in place, as their upper triangles are."""
    covariance[_UPPER[::-1]] = covariance[_UPPER]
