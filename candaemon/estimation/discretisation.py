"""Discretised linear motion models: transition, process noise and input over one step, of an axis and of the plane.

States are [position, velocity, acceleration] and, for the constant jerk, a fourth: its jerk. Han et al. 2015 writes
the plane as two such axes one after the other, [x, ẋ, ẍ, y, ẏ, ÿ].

A matrix of the plane is M = Mₗ ⊗ A + Mₜ ⊗ (I − A) with A = d dᵀ of the direction d, along which Mₗ holds and across
which Mₜ does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import exp, factorial
from typing import Any, NamedTuple

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices

_LONG = 1.0
"""αT from which on the closed forms lose no digits; below, they cancel and a series in αT is exact to rounding."""
_TERMS = 24
_ORDERS = (2, 1, 0)
"""Of position, velocity and acceleration: so often the acceleration is integrated."""


def _series() -> tuple[Floats, Indices]:
    """Return F, Q and U / α as series in −αT: coefficients (terms, 21), and powers of T before them (21,).

    Source: Han et al. 2015.

    An acceleration of 1 has become Σ (−α)ⁿ tⁿ⁺ᵖ / (n+p)! after a time t, integrated p times; Q integrates the products
    of two of these over the step, U / α one.
    """
    coefficients, powers = np.zeros((_TERMS, 21)), np.zeros(21, np.intp)
    f, q = (coefficients[:, k : k + 9].reshape(_TERMS, 3, 3) for k in (0, 9))
    f[0] = (1.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)
    powers[:9] = np.maximum(np.subtract.outer(_ORDERS, _ORDERS), 0).ravel()
    powers[9:18] = np.add.outer(_ORDERS, _ORDERS).ravel() + 1
    powers[18:] = np.array(_ORDERS) + 1
    for n in range(_TERMS):
        for i, p in enumerate(_ORDERS):
            f[n, i, 2] = 1 / factorial(n + p)
            coefficients[n, 18 + i] = 1 / factorial(n + p + 1)
            for j, r in enumerate(_ORDERS[: i + 1]):
                products = (1 / (factorial(k + p) * factorial(n - k + r)) for k in range(n + 1))
                q[n, i, j] = q[n, j, i] = sum(products) / (n + p + r + 1)
    return coefficients, powers


_COEFFICIENTS, _POWERS = _series()


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis over one time step, with S states: 3, or 4 with the jerk.

    Attributes:
        transition: F, (S, S).
        noise: Q, (S, S).
        input: U, (S,): what a mean of the highest derivative, to which that decays, adds; 0 where it keeps.
    """

    transition: Floats
    noise: Floats
    input: Floats


def white_axis(dt: float, intensity: float, *, order: int) -> Axis:
    """Return an axis whose highest derivative is driven by white noise in continuous time.

    Args:
        dt: T, s.
        intensity: power of the white noise that drives the highest derivative.
        order: of that derivative: 1 nearly constant velocity (Friedland), 2 nearly constant acceleration (Hampton),
            3 nearly constant jerk, the four states of Hou.

    Returns:
        F with T^(j−i)/(j−i)!, for order 1 that of Kim and Hong 2004, eq. (5) and Zhang et al. 2016, eq. (2); Q with
        T^(2·order+1−i−j) / ((order−i)! (order−j)! (2·order+1−i−j)), the noise white in continuous time, where those
        papers have an acceleration that is constant over a step, through G = [T²/2, T]. States beyond the order are
        zero.
    """
    f, q = _white(order)
    powers = _powers_of(dt, order)
    return Axis(f.over(powers), q.over(intensity * powers), np.zeros(len(f.powers)))


def white_plane(dt: float, intensity: float, *, order: int, width: int) -> tuple[Floats, Floats]:
    """Return F and Q of `white_axis` in both axes of the plane, (width, width) each; arguments as there."""
    f, q = _white_plane(order, width)
    powers = _powers_of(dt, order)
    return f.over(powers), q.over(intensity * powers)


