"""No vehicle is wider than a lorry: what shows more than that, side by side, is two.

Two cars in a queue may be taken for one from the start: the rear corner of the one ahead and the front corner of the
one beside it lie as close together as those of a car, and move as fast. Sooner or later they show how wide both are.

So do two that stood side by side when they were seen first, far away. What stood all the time may be parked across:
its axis is only our own heading. But where one scan shows it so far apart, and nothing between, it is two cars more
often than one: in drives whose truth is known, of 18 that seemed one, 15 were two. Not so where we look across that
axis, or have turned off: who waits at a crossing shows how long it is.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.tracker import ReflectionSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import POSITION
from candaemon.tracking.body_merging import stand_without_course
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import to_travel_axes

_AXIS_ERROR = 0.1  # rad, by which an axis may be wrong: so much of what lies along a body seems to lie across


def beside_widest(bodies: Bodies, settings: ReflectionSettings, time_ns: int, pose: EgoPose) -> Indices | None:
    """Return of bodies wider than any vehicle the reflections on the other side of the widest gap than the leading one.

    How wide a body is that moves and whose axis is not known, nobody knows. One that stood all the time counts once it
    has stood for `stood.time`, by the reflections of a single scan, while we look and drive along that axis rather than
    across.

    Args:
        bodies: with their reflections.
        settings: how wide vehicles are, and for how long a reflection counts.
        time_ns: of the cycle.
        pose: ego pose.

    Returns:
        Rows (m,), none of which leads; None: there are none.
    """
    reflections = bodies.reflections
    if extent_across(reflections.offset) < settings.widest:  # of all bodies together, which takes less time
        return None
    across = reflections.offset[:, 1]
    obstacles, stood = bodies.obstacles, settings.stood
    stands = stand_without_course(bodies, 2 * stood.speed, stood.moved)
    stands &= time_ns - obstacles.first_ns > round(stood.time * 1e9)
    stands &= _faced(bodies, pose)
    since_ns = np.where(stands, time_ns, time_ns - round(settings.patience * 1e9))
    seen = (reflections.last_ns >= since_ns[reflections.body]).nonzero()[0]
    body = reflections.body[seen]
    low, high = np.full(len(bodies), np.inf), np.full(len(bodies), -np.inf)
    np.minimum.at(low, body, across[seen])
    np.maximum.at(high, body, across[seen])
    wide = ((high - low > settings.widest) & (obstacles.directed | stands)).nonzero()[0]
    least = np.where(stands, stood.apart, 0.0)
    found = [_beside(bodies, each, seen[body == each], settings.widest, least[each]) for each in wide.tolist()]
    beside = [rows for rows in found if len(rows)]
    return np.concatenate(beside) if beside else None


def _faced(bodies: Bodies, pose: EgoPose) -> Booleans:
    """Return of which bodies we see an end rather than a side, and drive along their axes rather than across (k,)."""
    axis = bodies.obstacles.axis
    sight = to_travel_axes(bodies.moments().mean[:, POSITION] - np.array([pose.east, pose.north]), axis)
    course = to_travel_axes(np.broadcast_to([np.cos(pose.heading), np.sin(pose.heading)], axis.shape), axis)
    sight, course = np.abs(sight), np.abs(course)
    return np.asarray((sight[:, 1] < sight[:, 0]) & (course[:, 1] < course[:, 0]))


def extent_across(offset: Floats) -> float:
    """Return how far apart across the first and the last of reflections (n, 2) lie, whatever their bodies, m."""
    if compiled.in_use:
        return compiled.kernels.widest_across(offset)
    return float(offset[:, 1].max() - offset[:, 1].min())


def _beside(bodies: Bodies, body: int, rows: Indices, widest: float, least: float) -> Indices:
    """Return which of a body's reflections (m,) lie beside it, as `beside_widest` does; none of one not too wide.

    Args:
        bodies: with their reflections.
        body: row of the body.
        rows: of its reflections that count.
        widest: m.
        least: width of the gap between the two at least, m.
    """
    reflections = bodies.reflections
    rows = rows[reflections.offset[rows, 1].argsort(kind="stable")]
    if not is_wide(reflections.offset[rows], reflections.variance[rows], widest):
        return rows[:0]
    across = reflections.offset[rows, 1]
    gap = int(np.diff(across).argmax())
    if across[gap + 1] - across[gap] < least:
        return rows[:0]
    middle = 0.5 * (across[gap] + across[gap + 1])
    leader = bodies.obstacles.leader[body]
    return rows[gap + 1 :] if reflections.offset[leader, 1] < middle else rows[: gap + 1]


def wide_together(bodies: Bodies, young: int, old: int, settings: ReflectionSettings, time_ns: int) -> bool:
    """Return whether two bodies show more, side by side across the axis of the older, than a vehicle is wide.

    Args:
        bodies: with their reflections.
        young: row of the one.
        old: row of the other, whose axis is to be known: else they are not.
        settings: as for `beside_widest`.
        time_ns: of the cycle.
    """
    if not bodies.obstacles.directed[old]:
        return False
    reflections, shown = bodies.reflections, bodies.moments().shown
    seen = reflections.last_ns >= time_ns - round(settings.patience * 1e9)
    rows = (seen & ((reflections.body == young) | (reflections.body == old))).nonzero()[0]
    place = shown[reflections.body[rows], :2] + bodies.offsets(rows)
    axis = np.broadcast_to(bodies.obstacles.axis[old], place.shape)
    return len(rows) > 1 and is_wide(to_travel_axes(place, axis), reflections.variance[rows], settings.widest)


def is_wide(place: Floats, variance: Floats, widest: float) -> bool:
    """Return whether reflections surely are farther apart across than a vehicle is wide.

    Args:
        place: of reflections along and across an axis (m, 2), m.
        variance: of each component (m,), m².
        widest: m.
    """
    along, across = place.T
    first, last = across.argmin(), across.argmax()
    error = np.sqrt(variance[first] + variance[last]) + _AXIS_ERROR * np.ptp(along)
    return bool(across[last] - across[first] - error > widest)
