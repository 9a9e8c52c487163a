"""Riders in line: what shows the same two places all the time, a bicycle apart and nothing between, is two.

Cyclists one behind another may be taken for one vehicle when they are seen first, far away: their reflections lie as
close together as those of a car, and move as fast. But the reflections of a vehicle come and go: sooner or later it
shows another one between, or is faster. Of one whose side we see, as of a lorry beside us, they may stay.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Indices
from candaemon.arrays.rows import distinct
from candaemon.config.tracker import ReflectionSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import POSITION, VELOCITY
from candaemon.tracking.body_sizes import RIDER, SURELY_ALONE, TOLD_WIDTH
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import NARROW
from candaemon.tracking.reflections import to_travel_axes

_ASIDE = 0.1  # of the distance along a body, within which of its axis we see little more than its end
_BESIDE = 0.5  # of that distance: farther aside, we see its side


def in_line(bodies: Bodies, settings: ReflectionSettings, pose: EgoPose) -> Indices | None:
    """Return of bodies that are riders in line the reflections beyond the widest gap from the leading one.

    Args:
        bodies: with their reflections.
        settings: for how long each rider has shown a reflection, and how far apart they are.
        pose: of the vehicle at the cycle's time, which sees them from behind or ahead.

    Returns:
        Rows (m,), none of which leads; None: there are none.
    """
    reflections, obstacles, riders = bodies.reflections, bodies.obstacles, settings.riders
    room = RIDER[0] + settings.edge
    if not any_far_along(bodies, riders.fastest, 0.5 * room):  # none lies so far from another one
        return None
    slow = obstacles.confirmed & obstacles.directed & (obstacles.fastest < riders.fastest)
    steady = reflections.first_ns <= pose.time_ns - round(riders.time * 1e9)
    steady &= reflections.last_ns >= pose.time_ns - round(settings.patience * 1e9)
    mean = bodies.moments().mean
    velocity, sight = mean[:, VELOCITY], mean[:, POSITION] - (pose.east, pose.north)
    distance, aside = np.abs(to_travel_axes(sight, obstacles.axis)).T
    moves = (velocity * velocity).sum(axis=1) > settings.stood.moved**2
    slow &= moves & (aside < np.maximum(0.5 * settings.widest, _ASIDE * distance)) & (aside < _BESIDE * distance)
    slow &= (obstacles.width < NARROW) | (obstacles.width_variance > TOLD_WIDTH)  # a sensor may tell that it is a car
    several = (np.bincount(reflections.body[steady], minlength=len(bodies)) > 1) & slow
    found = [_beyond_gap(bodies, each, steady.nonzero()[0], room) for each in several.nonzero()[0].tolist()]
    rows = [each for each in found if len(each)]
    return np.concatenate(rows) if rows else None


def any_far_along(bodies: Bodies, slower: float, far: float) -> bool:
    """Return whether a reflection of a known body lies farther along it than that.

    Args:
        bodies: with their reflections.
        slower: m/s; what was ever faster does not count.
        far: m from the reference point.
    """
    reflections, obstacles = bodies.reflections, bodies.obstacles
    offset, body, confirmed, directed = reflections.offset, reflections.body, obstacles.confirmed, obstacles.directed
    if compiled.in_use:
        return compiled.kernels.lies_far_along(offset, body, confirmed, directed, obstacles.fastest, slower, far)
    slow = confirmed & directed & (obstacles.fastest < slower)
    return bool((slow.take(body) & (np.abs(offset[:, 0]) > far)).any())


def _beyond_gap(bodies: Bodies, body: int, steady: Indices, room: float) -> Indices:
    """Return a body's reflections beyond the widest gap along it from the leading one; none where there is no gap.

    Args:
        bodies: with their reflections.
        body: row of the one.
        steady: reflections of all bodies that have been seen for long (m,); on either side of the gap there is one.
        room: m, width of the gap at least.
    """
    reflections, leader = bodies.reflections, bodies.obstacles.leader[body]
    rows = (reflections.body == body).nonzero()[0]
    rows = rows[reflections.offset[rows, 0].argsort(kind="stable")]
    along, variance = reflections.offset[rows, 0], reflections.variance[rows]
    gap = int(np.diff(along).argmax())
    behind, ahead = rows[: gap + 1], rows[gap + 1 :]
    surely = along[gap + 1] - along[gap] - np.sqrt(variance[gap] + variance[gap + 1]) > room
    if not (surely and np.isin(behind, steady).any() and np.isin(ahead, steady).any()):
        return np.empty(0, dtype=np.intp)
    return np.asarray(ahead if leader in behind else behind)


def part_in_line(bodies: Bodies, rows: Indices) -> int:
    """Give riders in line bodies of their own, as small as they are; return how many those are.

    Args:
        bodies: of which some become two.
        rows: of their reflections (m,), as `in_line` returns them.
    """
    obstacles, known, left = bodies.obstacles, len(bodies), distinct(bodies.reflections.body[rows])
    bodies.split_together(rows)
    bodies.refer_to_leaders(left)
    riders = np.concatenate([left, np.arange(known, len(bodies))])
    obstacles.confirmed[riders] = True  # what was seen for so long exists
    obstacles.existence[known:] = obstacles.existence[left]
    obstacles.length[riders], obstacles.width[riders] = RIDER
    obstacles.extent[riders], obstacles.alone[riders] = 0.0, SURELY_ALONE
    return len(bodies) - known
