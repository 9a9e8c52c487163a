"""The report of a cycle: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from cmath import exp
from math import cos, sin

import numpy as np

from candaemon.arrays import Floats
from candaemon.ego.pose import EgoPose
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.reflections import RigidMotion
from candaemon.tracking.track_store import TrackStore
from candaemon.tracking.update import Used

_HISTORY_LENGTH = 32  # scans in an obstacle's history
_REPORTED = np.add.outer(6 * np.arange(4), np.arange(4)).ravel()
"""Of a flat covariance of six states: that of x, y, vx, vy."""
_VARIANCES = np.array([0, 5, 10, 15])
"""Of that one, flat."""
_KEPT, _SIDEWAYS = np.eye(4), np.kron(np.eye(2), [[0.0, 1.0], [-1.0, 0.0]])
_TURN = np.stack(
    [
        np.kron(_KEPT, _KEPT),
        np.kron(_KEPT, _SIDEWAYS) + np.kron(_SIDEWAYS, _KEPT),
        np.kron(_SIDEWAYS, _SIDEWAYS),
    ]
).transpose(0, 2, 1)
"""(3, 16, 16); with cos², cos·sin and sin² of an angle as factors they turn flat covariances by one product."""


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
    obstacles, reflections = tracks.obstacles, tracks.reflections
    state, turn = motion.state, exp(-1j * pose.heading)
    position, velocity, acceleration = (state.view(np.complex128) * turn).T  # plane vectors are complex numbers
    position -= complex(pose.east, pose.north) * turn
    covariance = _turned(motion.covariance, pose.heading)
    deviation = np.sqrt(np.maximum(covariance.take(_VARIANCES, axis=1), 0.0))
    unknown = np.full(len(obstacles), np.nan)
    square = velocity.real**2 + velocity.imag**2
    curving = (acceleration * velocity.conj()).imag
    yaw_rate = np.divide(curving, square, out=unknown.copy(), where=square > min_speed * min_speed)
    course = obstacles.direction.view(np.complex128)[:, 0] * (obstacles.forward * turn)
    heading = np.arctan2(course.imag, course.real, out=unknown.copy(), where=obstacles.forward != 0.0)
    status = np.add(pose.time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
    used_sensor = np.empty(len(used.objects), np.int64)
    used_sensor.fill(used.sensor)
    return Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=status,
        x=position.real,
        y=position.imag,
        vx=velocity.real,
        vy=velocity.imag,
        ax=acceleration.real,
        ay=acceleration.imag,
        east=state[:, 0],
        north=state[:, 1],
        ve=state[:, 2],
        vn=state[:, 3],
        sx=deviation[:, 0],
        sy=deviation[:, 1],
        svx=deviation[:, 2],
        svy=deviation[:, 3],
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH),
        sensors=obstacles.sensors.copy(),
        heading=heading,
        yaw_rate=yaw_rate,
        length=unknown,
        width=unknown,
        center_x=position.real,
        center_y=position.imag,
        kind=np.zeros(len(obstacles), np.int8),
        kind_likelihood=unknown,
        covariance=covariance.reshape(-1, 4, 4),
        used_row=reflections.obstacle[used.reflection],
        used_sensor=used_sensor,
        used_object=used.objects,
    )


def _turned(covariance: Floats, heading: float) -> Floats:
    """Return the covariances of x, y, vx, vy in vehicle axes, flat (k, 16), of those of six states (k, 6, 6)."""
    c, s = cos(heading), sin(heading)
    turn = c * c * _TURN[0] + c * s * _TURN[1] + s * s * _TURN[2]
    return np.asarray(covariance.reshape(-1, 36).take(_REPORTED, axis=1) @ turn)
