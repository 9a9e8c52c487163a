"""The step that rigid bodies take in every mode, by its blocks: most of the Jacobian F is zero or the identity.

Arrays have the components of the state first and the bodies last: what is done to a component is then done to all
bodies at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats


@dataclass(frozen=True, slots=True)
class BodyTransition:
    """F of n bodies in M modes, of the state's position p, velocity v, w = [ω, a] and bias b.

    [p⁺ − p, v⁺] = gain · [v, w]; w and b decay.

    Attributes:
        gain: (4, 4, M, n).
        decay: of both components of w and of b (4, M).
    """

    gain: Floats
    decay: Floats

    def apply(self, columns: Floats) -> None:
        """Multiply columns (8, k, M, n) by F from the left, in place."""
        after = np.einsum("abin,bcin->acin", self.gain, columns[2:6])
        columns[:2] += after[:2]
        columns[2:4] = after[2:]
        columns[4:] *= self.decay[:, None, :, None]

    def propagate(self, covariance: Floats) -> None:
        """Make F P Fᵀ of covariances P (8, 8, M, n), in place."""
        self.apply(covariance)
        self.apply(np.swapaxes(covariance, 0, 1))

    def dense(self) -> Floats:
        """Return F (8, 8, M, n)."""
        width = len(self.gain) + len(self.decay)
        matrix = np.zeros((width, width, *self.gain.shape[2:]))
        for at in range(width):
            matrix[at, at] = 1.0
        self.apply(matrix)
        return matrix
