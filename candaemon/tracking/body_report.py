"""The report of a cycle of bodies: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from candaemon.arrays import Booleans, Floats
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import TURN, acceleration
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import add_places, classes, size_known
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
    shown: Booleans,
    existence: Floats | None = None,
) -> Obstacles:
    """Return the obstacles in vehicle axes and in the local frame.

    Args:
        bodies: predicted to the pose's time.
        pose: ego pose.
        used: the detections of this cycle and the bodies they updated.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
        wander_time: within which reflections wander over their bodies, s.
        shown: which obstacles are reported (k,).
        existence: their probabilities of existence (k,); None: the shares of recent scans in which they were seen.
    """
    obstacles, moments = bodies.obstacles, bodies.moments()
    mean = moments.mean
    state = np.concatenate([mean[:, :4], acceleration(mean)], axis=1)
    told, covariance = in_vehicle_axes(state, moments.covariance, obstacles.axis, np.ones(len(obstacles)), pose, np.inf)
    add_places(bodies, told, covariance, pose.velocity_covariance, wander_time)
    x, y, vx, vy, ax, ay, sx, sy, svx, svy, _, axis_x, axis_y = told
    speed = np.sqrt(vx * vx + vy * vy)
    standing = bodies.filter.probability[:, STANDING] > _SURELY
    old = (pose.time_ns - obstacles.first_ns) * 1e-9 > _SETTLED
    standing |= old & (obstacles.fastest < _LEAST_SPEED)
    sized = size_known(bodies)
    centre = np.where(sized[:, None], obstacles.facing @ pose.rotation, 0.0)
    status = np.add(pose.time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
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
        ve=mean[:, 2],
        vn=mean[:, 3],
        sx=sx,
        sy=sy,
        svx=svx,
        svy=svy,
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=existence.copy(),
        sensors=obstacles.sensors.copy(),
        heading=np.where(obstacles.directed, np.arctan2(axis_y, axis_x), np.nan),
        yaw_rate=np.where(speed > _LEAST_SPEED, mean[:, TURN], 0.0),
        length=np.where(sized, obstacles.length, np.nan),
        width=np.where(sized, obstacles.width, np.nan),
        center_x=x - centre[:, 0],
        center_y=y - centre[:, 1],
        kind=classes(obstacles.length, obstacles.width, obstacles.length_variance, speed, standing),
        kind_likelihood=np.full(len(obstacles), np.nan),
        covariance=covariance,
        used_row=used.reflection,
        used_sensor=np.full(len(used.objects), used.sensor, dtype=np.int64),
        used_object=used.objects,
    )
    return found if shown.all() else _only(found, shown)


def _only(obstacles: Obstacles, shown: Booleans) -> Obstacles:
    """Return some of the obstacles, with the detections that they used."""
    names = {each.name for each in fields(Obstacles)} - {"time_ns"}
    used = shown[obstacles.used_row]
    columns = {name: getattr(obstacles, name)[used if name.startswith("used") else shown] for name in names}
    columns["used_row"] = (np.cumsum(shown) - 1)[columns["used_row"]]
    return Obstacles(time_ns=obstacles.time_ns, **columns)
