"""The motion of rigid bodies, all bodies at once: an interacting multiple model filter with one row a body.

The state is [x, y, vx, vy, ω, a, bx, by] in the local frame: reference point (m), velocity over ground (m/s), turn rate
(rad/s, positive to the left), acceleration along the course (m/s²), and the bias of what the sensors report of the
reference point (m). A vehicle's velocity lies along its axis, so ω turns the velocity and a stretches it: a coordinated
turn with an acceleration (Bar-Shalom, Li and Kirubarajan 2001, ch. 11). In these coordinates, other than with speed and
heading as states, a body at rest is nothing special, and the modes' estimates can be mixed.

The bias is a first-order Gauss-Markov process: reflections wander over a body, and radars that filter by themselves
report a random walk about the truth. A measured position is x + b and white noise.

The modes share the state, and differ in what moves it: `BodyMode`.

The arrays lie in memory with the bodies innermost, and all work is done on their transposes, components first:
(8, M, n) and (8, 8, M, n). Each component of all bodies and modes is then one run of numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1, prod

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state
from candaemon.estimation.body_rates import LEAST_INFORMATION, BodyRates, SpeedComponent
from candaemon.estimation.body_transition import BodyTransition, symmetrise_upper
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.smoothing import Link, smoothing_gain

WIDTH = 8
SLOW = 1.0  # m/s, below which the course says nothing of the axis
POSITION, VELOCITY, BIAS = slice(0, 2), slice(2, 4), slice(6, 8)
TURN, ACCELERATION = 4, 5
SEEN = [0, 1, 2, 3, 6, 7]  # of what sensors see: place, velocity, bias
_UNMEASURED = float(0.5 / np.pi)  # variance of a number that adds nothing to a log likelihood
_LEAST_PROBABILITY = 1e-6
_STOPPABLE = 3.0  # m/s in every mode that moves, from which nothing comes to stand at once
_LEAST_TURNING = 0.03  # root of the share of turn rates never hidden: a variance that fades for minutes would be zero
_UNSEEN_ACCELERATION = 0.1  # m/s² that a link adds: what stands has none at all, which would tie velocities to rounding
_SHARPEST_ONSET = 0.6  # rad/s, largest standard deviation of the rate of a turn that begins
_FULL_TURN = 1.2  # rad/s; hardly anything turns faster: a bicycle at 4 m/s on a circle of 3.5 m


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
        turn_time: correlation time of ω, s.
        settles: whether, where the sensors' walk hides it, its velocity across the axis settles while it is slow, and
            it hardly turns.
        onset: standard deviation of turn rate × speed of a turn that begins as this mode is entered, m/s²; 0: the turn
            rate stays what it was.
        acceleration_onset: standard deviation of an acceleration along the course that begins as this mode is entered,
            m/s²; 0: it stays what it was.
    """

    moves: bool
    acceleration: float
    lateral_acceleration: float
    velocity_noise: float
    bias_walk: float
    dwell: float
    turn_time: float
    settles: bool = False
    onset: float = 0.0
    acceleration_onset: float = 0.0


@dataclass(frozen=True, slots=True)
class BodyDynamics:
    """What vehicles do, in every mode.

    Attributes:
        first_acceleration: standard deviation of a body's first acceleration, if its mode has no smaller one, m/s².
        acceleration_time: correlation time of the acceleration, s.
        turn_rate: largest standard deviation of ω, rad/s, which holds at low speed.
        standing: standard deviation of the speed of what stands, m/s.
        first_bias: standard deviation of a body's first bias, m.
        evidence: power of the likelihoods that weigh the modes where successive errors are alike.
        settling: time constant with which a velocity across the axis settles that is wholly hidden, s.
        settling_speed: above which that does not settle, m/s: the course tells the axis, not the axis the course.
    """

    first_acceleration: float
    acceleration_time: float
    turn_rate: float
    standing: float
    first_bias: float
    evidence: float
    settling: float = 1.0
    settling_speed: float = 5.0


@dataclass(slots=True)
class BodyFilterState:
    """All that a body filter remembers: of n bodies in M modes, each array in Fortran's order.

    Attributes:
        mean: (n, M, 8).
        covariance: (n, M, 8, 8), symmetric to the last bit.
        probability: of the modes (n, M).
    """

    mean: Floats
    covariance: Floats
    probability: Floats


