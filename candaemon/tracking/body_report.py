"""The report of a cycle of bodies: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import Booleans, Floats
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import SLOW, TURN, VELOCITY, motion
from candaemon.tracking.body_modes import SETTLED, STANDING, STILL
from candaemon.tracking.body_sizes import ENOUGH, SMALL, TOLD_LENGTH
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import NARROW, TRUCK_LENGTH, WALKING, classes
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.reporting import in_vehicle_axes, turned
from candaemon.tracking.turning import rate_and_pivot
from candaemon.tracking.update import Used

_HISTORY_LENGTH = 32  # scans in an obstacle's history
_LEAST_SPEED = STILL  # m/s; slower, nothing turns
_SURELY = 0.9  # probability of standing
_SMALL_PLACE, _PLACE, _LARGE_PLACE = 0.15, 0.3, 0.55  # m from the reference point: of walkers, unknown bodies, vehicles
_CLOSE = 0.1  # m, nearest that the line of sight is known
_ANYWHERE = 12.0**-0.5  # of a length, standard deviation of a place anywhere on it


def report(
    bodies: Bodies,
    pose: EgoPose,
    used: Used,
    slack_ns: int,
    wander_time: float,
    shown: Booleans | None = None,
    existence: Floats | None = None,
) -> Obstacles:
    """Return the obstacles in vehicle axes and in the local frame.

    Args:
        bodies: predicted to the pose's time.
        pose: ego pose.
        used: the detections of this cycle and the bodies they updated.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
        wander_time: within which reflections wander over their bodies, s.
        shown: which obstacles are reported (k,); None: all.
        existence: their probabilities of existence (k,); None: the shares of recent scans in which they were seen.
    """
    obstacles = bodies.obstacles
    numbers, codes, covariance = _told(bodies, pose, slack_ns, wander_time)
    if existence is None:
        existence = np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH)
    used_row, used_object = used.reflection, used.objects
    if shown is None or shown.all():
        rows = np.arange(len(obstacles))
    else:
        rows, kept = shown.nonzero()[0], shown[used_row]
        numbers, codes, covariance = numbers.take(rows, axis=1), codes.take(rows, axis=1), covariance.take(rows, axis=0)
        used_row, used_object = (shown.cumsum() - 1)[used_row[kept]], used_object[kept]
    x, y, vx, vy, ax, ay, sx, sy, svx, svy, yaw_rate, axis_x, axis_y = numbers[:13]
    length, width, center_x, center_y, age, east, north, ve, vn = numbers[13:]
    return Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.take(rows),
        state=codes[0],
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        ax=ax,
        ay=ay,
        east=east,
        north=north,
        ve=ve,
        vn=vn,
        sx=sx,
        sy=sy,
        svx=svx,
        svy=svy,
        age=age,
        existence=existence.take(rows),
        sensors=obstacles.sensors.take(rows),
        heading=np.where(obstacles.directed.take(rows), np.arctan2(axis_y, axis_x), np.nan),
        yaw_rate=yaw_rate,
        length=length,
        width=width,
        center_x=center_x,
        center_y=center_y,
        kind=codes[1],
        kind_likelihood=np.full(len(rows), np.nan),
        covariance=covariance,
        used_row=used_row,
        used_sensor=np.full(len(used_object), used.sensor, dtype=np.int64),
        used_object=used_object,
    )


def _told(bodies: Bodies, pose: EgoPose, slack_ns: int, wander_time: float) -> tuple[Floats, NDArray[np.int8], Floats]:
    """Return what is told of the bodies in vehicle axes and in the local frame.

    Args:
        bodies: as in `report`.
        pose: likewise.
        slack_ns: likewise.
        wander_time: likewise.

    Returns:
        Numbers (22, k), NaN where unknown: as `in_vehicle_axes` returns them, with the axes of the boxes for courses;
        length, width, x and y of the centre, age; place and velocity in the local frame. State and class (2, k).
        Covariance of [x, y, vx, vy] (k, 4, 4).
    """
    obstacles, moments, standing = bodies.obstacles, bodies.moments(), bodies.filter.probability[:, STANDING]
    mean, c, s = moments.mean, cos(pose.heading), sin(pose.heading)
    if compiled.in_use:
        rate, pivot = rate_and_pivot(turning := bodies.turning())
        return compiled.kernels.report_bodies(
            mean,
            moments.covariance,
            standing,
            rate,
            None if turning is None else turning.variance,
            pivot,
            obstacles.axis,
            obstacles.facing,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.alone,
            obstacles.fastest,
            obstacles.first_ns,
            obstacles.last_ns,
            obstacles.confirmed,
            pose.velocity_covariance,
            pose.east,
            pose.north,
            c,
            s,
            pose.time_ns,
            slack_ns,
            wander_time,
            SLOW,
            _CLOSE,
            _SMALL_PLACE,
            _PLACE,
            _LARGE_PLACE,
            _ANYWHERE,
            _SURELY,
            SETTLED,
            _LEAST_SPEED,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            NARROW,
            TRUCK_LENGTH,
            WALKING,
        )
    moving, swing = motion(mean), bodies.swing()
    facing_x, facing_y = turned(obstacles.facing[:, 0], obstacles.facing[:, 1], c, s)
    if swing is not None:
        moving[:, VELOCITY] += swing[0]
    told, covariance = in_vehicle_axes(
        moving, moments.covariance, obstacles.axis, np.ones(len(obstacles)), pose, np.inf
    )
    if swing is not None:
        unknown = np.stack(turned(swing[1][:, 0], swing[1][:, 1], c, s), axis=1)
        covariance[:, VELOCITY, VELOCITY] += unknown[:, :, None] * unknown[:, None]
    _add_places(bodies, told, covariance, pose.velocity_covariance, wander_time)
    more, codes = _lives(bodies, pose.time_ns, told, slack_ns, standing, (facing_x, facing_y))
    return np.vstack([told, more, moving[:, :4].T]), codes, covariance


def _lives(
    bodies: Bodies, time_ns: int, told: Floats, slack_ns: int, standing: Floats, facing: tuple[Floats, Floats]
) -> tuple[Floats, NDArray[np.int8]]:
    """Return length, width, centre, x and y, age, NaN where unknown (5, k), and state and class (2, k); tell yaw rates.

    Args:
        bodies: as in `report`.
        time_ns: of the pose.
        told: as `in_vehicle_axes` returns it; the yaw rates are changed to those of the filter.
        slack_ns: as in `report`.
        standing: probability that each stands (k,).
        facing: the reference points minus the centres of the boxes in vehicle axes, x and y (k,) each, m.
    """
    obstacles, turn = bodies.obstacles, bodies.moments().mean[:, TURN]
    x, y, vx, vy = told[:4]
    speed = np.sqrt(vx * vx + vy * vy)
    stands = standing > _SURELY
    stands |= ((time_ns - obstacles.first_ns) * 1e-9 > SETTLED) & (obstacles.fastest < STILL)
    sized = obstacles.sized
    status = np.add(time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
    told[10] = np.where(speed > _LEAST_SPEED, turn, 0.0)
    numbers = [
        np.where(sized, obstacles.length, np.nan),
        np.where(sized, obstacles.width, np.nan),
        x - np.where(sized, facing[0], 0.0),
        y - np.where(sized, facing[1], 0.0),
        np.maximum(time_ns - obstacles.first_ns, 0) * 1e-9,
    ]
    kind = classes(obstacles.length, obstacles.width, obstacles.length_variance, speed, stands)
    return np.stack(numbers), np.stack([status, kind])


def _add_places(bodies: Bodies, told: Floats, covariance: Floats, own: Floats, time: float) -> None:
    """Add what is unknown of where on bodies the reflections lie, and of our own velocity, to what is told of them.

    Of a body that shows its side, the reflections may lie anywhere along it. As they wander over it, its velocity is
    uncertain across the line of sight, where it follows from places alone; along it, it is measured.

    Args:
        bodies: with their boxes.
        told: as `in_vehicle_axes` returns it with the boxes' axes for courses (13, k); the deviations are changed.
        covariance: of [x, y, vx, vy] (k, 4, 4), changed.
        own: covariance of our velocity (2, 2), (m/s)².
        time: within which reflections wander over their bodies, s.
    """
    obstacles = bodies.obstacles
    x, y = told[:2] / np.maximum(np.sqrt(told[0] * told[0] + told[1] * told[1]), _CLOSE)
    unresolved = np.where(obstacles.alone > 1.0, _SMALL_PLACE, _PLACE)
    anywhere = np.square(np.where(obstacles.alone < 0.0, _LARGE_PLACE, unresolved))
    side = _ANYWHERE * (obstacles.length * (told[11] * y - told[12] * x))
    along, left = side * told[11:], (-y, x)
    place = along[:, None] * along
    place[0, 0] = anywhere + place[0, 0]
    place[1, 1] = anywhere + place[1, 1]
    speed = sum(left[i] * place[i, j] * left[j] for i in (0, 1) for j in (0, 1)) / (time * time)
    for i in (0, 1):
        for j in (0, 1):
            covariance[:, i, j] += place[i, j]
            covariance[:, 2 + i, 2 + j] += own[i, j] + speed * left[i] * left[j]
    told[6:10] = np.sqrt(np.maximum(np.einsum("nii->in", covariance), 0.0))