def _powers_of(dt: float, order: int) -> Floats:
    return np.array([dt**k for k in range(2 * order + 2)])


class _Powers(NamedTuple):
    """A matrix whose elements are coefficients times powers of T."""

    coefficients: Floats
    powers: Indices

    def over(self, powers: Floats) -> Floats:
        """Return the matrix by the powers of T from the zeroth on."""
        return self.coefficients * powers.take(self.powers)


@cache
def _white(order: int) -> tuple[_Powers, _Powers]:
    """Return F and Q of an axis whose derivative of this order is driven by white noise."""
    size = max(order + 1, 3)
    (f, f_powers), (q, q_powers) = ((np.zeros((size, size)), np.zeros((size, size), np.intp)) for _ in range(2))
    for i in range(order + 1):
        for j in range(i, order + 1):
            f[i, j], f_powers[i, j] = 1 / factorial(j - i), j - i
            power = 2 * order + 1 - i - j
            q[i, j] = q[j, i] = 1 / (factorial(order - i) * factorial(order - j) * power)
            q_powers[i, j] = q_powers[j, i] = power
    return _Powers(f, f_powers), _Powers(q, q_powers)


@cache
def _white_plane(order: int, width: int) -> tuple[_Powers, _Powers]:
    """Return the same in both axes of the plane."""
    f, q = (
        _Powers(isotropic(each.coefficients, width), isotropic(each.powers.astype(float), width).astype(np.intp))
        for each in _white(order)
    )
    return f, q


def decaying_axis(rate: float, dt: float, intensity: float, *, order: int) -> Axis:
    """Return an axis whose highest derivative decays exponentially.

    Source: Han et al. 2015, eqs. (15), (16), (19).

    Args:
        rate: α, 1/s, the inverse time constant.
        dt: T, s.
        intensity: power of the white noise that drives the highest derivative.
        order: 2, the acceleration decays: Singer and Han et al. 2015, eq. (15), (19); 1, the velocity does: a drift
            that settles.

    Returns:
        Transition (15), noise (19) and input (16) of Han et al. 2015 for order 2; q33 is (1 − e^(−2αT)) / 2α, where
        (19) misprints. For order 1 the same, of the velocity in the place of the acceleration.
    """
    f, q, u = _closed(rate, dt) if rate * dt > _LONG else _summed(rate, dt)
    if order == 1:
        f, q, u = _lowered(f), _lowered(q), np.array((u[1], u[2], 0.0))
    return Axis(f, intensity * q, u)


def axis_elements(rate: float, dt: float, intensity: float, *, mean_decays: bool) -> Floats:
    """Return what tells a prediction of `decaying_axis` of order 2, (14,).

    The elements that are neither one nor zero of F and of the mean's own F, [0, 1], [0, 2], [1, 2] and [2, 2] of each,
    and the upper triangle of Q, row by row.

    Args:
        rate: α, 1/s.
        dt: T, s.
        intensity: of the white noise that drives the acceleration.
        mean_decays: whether F is the mean's own too: else its acceleration lasts, as in the CS model.
    """
    if compiled.in_use and rate * dt <= _LONG:
        return compiled.kernels.axis_elements(_COEFFICIENTS, _POWERS, dt, rate, intensity, mean_decays)
    axis = decaying_axis(rate, dt, intensity, order=2)
    transition, noise = axis.transition.take(_BEHIND), axis.noise.take(_UPPER)
    return np.concatenate([transition, transition if mean_decays else (dt, dt * dt / 2, dt, 1.0), noise])


_BEHIND, _UPPER = np.array((1, 2, 5, 8)), np.array((0, 1, 2, 4, 5, 8))


