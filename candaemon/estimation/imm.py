"""The interacting multiple model filter, batched over tracks and models at once.

One filter with M models keeps means (n, M, D) and covariances (n, M, D, D) over the union of its models' components.
A single model is an IMM with M = 1, whose mixing is the identity. The cycle is that of Blom and Bar-Shalom as paper
002 section 3 writes it: mixing, prediction, update with likelihoods, mode probabilities, combination.

A model that lacks a component (a constant velocity model has no acceleration) takes part in the mixing of that
component with the estimate of those models that have it; so it biases nobody (Yuan, Bar-Shalom et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candaemon.estimation.kalman import line_of_sight, propagated, symmetrise, update_position, update_scalar
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.models import ACCELERATION, TURN, VELOCITY, CoordinatedTurn, LinearModel, MotionModel

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_LEAST_PROBABILITY = 1e-12


@dataclass(frozen=True, slots=True)
class _Lending:
    """Components that some models have and lend to the others for the mixing."""

    block: slice
    lenders: list[int]
    borrowers: list[int]

    @classmethod
    def of(cls, has: NDArray[np.bool_], block: slice) -> _Lending:
        """Find who has the components, by the table has[model, component]."""
        have = has[:, block].any(axis=1)
        return cls(block, np.flatnonzero(have).tolist(), np.flatnonzero(~have).tolist())


class Imm:
    """Batched IMM over any motion models; rows are tracks.

    State order [x, y, vx, vy, ax, ay, ω], cut after what the models use; level frame, SI units.

    Args:
        models: the motion models.
        switch_rate: rate of leaving a model, 1/s; over a step dt a model is left with probability
            1 − e^(−rate·dt), shared evenly among the others.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
    """

    def __init__(
        self, models: Sequence[MotionModel], *, switch_rate: float, acceleration: float, turn_rate: float
    ) -> None:
        self._models = tuple(models)
        self._switch_rate = switch_rate
        used = {component for model in models for component in model.components}
        self._width = max(used) + 1
        m, d = len(self._models), self._width
        self._has = np.array([[c in model.components for c in range(d)] for model in self._models])
        self._has_both = self._has[:, :, None] & self._has[:, None, :]
        self._turning = [j for j, model in enumerate(self._models) if isinstance(model, CoordinatedTurn)]
        self._lending = [_Lending.of(self._has, block) for block in (ACCELERATION, slice(TURN, TURN + 1))]
        self._first_variance = np.zeros(d)
        self._first_variance[4:6] = acceleration**2
        self._first_variance[6:] = turn_rate**2
        self.mean: Floats = np.zeros((0, m, d))
        self.covariance: Floats = np.zeros((0, m, d, d))
        self.probability: Floats = np.zeros((0, m))

    def __len__(self) -> int:
        return len(self.mean)

    def spawn(
        self, position: Floats, position_covariance: Floats, velocity: Floats, velocity_covariance: Floats
    ) -> None:
        """Append k tracks.

        Args:
            position: (k, 2), m.
            position_covariance: (k, 2, 2).
            velocity: over ground (k, 2), m/s.
            velocity_covariance: (k, 2, 2).
        """
        k, m, d = len(position), len(self._models), self._width
        mean, covariance = np.zeros((k, m, d)), np.zeros((k, m, d, d))
        mean[:, :, :2], mean[:, :, 2:4] = position[:, None], velocity[:, None]
        covariance[:] = np.diag(self._first_variance)
        covariance[:, :, :2, :2] = position_covariance[:, None]
        covariance[:, :, 2:4, 2:4] = velocity_covariance[:, None]
        covariance *= self._has_both
        self._append(mean, covariance, np.full((k, m), 1.0 / m))

    def clone(self, rows: Rows, position: Floats, position_covariance: Floats) -> None:
        """Append tracks that move as those of the given rows do, at positions of their own (k, 2)."""
        mean, covariance = self.mean[rows].copy(), self.covariance[rows].copy()
        mean[:, :, :2] = position[:, None]
        covariance[:, :, :2, :] = 0.0
        covariance[:, :, :, :2] = 0.0
        covariance[:, :, :2, :2] = position_covariance[:, None]
        self._append(mean, covariance, self.probability[rows].copy())

    def keep(self, rows: Rows | NDArray[np.bool_]) -> None:
        """Keep the given rows and forget the others."""
        self.mean, self.covariance, self.probability = self.mean[rows], self.covariance[rows], self.probability[rows]

    def predict(self, dt: float, direction: Floats) -> None:
        """Mix and predict all tracks by dt (s); direction of travel (n, 2)."""
        if not len(self):
            return
        if len(self._models) > 1:
            self._mix(dt)
        for j, model in enumerate(self._models):
            self.mean[:, j], f, q = model.transition(self.mean[:, j], dt, direction)
            np.add(propagated(self.covariance[:, j], f), q, out=self.covariance[:, j])
        symmetrise(self.covariance)

    @property
    def directional(self) -> bool:
        """Whether any model treats the directions along and across the travel differently."""
        return any(isinstance(model, LinearModel) and not model.isotropic for model in self._models)

    def retreat(self, dt: float) -> None:
        """Take all tracks back by a short dt (s), for a measurement that comes late; what was learnt since is kept."""
        self.mean[:, :, :2] -= dt * self.mean[:, :, VELOCITY]

    def update(self, rows: Rows, measurement: Measurement) -> Floats:
        """Update the given rows (m,) with a measurement each; return the likelihood-weighted NIS (m,).

        The other rows keep their predicted state and their predicted mode probabilities.
        """
        every = len(rows) == len(self) and bool((rows == np.arange(len(rows))).all())
        mean = self.mean if every else self.mean[rows]
        covariance = self.covariance if every else self.covariance[rows]
        fit = update_position(mean, covariance, measurement.position[:, None], measurement.noise[:, None])
        nis, log_likelihood = fit.nis, fit.log_likelihood
        if measurement.range_rate is not None and measurement.range_rate_variance is not None:
            rate, row = line_of_sight(mean, measurement.origin, measurement.velocity)
            d_nis, d_log = self._scalar(
                mean, covariance, row, measurement.range_rate[:, None] - rate, measurement.range_rate_variance[:, None]
            )
            nis, log_likelihood = nis + d_nis, log_likelihood + d_log
        for part in measurement.projections:
            row = np.zeros((*mean.shape[:2], 4))
            row[:, :, 2:] = part.direction[:, None]
            speed = (row[:, :, 2:] * mean[:, :, VELOCITY]).sum(axis=-1)
            d_nis, d_log = self._scalar(mean, covariance, row, part.value[:, None] - speed, part.variance[:, None])
            nis, log_likelihood = nis + d_nis, log_likelihood + d_log
        if not every:
            self.mean[rows], self.covariance[rows] = mean, covariance
        if len(self._models) == 1:
            return nis[:, 0]
        prior = self.probability[rows]
        posterior = prior * np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
        posterior = np.maximum(posterior, _LEAST_PROBABILITY)
        posterior /= posterior.sum(axis=1, keepdims=True)
        self.probability[rows] = posterior
        weighted: Floats = (prior * nis).sum(axis=1)
        return weighted

    @staticmethod
    def _scalar(
        mean: Floats, covariance: Floats, row: Floats, innovation: Floats, variance: Floats
    ) -> tuple[Floats, Floats]:
        """Update with one speed; where it was not measured (NaN), change nothing and fit perfectly."""
        known = np.isfinite(innovation)
        if not known.all():
            row = np.where(known[..., None], row, 0.0)
            innovation = np.where(known, innovation, 0.0)
        fit = update_scalar(mean, covariance, row, innovation, variance)
        return fit.nis, np.where(known, fit.log_likelihood, 0.0)

    def combined(self) -> tuple[Floats, Floats]:
        """Return the combined mean (n, 6) and covariance (n, 6, 6) over [x, y, vx, vy, ax, ay].

        A constant velocity model says that the acceleration is zero, a coordinated turn that it is ω × v.
        """
        if len(self._models) == 1 and self._width == 6:
            return self.mean[:, 0], self.covariance[:, 0]
        mean = np.zeros((*self.mean.shape[:2], 6))
        shared = min(self._width, 6)
        mean[:, :, :shared] = self.mean[:, :, :shared]
        for j in self._turning:
            turn_rate = self.mean[:, j, TURN]
            mean[:, j, 4] = -turn_rate * self.mean[:, j, 3]
            mean[:, j, 5] = turn_rate * self.mean[:, j, 2]
        overall = np.matmul(self.probability[:, None, :], mean)
        mean -= overall
        covariance = np.matmul(np.swapaxes(mean, 1, 2) * self.probability[:, None, :], mean)
        n, m, d = self.mean.shape
        within = np.matmul(self.probability[:, None, :], self.covariance.reshape(n, m, d * d)).reshape(n, d, d)
        covariance[:, :shared, :shared] += within[:, :shared, :shared]
        return overall[:, 0], covariance

    def expected_position(self, rows: Rows, horizon: float, direction: Floats) -> Floats:
        """Return where the given rows' models expect their targets after a time.

        Args:
            rows: (m,) rows.
            horizon: s.
            direction: direction of travel of these rows, (m, 2).

        Returns:
            Positions (m, 2), m.
        """
        position = np.zeros((len(rows), 2))
        for j, model in enumerate(self._models):
            mean, _, _ = model.transition(self.mean[rows, j], horizon, direction)
            position += self.probability[rows, j, None] * mean[:, :2]
        return position

    def _append(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, covariance])
        self.probability = np.concatenate([self.probability, probability])

    def _mix(self, dt: float) -> None:
        """Mix the models' estimates: means, covariances and their spread, and predict the mode probabilities."""
        m, d = len(self._models), self._width
        leave = -np.expm1(-self._switch_rate * dt)
        switch = np.full((m, m), leave / (m - 1))
        np.fill_diagonal(switch, 1.0 - leave)
        self._fill_missing()
        predicted = self.probability @ switch
        weights = self.probability[:, None, :] * switch.T[None] / predicted[:, :, None]
        centre = self.mean[:, 0].copy()
        deviation = self.mean - centre[:, None]
        moment = deviation[..., :, None] * deviation[..., None, :]
        moment += self.covariance
        shift = np.matmul(weights, deviation)
        mixed = np.matmul(weights, moment.reshape(-1, m, d * d)).reshape(-1, m, d, d)
        mixed -= shift[..., :, None] * shift[..., None, :]
        mixed *= self._has_both
        self.mean = (centre[:, None] + shift) * self._has
        self.covariance = mixed
        self.probability = predicted

    def _fill_missing(self) -> None:
        """Give the components a model lacks the estimate of those that have them."""
        for lending in self._lending:
            if not lending.lenders or not lending.borrowers:
                continue
            block = lending.block
            mean, covariance = self._estimate(lending.lenders, block)
            for j in lending.borrowers:
                self.mean[:, j, block] = mean
                self.covariance[:, j, block, block] = covariance

    def _estimate(self, models: list[int], block: slice) -> tuple[Floats, Floats]:
        """Combine what some models say of some components: mean (n, C) and covariance (n, C, C)."""
        if len(models) == 1:
            return self.mean[:, models[0], block], self.covariance[:, models[0], block, block]
        probability = self.probability[:, models]
        share = probability / np.maximum(probability.sum(axis=1, keepdims=True), 1e-300)
        mean = np.einsum("nj,njc->nc", share, self.mean[:, models, block])
        spread = self.mean[:, models, block] - mean[:, None]
        covariance = np.einsum("nj,njcd->ncd", share, self.covariance[:, models, block, block])
        covariance += np.einsum("nj,njc,njd->ncd", share, spread, spread)
        return mean, covariance