@dataclass(slots=True)  # made each cycle
class _StepConstants:
    """What a step has the same for all bodies in M modes.

    Attributes:
        dt: its length, s.
        leave: share of each mode's probability that leaves it (M, 1).
        decay: of ω, a and both components of the bias (4, M).
        drive: what drives each mode (7, M, 1), see `BodyFilter._drive`.
    """

    dt: float
    leave: Floats
    decay: Floats
    drive: Floats


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
        self._moves = _column([mode.moves for mode in modes])
        steers = _column([mode.moves and mode.acceleration > 0.0 for mode in modes])
        self._acceleration = _column([mode.acceleration for mode in modes])
        self._lateral_acceleration = _column([mode.lateral_acceleration for mode in modes])
        white = _column([mode.velocity_noise for mode in modes])
        walk = _column([mode.bias_walk for mode in modes])
        self._settles = _column([mode.settles for mode in modes])
        self._onset = _column([mode.onset for mode in modes])
        self._speeding = _column([mode.acceleration_onset for mode in modes])
        self._begins = np.hstack([self._onset, self._settles, self._speeding]).T.copy()
        self._dwell = _column([mode.dwell for mode in modes])
        self._others = self._dwell.sum() - self._dwell
        self._has_room = len(modes) <= compiled.WIDEST
        self._turn_time = _column([mode.turn_time for mode in modes])
        self._fading = np.stack([self._dwell, 0.5 * self._turn_time])
        self._memory = np.vstack([self._turn_time.T, np.full((1, len(modes)), dynamics.acceleration_time)])
        self._modes = np.hstack([self._moves, self._lateral_acceleration, self._settles]).T.copy()
        none, variance = np.zeros_like(white), self._acceleration**2
        self._driven = np.stack([white, white, white, walk, none, variance, steers])
        self._standing = (1.0 - self._moves) * dynamics.standing**2
        self._state = self._empty()
        self._buffer = np.empty(0)
        self._step_constants = _StepConstants(np.nan, *[np.empty(0)] * 3)
        self.linking = False
        self.link: Link | None = None

    def __len__(self) -> int:
        return len(self._state.probability)

    @property
    def _compiled(self) -> bool:
        """Whether the kernels compute, which have room for so many modes."""
        return self._has_room and compiled.in_use

    @property
    def state(self) -> BodyFilterState:
        """All that it remembers; covariances that are set become symmetric.

        Raises:
            ValueError: a state that is set does not fit the filter.
        """
        return self._state

    @state.setter
    def state(self, state: BodyFilterState) -> None:
        self._state = checked_state(state, self._empty())
        state.mean, state.covariance = np.asfortranarray(state.mean), np.asfortranarray(state.covariance)
        symmetrise_upper(state.covariance.T)
        state.probability = np.asfortranarray(state.probability)

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
        mean, covariance = self._begun(position, noise, velocity, velocity_covariance)
        state = self._state
        self._set(
            np.concatenate([state.mean.T, mean.T], axis=-1),
            np.concatenate([state.covariance.T, covariance.T], axis=-1),
            np.concatenate([state.probability.T, probability.T], axis=-1),
        )

    def restart(
        self,
        rows: Indices,
        position: Floats,
        noise: Floats,
        velocity: Floats,
        velocity_covariance: Floats,
        probability: Floats,
    ) -> None:
        """Let bodies begin anew, as `spawn` does.

        Args:
            rows: of the bodies, none twice (k,).
            position: (k, 2), m.
            noise: covariance of that position, without the bias (k, 2, 2).
            velocity: over ground in each mode (k, M, 2), m/s.
            velocity_covariance: (k, M, 2, 2).
            probability: of the modes (k, M).
        """
        state = self._state
        state.mean[rows], state.covariance[rows] = self._begun(position, noise, velocity, velocity_covariance)
        state.probability[rows] = probability

    def _begun(
        self, position: Floats, noise: Floats, velocity: Floats, velocity_covariance: Floats
    ) -> tuple[Floats, Floats]:
        """Return means (k, M, 8) and covariances (k, M, 8, 8) of bodies that begin, as `spawn` is told."""
        dynamics, (k, m) = self._dynamics, velocity.shape[:2]
        mean, covariance = np.zeros((k, m, WIDTH)), np.zeros((k, m, WIDTH, WIDTH))
        mean[:, :, POSITION], mean[:, :, VELOCITY] = position[:, None], velocity
        bias = np.eye(2) * dynamics.first_bias**2
        covariance[:, :, POSITION, POSITION] = noise[:, None] + bias
        covariance[:, :, POSITION, BIAS] = covariance[:, :, BIAS, POSITION] = -bias
        covariance[:, :, BIAS, BIAS] = bias
        covariance[:, :, VELOCITY, VELOCITY] = velocity_covariance
        speed = np.hypot(velocity[..., 0], velocity[..., 1]).T
        covariance[:, :, TURN, TURN] = np.square(self._turn_rates(speed)).T
        first = np.minimum(self._acceleration, dynamics.first_acceleration)
        covariance[:, :, ACCELERATION, ACCELERATION] = np.square(first).T
        symmetrise_upper(covariance.T)
        return mean, covariance

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        state, rows = self._state, np.arange(len(self))[rows]
        self._set(*(array.T.take(rows, axis=-1) for array in (state.mean, state.covariance, state.probability)))

    def _set(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        """Take other estimates, components first."""
        self._state.mean, self._state.covariance = np.ascontiguousarray(mean).T, np.ascontiguousarray(covariance).T
        self._state.probability = np.ascontiguousarray(probability).T

    def shift(self, step: Floats) -> None:
        """Move the reference points by steps (n, 2), m: what they lie on has turned, or is another part of the body."""
        self._state.mean[:, :, POSITION] += step[:, None]

    def settle(self, step: Floats, spread: Floats | None = None) -> None:
        """Move the reference points by steps that the bias had: what the sensors see stays where it is.

        Args:
            step: (n, 2), m.
            spread: standard deviation, along a direction (n, 2), m/s, by which it is open again how fast bodies move
                that way, in the modes that move; None: it is not.
        """
        mean, covariance = self._state.mean.T, self._state.covariance.T
        if self._compiled:
            compiled.kernels.settle_bodies(mean, covariance, self._moves, step, spread)
            return
        mean[POSITION] += step.T[:, None]
        mean[BIAS] -= step.T[:, None]
        if spread is None:
            return
        opened = spread.T[:, None] * spread.T
        covariance[VELOCITY, VELOCITY] += self._moves * opened[:, :, None]

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

    def predict(self, dt: float, axis: Floats, walk: Floats, hidden: Floats, bias_time: Floats) -> None:
        """Predict all bodies by dt, s.

        Args:
            dt: s.
            axis: unit vector along each body (n, 2), which a slow one speeds up along.
            walk: random walk of each one's bias along and across that axis, as its sensors have it (n, 2), m²/s.
            hidden: how surely that walk hides how each moves across its axis, 0 to 1 (n,): in the modes that settle,
                the velocity across of what is slow then does, and it hardly turns.
            bias_time: time constants with which the biases return to zero (n,), s.
        """
        self.link = None
        if not len(self):
            return
        self._interact(dt, hidden)
        before = self.combined() if self.linking else None
        transition = self._step(dt, axis, walk, hidden, np.exp(-dt / bias_time))
        if before is not None and transition is not None:
            weighted = np.einsum("in,cdin->ncd", self.probability.T, transition.dense())
            self.link = self._linked(before, weighted)

    def _linked(self, before: tuple[Floats, Floats], transition: Floats) -> Link:
        """Return the link of a prediction from combined moments, with the modes' mean transition (n, 8, 8)."""
        was, covariance_was = before
        mean, covariance = self.combined()
        first, second = report_jacobian(was), report_jacobian(mean)
        cross = first @ covariance_was @ np.swapaxes(transition, 1, 2) @ np.swapaxes(second, 1, 2)
        state, predicted = reported(mean, covariance)
        for at in (4, 5):
            predicted[:, at, at] += _UNSEEN_ACCELERATION**2
        return Link(state, predicted, smoothing_gain(cross, predicted))

    def _interact(self, dt: float, hidden: Floats) -> None:
        """Mix the modes' estimates, and predict the modes' probabilities (Blom and Bar-Shalom 1988).

        A turn that begins may have any rate, and who brakes any acceleration: how the body moved before tells nothing
        of that. So where they begin in a mode, they are open to the extent that the body has just entered the mode.
        """
        if len(self._dwell) == 1:
            return
        dwell, others = self._dwell, self._others
        leave = self._constants(dt).leave
        prior, mean, covariance = self.probability.T, self._state.mean.T, self._state.covariance.T
        if self._compiled:
            limits = _STOPPABLE, _LEAST_PROBABILITY, SLOW, _SHARPEST_ONSET, _LEAST_TURNING
            self._state.probability = compiled.kernels.mix_bodies(
                mean, covariance, prior, leave, dwell, others, self._moves, self._begins, hidden, *limits
            ).T
            return
        # what leaves a mode goes to the others by their dwell: the part of a pool that all modes fill, but for its own
        share = leave / others
        filled, own = share * prior, (1.0 - leave - dwell * share) * prior
        predicted = own + dwell * _total(filled)
        own, pooled = own / predicted, dwell / predicted
        origin = mean[:, :1].copy()
        mean -= origin
        covariance += self._outer(mean, mean)
        pool = _weighted(filled, mean)
        mean *= own
        mean += pooled * pool[:, None]
        pool = _weighted(filled, covariance)
        covariance *= own
        covariance += np.multiply(pooled, pool[:, :, None], out=self._room(covariance.shape))
        covariance -= self._outer(mean, mean)
        mean += origin
        entered = pooled * (_total(filled) - filled)
        rate = np.minimum(self._onset / np.maximum(_speed(mean), SLOW), _SHARPEST_ONSET) * self._seen_turning(hidden)
        covariance[TURN, TURN] += entered * rate * rate
        covariance[ACCELERATION, ACCELERATION] += entered * self._speeding * self._speeding
        self._keep_moving(mean, predicted, (1.0 - leave) * prior)
        self._state.probability = predicted.T

    def _keep_moving(self, mean: Floats, probability: Floats, stays: Floats) -> None:
        """Let what moves fast not stand at the next moment: unseen, it would seem to slow down without a reason.

        What stands so far may go on to: a noisy place makes the modes that move fast, which says nothing against it.

        Args:
            mean: (8, M, n).
            probability: of the modes (M, n), changed.
            stays: probability with which each mode was there before, and is not left (M, n).
        """
        speed = _speed(mean).min(axis=0, where=self._moves > 0.0, initial=np.inf)
        stands = (self._moves == 0.0) & (speed > _STOPPABLE)
        most = np.where(stands, np.maximum(stays, _LEAST_PROBABILITY), np.inf)
        np.minimum(probability, most, out=probability)
        probability /= _total(probability)

    def _outer(self, left: Floats, right: Floats) -> Floats:
        """Return the products of vectors (8, M, n) and (8, M, n): (8, 8, M, n), for the moment only as of `_room`."""
        return np.multiply(left[:, None], right, out=self._room((WIDTH, *left.shape)))

    def _room(self, shape: tuple[int, ...]) -> Floats:
        """Return an array in memory that the next call takes: fresh memory costs more than what is computed in it."""
        size = prod(shape)
        if len(self._buffer) < size:
            self._buffer = np.empty(size)
        return self._buffer[:size].reshape(shape)

    def _step(self, dt: float, axis: Floats, walk: Floats, hidden: Floats, fade: Floats) -> BodyTransition | None:
        """Predict means and covariances in each mode; return F, which the kernel tells only if `linking`."""
        mean, covariance, constants = self._state.mean.T, self._state.covariance.T, self._constants(dt)
        drive, decay = constants.drive, constants.decay
        # an estimate that ran away would be blamed for all that follows
        if self._compiled:
            turn = compiled.kernels.turns_of_modes(mean, drive, TURN, 6, _FULL_TURN)
        else:
            np.minimum(np.maximum(mean[TURN], -_FULL_TURN), _FULL_TURN, out=mean[TURN])
            turn = mean[TURN] * drive[6]
        turned = np.empty((2, *turn.shape))
        np.cos(turn, out=turned[0])
        np.sin(turn, out=turned[1])
        settling = None
        if np.count_nonzero(hidden):
            settling = -np.expm1(-dt / self._dynamics.settling * hidden * self._settles * self.unsteady(_speed(mean)))
        if not self._compiled:
            transition = self._transition(dt, axis, turned, drive[6], decay, fade, settling)
            transition.propagate(covariance)
            self._add_noise(dt, axis, walk, hidden, drive)
            return transition
        gain = np.empty((4, 4, *turn.shape)) if self.linking else None
        compiled.kernels.step_bodies(
            mean,
            covariance,
            turned,
            self._modes,
            decay,
            drive,
            axis,
            walk,
            hidden,
            fade,
            settling,
            gain,
            dt,
            SLOW,
            self._dynamics.turn_rate,
            _LEAST_TURNING,
        )
        return None if gain is None else BodyTransition(gain, decay, fade)

    def unsteady(self, speed: Floats) -> Floats:
        """Return how surely bodies at speeds (…), m/s, have no course that could tell their axis (…), 0 to 1."""
        return np.asarray(np.exp(-np.square(speed / self._dynamics.settling_speed)))

    def _constants(self, dt: float) -> _StepConstants:
        """Return what a step of dt, s, has the same for all bodies."""
        if dt != self._step_constants.dt:
            (leave, turning), decay = -np.expm1(-dt / self._fading), np.exp(-dt / self._memory)
            self._step_constants = _StepConstants(dt, leave, decay, self._drive(dt, turning))
        return self._step_constants

    def _drive(self, dt: float, turning: Floats) -> Floats:
        """Return what drives each mode in a step of dt, s: (7, M, 1); the share of the variance of ω is given (M, 1).

        Added to the variance of a place, to that of place with speed, of a speed and of the bias; the share of the
        variance of ω that is added; added to the variance of a; and dt, if it steers.
        """
        gained = -expm1(-2.0 * dt / self._dynamics.acceleration_time)
        times = [dt**3 / 3.0, dt**2 / 2.0, dt, dt, 0.0, gained, dt]
        if compiled.in_use:
            return compiled.kernels.drive_modes(self._driven, self._standing, turning, times)
        drive = self._driven * np.array(times)[:, None, None]
        drive[2] += self._standing
        drive[4] = turning
        return np.asarray(drive)

    def _transition(
        self,
        dt: float,
        axis: Floats,
        turned: Floats,
        steered: Floats,
        decay: Floats,
        fade: Floats,
        settling: Floats | None,
    ) -> BodyTransition:
        """Predict the means; return their Jacobians F.

        Args:
            dt: s.
            axis: of the bodies (n, 2).
            turned: cosine and sine of the turns (2, M, n).
            steered: dt of the modes that steer, else 0 (M, 1).
            decay: as in `BodyTransition`.
            fade: likewise.
            settling: share of a velocity across the axis that goes (M, n); None: nothing of any.
        """
        mean, moves = self._state.mean.T, self._moves
        vx, vy, acceleration = mean[2], mean[3], mean[ACCELERATION]
        speed = _speed(mean)
        fast, divisor = speed > SLOW, np.maximum(speed, SLOW)
        c, s = turned
        turned_x, turned_y = c * vx - s * vy, s * vx + c * vy
        after = np.empty((2, 4, *speed.shape))  # velocity by velocity, ω and a
        after[0, 0] = after[1, 1] = c * moves
        after[1, 0] = s * moves
        after[0, 1] = -after[1, 0]
        after[0, 2], after[1, 2] = -turned_y * steered, turned_x * steered
        for at, component in ((0, vx), (1, vy)):
            after[at, 3] = np.where(fast, component / divisor, axis[:, at]) * steered
        velocity = np.stack(
            [turned_x * moves + after[0, 3] * acceleration, turned_y * moves + after[1, 3] * acceleration]
        )
        half = 0.5 * dt
        gain = np.concatenate([half * after, after])
        for at in (0, 1):
            gain[at, at] += half * moves
        if settling is not None:
            left_x, left_y = -axis[:, 1], axis[:, 0]
            settled = np.stack([settling * left_x, settling * left_y])
            velocity -= settled * (left_x * velocity[0] + left_y * velocity[1])
            gain[2:] -= settled[:, None] * (left_x * after[0] + left_y * after[1])
        mean[POSITION] += half * (mean[VELOCITY] * moves + velocity)
        mean[VELOCITY] = velocity
        mean[4:6] *= decay[:, :, None]
        mean[BIAS] *= fade
        return BodyTransition(gain, decay, fade)

    def _add_noise(self, dt: float, axis: Floats, walk: Floats, hidden: Floats, drive: Floats) -> None:
        """Add the process noise Q of a step of dt, s, to the predicted covariances."""
        mean, covariance = self._state.mean.T, self._state.covariance.T
        for at in (0, 1):
            covariance[at, at] += drive[0]
            covariance[at, 2 + at] += drive[1]
            covariance[2 + at, at] += drive[1]
            covariance[2 + at, 2 + at] += drive[2]
        c, sine = axis[:, 0], axis[:, 1]
        across = drive[3] + walk[:, 1] * dt
        more = (walk[:, 0] - walk[:, 1]) * dt
        covariance[6, 6] += across + more * c * c
        covariance[7, 7] += across + more * sine * sine
        covariance[6, 7] += more * c * sine
        covariance[7, 6] += more * c * sine
        turn_rate = self._turn_rates(_speed(mean)) * self._seen_turning(hidden)
        covariance[TURN, TURN] += turn_rate * turn_rate * drive[4]
        covariance[ACCELERATION, ACCELERATION] += drive[5]

    def _seen_turning(self, hidden: Floats) -> Floats:
        """Return the share of the turn rates' deviations that counts where the sensors' walk hides some (n,): (M, n).

        It is the square of what is not hidden: of a sensor that walks, most of what seems to turn is its walk.
        """
        return np.square(np.maximum(1.0 - self._settles * hidden, _LEAST_TURNING))

    def _turn_rates(self, speed: Floats) -> Floats:
        """Return the standard deviations of ω in each mode at speeds (M, n), m/s: (M, n), rad/s."""
        return np.minimum(self._lateral_acceleration / np.maximum(speed, SLOW), self._dynamics.turn_rate)

    def update(
        self, rows: Indices, measurement: Measurement, alike: float = 1.0, rates: BodyRates | None = None
    ) -> Floats:
        """Update the given rows with a measurement each.

        Args:
            rows: of the bodies (m,).
            measurement: one each; its range rates are not used.
            alike: how surely its errors are like those of the sensor's scan before, 0 to 1.
            rates: range rates of those bodies, any number each.

        Returns:
            The NIS of each (m,), weighted as the modes are.
        """
        state, rows = self._state, np.ascontiguousarray(rows, dtype=np.intp)
        mean, covariance, probability = state.mean.T, state.covariance.T, state.probability.T
        evidence = 1.0 + alike * (self._dynamics.evidence - 1.0)
        if self._compiled:
            return compiled.kernels.update_bodies(
                mean,
                covariance,
                probability,
                rows,
                measurement.position,
                measurement.noise,
                rates,
                measurement.projections,
                self._moves,
                LEAST_INFORMATION,
                evidence,
                _UNMEASURED,
                _LEAST_PROBABILITY,
            )
        mean, covariance, prior = (array.take(rows, axis=-1) for array in (mean, covariance, probability))
        nis, spread = self._take_places(mean, covariance, measurement)
        speeds = () if rates is None else rates.components(self._seen(mean, prior))
        for speed in (*speeds, *map(_component, measurement.projections)):
            self._take_speed(mean, covariance, speed, nis, spread)
        log_likelihood = -0.5 * (nis + np.log(spread))  # less what is the same in all modes
        weight = prior * np.exp(evidence * (log_likelihood - log_likelihood.max(axis=0)))
        weight = np.maximum(weight / _total(weight), _LEAST_PROBABILITY)
        probability[:, rows] = weight / _total(weight)
        state.mean.T[..., rows], state.covariance.T[..., rows] = mean, covariance
        return _total(prior * nis)

    def _seen(self, mean: Floats, probability: Floats) -> Floats:
        """Return the places where the sensors see bodies, velocities and turn rates, over all modes (m, 5)."""
        place = _weighted(probability, mean[POSITION] + mean[BIAS])
        return np.concatenate([place, _weighted(probability, mean[2:5])]).T

    def _take_places(self, mean: Floats, covariance: Floats, measurement: Measurement) -> tuple[Floats, Floats]:
        """Update with the positions, x + b; return NIS and determinants of the innovations' covariances, (M, m) each.

        Args:
            mean: of the bodies measured (8, M, m); changed in place.
            covariance: likewise, (8, 8, M, m).
            measurement: one each.
        """
        noise = measurement.noise
        x, y = measurement.position.T
        x, y = x - mean[0] - mean[6], y - mean[1] - mean[7]
        cross_x, cross_y = covariance[0] + covariance[6], covariance[1] + covariance[7]  # H P, (8, M, m) each
        # no less than the noise, nor than its determinant, which rounding hides where a body flies off
        a = np.maximum(cross_x[0] + cross_x[6] + noise[:, 0, 0], noise[:, 0, 0])
        least = noise[:, 0, 0] * noise[:, 1, 1] - noise[:, 0, 1] * noise[:, 0, 1]
        first = 1.0 / np.sqrt(a)
        slope = (cross_y[0] + cross_y[6] + noise[:, 0, 1]) * first
        rest = np.maximum(cross_y[1] + cross_y[7] + noise[:, 1, 1] - slope * slope, least / a)
        second = 1.0 / np.sqrt(rest)
        x *= first
        y = (y - slope * x) * second
        cross_x *= first
        cross_y -= slope * cross_x
        cross_y *= second
        mean += cross_x * x
        mean += cross_y * y
        covariance -= self._outer(cross_x, cross_x)
        covariance -= self._outer(cross_y, cross_y)
        return x * x + y * y, a * rest

    def _take_speed(self, mean: Floats, covariance: Floats, speed: SpeedComponent, nis: Floats, spread: Floats) -> None:
        """Update with one number each; add to NIS and determinants. One that was not measured changes no weight.

        Args:
            mean: as in `_take_places`.
            covariance: likewise.
            speed: of each.
            nis: (M, m), added to.
            spread: determinants of the innovations' covariances (M, m), multiplied by its variance.
        """
        (slope_x, slope_y), (x, y) = speed.slope.T, speed.direction.T
        place_x, place_y = mean[0] + mean[6], mean[1] + mean[7]
        innovation = speed.value - (slope_x * place_x + slope_y * place_y + x * mean[2] + y * mean[3])
        row = {0: slope_x, 1: slope_y, 2: x, 3: y, 6: slope_x, 7: slope_y}
        if speed.lever is not None:  # what stands does not turn
            row[TURN] = speed.lever * self._moves
            innovation = innovation - row[TURN] * mean[TURN]
        known = np.isfinite(innovation)
        innovation = np.where(known, innovation, 0.0)
        row = {component: np.where(known, value, 0.0) for component, value in row.items()}
        cross = sum((covariance[component] * value for component, value in row.items()), start=np.zeros(()))
        s = sum((cross[component] * value for component, value in row.items()), start=speed.variance)
        s = np.maximum(s, speed.variance)
        root = 1.0 / np.sqrt(s)
        cross, innovation = cross * root, innovation * root
        mean += cross * innovation
        covariance -= self._outer(cross, cross)
        nis += innovation * innovation
        spread *= np.where(known, s, _UNMEASURED)

    def combined(self) -> tuple[Floats, Floats]:
        """Return means (n, 8) and covariances (n, 8, 8) over all modes."""
        if self._compiled:
            state = self._state
            return compiled.kernels.combine_bodies(state.probability.T, state.mean.T, state.covariance.T)
        return self._combined(slice(None))

    def moments(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return means (n, 8) over all modes, the covariances of place and velocity (n, 4, 4), and what sensors see.

        That is as `shown` has it.
        """
        if self._compiled:
            state = self._state
            return compiled.kernels.moments_of_bodies(state.probability.T, state.mean.T, state.covariance.T)
        mean, covariance = self._combined(SEEN)
        return mean, covariance[:, :4, :4].copy(), *shown(mean, covariance)

    def shown_in_modes(self, rows: Indices) -> tuple[Floats, Floats]:
        """Return what sensors see of some bodies (m,) as `shown` has it, in each mode: (m, M, 4) and (m, M, 4, 4)."""
        state, m = self._state, len(self._dwell)
        covariance = state.covariance[rows][:, :, SEEN][..., SEEN]
        seen, spread = shown(state.mean[rows].reshape(-1, WIDTH), covariance.reshape(-1, 6, 6))
        return seen.reshape(-1, m, 4), spread.reshape(-1, m, 4, 4)

    def turn_rates(self) -> tuple[Floats, Floats]:
        """Return means and variances of ω over all modes (n,), rad/s and (rad/s)²."""
        probability, turn = self.probability.T, self._state.mean.T[TURN]
        mean = _weighted(probability, turn)
        return mean, _weighted(probability, self._state.covariance.T[TURN, TURN] + np.square(turn - mean))

    def _combined(self, components: slice | list[int]) -> tuple[Floats, Floats]:
        """Return means (n, 8) and covariances (n, K, K) over all modes, of K components those."""
        probability, mean = self.probability.T, self._state.mean.T
        overall = _weighted(probability, mean)
        deviation = (mean - overall[:, None])[components]
        second = deviation[:, None] * deviation
        second += self._state.covariance.T[components][:, components]
        return np.ascontiguousarray(overall.T), np.ascontiguousarray(_weighted(probability, second).T)

    def _empty(self) -> BodyFilterState:
        m = len(self._dwell)
        return BodyFilterState(np.zeros((0, m, WIDTH)), np.zeros((0, m, WIDTH, WIDTH)), np.zeros((0, m)))


def _component(projection: Projection) -> SpeedComponent:
    """Return a measured component of the velocity as one that depends on the velocity alone."""
    direction = np.ascontiguousarray(projection.direction)
    return SpeedComponent(np.zeros_like(direction), direction, projection.value, projection.variance)


def _column(values: Sequence[float]) -> Floats:
    """Return a number of each mode (M, 1)."""
    return np.array(values, dtype=np.float64)[:, None]


def _total(terms: Floats) -> Floats:
    """Return the sum over the modes (M, n), from the first to the last."""
    total = terms[0].copy()
    for term in terms[1:]:
        total += term
    return np.asarray(total)


def _weighted(weight: Floats, values: Floats) -> Floats:
    """Return the sum over the modes of weights (M, n) times values (…, M, n), from the first to the last."""
    total: Floats = weight[0] * values[..., 0, :]
    for mode in range(1, len(weight)):
        total += weight[mode] * values[..., mode, :]
    return total


def _speed(mean: Floats) -> Floats:
    """Return the speeds (…) of states (8, …), m/s; hypot, which libraries round in ways of their own, is not needed."""
    return np.asarray(np.sqrt(mean[2] * mean[2] + mean[3] * mean[3]))


def motion(mean: Floats) -> Floats:
    """Return [x, y, vx, vy, ax, ay] of bodies (n, 6), local frame.

    The acceleration over ground, m/s², is that along the course, and towards the centre of the turn.

    Args:
        mean: states (n, 8).
    """
    if compiled.in_use:
        return compiled.kernels.motion_of_bodies(mean, SLOW)
    vx, vy, turn = mean[:, 2], mean[:, 3], mean[:, TURN]
    along = mean[:, ACCELERATION] / np.maximum(_speed(mean.T), SLOW)
    return np.concatenate([mean[:, :4], np.stack([along * vx - turn * vy, along * vy + turn * vx], axis=1)], axis=1)


def shown(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return what sensors see of bodies: means (n, 4) and covariances (n, 4, 4) of [x + bx, y + by, vx, vy].

    Args:
        mean: states (n, 8).
        covariance: of [x, y, vx, vy, bx, by] (n, 6, 6).
    """
    seen = np.concatenate([mean[:, POSITION] + mean[:, BIAS], mean[:, VELOCITY]], axis=1)
    rows = covariance[:, :4].copy()
    rows[:, POSITION] += covariance[:, 4:]
    spread = rows[:, :, :4].copy()
    spread[:, :, POSITION] += rows[:, :, 4:]
    return seen, spread


def report_jacobian(mean: Floats) -> Floats:
    """Return the Jacobian (n, 6, 8) of [x, y, vx, vy, ax, ay] over the state, velocity held for the last two."""
    velocity = mean[:, VELOCITY]
    course = velocity / np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]), SLOW)[:, None]
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
    return motion(mean), jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
