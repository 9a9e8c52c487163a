"""The motion of rigid bodies, all bodies at once: an interacting multiple model filter with one row a body.

The state is [x, y, vx, vy, ω, a, bx, by] in the local frame: reference point (m), velocity over ground (m/s), turn rate
(rad/s, positive to the left), acceleration along the course (m/s²), and the bias of what the sensors report of the
reference point (m). A vehicle's velocity lies along its axis, so ω turns the velocity and a stretches it: a coordinated
turn with an acceleration (Bar-Shalom, Li and Kirubarajan 2001, ch. 11). In these coordinates, other than with speed and
heading as states, a body at rest is nothing special, and the modes' estimates can be mixed.

The bias is a first-order Gauss-Markov process: reflections wander over a body, and radars that filter by themselves
report a random walk about the truth. A measured position is x + b and white noise.

The modes share the state, and differ in what moves it: `BodyMode`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state
from candaemon.estimation.filter_bank import moments
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.smoothing import Link, smoothing_gain

WIDTH = 8
POSITION, VELOCITY, BIAS = slice(0, 2), slice(2, 4), slice(6, 8)
TURN, ACCELERATION = 4, 5
_LOG_2_PI = float(np.log(2.0 * np.pi))
_LEAST_PROBABILITY = 1e-6
_SLOW = 1.0  # m/s, below which the course says nothing of the axis
_FULL_TURN = 0.6  # rad/s; no vehicle turns faster


@dataclass(frozen=True, slots=True)
class BodyMode:
    """One way in which a body moves.

    Attributes:
        moves: whether it has a velocity at all; else it stands.
        acceleration: standard deviation of the acceleration along the course, m/s²; 0: turn rate and acceleration
            change nothing.
        lateral_acceleration: standard deviation of turn rate × speed, m/s².
        velocity_noise: white acceleration in any direction, (m/s²)²/Hz.
        bias_walk: random walk of the bias beyond the sensors' own, m²/s.
        dwell: mean time for which a body stays in the mode, s.
        settles: whether its velocity across the axis settles where the sensors' walk hides it.
    """

    moves: bool
    acceleration: float
    lateral_acceleration: float
    velocity_noise: float
    bias_walk: float
    dwell: float
    settles: bool = False


@dataclass(frozen=True, slots=True)
class BodyDynamics:
    """What vehicles do, in every mode.

    Attributes:
        first_acceleration: standard deviation of a body's first acceleration, m/s².
        acceleration_time: correlation time of the acceleration, s.
        turn_rate: largest standard deviation of ω, rad/s, which holds at low speed.
        turn_time: correlation time of ω, s.
        standing: standard deviation of the speed of what stands, m/s.
        bias_time: time constant with which the bias returns to zero, s.
        first_bias: standard deviation of a body's first bias, m.
        evidence: power of the likelihoods that weigh the modes: below 1 where successive errors are alike.
    """

    first_acceleration: float
    acceleration_time: float
    turn_rate: float
    turn_time: float
    standing: float
    bias_time: float
    first_bias: float
    evidence: float


@dataclass(slots=True)
class BodyFilterState:
    """All that a body filter remembers: of n bodies in M modes.

    Attributes:
        mean: (n, M, 8).
        covariance: (n, M, 8, 8).
        probability: of the modes (n, M).
    """

    mean: Floats
    covariance: Floats
    probability: Floats


class BodyFilter:
    """An interacting multiple model filter of rigid bodies.

    Args:
        modes: in the order of the mode probabilities.
        dynamics: of all modes.

    Attributes:
        linking: whether each prediction leaves a `link`.
        link: what a smoother needs of the latest prediction, over `reported` states, n bodies; None without `linking`.
    """

    def __init__(self, modes: Sequence[BodyMode], dynamics: BodyDynamics) -> None:
        self._dynamics = dynamics
        self._moves = np.array([float(mode.moves) for mode in modes])
        self._steers = np.array([float(mode.moves and mode.acceleration > 0.0) for mode in modes])
        self._acceleration = np.array([mode.acceleration for mode in modes])
        self._lateral_acceleration = np.array([mode.lateral_acceleration for mode in modes])
        self._velocity_noise = np.array([mode.velocity_noise for mode in modes])
        self._walk = np.array([mode.bias_walk for mode in modes])
        self._dwell = np.array([mode.dwell for mode in modes])
        self._settles = np.array([float(mode.settles) for mode in modes])
        self._share = self._dwell / self._dwell.sum()
        self._state = self._empty()
        self.linking = False
        self.link: Link | None = None

    def __len__(self) -> int:
        return len(self._state.probability)

    @property
    def state(self) -> BodyFilterState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit the filter.
        """
        return self._state

    @state.setter
    def state(self, state: BodyFilterState) -> None:
        self._state = checked_state(state, self._empty())

    @property
    def probability(self) -> Floats:
        """Of the modes (n, M)."""
        return self._state.probability

    def spawn(
        self, position: Floats, noise: Floats, velocity: Floats, velocity_covariance: Floats, probability: Floats
    ) -> None:
        """Append k bodies.

        Args:
            position: (k, 2), m.
            noise: covariance of that position as measured, without the bias (k, 2, 2).
            velocity: over ground in each mode (k, M, 2), m/s.
            velocity_covariance: (k, M, 2, 2).
            probability: of the modes (k, M).
        """
        dynamics, (k, m) = self._dynamics, probability.shape
        mean, covariance = np.zeros((k, m, WIDTH)), np.zeros((k, m, WIDTH, WIDTH))
        mean[:, :, POSITION], mean[:, :, VELOCITY] = position[:, None], velocity
        bias = np.eye(2) * dynamics.first_bias**2
        covariance[:, :, POSITION, POSITION] = noise[:, None] + bias
        covariance[:, :, POSITION, BIAS] = covariance[:, :, BIAS, POSITION] = -bias
        covariance[:, :, BIAS, BIAS] = bias
        covariance[:, :, VELOCITY, VELOCITY] = velocity_covariance
        covariance[:, :, TURN, TURN] = dynamics.turn_rate**2 / 4
        covariance[:, :, ACCELERATION, ACCELERATION] = dynamics.first_acceleration**2
        state = self._state
        state.mean = np.concatenate([state.mean, mean])
        state.covariance = np.concatenate([state.covariance, covariance])
        state.probability = np.concatenate([state.probability, probability])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        state = self._state
        state.mean, state.covariance = state.mean[rows], state.covariance[rows]
        state.probability = state.probability[rows]

    def shift(self, step: Floats) -> None:
        """Move the reference points by steps (n, 2), m: what they lie on has turned, or is another part of the body."""
        self._state.mean[:, :, POSITION] += step[:, None]

    def loosen(self, rows: Indices, variance: float) -> None:
        """Let it be open again where on rows' bodies the leading reflections lie: position and bias, not their sum.

        Args:
            rows: of the bodies.
            variance: of each component, m².
        """
        covariance = self._state.covariance
        for at in (0, 1):
            covariance[rows, :, at, at] += variance
            covariance[rows, :, 6 + at, 6 + at] += variance
            covariance[rows, :, at, 6 + at] -= variance
            covariance[rows, :, 6 + at, at] -= variance

    def rebase(self, rows: Indices, step: Floats, variance: Floats) -> None:
        """Let the bias of rows refer to another reflection, which lies steps (m, 2) away, known to a variance (m,)."""
        self._state.mean[rows, :, BIAS] += step[:, None]
        for axis in (6, 7):
            self._state.covariance[rows, :, axis, axis] += variance[:, None]

    def predict(self, dt: float, axis: Floats, walk: Floats, settling: Floats) -> None:
        """Predict all bodies by dt, s.

        Args:
            dt: s.
            axis: unit vector along each body (n, 2), which a slow one speeds up along.
            walk: random walk of each one's bias along and across that axis, as its sensors have it (n, 2), m²/s.
            settling: rate at which the velocity across the axis settles in the modes that do (n,), 1/s.
        """
        self.link = None
        if not len(self):
            return
        self._interact(dt)
        before = self.combined() if self.linking else None
        transition = self._transition(dt, axis, settling)
        covariance = np.matmul(np.matmul(transition, self._state.covariance), np.swapaxes(transition, -2, -1))
        self._add_noise(covariance, dt, axis, walk)
        self._state.covariance = covariance
        if before is not None:
            weighted = np.matmul(self.probability[:, None], transition.reshape(len(self), -1, WIDTH * WIDTH))
            self.link = self._linked(before, weighted.reshape(-1, WIDTH, WIDTH))

    def _linked(self, before: tuple[Floats, Floats], transition: Floats) -> Link:
        """Return the link of a prediction from combined moments, with the modes' mean transition (n, 8, 8)."""
        was, covariance_was = before
        mean, covariance = self.combined()
        first, second = report_jacobian(was), report_jacobian(mean)
        cross = first @ covariance_was @ np.swapaxes(transition, 1, 2) @ np.swapaxes(second, 1, 2)
        state, predicted = reported(mean, covariance)
        return Link(state, predicted, smoothing_gain(cross, predicted))

    def _interact(self, dt: float) -> None:
        """Mix the modes' estimates, and predict the modes' probabilities (Blom and Bar-Shalom 1988)."""
        state = self._state
        m = len(self._dwell)
        if m == 1:
            return
        leave = -np.expm1(-dt / self._dwell)
        others = np.where(np.eye(m, dtype=np.bool_), 0.0, self._share)
        chain = leave[:, None] * others / others.sum(axis=1, keepdims=True) + np.diag(1.0 - leave)
        predicted = state.probability @ chain
        weight = np.swapaxes(state.probability[:, :, None] * chain / predicted[:, None, :], 1, 2)  # (n, to, from)
        origin = state.mean[:, :1]
        deviation = state.mean - origin
        mixed = np.matmul(weight, deviation)
        second = state.covariance + deviation[..., :, None] * deviation[..., None, :]
        n = len(deviation)
        covariance = np.matmul(weight, second.reshape(n, m, WIDTH * WIDTH)).reshape(n, m, WIDTH, WIDTH)
        covariance -= mixed[..., :, None] * mixed[..., None, :]
        state.mean, state.covariance, state.probability = origin + mixed, covariance, predicted

    def _transition(self, dt: float, axis: Floats, settling: Floats) -> Floats:
        """Predict the means; return the Jacobians F (n, M, 8, 8)."""
        dynamics, mean = self._dynamics, self._state.mean
        moves, steers = self._moves, self._steers
        velocity = mean[..., VELOCITY]
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        fast = (speed > _SLOW)[..., None]
        course = np.where(fast, velocity / np.maximum(speed, _SLOW)[..., None], axis[:, None])
        turn = np.clip(mean[..., TURN], -_FULL_TURN, _FULL_TURN) * dt * steers
        c, s = np.cos(turn), np.sin(turn)
        vx, vy = c * velocity[..., 0] - s * velocity[..., 1], s * velocity[..., 0] + c * velocity[..., 1]
        f = np.zeros((*mean.shape, WIDTH))
        f[..., 0, 0] = f[..., 1, 1] = 1.0
        f[..., 2, 2] = f[..., 3, 3] = c * moves
        f[..., 2, 3] = -s * moves
        f[..., 3, 2] = s * moves
        half = 0.5 * dt
        f[..., 0, 2] = f[..., 1, 3] = half * (1.0 + c) * moves
        f[..., 0, 3] = -half * s * moves
        f[..., 1, 2] = half * s * moves
        f[..., 2, TURN], f[..., 3, TURN] = -vy * dt * steers, vx * dt * steers
        f[..., 2:4, ACCELERATION] = course * (dt * steers)[:, None]
        f[..., 0:2, 4:6] = half * f[..., 2:4, 4:6]
        f[..., TURN, TURN] = np.exp(-dt / dynamics.turn_time)
        f[..., ACCELERATION, ACCELERATION] = np.exp(-dt / dynamics.acceleration_time)
        f[..., 6, 6] = f[..., 7, 7] = np.exp(-dt / dynamics.bias_time)
        gained = course * (mean[..., ACCELERATION] * dt * steers)[..., None]
        after = (np.stack([vx, vy], axis=-1) + gained) * moves[:, None]
        if settling.any():
            left = np.stack([-axis[:, 1], axis[:, 0]], axis=1)[:, None]
            settled = -np.expm1(-dt * settling[:, None] * self._settles)
            after -= (settled * (left * after).sum(axis=-1))[..., None] * left
            across = (left[..., None] * f[..., 2:4, :]).sum(axis=-2)
            f[..., 2:4, :] -= settled[..., None, None] * left[..., None] * across[..., None, :]
        mean[..., POSITION] += half * (velocity * moves[:, None] + after)
        mean[..., VELOCITY] = after
        mean[..., 4:] *= np.diagonal(f[0, 0])[4:]
        return f

    def _add_noise(self, covariance: Floats, dt: float, axis: Floats, walk: Floats) -> None:
        """Add the process noise Q of a step of dt, s, to the predicted covariances."""
        dynamics, mean = self._dynamics, self._state.mean
        white = self._velocity_noise
        for at in (0, 1):
            covariance[..., at, at] += white * (dt**3 / 3.0)
            covariance[..., at, 2 + at] += white * (dt**2 / 2.0)
            covariance[..., 2 + at, at] += white * (dt**2 / 2.0)
            covariance[..., 2 + at, 2 + at] += white * dt + (1.0 - self._moves) * dynamics.standing**2
            covariance[..., 6 + at, 6 + at] += self._walk * dt
        c, sine = axis[:, 0], axis[:, 1]
        across = walk[:, 1] * dt
        more = (walk[:, 0] - walk[:, 1]) * dt
        covariance[..., 6, 6] += (across + more * c * c)[:, None]
        covariance[..., 7, 7] += (across + more * sine * sine)[:, None]
        covariance[..., 6, 7] += (more * c * sine)[:, None]
        covariance[..., 7, 6] += (more * c * sine)[:, None]
        speed = np.hypot(mean[..., 2], mean[..., 3])
        turn_rate = np.minimum(self._lateral_acceleration / np.maximum(speed, _SLOW), dynamics.turn_rate)
        covariance[..., TURN, TURN] += turn_rate**2 * -np.expm1(-2.0 * dt / dynamics.turn_time)
        gained = -np.expm1(-2.0 * dt / dynamics.acceleration_time)
        covariance[..., ACCELERATION, ACCELERATION] += self._acceleration**2 * gained

    def update(self, rows: Indices, measurement: Measurement) -> Floats:
        """Update the given rows (m,) with a measurement each; return their NIS (m,), weighted as the modes are."""
        state = self._state
        every = len(rows) == len(self) and bool((rows == np.arange(len(rows))).all())
        mean = state.mean if every else state.mean[rows]
        covariance = state.covariance if every else state.covariance[rows]
        prior = state.probability if every else state.probability[rows]
        nis, log_likelihood = self._update_position(mean, covariance, measurement)
        if measurement.range_rate is not None and measurement.range_rate_variance is not None:
            reflection = np.concatenate([mean[..., POSITION] + mean[..., BIAS], mean[..., VELOCITY]], axis=-1)
            rate, row = line_of_sight(reflection, measurement.origin, measurement.velocity)
            wide = np.zeros_like(mean)
            wide[..., :4] = row
            wide[..., BIAS] = row[..., :2]
            innovation = measurement.range_rate[:, None] - rate
            self._update_scalar(
                mean, covariance, wide, innovation, measurement.range_rate_variance, nis, log_likelihood
            )
        for part in measurement.projections:
            wide = np.zeros_like(mean)
            wide[..., VELOCITY] = part.direction[:, None]
            innovation = part.value[:, None] - (wide[..., VELOCITY] * mean[..., VELOCITY]).sum(axis=-1)
            self._update_scalar(mean, covariance, wide, innovation, part.variance, nis, log_likelihood)
        evidence = self._dynamics.evidence * (log_likelihood - log_likelihood.max(axis=1, keepdims=True))
        weight = prior * np.exp(evidence)
        weight = np.maximum(weight / weight.sum(axis=1, keepdims=True), _LEAST_PROBABILITY)
        posterior = weight / weight.sum(axis=1, keepdims=True)
        weighted = np.asarray((prior * nis).sum(axis=1))
        if every:
            state.probability = posterior
        else:
            state.mean[rows], state.covariance[rows], state.probability[rows] = mean, covariance, posterior
        return weighted

    @staticmethod
    def _update_position(mean: Floats, covariance: Floats, measurement: Measurement) -> tuple[Floats, Floats]:
        """Update with the positions, x + b; return NIS and log likelihood, (m, M) each."""
        innovation = measurement.position[:, None] - mean[..., POSITION] - mean[..., BIAS]
        cross = covariance[..., POSITION] + covariance[..., BIAS]  # P Hᵀ (m, M, 8, 2)
        s = cross[..., POSITION, :] + cross[..., BIAS, :] + measurement.noise[:, None]
        a, b, d = s[..., 0, 0], s[..., 0, 1], s[..., 1, 1]
        determinant = a * d - b * b
        inverse = np.empty_like(s)
        inverse[..., 0, 0], inverse[..., 1, 1] = d / determinant, a / determinant
        inverse[..., 0, 1] = inverse[..., 1, 0] = -b / determinant
        gain = np.matmul(cross, inverse)
        weighted = np.matmul(inverse, innovation[..., None])[..., 0]
        nis = (innovation * weighted).sum(axis=-1)
        mean += np.matmul(cross, weighted[..., None])[..., 0]
        covariance -= np.matmul(gain, np.swapaxes(cross, -2, -1))
        return nis, -0.5 * (nis + np.log(determinant)) - _LOG_2_PI

    @staticmethod
    def _update_scalar(
        mean: Floats,
        covariance: Floats,
        row: Floats,
        innovation: Floats,
        variance: Floats,
        nis: Floats,
        log_likelihood: Floats,
    ) -> None:
        """Update with one number each, NaN where it was not measured, and add to NIS and log likelihood.

        Args:
            mean: (m, M, 8), changed in place.
            covariance: (m, M, 8, 8), changed in place.
            row: H of each (m, M, 8).
            innovation: (m, M).
            variance: of the measurement (m,).
            nis: (m, M), added to.
            log_likelihood: (m, M), added to.
        """
        known = np.isfinite(innovation)
        if not known.all():
            innovation, row = np.where(known, innovation, 0.0), np.where(known[..., None], row, 0.0)
        cross = np.matmul(covariance, row[..., None])[..., 0]
        s = (row * cross).sum(axis=-1) + variance[:, None]
        gain = cross / s[..., None]
        mean += gain * innovation[..., None]
        covariance -= gain[..., :, None] * cross[..., None, :]
        part = innovation**2 / s
        nis += part
        log_likelihood -= np.where(known, 0.5 * (part + np.log(s) + _LOG_2_PI), 0.0)

    def combined(self) -> tuple[Floats, Floats]:
        """Return means (n, 8) and covariances (n, 8, 8) over all modes."""
        return moments(self._state.probability, self._state.mean, self._state.covariance)

    def _empty(self) -> BodyFilterState:
        m = len(self._dwell)
        return BodyFilterState(np.zeros((0, m, WIDTH)), np.zeros((0, m, WIDTH, WIDTH)), np.zeros((0, m)))


