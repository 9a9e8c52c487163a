"""A linear Kalman filter that learns its noise from its innovations, batched over tracks."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.innovation_noise import process_noise
from candaemon.estimation.kalman import predict, update
from candaemon.estimation.noise_estimator import Adapted, NoiseEstimator


class AdaptiveFilter:
    """A linear Kalman filter of n tracks that learns its noise: the IAKF, its local filter on its own.

    Source: Gao et al. 2016.

    Rows are tracks; the state is the caller's, (D,), as are F, Q and H.

    Args:
        estimator: of the measurement noise, without tracks.
        process: whether the process noise is learnt too, (16); that is meaningful only where the measurement
            noise is not learnt. What is learnt is added to the Q that is given.

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
