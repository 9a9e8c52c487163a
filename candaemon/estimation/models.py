"""Motion models over ground, batched over tracks.

Every model speaks of the state [x, y, vx, vy, ax, ay, ω] in the level frame (m, m/s, m/s², rad/s, ω positive to the
left) and uses the `components` it has; the others stay zero. Where a model treats the two axes differently, the axes
are along and across the direction of travel, a unit vector a track.

Linear models are built axis by axis: an axis has a 3 × 3 transition and noise over (position, velocity,
acceleration), and the plane's matrices are F = Fₗ ⊗ A + Fₜ ⊗ (I − A) with A = d dᵀ of the direction d.
Paper 000 writes the same matrices with the state ordered [x, ẋ, ẍ, y, ẏ, ÿ].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

POSITION, VELOCITY, ACCELERATION, TURN = slice(0, 2), slice(2, 4), slice(4, 6), 6
_X, _Y = slice(0, 6, 2), slice(1, 6, 2)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_NODES, _WEIGHTS = (_NODES + 1) / 2, _WEIGHTS / 2


class MotionModel(Protocol):
    """A motion model of n tracks at once."""

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        ...

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the predicted mean (n, D), the Jacobian F and the noise Q, each (n or 1, D, D).

        Args:
            mean: state, (n, D), D the width of the state that the filter carries.
            dt: time step, s.
            direction: unit vector of travel in the level frame, (n, 2).
        """
        ...


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis over one time step: transition and noise over (position, velocity, acceleration), 3 × 3 each."""

    transition: Floats
    noise: Floats


def _integrated(gains: Floats, dt: float) -> Floats:
    """Integrate gains gainsᵀ over the step by Gauss-Legendre quadrature.

    The textbook closed forms cancel for small αT; a weighted sum of outer products neither cancels nor
    leaves the positive semidefinite cone.
    """
    return (gains * (_WEIGHTS * dt)) @ gains.T


def decaying_axis(rate: float, dt: float, intensity: float, *, order: int) -> Axis:
    """Return an axis whose highest derivative decays exponentially.

    Args:
        rate: α, 1/s, the inverse time constant.
        dt: T, s.
        intensity: power of the white noise that drives the highest derivative.
        order: 2, the acceleration decays: Singer and paper 000 (15), (19); 1, the velocity does: a drift that settles.

    Returns:
        Transition (15) and noise (19) of paper 000 for order 2.
    """
    settled = -expm1(-rate * dt) / rate
    decay = 1.0 - rate * settled
    moments = np.zeros((3, len(_NODES)))
    elapsed = _NODES * dt
    ramp = np.expm1(-rate * elapsed) / -rate
    if order == 1:
        f = np.array(((1.0, settled, 0.0), (0.0, decay, 0.0), (0.0, 0.0, 0.0)))
        moments[0], moments[1] = ramp, 1.0 - rate * ramp
    else:
        f = np.array(((1.0, dt, (dt - settled) / rate), (0.0, 1.0, settled), (0.0, 0.0, decay)))
        moments[0], moments[1], moments[2] = (elapsed - ramp) / rate, ramp, 1.0 - rate * ramp
    return Axis(f, intensity * _integrated(moments, dt))


def white_axis(dt: float, intensity: float, *, order: int) -> Axis:
    """Return an axis driven by white noise: order 1 nearly constant velocity, order 2 nearly constant acceleration.

    Friedland's and Hampton's models with continuous white noise on the highest derivative.
    """
    f, q = np.zeros((3, 3)), np.zeros((3, 3))
    f[0, 0], f[0, 1], f[1, 1] = 1.0, dt, 1.0
    if order == 1:
        q[:2, :2] = ((dt**3 / 3, dt**2 / 2), (dt**2 / 2, dt))
    else:
        f[0, 2], f[1, 2], f[2, 2] = dt**2 / 2, dt, 1.0
        q[:] = (
            (dt**5 / 20, dt**4 / 8, dt**3 / 6),
            (dt**4 / 8, dt**3 / 3, dt**2 / 2),
            (dt**3 / 6, dt**2 / 2, dt),
        )
    return Axis(f, intensity * q)


def _plane(along: Floats, across: Floats, direction: Floats, width: int) -> Floats:
    """Spread two 3 × 3 axis matrices over the plane, (n, width, width)."""
    if along is across or not (along != across).any():
        return _isotropic(along, width)[None]
    difference = along - across
    cosine, sine = direction[:, 0, None, None], direction[:, 1, None, None]
    mixed = difference * (cosine * sine)
    out = np.zeros((len(direction), width, width))
    out[:, _X, _X] = across + difference * (cosine * cosine)
    out[:, _Y, _Y] = across + difference * (sine * sine)
    out[:, _X, _Y] = mixed
    out[:, _Y, _X] = mixed
    return out


def _isotropic(axis: Floats, width: int) -> Floats:
    """Give x and y the same 3 × 3 matrix, (width, width)."""
    full = np.zeros((width, width))
    full[_X, _X] = axis
    full[_Y, _Y] = axis
    return full


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Nearly constant velocity or acceleration, its noise and memory chosen along and across the travel.

    Attributes:
        order: 1 constant velocity (CV, Friedland), 2 constant acceleration (CA, Hampton).
        noise: power of the white noise along and across, (m/s²)²/Hz for order 1, (m/s³)²/Hz for order 2.
        settling: time constants along and across with which the highest derivative decays, s; None: it keeps.
            Across, it is the *velocity* that decays, whatever the order: vehicles keep to their lane.
        wander: power of a random walk of position along and across, m²/s: the reflection moves over the vehicle.
    """

    order: int
    noise: tuple[float, float]
    settling: tuple[float | None, float | None] = (None, None)
    wander: tuple[float, float] = (0.0, 0.0)

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return tuple(range(4 if self.order == 1 else 6))

    @property
    def isotropic(self) -> bool:
        """Whether the model is the same along and across the travel."""
        return self.settling == (None, None) and self.noise[0] == self.noise[1] and self.wander[0] == self.wander[1]

    def axes(self, dt: float) -> tuple[Axis, Axis]:
        """Return the axis along and the axis across the direction of travel."""
        along = self._axis(0, self.order, dt)
        if self.isotropic:
            return along, along
        return along, self._axis(1, self.order if self.settling[1] is None else 1, dt)

    def _axis(self, which: int, order: int, dt: float) -> Axis:
        time_constant = self.settling[which]
        if time_constant is None:
            axis = white_axis(dt, self.noise[which], order=order)
        else:
            axis = decaying_axis(1.0 / time_constant, dt, self.noise[which], order=order)
        axis.noise[0, 0] += self.wander[which] * dt
        return axis

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Predict the mean with its own F; see `MotionModel.transition`."""
        along, across = self.axes(dt)
        f = _plane(along.transition, across.transition, direction, mean.shape[1])
        q = _plane(along.noise, across.noise, direction, mean.shape[1])
        predicted = mean @ f[0].T if len(f) == 1 else np.matmul(f, mean[:, :, None])[:, :, 0]
        return predicted, f, q


@dataclass(frozen=True, slots=True)
class CurrentStatistical:
    """The current statistical model of paper 000: acceleration decays to its current mean, its variance adapts.

    The variance is that of a modified Rayleigh density between the current acceleration and the limit, (8) and (20).
    At and beyond the limit (8) falls to zero, and past it grows again: a target that brakes at the limit would be lost.
    So the distance to the limit is clamped at zero and the variance has a floor.

    Attributes:
        alpha: manoeuvre frequency α, 1/s.
        limit: a_max, m/s², the same forwards and backwards.
        floor: smallest variance of the acceleration, (m/s²)².
    """

    alpha: float
    limit: float
    floor: float

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return tuple(range(6))

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Predict the mean with (14), F by (15), Q by (18) to (20) of paper 000; see `MotionModel.transition`.

        With ā the current acceleration (17), F x + U ā is the constant-acceleration transition exactly.
        """
        del direction  # the model is the same in every direction
        width = mean.shape[1]
        axis = decaying_axis(self.alpha, dt, 2 * self.alpha, order=2)
        constant = np.array(((1.0, dt, dt * dt / 2), (0.0, 1.0, dt), (0.0, 0.0, 1.0)))
        predicted = mean @ _isotropic(constant, width).T
        per_axis = np.zeros((2, width, width))
        per_axis[0, _X, _X] = per_axis[1, _Y, _Y] = axis.noise
        q = self.variance(mean[:, ACCELERATION]) @ per_axis.reshape(2, -1)
        return predicted, _isotropic(axis.transition, width)[None], q.reshape(-1, width, width)

    def variance(self, acceleration: Floats) -> Floats:
        """Return σₐ² of (8) and (20), with the clamp and the floor."""
        room = np.maximum(self.limit - np.abs(acceleration), 0.0)
        return np.maximum((4 - np.pi) / np.pi * room**2, self.floor)


