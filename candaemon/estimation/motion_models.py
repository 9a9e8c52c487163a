"""Motion models over ground, batched over tracks.

Every model speaks of the state [x, y, vx, vy, ax, ay, ω, jx, jy] in the local frame (m, m/s, m/s², rad/s, m/s³; ω
positive to the left) and uses the `components` it has; the others stay zero. Where a model treats the two axes
differently, the axes are along and across the direction of travel, a unit vector a track.

Linear models are built axis by axis: an axis has a transition and a noise over (position, velocity, acceleration,
jerk), spread over the plane by `plane`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats
from candaemon.estimation.discretisation import Axis, X, Y, decaying_axis, directed, isotropic, white_axis, white_plane
from candaemon.estimation.kalman import diagonals_of

POSITION, VELOCITY, ACCELERATION, TURN = slice(0, 2), slice(2, 4), slice(4, 6), 6
JERK = slice(7, 9)


class MotionModel(Protocol):
    """A motion model of n tracks at once.

    Source: Kim and Hong 2004, eq. (1).
    """

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        ...

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the predicted mean (n, D), the Jacobian F and the noise Q, each (n or 1, D, D).

        Args:
            mean: state, (n, D), D the width of the state that the filter carries.
            dt: time step, s.
            direction: unit vector of travel in the local frame, (n, 2).
        """
        ...


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Nearly constant velocity, acceleration or jerk, its noise and memory chosen along and across the travel.

    Source: Kim and Hong 2004, eqs. (5), (6); Zhang et al. 2016, eqs. (1), (2), (3).

    Of order 1 it is (1) to (3) of Zhang et al. 2016 and (5), (6) of Kim and Hong 2004; but for the noise, which is
    white in continuous time, where those papers have an acceleration that is constant over a step, through G.

    Attributes:
        order: 1 constant velocity (CV, Friedland), 2 constant acceleration (CA, Hampton), 3 constant jerk (Hou's four
            states of an axis).
        noise: power of the white noise along and across, (m/s²)²/Hz for order 1, (m/s³)²/Hz for order 2, (m/s⁴)²/Hz
            for order 3.
        decay_time: time constants along and across with which the highest derivative decays, s; None: it keeps, as the
            jerk always does. Across, it is the *velocity* that decays, whatever the order: vehicles keep to their lane.
        position_noise: power spectral density of the position's random walk along and across, m²/s: the reflection
            moves over the vehicle.
    """

    order: int
    noise: tuple[float, float]
    decay_time: tuple[float | None, float | None] = (None, None)
    position_noise: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.order == 3 and self.decay_time != (None, None):
            raise ValueError("a constant jerk does not settle")

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return (tuple(range(4)), tuple(range(6)), (*range(6), 7, 8))[self.order - 1]

    @property
    def isotropic(self) -> bool:
        """Whether the model is the same along and across the travel."""
        return (
            self.decay_time == (None, None)
            and self.noise[0] == self.noise[1]
            and self.position_noise[0] == self.position_noise[1]
        )

    def axes(self, dt: float) -> tuple[Axis, Axis]:
        """Return the axis along and the axis across the direction of travel."""
        across = self.order if self.decay_time[1] is None else 1
        return self._axis(0, self.order, dt), self._axis(1, across, dt)

    def _axis(self, which: int, order: int, dt: float) -> Axis:
        time_constant = self.decay_time[which]
        if time_constant is None:
            axis = white_axis(dt, self.noise[which], order=order)
        else:
            axis = decaying_axis(1.0 / time_constant, dt, self.noise[which], order=order)
        axis.noise[0, 0] += self.position_noise[which] * dt
        return axis

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Predict the mean with its own F; see `MotionModel.transition`."""
        width = mean.shape[1]
        if self.isotropic:
            f, q = _white_matrices(self.order, width, dt, self.noise[0], self.position_noise[0])
            return _moved(mean, f), f, q
        along, across = self.axes(dt)
        f = directed(along.transition, across.transition, direction, width)
        return _moved(mean, f), f, directed(along.noise, across.noise, direction, width)

    def predicted_mean(self, mean: Floats, dt: float, direction: Floats) -> Floats:
        """Predict the mean alone; see the function `predicted_mean`."""
        if self.isotropic:
            return _moved(mean, _white_matrices(self.order, mean.shape[1], dt)[0])
        along, across = self.axes(dt)
        return _moved(mean, directed(along.transition, across.transition, direction, mean.shape[1]))


