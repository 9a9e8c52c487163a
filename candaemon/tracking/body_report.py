"""The report of a cycle of bodies: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from dataclasses import fields
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import Booleans, Floats
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import TURN, VELOCITY, motion
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_sizes import ENOUGH, SMALL, TOLD_LENGTH
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import (
    NARROW,
    TRUCK_LENGTH,
    WALKING,
    add_places,
    classes,
)
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.reporting import in_vehicle_axes
from candaemon.tracking.update import Used

_HISTORY_LENGTH = 32  # scans in an obstacle's history
_LEAST_SPEED = 0.5  # m/s; slower, nothing turns
_SURELY = 0.9  # probability of standing
_SETTLED = 2.0  # s, after which what never moved stands


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
    obstacles, moments = bodies.obstacles, bodies.moments()
    mean, swing = moments.mean, bodies.swing()
    moving = motion(mean)
    if swing is not None:
        moving[:, VELOCITY] += swing[0]
    told, covariance = in_vehicle_axes(
        moving, moments.covariance, obstacles.axis, np.ones(len(obstacles)), pose, np.inf
    )
    if swing is not None:
        unknown = swing[1] @ pose.rotation
        covariance[:, VELOCITY, VELOCITY] += unknown[:, :, None] * unknown[:, None]
    add_places(bodies, told, covariance, pose.velocity_covariance, wander_time)
    x, y, vx, vy, ax, ay, sx, sy, svx, svy, _, axis_x, axis_y = told
    (yaw_rate, length, width, center_x, center_y, age), (status, kind) = _told(bodies, pose, told, slack_ns)
    if existence is None:
        existence = np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH)
    found = Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=status,
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        ax=ax,
        ay=ay,
        east=mean[:, 0],
        north=mean[:, 1],
        ve=moving[:, 2],
        vn=moving[:, 3],
        sx=sx,
        sy=sy,
        svx=svx,
        svy=svy,
        age=age,
        existence=existence.copy(),
        sensors=obstacles.sensors.copy(),
        heading=np.where(obstacles.directed, np.arctan2(axis_y, axis_x), np.nan),
        yaw_rate=yaw_rate,
        length=length,
        width=width,
        center_x=center_x,
        center_y=center_y,
        kind=kind,
        kind_likelihood=np.full(len(obstacles), np.nan),
        covariance=covariance,
        used_row=used.reflection,
        used_sensor=np.full(len(used.objects), used.sensor, dtype=np.int64),
        used_object=used.objects,
    )
    return found if shown is None or shown.all() else _only(found, shown)


def _told(bodies: Bodies, pose: EgoPose, told: Floats, slack_ns: int) -> tuple[Floats, NDArray[np.int8]]:
    """Return yaw rate, length, width, x and y of the centre, age, NaN where unknown (6, k); state and class (2, k).

    Args:
        bodies: as in `report`.
        pose: ego pose.
        told: as `in_vehicle_axes` returns it.
        slack_ns: as in `report`.
    """
    obstacles, mean = bodies.obstacles, bodies.moments().mean
    c, s, standing = cos(pose.heading), sin(pose.heading), bodies.filter.probability[:, STANDING]
    if compiled.in_use:
        return compiled.kernels.tell_bodies(
            told,
            mean,
            obstacles.facing,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.fastest,
            obstacles.first_ns,
            obstacles.last_ns,
            obstacles.confirmed,
            standing,
            pose.time_ns,
            slack_ns,
            c,
            s,
            _SURELY,
            _SETTLED,
            _LEAST_SPEED,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            NARROW,
            TRUCK_LENGTH,
            WALKING,
        )
    x, y, vx, vy = told[:4]
    speed, (facing_x, facing_y) = np.sqrt(vx * vx + vy * vy), obstacles.facing.T
    stands = standing > _SURELY
    stands |= ((pose.time_ns - obstacles.first_ns) * 1e-9 > _SETTLED) & (obstacles.fastest < _LEAST_SPEED)
    sized = obstacles.sized
    status = np.add(pose.time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
    numbers = [
        np.where(speed > _LEAST_SPEED, mean[:, TURN], 0.0),
        np.where(sized, obstacles.length, np.nan),
        np.where(sized, obstacles.width, np.nan),
        x - np.where(sized, facing_x * c + facing_y * s, 0.0),
        y - np.where(sized, facing_y * c - facing_x * s, 0.0),
        np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
    ]
    kind = classes(obstacles.length, obstacles.width, obstacles.length_variance, speed, stands)
    return np.stack(numbers), np.stack([status, kind])


def _only(obstacles: Obstacles, shown: Booleans) -> Obstacles:
    """Return some of the obstacles, with the detections that they used."""
    names = {each.name for each in fields(Obstacles)} - {"time_ns"}
    used = shown[obstacles.used_row]
    columns = {name: getattr(obstacles, name)[used if name.startswith("used") else shown] for name in names}
    columns["used_row"] = (np.cumsum(shown) - 1)[columns["used_row"]]
    return Obstacles(time_ns=obstacles.time_ns, **columns)
