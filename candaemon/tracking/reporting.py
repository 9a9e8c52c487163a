"""The report of a cycle: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import Floats
from candaemon.ego.pose import EgoPose
from candaemon.tracking.columns import ObstacleTable
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.reflections import RigidMotion
from candaemon.tracking.track_store import TrackStore
from candaemon.tracking.update import Used

_HISTORY_LENGTH = 32  # scans in an obstacle's history


def report(
    tracks: TrackStore, motion: RigidMotion, pose: EgoPose, used: Used, slack_ns: int, min_speed: float
) -> Obstacles:
    """Return the obstacles in vehicle axes and in the local frame.

    Args:
        tracks: predicted to the pose's time.
        motion: of the obstacles.
        pose: ego pose.
        used: the detections of this cycle and the reflections they updated.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
        min_speed: from which on an obstacle has a yaw rate, m/s.
    """
    obstacles, reflections, state = tracks.obstacles, tracks.reflections, motion.state
    told, covariance = in_vehicle_axes(
        state, motion.covariance, obstacles.direction, obstacles.forward, pose, min_speed * min_speed
    )
    x, y, vx, vy, ax, ay, sx, sy, svx, svy, yaw_rate, course_x, course_y = told
    unknown = np.empty(len(obstacles))
    unknown.fill(np.nan)
    heading = np.arctan2(course_y, course_x)
    status, age, existence = _lives(obstacles, pose.time_ns, slack_ns)
    used_sensor = np.empty(len(used.objects), np.int64)
    used_sensor.fill(used.sensor)
    return Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=status,
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        ax=ax,
        ay=ay,
        east=state[:, 0],
        north=state[:, 1],
        ve=state[:, 2],
        vn=state[:, 3],
        sx=sx,
        sy=sy,
        svx=svx,
        svy=svy,
        age=age,
        existence=existence,
        sensors=obstacles.sensors.copy(),
        heading=heading,
        yaw_rate=yaw_rate,
        length=unknown,
        width=unknown,
        center_x=x,
        center_y=y,
        kind=np.zeros(len(obstacles), np.int8),
        kind_likelihood=unknown,
        covariance=covariance,
        used_row=reflections.obstacle.take(used.reflection),
        used_sensor=used_sensor,
        used_object=used.objects,
    )


def _lives(obstacles: ObstacleTable, time_ns: int, slack_ns: int) -> tuple[NDArray[np.int8], Floats, Floats]:
    """Return the states of k obstacles, their ages, s, and the shares of recent scans in which they were seen, (k,)."""
    if compiled.in_use:
        return compiled.kernels.lives(
            obstacles.first_ns,
            obstacles.last_ns,
            obstacles.history,
            obstacles.scans,
            obstacles.confirmed,
            time_ns,
            slack_ns,
            _HISTORY_LENGTH,
        )
    status = np.add(time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
    existence = np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH)
    return status, np.maximum(time_ns - obstacles.first_ns, 0) * 1e-9, existence


def in_vehicle_axes(
    state: Floats, spread: Floats, direction: Floats, forward: Floats, pose: EgoPose, least_square: float
) -> tuple[Floats, Floats]:
    """Return what is told of k obstacles in vehicle axes.

    Args:
        state: [x, y, vx, vy, ax, ay], local frame (k, 6).
        spread: its covariance (k, 4, 4) or more.
        direction: of their travel, unit vectors (k, 2).
        forward: 1 where they drive that way, −1 where the other way, 0 where they show no course (k,).
        pose: ego pose.
        least_square: of a speed, (m/s)², above which an obstacle has a yaw rate.

    Returns:
        x, y, vx, vy, ax, ay, the deviations of the first four, the yaw rate and the course, a vector, NaN where there
        is none, (13, k); and the covariance (k, 4, 4).
    """
    c, s = cos(pose.heading), sin(pose.heading)
    if compiled.in_use:
        return compiled.kernels.vehicle_axes(
            state,
            spread,
            direction,
            forward,
            pose.east,
            pose.north,
            c,
            s,
            least_square,
        )
    told = np.empty((13, len(state)))
    vectors = state.T.reshape(3, 2, -1) - np.array([[pose.east, pose.north], [0.0, 0.0], [0.0, 0.0]])[:, :, None]
    told[:6:2], told[1:6:2] = turned(vectors[:, 0], vectors[:, 1], c, s)
    blocks = spread[:, :4, :4].reshape(-1, 2, 2, 2, 2)
    half = np.stack(turned(blocks[:, :, 0], blocks[:, :, 1], c, s), axis=2)
    covariance = np.stack(turned(half[..., 0], half[..., 1], c, s), axis=-1).reshape(-1, 4, 4)
    covariance = np.where(np.tri(4, k=-1, dtype=np.bool_), np.swapaxes(covariance, 1, 2), covariance)
    told[6:10] = np.sqrt(np.maximum(np.einsum("nii->in", covariance), 0.0))
    vx, vy, ax, ay = told[2:6]
    square = vx * vx + vy * vy
    told[10] = np.nan
    np.divide(ay * vx - ax * vy, square, out=told[10], where=square > least_square)
    told[11:] = np.stack(turned(direction[:, 0], direction[:, 1], c, s)) * np.where(forward == 0.0, np.nan, forward)
    return told, covariance


def turned(x: Floats, y: Floats, c: float, s: float) -> tuple[Floats, Floats]:
    """Return vectors in axes that are turned by an angle with cosine c and sine s."""
    return x * c + y * s, y * c - x * s