@dataclass(frozen=True, slots=True)
class Singer:
    """Singer's model: acceleration is coloured noise of zero mean, Han et al. 2015, eq. (9) with ā = 0.

    Source: Han et al. 2015, eq. (9).

    Attributes:
        alpha: manoeuvre frequency α, 1/s.
        deviation: standard deviation of the acceleration, m/s².
    """

    alpha: float
    deviation: float

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return tuple(range(6))

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Predict with F by (15) and Q by (18), (19) of Han et al. 2015; see `MotionModel.transition`."""
        del direction  # the model is the same in every direction
        axis = decaying_axis(self.alpha, dt, 2 * self.alpha * self.deviation**2, order=2)
        f = isotropic(axis.transition, mean.shape[1])
        return _moved(mean, f[None]), f[None], isotropic(axis.noise, mean.shape[1])[None]


@dataclass(frozen=True, slots=True)
class CurrentStatistical:
    """The current statistical model: acceleration decays to its current mean, its variance adapts.

    Source: Han et al. 2015, eqs. (9), (10), (11), (13); Zhang et al. 2016, eqs. (4), (5), (6).

    It is (14) to (20) of Han et al. 2015, from the continuous (9) to (13), and (4) to (6) of Zhang et al. 2016.

    The variance is that of a modified Rayleigh density between the current acceleration and the limit, (8) and (20).
    At and beyond the limit (8) falls to zero, and past it grows again: a target that brakes at the limit would be lost.
    So the distance to the limit is clamped at zero and the variance has a floor.

    Attributes:
        alpha: manoeuvre frequency α, 1/s.
        limit: a_max, m/s², the same forwards and backwards.
        floor: smallest variance of the acceleration, (m/s²)².
        innovation_memory: time constant, s, of the mean NIS that the variance follows too, `driven_variance`; None: it
            does not.
    """

    alpha: float
    limit: float
    floor: float
    innovation_memory: float | None = None

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return tuple(range(6))

    def transition(
        self, mean: Floats, dt: float, direction: Floats, fit: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Predict the mean with F x + U ā, and return F and Q, whose variance adapts.

        Source: Han et al. 2015, eqs. (14), (17), (18).

        The mean acceleration ā is the current one (17), so that F x + U ā is the transition of constant acceleration,
        and F the Jacobian with ā held. See `MotionModel.transition`.

        Args:
            mean: state, (n, D).
            dt: time step, s.
            direction: of travel, (n, 2).
            fit: recent mean NIS over its degrees of freedom (n,), where the variance follows the innovations.
        """
        del direction  # the model is the same in every direction
        width = mean.shape[1]
        axis = decaying_axis(self.alpha, dt, 2 * self.alpha, order=2)
        f = isotropic(axis.transition, width)
        predicted = _driven(mean, axis, f)
        per_axis = np.zeros((2, width, width))
        per_axis[0, X, X] = per_axis[1, Y, Y] = axis.noise
        variance = self.variance(mean[:, ACCELERATION])
        if fit is not None:
            variance = driven_variance(variance, self.floor, fit[:, None])
        q = variance @ per_axis.reshape(2, -1)
        return predicted, f[None], q.reshape(-1, width, width)

    def predicted_mean(self, mean: Floats, dt: float, direction: Floats) -> Floats:
        """Predict the mean alone; see the function `predicted_mean`."""
        del direction  # as above
        axis = decaying_axis(self.alpha, dt, 2 * self.alpha, order=2)
        return _driven(mean, axis, isotropic(axis.transition, mean.shape[1]))

    def variance(self, acceleration: Floats) -> Floats:
        """Return σₐ² of (8) and (20), with the clamp and the floor.

        Source: Han et al. 2015, eqs. (8), (12), (20).
        """
        room = np.maximum(self.limit - np.abs(acceleration), 0.0)
        return np.maximum((4 - np.pi) / np.pi * room**2, self.floor)


def driven_variance(variance: Floats, floor: float, fit: Floats) -> Floats:
    """Return the acceleration's variance between its floor and (8), as the innovations ask for it.

    As long as the innovations are as small as a target that keeps its acceleration makes them, the floor is enough;
    where they are twice as large as predicted, it is (8) in full.

    Args:
        variance: by (8) and (20), (m/s²)².
        floor: smallest variance, (m/s²)².
        fit: recent mean NIS over its degrees of freedom.
    """
    return np.asarray(floor + np.clip(fit - 1.0, 0.0, 1.0) * (variance - floor))


