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
_REPORTED_VARIANCES = np.array([0, 1, 7, 14, 15, 21])
"""Of a flat covariance of six states: the variances and the covariance of x, y, then of vx, vy."""


def report(tracks: TrackStore, motion: RigidMotion, pose: EgoPose, used: Used, slack_ns: int) -> Obstacles:
    """Return the obstacles in vehicle axes and in the local frame.

    Args:
        tracks: predicted to the pose's time.
        motion: of the obstacles.
        pose: ego pose.
        used: the detections of this cycle and the reflections they updated.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
    """
    obstacles, reflections = tracks.obstacles, tracks.reflections
    state, turn = motion.state, exp(-1j * pose.heading)
    position, velocity, acceleration = (state.view(np.complex128) * turn).T  # plane vectors are complex numbers
    position -= complex(pose.east, pose.north) * turn
    deviation = np.sqrt(np.maximum(_turned_variances(motion.covariance, pose.heading), 0.0))
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
        sx=deviation[:, 0, 0],
        sy=deviation[:, 0, 1],
        svx=deviation[:, 1, 0],
        svy=deviation[:, 1, 1],
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH),
        sensors=obstacles.sensors.copy(),
        used_row=reflections.obstacle[used.reflection],
        used_sensor=used_sensor,
        used_object=used.objects,
    )


def _turned_variances(covariance: Floats, heading: float) -> Floats:
    """Return the variances (k, 2, 2) of x, y and of vx, vy in vehicle axes."""
    c, s = cos(heading), sin(heading)
    turn = np.array([[c * c, s * s], [2 * c * s, -2 * c * s], [s * s, c * c]])
    variances = covariance.reshape(-1, 36).take(_REPORTED_VARIANCES, axis=1)
    return np.asarray((variances.reshape(-1, 3) @ turn).reshape(-1, 2, 2))
