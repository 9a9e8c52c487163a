"""The estimates of a bank's models in the reported state, [x, y, vx, vy, ax, ay].

A constant velocity model says that the acceleration is zero, a coordinated turn that it is ω × v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.motion_models import ACCELERATION, TURN

REPORTED = 6
"""Components that are reported."""


@dataclass(frozen=True, slots=True)
class OutputState:
    """Estimates of n tracks under M models, to be read.

    Attributes:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        turning: indices of the models that turn.
    """

    mean: Floats
    covariance: Floats
    turning: Sequence[int]

    @property
    def _shared(self) -> int:
        """How many of the reported components any model has."""
        width: int = self.mean.shape[2]
        return min(width, REPORTED)

    def reported_mean(self) -> Floats:
        """Return the mean of each model, (n, M, 6)."""
        mean = np.zeros((*self.mean.shape[:2], REPORTED))
        mean[:, :, : self._shared] = self.mean[:, :, : self._shared]
        for j in self.turning:
            turn_rate = self.mean[:, j, TURN]
            mean[:, j, 4] = -turn_rate * self.mean[:, j, 3]
            mean[:, j, 5] = turn_rate * self.mean[:, j, 2]
        return mean

    def reported_covariance(self) -> Floats:
        """Return the covariance of each model, (n, M, C, C) over the first C of the six components that any has."""
        covariance = self.covariance[:, :, : self._shared, : self._shared]
        if not self.turning:
            return covariance
        covariance = covariance.copy()
        for j in self.turning:
            # S P and S P Sᵀ by the two components that each row of the slope S has
            own, w = self.covariance[:, j], self.mean[:, j, TURN, None]
            vx, vy = self.mean[:, j, 2, None], self.mean[:, j, 3, None]
            first, second = -w * own[:, 3] - vy * own[:, TURN], w * own[:, 2] + vx * own[:, TURN]
            covariance[:, j, 4, :4] = covariance[:, j, :4, 4] = first[:, :4]
            covariance[:, j, 5, :4] = covariance[:, j, :4, 5] = second[:, :4]
            w, vx, vy = w[:, 0], vx[:, 0], vy[:, 0]
            covariance[:, j, 4, 4] = -w * first[:, 3] - vy * first[:, TURN]
            covariance[:, j, 4, 5] = covariance[:, j, 5, 4] = w * first[:, 2] + vx * first[:, TURN]
            covariance[:, j, 5, 5] = w * second[:, 2] + vx * second[:, TURN]
        return covariance

    def cross(self, predicted: OutputState, probability: Floats, transitions: Sequence[Floats]) -> Floats:
        """Return the cross covariance of the reported state with that after a prediction, (n, 6, 6).

        Args:
            predicted: the same tracks after it.
            probability: of the models, (n, M).
            transitions: F of each model, (n or 1, D, D).
        """
        before, after = self.reported_mean(), predicted.reported_mean()
        before -= np.matmul(probability[:, None, :], before)
        after -= np.matmul(probability[:, None, :], after)
        cross = np.matmul(np.swapaxes(before, 1, 2) * probability[:, None, :], after)
        here, there = self._slopes(), predicted._slopes()
        for j, f in enumerate(transitions):
            turned = np.swapaxes(there[:, j] @ np.ascontiguousarray(f), -1, -2)  # a product rounds as its factors lie
            own = here[:, j] @ self.covariance[:, j] @ turned
            cross += probability[:, j, None, None] * own
        return np.asarray(cross)

    def _slope(self, j: int) -> Floats:
        """Return the Jacobian of a turning model's acceleration ω × v over its state, (n, 2, D)."""
        turn_rate = self.mean[:, j, TURN]
        slope = np.zeros((len(self.mean), 2, self.mean.shape[2]))
        slope[:, 0, 3], slope[:, 0, TURN] = -turn_rate, -self.mean[:, j, 3]
        slope[:, 1, 2], slope[:, 1, TURN] = turn_rate, self.mean[:, j, 2]
        return slope

    def _slopes(self) -> Floats:
        """Return the Jacobian of each model's reported state over its own, (n, M, 6, D)."""
        slopes = np.zeros((*self.mean.shape[:2], REPORTED, self.mean.shape[2]))
        shared = np.arange(self._shared)
        slopes[:, :, shared, shared] = 1.0
        for j in self.turning:
            slopes[:, j, ACCELERATION] = self._slope(j)
        return slopes
