"""A bank of filters, one a motion model, over the same tracks: what the interacting, switching and federated share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state
from candaemon.estimation.estimator_state import EstimatorState, MomentBankState
from candaemon.estimation.kalman import propagate
from candaemon.estimation.measurement import Measurement, in_order
from candaemon.estimation.measurement_update import correct
from candaemon.estimation.motion_models import (
    VELOCITY,
    CoordinatedTurn,
    CurrentStatistical,
    MotionModel,
    predicted_mean,
)
from candaemon.estimation.output_state import REPORTED, OutputState
from candaemon.estimation.packed_symmetric import PackedSymmetric
from candaemon.estimation.sensor_noise import SensorNoise, SensorNoiseState
from candaemon.estimation.smoothing import Link, smoothing_gain

_NOT_BY_TRACK = frozenset({"columns", "stated", "trace"})
"""Arrays of states that do not have one row a track."""


class FilterBank(ABC):
    """Batched filters on M motion models; rows are tracks.

    State order [x, y, vx, vy, ax, ay, ω, jx, jy], cut after what the models use; local frame, SI units. Each model has
    the components that it uses; the others stay zero.

    Args:
        models: the motion models.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
        jerk: standard deviation of a track's first jerk, m/s³.
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.

    Attributes:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        linking: whether `predict` leaves a `link` for smoothing.
        link: of the latest prediction, for a smoother; None before the first.
    """

    mean: Floats
    covariance: Floats

    def __init__(
        self,
        models: Sequence[MotionModel],
        *,
        acceleration: float,
        turn_rate: float,
        jerk: float,
        noise: SensorNoise | None,
    ) -> None:
        self._models = tuple(models)
        self._noise = noise
        self._width = 1 + max(component for model in models for component in model.components)
        d = self._width
        self._has = np.array([[c in model.components for c in range(d)] for model in self._models])
        self._has_both = self._has[:, :, None] & self._has[:, None, :]
        self._turns = np.array([isinstance(model, CoordinatedTurn) for model in self._models])
        self._turning = np.flatnonzero(self._turns).tolist()
        self._memories = _memories(self._models)
        self._first_variance = np.zeros(d)
        self._first_variance[4:6] = acceleration**2
        self._first_variance[6:7] = turn_rate**2
        self._first_variance[7:] = jerk**2
        self._state = self._empty()
        self.linking = False
        self.link: Link | None = None

    def __len__(self) -> int:
        return len(self._state.probability)

    @property
    def state(self) -> EstimatorState:
        """All that it remembers; the link is not a part of it.

        Raises:
            ValueError: a state that is set does not fit the filter.
        """
        return self._state

    @state.setter
    def state(self, state: EstimatorState) -> None:
        self._state = checked_state(state, self._empty(), except_for=_NOT_BY_TRACK)
        self._hand_down()

    @property
    def probability(self) -> Floats:
        """Weights of the models, (n, M)."""
        return self._state.probability

    @probability.setter
    def probability(self, probability: Floats) -> None:
        self._state.probability = probability

    @abstractmethod
    def _empty(self) -> EstimatorState:
        """Return the state of a bank without tracks."""

    def _empty_weights(self) -> tuple[Floats, Floats, float, SensorNoiseState | None]:
        """Return what all banks remember beside their estimates, without tracks."""
        m = len(self._models)
        return np.zeros((0, m)), np.ones((0, m)), 0.0, None if self._noise is None else self._noise.state

    def _hand_down(self) -> None:
        """Give the parts of the filter their parts of the state that was set, and check how many tracks they have."""
        if self._noise is None and self._state.noise is None:
            return
        if self._noise is None or self._state.noise is None or self._state.noise.count != len(self):
            raise ValueError("what is known of the sensors' noise does not fit the filter")
        self._noise.state = self._state.noise

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

    def clone(self, rows: Indices, position: Floats, position_covariance: Floats) -> None:
        """Append tracks that are as those of the given rows, but for positions of their own.

        Args:
            rows: (k,).
            position: (k, 2), m.
            position_covariance: (k, 2, 2).
        """
        first = len(self)
        self.keep(np.concatenate([np.arange(first), rows]))
        mean, covariance = self.mean, self.covariance
        mean[first:, :, :2] = position[:, None]
        covariance[first:, :, :2, :] = 0.0
        covariance[first:, :, :, :2] = 0.0
        covariance[first:, :, :2, :2] = position_covariance[:, None]
        self.mean, self.covariance = mean, covariance  # for filters that keep them in another form

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        self._keep_estimates(rows)
        state = self._state
        state.probability, state.mean_nis = state.probability[rows], state.mean_nis[rows]
        if self._noise is not None:
            self._noise.keep(rows)

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers; what is known of those left out is forgotten.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        if self._noise is not None:
            self._noise.renumber_sensors(sensors)

    def predict(self, dt: float, direction: Floats) -> None:
        """Predict all tracks under every model, as extended Kalman filters do: f(x) and F P Fᵀ + Q.

        Source: Kim and Hong 2004, eqs. (12), (16).

        That is (12) and (16) of Kim and Hong 2004, which write the covariance as the inverse of an information matrix.

        Args:
            dt: s.
            direction: of travel, unit vectors (n, 2).
        """
        if not len(self):
            self.link = None
            return
        self._state.dt = dt
        self._interact(dt)  # 1. mixing
        before = OutputState(self.mean.copy(), self.covariance.copy(), self._turning) if self.linking else None
        # 2. prediction by each model
        transitions = [self._predict_model(j, dt, direction) for j in range(len(self._models))]
        if before is not None:
            self.link = self._link(before, transitions)

    @abstractmethod
    def _interact(self, dt: float) -> None:
        """Let the models' estimates meet before a prediction by dt, s."""

    def _predict_model(self, j: int, dt: float, direction: Floats) -> Floats:
        """Predict with one model; return its transition F (n or 1, D, D)."""
        model = self._models[j]
        if isinstance(model, CurrentStatistical) and model.innovation_memory is not None:
            self.mean[:, j], f, q = model.transition(self.mean[:, j], dt, direction, self._state.mean_nis[:, j])
        else:
            self.mean[:, j], f, q = model.transition(self.mean[:, j], dt, direction)
        propagate(self.covariance[:, j], f, q)
        return f

    @property
    def adapting(self) -> bool:
        """Whether each track estimates how noisy the sensors are."""
        return self._noise is not None

    def retrodict(self, dt: float) -> None:
        """Take all tracks back by a short dt (s), for a measurement that comes late; what was learnt since is kept."""
        self.mean[:, :, :2] -= dt * self.mean[:, :, VELOCITY]

    def update(self, rows: Indices, measurement: Measurement) -> Floats:
        """Update the given rows (m,) with a measurement each; return their NIS (m,), weighted as the models are.

        The other rows keep their predicted state and their predicted weights.
        """
        measurement = self._adapted(rows, measurement)
        every = len(rows) == len(self) and in_order(rows)
        mean = self.mean if every else self.mean[rows]
        covariance = self.covariance if every else self.covariance[rows]
        # 3. update of each model
        nis, log_likelihood = self._update_models(rows, mean, covariance, measurement)
        if not every:
            self.mean[rows], self.covariance[rows] = mean, covariance
        self._note_fit(rows, nis, measurement)
        if len(self._models) == 1:
            return nis[:, 0]
        prior = self.probability[rows]
        self._update_probabilities(rows, log_likelihood)  # 4. mode probabilities
        return summed_models(prior * nis)

    def inflated(self, rows: Indices, measurement: Measurement) -> Measurement:
        """Return a measurement of a sensor that keeps an object's id with its noise inflated to the largest plausible.

        With its stated noise where the noise is not estimated. Nothing is learnt.

        Args:
            rows: the tracks of the ids, (m,).
            measurement: a detection each.
        """
        return measurement if self._noise is None else self._noise.inflated(rows, measurement)

    def _update_models(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        """Update the estimates of the given rows in place; return NIS and log likelihood, (m, M) each."""
        del rows  # the filters of all rows are alike
        return correct(mean, covariance, measurement)

    @abstractmethod
    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Weigh the models of the given rows after a measurement, whose log likelihood under each is (m, M)."""

    def combined(self) -> tuple[Floats, Floats]:
        """Return the combined mean (n, 6) and covariance (n, 6, 6) over [x, y, vx, vy, ax, ay].

        A constant velocity model says that the acceleration is zero, a coordinated turn that it is ω × v. To be read:
        the arrays may be the filter's own, which `predict` and `update` change.
        """
        if len(self._models) == 1 and self._width == REPORTED:
            return self.mean[:, 0], self.covariance[:, 0]
        if compiled.in_use and max(len(self._models), self._width) <= compiled.WIDEST:
            return compiled.kernels.combined(self.probability, self.mean, self.covariance, self._turns)
        reading = self._reading()
        return moments(self.probability, reading.reported_mean(), reading.reported_covariance())

    def expected_position(self, rows: Indices, horizon: float, direction: Floats) -> Floats:
        """Return where the given rows' models expect their targets after a time.

        Args:
            rows: (m,) rows.
            horizon: s.
            direction: direction of travel of these rows, (m, 2).

        Returns:
            Positions (m, 2), m.
        """
        position, mean, weight = np.zeros((len(rows), 2)), self.mean.take(rows, axis=0), self.probability[rows]
        for j, model in enumerate(self._models):
            position += weight[:, j, None] * predicted_mean(model, mean[:, j], horizon, direction)[:, :2]
        return position

    def _adapted(self, rows: Indices, measurement: Measurement) -> Measurement:
        """Return the measurement as noisy as the tracks have found it to be."""
        if self._noise is None:
            return measurement
        mean, covariance = self.combined()
        return self._noise.adapted(rows, measurement, mean[rows, :2], covariance[rows, :2, :2])

    def _note_fit(self, rows: Indices, nis: Floats, measurement: Measurement) -> None:
        """Update the recent mean NIS, for models whose noise follows them; NIS is (m, M)."""
        if not self._memories:
            return
        degrees, state = measurement.measured, self._state
        for j, memory in self._memories:
            share = -np.expm1(-state.dt / memory)
            state.mean_nis[rows, j] += share * (nis[:, j] / degrees - state.mean_nis[rows, j])

    def _link(self, before: OutputState, transitions: Sequence[Floats]) -> Link:
        """Return what a smoother needs of a prediction.

        Args:
            before: what the mixed estimates said before it.
            transitions: F of each model.
        """
        mean, predicted = (each.copy() for each in self.combined())
        cross = before.cross(self._reading(), self.probability, transitions)
        return Link(mean, predicted, smoothing_gain(cross, predicted))

    def _reading(self) -> OutputState:
        return OutputState(self.mean, self.covariance, self._turning)

    @abstractmethod
    def _keep_estimates(self, rows: Indices | Booleans) -> None:
        """Keep the estimates of the given rows."""

    @abstractmethod
    def _append_estimates(self, mean: Floats, covariance: Floats) -> None:
        """Append the estimates of k tracks, mean (k, M, D) and covariance (k, M, D, D)."""

    def _append(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        self._append_estimates(mean, covariance)
        state = self._state
        state.probability = np.concatenate([state.probability, probability])
        if self._noise is not None:
            self._noise.spawn(len(mean))
        state.mean_nis = np.concatenate([state.mean_nis, np.ones(probability.shape)])


class MomentBank(FilterBank):
    """A filter bank that keeps mean and covariance of each model as they are."""

    _state: MomentBankState

    @property
    def mean(self) -> Floats:
        """(n, M, D)."""
        return self._state.mean

    @mean.setter
    def mean(self, mean: Floats) -> None:
        self._state.mean = mean

    @property
    def covariance(self) -> Floats:
        """(n, M, D, D)."""
        return self._state.covariance

    @covariance.setter
    def covariance(self, covariance: Floats) -> None:
        self._state.covariance = covariance

    def _empty(self) -> MomentBankState:
        return MomentBankState(*self._empty_weights(), *self._empty_moments())

    def _hand_down(self) -> None:
        super()._hand_down()
        state = self._state  # a saved one may lie in memory in another order than the kernels take
        state.mean, state.covariance = np.ascontiguousarray(state.mean), np.ascontiguousarray(state.covariance)
        state.probability = np.ascontiguousarray(state.probability)

    def _empty_moments(self) -> tuple[Floats, Floats]:
        """Return means and covariances of no tracks."""
        m, d = len(self._models), self._width
        return np.zeros((0, m, d)), np.zeros((0, m, d, d))

    def _keep_estimates(self, rows: Indices | Booleans) -> None:
        self.mean, self.covariance = self.mean[rows], self.covariance[rows]

    def _append_estimates(self, mean: Floats, covariance: Floats) -> None:
        self.mean = np.concatenate([self.mean, mean])
        self.covariance = np.concatenate([self.covariance, covariance])


def moments(probability: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return the mean (n, D) and the covariance (n, D, D) of the mixture of the models' estimates.

    Args:
        probability: of the modes, (n, M).
        mean: (n, M, D).
        covariance: (n, M, C, C), of the first C ≤ D components; the others are certain within a model.
    """
    overall, combined = mixture(probability[:, None], mean, covariance)
    return np.ascontiguousarray(overall[:, 0]), np.ascontiguousarray(combined[:, 0])


def mixture(weights: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return means (n, J, D) and covariances (n, J, D, D) of J mixtures of the models' estimates.

    They lie in memory with the tracks last: numpy is quickest along the last axis, and there are more tracks than
    components. What numpy makes of them element by element lies as they do.

    Args:
        weights: of the models in each mixture, (n, J, M).
        mean: (n, M, D).
        covariance: (n, M, C, C), of the first C ≤ D components; the others are certain within a model.
    """
    n, m, d = mean.shape
    c, triangle = covariance.shape[-1], _packed(d)
    if c < d:
        covariance = np.pad(covariance, ((0, 0), (0, 0), (0, d - c), (0, d - c)))
    means, w = (np.ascontiguousarray(each.transpose(1, 2, 0)) for each in (mean, weights))
    within = triangle.pack(covariance.reshape(n * m, d, d)).reshape(triangle.entries, n, m).transpose(2, 0, 1)
    mixed = w[:, 0, None] * means[0]
    for i in range(1, m):
        mixed += w[:, i, None] * means[i]
    spread = np.zeros((len(mixed), triangle.entries, n))
    for i in range(m):
        # Spread around each mixed mean, a sum of squares: second moments less the mean's would cancel, even below zero.
        part = triangle.product(means[i] - mixed)
        part += within[i]
        part *= w[:, i, None]
        spread += part
    full = spread.take(triangle.place.ravel(), axis=1).reshape(len(mixed), d, d, n)
    return mixed.transpose(2, 0, 1), full.transpose(3, 0, 1, 2)


def summed_models(values: Floats) -> Floats:
    """Return the sum over models of values (n, M), from the first to the last as the kernels add them up, (n,)."""
    total = values[:, 0].copy()
    for j in range(1, values.shape[1]):
        total += values[:, j]
    return total


_packed = lru_cache(PackedSymmetric)


def _memories(models: Sequence[MotionModel]) -> list[tuple[int, float]]:
    """Return the models whose noise follows the innovations, each with the time constant of their mean."""
    return [
        (j, model.innovation_memory)
        for j, model in enumerate(models)
        if isinstance(model, CurrentStatistical) and model.innovation_memory is not None
    ]
