"""The axes of bodies follow the courses of their centres, the faster the better the course is known.

A vehicle moves along its axis at its centre only: two metres ahead of it, where it turns off at walking speed, its
course is tens of degrees away from its axis.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats
from candaemon.tracking.turning import Turning, rate_and_pivot

_COURSE_ERROR: Final = 0.1  # rad, standard deviation of a course that tells the axis
LEADS: Final = 2.0
"""m/s, who surely drove so fast has shown which end leads; backwards, a body that never did turns round at it."""
TIGHTEST: Final = 3.0
"""m, radius of the way of a car's rear axle where its wheels are turned fully; who walks or rides has none."""
_ACROSS: Final = 0.5  # of its speed: a body with less of it along its axis turns, and either end may lead after that
_TELLING: Final = 0.5  # how well a course is known that first tells which end of a body leads
_UNKNOWN: Final = 0.25  # (m/s)², of a course that nothing is known of
_DOUBT: Final = 0.5  # times the variance of a turn rate, below the square of which it counts for nothing
_UNSURE: Final = 2.0  # likewise, of the turn rate with which an axis turns on
_LEAST_TURN: Final = 1e-9  # (rad/s)²
_WRONG: Final = 0.3  # sine of the angle to the first course that is known well, above which an axis was a guess


def turned_axes(
    mean: Floats,
    covariance: Floats,
    axis: Floats,
    directed: Booleans,
    ahead: Floats,
    part: Floats,
    passed: Floats,
    facing: Floats,
    turning: Turning | None,
    backing: float,
    forgetting: float,
    tightest: Floats,
) -> tuple[Floats, Booleans | None]:
    """Return axes (n, 2) turned towards the courses, and which slow ones turned round (n,); None: none did.

    The axis of what surely turns turns on with it: what only follows a course lags behind one that bends. Which of them
    a course tells well is noted in place. A body that never showed a course may have either end ahead, and turns round
    with the first course that tells, however slow it is. The first course that is known well tells an axis that was far
    beside it, and so a guess, at once. One that showed a course backs: what went ahead fast, stops,
    and comes back slower has not turned round, which takes a course across its axis. The axis was wrong where it is
    faster than it went ahead, or goes backwards for long. A fast one that turns round is not among those returned: its
    axis has turned by up to a right angle on the way, and where its reflections lie on it is learnt anew. Nor does the
    axis of what once led turn faster than its way bends: who pulls at a car that has stopped, as one who crosses before
    it and is taken for a part of it, does not turn it on the spot.

    Args:
        mean: states of the bodies (n, 8), as in `BodyFilter`.
        covariance: of [x, y, vx, vy] (n, 4, 4).
        axis: unit vectors along them (n, 2).
        directed: whether the axis is known which way it points (n,), changed.
        ahead: speed backwards from which on each has turned round (n,), changed, m/s: the greatest ahead so far.
        part: of the turn towards a course that is known perfectly (n,).
        passed: for how long each axis turns on as its body surely does (n,), s; 0 where nobody has seen that it does.
        facing: the reference points minus the centres of the boxes (n, 2), m.
        turning: of those that are known to be no points.
        backing: faster than which nothing backs, m/s.
        forgetting: what a body loses of `ahead` in this step, as a share of the speed at which it goes backwards.
        tightest: most that each turns in this step for each m/s (n,), rad s/m.
    """
    if compiled.in_use:
        rate, pivot = rate_and_pivot(turning)
        axes, turned_round = compiled.kernels.turn_axes_of_bodies(
            mean,
            covariance,
            axis,
            directed,
            ahead,
            part,
            passed,
            facing,
            rate,
            None if turning is None else turning.variance,
            pivot,
            _COURSE_ERROR**2,
            backing,
            forgetting,
            LEADS,
            _ACROSS**2,
            _TELLING,
            _UNKNOWN,
            _DOUBT,
            _UNSURE,
            _LEAST_TURN,
            _WRONG,
            tightest,
        )
        return axes, turned_round
    vx, vy = mean[:, 2], mean[:, 3]
    spread = covariance[:, 2, 2] + covariance[:, 3, 3]
    on = np.zeros(len(mean))
    if turning is not None:
        arm_x, arm_y = (mean[:, :2] - facing - turning.pivot).T
        turn, variance = turning.rate, turning.variance
        unclear = variance / np.maximum(turn * turn, _LEAST_TURN)
        on = passed * (turn * np.maximum(1.0 - _UNSURE * unclear, 0.0))
        turn = turn * np.maximum(1.0 - _DOUBT * unclear, 0.0)
        vx, vy = vx - turn * arm_y, vy + turn * arm_x
        spread = spread + variance * (arm_x * arm_x + arm_y * arm_y)
    led = directed & (ahead >= LEADS)
    squared = vx * vx + vy * vy
    known = squared / (squared + 4.0 * spread + _UNKNOWN)
    directs = spread < _COURSE_ERROR**2 * squared
    tells = directs | (known > _TELLING)
    slow = squared < LEADS**2
    first = ~directed & tells & slow
    told = directs & ~directed
    directed |= directs
    share = known * known * part
    speed = np.sqrt(np.maximum(squared, 1e-6))
    most = (speed + np.sqrt(spread)) * tightest
    on = np.minimum(np.maximum(on, -most), most)
    x, y = axis[:, 0] - on * axis[:, 1], axis[:, 1] + on * axis[:, 0]  # to first order: their length is set at the end
    along = vx * x + vy * y
    across = directs & (along * along < _ACROSS**2 * squared)
    left = np.where(across, np.minimum(ahead, LEADS), ahead)
    left += np.where(directs, forgetting * np.minimum(along, 0.0), 0.0)
    turns = tells & ((along < np.where(first, 0.0, -np.maximum(left, LEADS))) | (left < 0.0))
    shown = np.where(turns, -along, np.where(directs, np.maximum(along, left), left))
    ahead[:] = np.minimum(np.maximum(shown, 0.0), backing)
    forward = np.where(turns, -1.0, 1.0)
    course_x, course_y = vx / speed, vy / speed
    backs = (course_x * x + course_y * y < 0.0) & (forward > 0.0)
    course_x, course_y = np.where(backs, -course_x, course_x), np.where(backs, -course_y, course_y)
    x, y = forward * x, forward * y
    beside = np.abs(x * course_y - y * course_x)
    share = np.where(told & (beside > _WRONG), 1.0, share)
    bend = share * beside
    share = np.where(led & (bend > most), share * most / np.maximum(bend, 1e-9), share)
    x, y = x + share * (course_x - x), y + share * (course_y - y)
    norm = np.maximum(np.sqrt(x * x + y * y), 1e-9)
    opposite = turns & slow
    return np.stack([x / norm, y / norm], axis=1), opposite if opposite.any() else None