@dataclass(frozen=True, slots=True)
class CoordinatedTurn:
    """Nearly constant speed turn; valid on velocity over ground only.

    Source: Kim and Hong 2004, eqs. (10), (11), (15).

    The first row of (9) and (11) lacks a sign, −(1 − cos ωT) / ω. The noise is white in continuous time, where (11) has
    accelerations that are constant over a step, through G.

    Attributes:
        noise: power of the white noise on velocity, (m/s²)²/Hz.
        turn_noise: power of the white noise on ω, (rad/s²)²/Hz.
        position_noise: power spectral density of the position's random walk, m²/s.
        limit: largest turn rate, rad/s; beyond it, as far as no vehicle goes, the estimate is drawn back to it. A slow
            target shows little of its turn rate, and past π/T any turn looks like another.
    """

    noise: float
    turn_noise: float
    position_noise: float = 0.0
    limit: float = np.inf

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return (0, 1, 2, 3, TURN)

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Turn the velocity by ωT; F is the Jacobian, f_ω its last column.

        Source: Kim and Hong 2004, eqs. (7), (8), (9), (11).

        Beyond the limit F is that at the limit, its last column included: were the clip's own derivative taken, which
        is none, the turn rate would count as known but for its noise. See `MotionModel.transition`.
        """
        del direction  # the model is the same in every direction
        predicted, f = _turned(mean, dt, self.limit)
        _, q = _white_matrices(1, mean.shape[1], dt, self.noise, self.position_noise, self.turn_noise)
        return predicted, f, q

    def predicted_mean(self, mean: Floats, dt: float, direction: Floats) -> Floats:
        """Predict the mean alone; see the function `predicted_mean`."""
        del direction  # as above
        return _turned(mean, dt, self.limit)[0]


def _turned(mean: Floats, dt: float, limit: float) -> tuple[Floats, Floats]:
    """Return means (n, D) after a turn over dt, s, and its Jacobian (n, D, D), at turn rates up to a limit, rad/s.

    Source: Kim and Hong 2004, eqs. (9), (11).
    """
    w = np.minimum(np.maximum(mean[:, TURN], -limit), limit)
    angle = w * dt
    sine, cosine = np.sin(angle), np.cos(angle)
    if compiled.in_use:
        return compiled.kernels.coordinated_turn(mean, dt, w, sine, cosine)
    small = np.abs(angle) < 1e-4  # where quotients by ω lose their digits
    divisor = np.where(small, 1.0, w)
    s = np.where(small, dt * (1.0 - angle * angle / 6.0), sine / divisor)
    c = np.where(small, dt * angle / 2.0, (1.0 - cosine) / divisor)
    s_w = np.where(small, -dt * dt * angle / 3.0, (dt * cosine - s) / divisor)
    c_w = np.where(small, dt * dt / 2.0, (dt * sine - c) / divisor)
    vx, vy, predicted = mean[:, 2], mean[:, 3], mean.copy()
    predicted[:, 0] += s * vx - c * vy
    predicted[:, 1] += c * vx + s * vy
    predicted[:, 2] = cosine * vx - sine * vy
    predicted[:, 3] = sine * vx + cosine * vy
    predicted[:, TURN] = w
    f = np.zeros((mean.shape[1], mean.shape[1], len(mean))).transpose(2, 0, 1)  # tracks last
    f[:, 0, 0] = f[:, 1, 1] = f[:, TURN, TURN] = 1.0
    f[:, 0, 2] = f[:, 1, 3] = s
    f[:, 0, 3], f[:, 1, 2] = -c, c
    f[:, 2, 2] = f[:, 3, 3] = cosine
    f[:, 2, 3], f[:, 3, 2] = -sine, sine
    f[:, 0, TURN] = s_w * vx - c_w * vy
    f[:, 1, TURN] = c_w * vx + s_w * vy
    f[:, 2, TURN] = -dt * predicted[:, 3]
    f[:, 3, TURN] = dt * predicted[:, 2]
    return predicted, f


def predicted_mean(model: MotionModel, mean: Floats, dt: float, direction: Floats) -> Floats:
    """Return the predicted mean (n, D) of a model's `transition` alone, to the last bit."""
    match model:
        case LinearModel() | CurrentStatistical() | CoordinatedTurn():  # whose F or Q cost time
            return model.predicted_mean(mean, dt, direction)
        case _:
            return model.transition(mean, dt, direction)[0]


@lru_cache(maxsize=64)
def _white_matrices(
    order: int, width: int, dt: float, noise: float = 0.0, position_noise: float = 0.0, turn_noise: float | None = None
) -> tuple[Floats, Floats]:
    """Return F and Q (1, width, width) of `white_plane`; not to be written to.

    Steps of time are the same in many cycles, horizons in all.
    """
    f, q = white_plane(dt, noise, order=order, width=width)
    q[0, 0] += position_noise * dt
    q[1, 1] += position_noise * dt
    if turn_noise is not None:
        q[TURN, TURN] = turn_noise * dt
    f.flags.writeable = q.flags.writeable = False
    return f[None], q[None]


def _moved(mean: Floats, transition: Floats) -> Floats:
    """Return F x of means (n, D) for transitions (n or 1, D, D)."""
    if compiled.in_use:
        return compiled.kernels.moved(mean, transition)
    return diagonals_of(transition).times(mean.T[:, None])[:, 0].T


def _driven(mean: Floats, axis: Axis, transition: Floats) -> Floats:
    """Return F x + U ā of means (n, D), ā the current acceleration, (17) of Han et al. 2015."""
    predicted = _moved(mean, transition[None])
    predicted[:, :6] += (axis.input[:, None] * mean[:, None, ACCELERATION]).reshape(-1, 6)
    return predicted