def acceleration(mean: Floats) -> Floats:
    """Return the accelerations over ground (n, 2), m/s²: along the course, and towards the centre of the turn.

    Args:
        mean: states (n, 8).
    """
    return np.asarray((report_jacobian(mean)[:, 4:, 4:6] @ mean[:, 4:6, None])[:, :, 0])


def report_jacobian(mean: Floats) -> Floats:
    """Return the Jacobian (n, 6, 8) of [x, y, vx, vy, ax, ay] over the state, velocity held for the last two."""
    velocity = mean[:, VELOCITY]
    course = velocity / np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]), _SLOW)[:, None]
    jacobian = np.zeros((len(mean), 6, WIDTH))
    jacobian[:, :4, :4] = np.eye(4)
    jacobian[:, 4, TURN], jacobian[:, 5, TURN] = -velocity[:, 1], velocity[:, 0]
    jacobian[:, 4:, ACCELERATION] = course
    return jacobian


def reported(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return means (n, 6) and covariances (n, 6, 6) of [x, y, vx, vy, ax, ay], local frame.

    Args:
        mean: states (n, 8).
        covariance: (n, 8, 8).
    """
    jacobian = report_jacobian(mean)
    state = np.concatenate([mean[:, :4], acceleration(mean)], axis=1)
    return state, jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
