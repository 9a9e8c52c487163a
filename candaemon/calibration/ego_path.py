"""Ego motion over a window as its sensors read it: distance driven and heading, smoothed so that no time is shifted.

A vehicle goes where its rear axle points. So the path follows from the distance and the turning alone, and neither an
error of an INS's heading nor one of its velocity's direction is taken for a turned sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.ego.pose import EgoPose, EgoStatus

STEP_NS: Final = 50_000_000
_STEP: Final = STEP_NS * 1e-9
_SPAN: Final = 2
"""Steps to each side over which a rate is taken, symmetric in time."""
MARGIN_NS: Final = 2 * _SPAN * STEP_NS
"""Before and after the instants asked for, from which rates of rates are taken."""

_KNOWN: Final = (EgoStatus.VALID, EgoStatus.INITIALISING)


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
        grid: Floats = _STEP * np.arange(len(self.heading), dtype=np.float64)
        middle = (self.heading[1:] + self.heading[:-1]) / 2 - bias * (grid[1:] + grid[:-1]) / 2
        steps = self.distance * np.exp(1j * middle)
        ahead = np.concatenate([[0.0], np.cumsum(steps)])
        offset = np.concatenate([[0.0], np.cumsum(_STEP * np.exp(1j * middle))])
        turned = np.concatenate([[0.0], np.cumsum(-0.5j * (grid[1:] + grid[:-1]) * scale * steps)])
        driven = np.concatenate([[0.0], np.cumsum(self.distance)])
        speed, turn = _rate(driven), _rate(self.heading)
        acceleration, turn_change = _rate(speed), _rate(turn)
        t = times_ns * 1e-9
        heading = np.interp(t, grid, self.heading) - bias * t
        return EgoMoments(
            scale * _between(t, grid, ahead),
            heading,
            scale * np.interp(t, grid, speed),
            np.interp(t, grid, turn) - bias,
            scale * np.interp(t, grid, acceleration),
            np.interp(t, grid, turn_change),
            _between(t, grid, ahead),
            _between(t, grid, offset),
            _between(t, grid, turned),
            t,
            np.exp(1j * heading),
        )


def ego_path(
    pose: Callable[[int], EgoPose | None], first_ns: int, last_ns: int, scales: Floats, biases: Floats
) -> EgoPath | None:
    """Return the path between two instants and `MARGIN_NS` beyond; None where ego motion was not known throughout.

    Args:
        pose: of the ego motion.
        first_ns: the first instant.
        last_ns: the last.
        scales: times, s since the first instant, and the factor that is in the pose's speed then (2, k).
        biases: likewise the yaw rate that was taken out of the pose's heading, rad/s (2, k).
    """
    begin_ns = first_ns - MARGIN_NS
    count = -(-(last_ns + MARGIN_NS - begin_ns) // STEP_NS) + 1
    poses = []
    for k in range(count):
        each = pose(begin_ns + k * STEP_NS)
        if each is None or each.status not in _KNOWN:
            return None
        poses.append(each)
    place = np.array([complex(each.east, each.north) for each in poses])
    heading = np.unwrap(np.array([each.heading for each in poses]))
    middle = (heading[1:] + heading[:-1]) / 2
    distance = np.real(np.diff(place) * np.exp(-1j * middle))
    grid = _STEP * (np.arange(count - 1) + 0.5) - MARGIN_NS * 1e-9
    distance = distance / np.interp(grid, *scales)
    undone = np.concatenate([[0.0], np.cumsum(_STEP * np.interp(grid, *biases))])
    return EgoPath(begin_ns, distance, heading - heading[0] + undone)


def _rate(values: Floats) -> Floats:
    """Return the rate over `_SPAN` steps to each side, held at the ends."""
    rate = np.empty_like(values)
    rate[_SPAN:-_SPAN] = (values[2 * _SPAN :] - values[: -2 * _SPAN]) / (2 * _SPAN * _STEP)
    rate[:_SPAN], rate[-_SPAN:] = rate[_SPAN], rate[-_SPAN - 1]
    return rate


def _between(t: Floats, grid: Floats, values: ComplexPlane) -> ComplexPlane:
    """Return values between the steps of a grid."""
    return np.asarray(np.interp(t, grid, values.real) + 1j * np.interp(t, grid, values.imag))
