"""Images of vehicles: a radar also sees them by echoes of two reflections, where nothing is.

An echo that goes to and fro twice appears at twice the distance, with twice the relative velocity; one that a row of
standing things reflects (a guard rail, a wall) appears behind the row, as in a mirror.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.body_filter import VELOCITY
from candaemon.radar.detections import Detections
from candaemon.tracking.body_modes import SETTLED, STANDING, STILL
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import to_travel_axes
from candaemon.tracking.standing_rows import StandingRow, standing_rows

_PLACE = 3.0  # m between an image and where it should be
_SPEED = 1.5  # m/s, likewise along the course or the line of sight; what stands is slower
_ACROSS = 4.0  # m/s across it, which is known worst
_DEVIATIONS = 3.0  # standard deviations of a velocity by which it may differ beyond that: of what is young, many m/s
_CONVOY = 4.0  # m/s over ground; what is slower is in no convoy
_NEARING = 0.7  # m/s along the line of sight, relative to the sensor, that tell an image of what is in no convoy
_PASSING = 1.0  # m/s across the line of sight, likewise, where twice that is surely told from it
_MOVES = 2.0  # m/s; slower, its image is not told from what is there: who walks has company on the other side of a rail
_STANDS = 0.5  # probability of standing; what is at twice the distance of what stands comes as fast as what is met
_DROVE = 4.0  # m/s; what was once as fast is a vehicle, and a long row mirrors it when it is slow too
_SPACING = 4.0  # m between the standing things of a row
_DEPTH = 1.2  # m, how exactly they lie in the middle
_GAP = 30.0  # m before and behind a long row for which it goes on: vehicles hide it
_MOST_POSTS = 40  # nearest to the sensor, of which rows are looked for


def images(bodies: Bodies, candidates: Indices, detections: Detections, brief: Booleans) -> Booleans:
    """Return which of some bodies (m,) are where the image of a confirmed one should be, and move like it.

    Args:
        bodies: that are known.
        candidates: rows of those asked for.
        detections: a scan of the sensor that would see the images.
        brief: which of them may also be echoes of a vehicle of the sensor's speed that hides them (m,).
    """
    shown, obstacles = bodies.moments().shown, bodies.obstacles
    others = obstacles.confirmed.copy()
    others[candidates] = False
    moves = (obstacles.fastest > STILL) | ((detections.time_ns - obstacles.first_ns) * 1e-9 < SETTLED)
    moving = np.flatnonzero(others & moves & (bodies.filter.probability[:, STANDING] < _STANDS))
    fast = np.flatnonzero(others & (np.hypot(shown[:, 2], shown[:, 3]) > _MOVES))
    found = np.zeros(len(candidates), dtype=np.bool_)
    if len(moving):
        found |= _doubled(bodies, candidates, moving, detections, brief).any(axis=1)
    if len(fast):
        found |= _mirrored(bodies, candidates, fast, detections).any(axis=1)
    drove = np.flatnonzero(others & (obstacles.fastest > _DROVE))
    if len(drove):
        for row in standing_rows(_posts(bodies, detections.measurement.origin)):
            found |= _mirrored_by(row, bodies, candidates, drove, detections).any(axis=1)
    return found


def _doubled(
    bodies: Bodies, candidates: Indices, sources: Indices, detections: Detections, brief: Booleans
) -> Booleans:
    """Return which candidates are at twice the distance of which sources, twice as fast relative to the sensor.

    Of what is hardly faster than the sensor that tells little: vehicles of a convoy are like this. There only what is
    brief counts, and only what the source hides.
    """
    sensor, moments = detections.measurement, bodies.moments()
    relative = moments.shown - np.concatenate([sensor.origin, sensor.velocity])
    place, velocity = relative[:, :2], relative[:, VELOCITY]
    sight = place[sources] / np.maximum(np.linalg.norm(place[sources], axis=1), 1.0)[:, None]
    alone = np.hypot(*moments.shown[sources, VELOCITY].T) < _CONVOY
    nearing = np.abs((velocity[sources] * sight).sum(axis=1)) > np.where(alone, _NEARING, _SPEED)
    apart = place[candidates, None] - 2 * place[sources]
    # the shadow is twice as wide where it is twice as far
    hidden = np.abs(to_travel_axes(apart, sight)[..., 1]) < bodies.obstacles.width[sources]
    # convoys, and what stands beside the road, are met where images would be: there the reference point alone counts
    any_part = np.hypot(velocity[sources, 0], velocity[sources, 1]) > _CONVOY
    any_part = any_part & (bodies.filter.probability[candidates, STANDING] < _STANDS)[:, None]
    away = np.where(any_part, 2 * _beyond(bodies, sources, 0.5 * apart), np.hypot(apart[..., 0], apart[..., 1]))
    spread = moments.shown_covariance[:, VELOCITY, VELOCITY]
    faster = velocity[candidates, None] - 2 * velocity[sources]
    passing = _crosses_twice_as_fast(faster, velocity[sources], spread[candidates], sight)
    near = (away < _PLACE) & (nearing | passing | (hidden & brief[:, None]))
    near &= _as_fast(faster, spread[candidates, None] + 4 * spread[sources], sight, 2 * _ACROSS)
    return np.asarray(near)


def _crosses_twice_as_fast(faster: Floats, velocity: Floats, spread: Floats, sight: Floats) -> Booleans:
    """Return which candidates cross the line of sight twice as fast as which sources, rather than as fast (m, s).

    Args:
        faster: than twice the sources' velocities, relative to the sensor (m, s, 2), m/s.
        velocity: of the sources, likewise (s, 2).
        spread: covariances of the candidates' velocities (m, 2, 2).
        sight: unit vectors to the sources (s, 2).
    """
    left = np.stack([-sight[:, 1], sight[:, 0]], axis=1)
    across = np.abs((velocity * left).sum(axis=1))
    unsure = np.sqrt(np.einsum("si,mij,sj->ms", left, spread, left))
    return np.asarray((across > _PASSING) & (np.abs((faster * left).sum(axis=2)) + unsure < 0.5 * across))


def _beyond(bodies: Bodies, sources: Indices, apart: Floats) -> Floats:
    """Return how far places (m, s, 2), relative to what s bodies show, lie beyond their ends and aside (m, s), m."""
    obstacles = bodies.obstacles
    axis, facing = obstacles.axis[sources], obstacles.facing[sources]
    away = to_travel_axes(apart, axis)
    along = np.abs(away[..., 0] + to_travel_axes(facing, axis)[:, 0]) - 0.5 * obstacles.length[sources]
    return np.asarray(np.hypot(np.maximum(along, 0.0), away[..., 1]))


def _as_fast(faster: Floats, spread: Floats, axis: Floats, across: float) -> Booleans:
    """Return which of m candidates and s sources move alike, as far as their velocities are known.

    Args:
        faster: differences of velocity (m, s, 2), local frame, m/s.
        spread: their covariances (m, s, 2, 2).
        axis: unit vectors (s, 2), along which they may differ least.
        across: by how much they may differ across it, m/s.
    """
    alike = np.ones(faster.shape[:2], dtype=np.bool_)
    for direction, most in ((axis, _SPEED), (np.stack([-axis[:, 1], axis[:, 0]], axis=1), across)):
        variance = np.einsum("si,msij,sj->ms", direction, spread, direction)
        differs = (faster * direction).sum(axis=2)
        alike &= differs * differs < most * most + _DEVIATIONS**2 * variance
    return alike


def _mirrored(bodies: Bodies, candidates: Indices, sources: Indices, detections: Detections) -> Booleans:
    """Return which candidates are beside which sources, as fast, with something standing in the middle between."""
    obstacles, shown = bodies.obstacles, bodies.moments().shown
    axis = obstacles.axis[sources]
    standing = shown[np.hypot(shown[:, 2], shown[:, 3]) < _SPEED, :2]
    apart = to_travel_axes(shown[candidates, None, :2] - shown[sources, :2], axis)
    spread = bodies.moments().shown_covariance[:, VELOCITY, VELOCITY]
    faster = shown[candidates, None, VELOCITY] - shown[sources, VELOCITY]
    us = to_travel_axes(detections.measurement.origin - shown[sources, :2], axis)[:, 1]
    beyond = (apart[..., 1] - us) * (apart[..., 1] / 2 - us) > (apart[..., 1] / 2 - us) ** 2
    # an image is of any part of the vehicle, which may be longer than is known
    centre = to_travel_axes(obstacles.facing[sources], axis)[:, 0]
    longest = obstacles.length[sources] + np.sqrt(obstacles.length_variance[sources])
    along = np.abs(apart[..., 0] + centre) - 0.5 * longest
    alike = (along < _PLACE) & beyond & _as_fast(faster, spread[candidates, None] + spread[sources], axis, _ACROSS)
    alike &= np.abs(apart[..., 1]) > 2 * _DEPTH
    for i, j in np.argwhere(alike):
        middle = (shown[candidates[i], :2] + shown[sources[j], :2]) / 2
        away = np.abs(to_travel_axes(standing - middle, axis[j]))
        alike[i, j] = ((away[:, 0] < _SPACING) & (away[:, 1] < _DEPTH)).any()
    return alike


def _posts(bodies: Bodies, origin: Floats) -> Floats:
    """Return the places of what never moved (n, 2), the nearest to a sensor."""
    shown = bodies.moments().shown
    stands = (np.hypot(shown[:, 2], shown[:, 3]) < _SPEED) & (bodies.obstacles.fastest < _MOVES)
    posts = shown[stands, :2]
    return posts[np.argsort(np.hypot(*(posts - origin).T), kind="stable")[:_MOST_POSTS]]


def _mirrored_by(
    row: StandingRow, bodies: Bodies, candidates: Indices, sources: Indices, detections: Detections
) -> Booleans:
    """Return which candidates are where a row shows which sources, and as fast."""
    obstacles, moments = bodies.obstacles, bodies.moments()
    shown, spread = moments.shown, moments.shown_covariance[:, VELOCITY, VELOCITY]
    us = to_travel_axes(detections.measurement.origin - row.centre, row.axis)
    image = to_travel_axes(shown[candidates, :2] - row.centre, row.axis)
    there = to_travel_axes(shown[sources, :2] - row.centre, row.axis)
    # where the line from the sensor to the image meets the row: there the echo was reflected
    share = abs(us[1]) / np.maximum(abs(us[1]) + np.abs(image[:, 1]), 1e-9)
    met = us[0] + share * (image[:, 0] - us[0])
    behind = (image[:, 1] * us[1] < 0.0) & (row.begin - _GAP < met) & (met < row.end + _GAP)
    centre = to_travel_axes(obstacles.facing[sources], row.axis)[:, 0]
    longest = obstacles.length[sources] + np.sqrt(obstacles.length_variance[sources])
    along = np.abs(image[:, None, 0] - there[:, 0] + centre) - 0.5 * longest
    faster = to_travel_axes(shown[candidates, VELOCITY], row.axis)[:, None]
    faster = faster - to_travel_axes(shown[sources, VELOCITY], row.axis) * np.array([1.0, -1.0])
    turned = np.array([row.axis, [-row.axis[1], row.axis[0]]])
    spread = turned @ spread @ turned.T
    lengthwise = np.broadcast_to([1.0, 0.0], (len(sources), 2))
    alike = _as_fast(faster, spread[candidates, None] + spread[sources], lengthwise, _ACROSS)
    beside = np.abs(image[:, None, 1] + there[:, 1]) < 2 * _DEPTH
    return np.asarray(alike & beside & (along < _PLACE) & behind[:, None] & (there[:, 1] * us[1] > 0.0))
