"""Ego motion over a window as its sensors read it: distance driven and heading, smoothed so that no time is shifted.

A vehicle goes where its rear axle points. So the path follows from the distance and the turning alone, and neither an
error of an INS's heading nor one of its velocity's direction is taken for a turned sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import ComplexPlane, Floats

STEP_NS: Final = 50_000_000
_STEP: Final = STEP_NS * 1e-9
_SPAN: Final = 2
"""Steps to each side over which a rate is taken, symmetric in time."""
MARGIN_NS: Final = 2 * _SPAN * STEP_NS
"""Before and after the instants asked for, from which rates of rates are taken."""

_Value = TypeVar("_Value", np.float64, np.complex128)


@dataclass(frozen=True, slots=True)
class EgoMoments:
    """Ego motion at n instants, with what odometry reads wrongly taken out.

    Attributes:
        position: in the window's own frame, m (n,).
        heading: in the window's own frame, rad (n,).
        speed: forward, m/s (n,).
        turn: yaw rate, rad/s (n,).
        acceleration: forward, m/s² (n,).
        turn_change: rad/s² (n,).
        per_scale: derivative of the position with respect to the speed's scale (n,).
        per_offset: derivative of the position with respect to an offset of the speed (n,).
        per_bias: derivative of the position with respect to the yaw rate's bias (n,).
        since: s since the window's first instant (n,): minus the derivative of the heading to the bias.
        ahead: unit vector along the heading (n,).
    """

    position: ComplexPlane
    heading: Floats
    speed: Floats
    turn: Floats
    acceleration: Floats
    turn_change: Floats
    per_scale: ComplexPlane
    per_offset: ComplexPlane
    per_bias: ComplexPlane
    since: Floats
    ahead: ComplexPlane


@dataclass(frozen=True, slots=True)
class EgoPath:
    """Ego motion as read, every 50 ms.

    Attributes:
        first_ns: time of the first step.
        distance: driven forward between steps, m (k − 1,).
        heading: as integrated from the yaw rate as read, not wrapped, rad (k,).
    """

    first_ns: int
    distance: Floats
    heading: Floats

    def at(self, times_ns: Floats, scale: float, bias: float) -> EgoMoments:
        """Return the motion at instants within the path less `MARGIN_NS` at each end.

        Args:
            times_ns: relative to `first_ns` (n,).
            scale: of the speed, 1 where it is right.
            bias: of the yaw rate, rad/s.
        """
        t = times_ns * 1e-9
        middle = (self.heading[1:] + self.heading[:-1]) / 2 - bias * _middle_times(len(self.distance))
        unit = np.exp(1j * middle)
        points, rates = _moments(self.distance, self.heading, unit, t, scale, bias)
        position, per_scale, per_offset, per_bias = points
        heading, speed, turn, acceleration, turn_change = rates
        return EgoMoments(
            position,
            heading,
            speed,
            turn,
            acceleration,
            turn_change,
            per_scale,
            per_offset,
            per_bias,
            t,
            np.exp(1j * heading),
        )


def ego_path(
    course: Callable[[int, int, int], tuple[ComplexPlane, Floats] | None],
    first_ns: int,
    last_ns: int,
    scales: Floats,
    biases: Floats,
) -> EgoPath | None:
    """Return the path between two instants and `MARGIN_NS` beyond; None where ego motion was not known throughout.

    Args:
        course: of the ego motion: where it was, and how it headed, at even steps.
        first_ns: the first instant.
        last_ns: the last.
        scales: times, s since the first instant, and the factor that is in the speed of the course then (2, k).
        biases: likewise the yaw rate that was taken out of its heading, rad/s (2, k).
    """
    begin_ns = first_ns - MARGIN_NS
    count = -(-(last_ns + MARGIN_NS - begin_ns) // STEP_NS) + 1
    known = course(begin_ns, STEP_NS, count)
    if known is None:
        return None
    place, heading = known
    middle = (heading[1:] + heading[:-1]) / 2
    distance = np.real(np.diff(place) * np.exp(-1j * middle))
    grid = _STEP * (np.arange(count - 1) + 0.5) - MARGIN_NS * 1e-9
    distance = distance / np.interp(grid, *scales)
    undone = np.concatenate([[0.0], np.cumsum(_STEP * np.interp(grid, *biases))])
    return EgoPath(begin_ns, distance, heading - heading[0] + undone)


def _middle_times(count: int) -> Floats:
    """Return the instants between so many steps and the next, s since the first (count,)."""
    return np.asarray(_STEP * (np.arange(count) + 0.5))


def _moments(
    distance: Floats, heading: Floats, unit: ComplexPlane, t: Floats, scale: float, bias: float
) -> tuple[ComplexPlane, Floats]:
    """Return what `EgoMoments` holds of n instants, in its order, less its last two.

    Args:
        distance: as in `EgoPath` (k - 1,).
        heading: likewise (k,).
        unit: direction between the steps (k - 1,).
        t: the instants, s since the first step (n,).
        scale: as for `EgoPath.at`.
        bias: likewise.

    Returns:
        Positions and their derivatives (4, n); headings and what else is real (5, n).
    """
    if compiled.in_use:
        return compiled.kernels.moments_of_path(distance, heading, unit, t, scale, bias, _STEP)
    steps = distance * unit
    summed = np.zeros((3, len(heading)), np.complex128)
    turned = (-1j * scale) * _middle_times(len(distance)) * steps
    np.cumsum([steps, _STEP * unit, turned], axis=1, out=summed[:, 1:])
    driven = np.zeros((2, len(heading)))
    np.cumsum(distance, out=driven[0, 1:])
    driven[1] = heading
    rates = _rate(driven)
    ahead, offset, turning = _between(t, summed)
    angle, speed, turn, acceleration, turn_change = _between(t, np.concatenate([driven[1:], rates, _rate(rates)]))
    told = np.array([angle - bias * t, scale * speed, turn - bias, scale * acceleration, turn_change])
    return np.array([scale * ahead, ahead, offset, turning]), told


def _rate(values: Floats) -> Floats:
    """Return the rates (n, k) of values (n, k) over `_SPAN` steps to each side, held at the ends."""
    rate = np.empty_like(values)
    rate[:, _SPAN:-_SPAN] = (values[:, 2 * _SPAN :] - values[:, : -2 * _SPAN]) / (2 * _SPAN * _STEP)
    rate[:, :_SPAN], rate[:, -_SPAN:] = rate[:, _SPAN, None], rate[:, -_SPAN - 1, None]
    return rate


def _between(t: Floats, values: NDArray[_Value]) -> NDArray[_Value]:
    """Return values (n, k) on a grid of `_STEP` at times within it (m,): (n, m)."""
    steps = t / _STEP
    before = np.minimum(np.maximum(steps.astype(np.int64), 0), values.shape[1] - 2)
    left = values.take(before, axis=1)
    between: NDArray[_Value] = left + (steps - before) * (values.take(before + 1, axis=1) - left)
    return between