def _summed(rate: float, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return F, Q and U by their series."""
    values = _powers_of(dt, 2).take(_POWERS) * _power_series(-rate * dt)
    return values[:9].reshape(3, 3), values[9:18].reshape(3, 3), rate * values[18:]


def _power_series(x: float) -> Floats:
    """Return Σ cₙ xⁿ of each of the series, by Horner's rule."""
    if compiled.in_use:
        return compiled.kernels.power_series(_COEFFICIENTS, x)
    values: Floats = _COEFFICIENTS[-1].copy()
    for coefficients in _COEFFICIENTS[-2::-1]:
        values *= x
        values += coefficients
    return values


def _closed(rate: float, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return F, Q and U as (15), (16) and (19) of Han et al. 2015 have them."""
    x, e = rate * dt, exp(-rate * dt)
    position, velocity = (x - 1 + e) / rate**2, (1 - e) / rate
    f = np.array(((1.0, dt, position), (0.0, 1.0, velocity), (0.0, 0.0, e)))
    q11 = (1 - e * e + 2 * x + 2 * x**3 / 3 - 2 * x * x - 4 * x * e) / (2 * rate**5)
    q12 = (e * e + 1 - 2 * e + 2 * x * e - 2 * x + x * x) / (2 * rate**4)
    q13 = (1 - e * e - 2 * x * e) / (2 * rate**3)
    q22 = (4 * e - 3 - e * e + 2 * x) / (2 * rate**3)
    q23 = (e * e + 1 - 2 * e) / (2 * rate**2)
    q33 = (1 - e * e) / (2 * rate)
    q = np.array(((q11, q12, q13), (q12, q22, q23), (q13, q23, q33)))
    return f, q, np.array((dt * dt / 2 - position, dt - velocity, 1 - e))


def _lowered(matrix: Floats) -> Floats:
    """Return the matrix of velocity and acceleration as that of position and velocity, (3, 3)."""
    lower = np.zeros((3, 3))
    lower[:2, :2] = matrix[1:, 1:]
    return lower


class _Places(NamedTuple):
    """Where an axis with so many states has its rows and columns in the plane's state, for x and for y."""

    x_rows: Any
    x_columns: Any
    y_rows: Any
    y_columns: Any


X, Y, _X_JERK, _Y_JERK = slice(0, 6, 2), slice(1, 6, 2), np.array((0, 2, 4, 7)), np.array((1, 3, 5, 8))
_PLACES = {3: _Places(X, X, Y, Y), 4: _Places(_X_JERK[:, None], _X_JERK, _Y_JERK[:, None], _Y_JERK)}


def directed(along: Floats, across: Floats, direction: Floats, width: int) -> Floats:
    """Spread two S × S axis matrices over the plane, (n or 1, width, width).

    Args:
        along: matrix of the axis along the direction.
        across: matrix of the axis to its left.
        direction: unit vector in the local frame, (n, 2).
        width: of the plane's state.
    """
    if along is across:
        return isotropic(along, width)[None]
    if compiled.in_use:
        return compiled.kernels.directed_matrices(along, across, direction, width)
    if not (along != across).any():
        return isotropic(along, width)[None]
    at, along, across = _PLACES[len(along)], _fitting(along, width), _fitting(across, width)
    difference = along - across
    cosine, sine = direction[:, 0, None, None], direction[:, 1, None, None]
    mixed = difference * (cosine * sine)
    out = np.zeros((len(direction), width, width))
    out[:, at.x_rows, at.x_columns] = across + difference * (cosine * cosine)
    out[:, at.y_rows, at.y_columns] = across + difference * (sine * sine)
    out[:, at.x_rows, at.y_columns] = mixed
    out[:, at.y_rows, at.x_columns] = mixed
    return out


def isotropic(axis: Floats, width: int) -> Floats:
    """Give x and y the same S × S matrix, (width, width)."""
    at, axis = _PLACES[len(axis)], _fitting(axis, width)
    full = np.zeros((width, width))
    full[at.x_rows, at.x_columns] = axis
    full[at.y_rows, at.y_columns] = axis
    return full


def _fitting(axis: Floats, width: int) -> Floats:
    """Cut an axis to the states that a plane of this width has: a filter of velocities alone has no acceleration."""
    return axis[: width // 2, : width // 2]