@dataclass(frozen=True, slots=True)
class CoordinatedTurn:
    """Nearly constant speed turn, paper 002 (9) with the signs put right; valid on velocity over ground only.

    Attributes:
        noise: power of the white noise on velocity, (m/s²)²/Hz.
        turn_noise: power of the white noise on ω, (rad/s²)²/Hz.
        wander: power of a random walk of position, m²/s.
    """

    noise: float
    turn_noise: float
    wander: float = 0.0

    @property
    def components(self) -> tuple[int, ...]:
        """Indices of the state's components that the model has."""
        return (0, 1, 2, 3, TURN)

    def transition(self, mean: Floats, dt: float, direction: Floats) -> tuple[Floats, Floats, Floats]:
        """Turn the velocity by ωT; F is the Jacobian; see `MotionModel.transition`."""
        del direction  # the model is the same in every direction
        vx, vy, w = mean[:, 2], mean[:, 3], mean[:, TURN]
        angle = w * dt
        small = np.abs(angle) < 1e-4
        divisor = np.where(small, 1.0, w)
        sine, cosine = np.sin(angle), np.cos(angle)
        s = np.where(small, dt * (1 - angle**2 / 6), sine / divisor)
        c = np.where(small, dt * angle / 2, (1 - cosine) / divisor)
        s_w = np.where(small, -dt * dt * angle / 3, (dt * cosine - s) / divisor)
        c_w = np.where(small, dt * dt / 2, (dt * sine - c) / divisor)
        predicted = mean.copy()
        predicted[:, 0] += s * vx - c * vy
        predicted[:, 1] += c * vx + s * vy
        predicted[:, 2] = cosine * vx - sine * vy
        predicted[:, 3] = sine * vx + cosine * vy
        f = np.zeros((len(mean), mean.shape[1], mean.shape[1]))
        f[:, 0, 0] = f[:, 1, 1] = f[:, TURN, TURN] = 1.0
        f[:, 0, 2] = f[:, 1, 3] = s
        f[:, 0, 3], f[:, 1, 2] = -c, c
        f[:, 2, 2] = f[:, 3, 3] = cosine
        f[:, 2, 3], f[:, 3, 2] = -sine, sine
        f[:, 0, TURN] = s_w * vx - c_w * vy
        f[:, 1, TURN] = c_w * vx + s_w * vy
        f[:, 2, TURN] = -dt * predicted[:, 3]
        f[:, 3, TURN] = dt * predicted[:, 2]
        axis = white_axis(dt, self.noise, order=1).noise
        axis[0, 0] += self.wander * dt
        q = _isotropic(axis, mean.shape[1])
        q[TURN, TURN] = self.turn_noise * dt
        return predicted, f, q[None]
