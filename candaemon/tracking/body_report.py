"""The report of a cycle of bodies: obstacles in vehicle axes and in the local frame."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from candaemon.arrays import Booleans, Floats
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import POSITION, TURN, VELOCITY, acceleration
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import classes, place_covariance, size_known, wandering
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.update import Used

_HISTORY_LENGTH = 32  # scans in an obstacle's history
_LEAST_SPEED = 0.5  # m/s; slower, nothing turns
_SURELY = 0.9  # probability of standing
_CLOSE = 0.1  # m
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
    obstacles, moments, turn = bodies.obstacles, bodies.moments(), pose.rotation
    mean = moments.mean
    place, velocity = pose.to_vehicle(mean[:, POSITION]), mean[:, VELOCITY] @ turn
    change = acceleration(mean) @ turn
    both = np.zeros((4, 4))
    both[:2, :2] = both[2:, 2:] = turn
    covariance = both.T @ moments.covariance[:, :4, :4] @ both
    sight = place / np.maximum(np.hypot(place[:, 0], place[:, 1]), _CLOSE)[:, None]
    axis = obstacles.axis @ turn
    lies = place_covariance(bodies, axis, sight)
    covariance[:, :2, :2] += lies
    covariance[:, 2:, 2:] += pose.velocity_covariance + wandering(lies, sight, wander_time)
    deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    standing = bodies.filter.probability[:, STANDING] > _SURELY
    old = (pose.time_ns - obstacles.first_ns) * 1e-9 > _SETTLED
    standing |= old & (obstacles.fastest < _LEAST_SPEED)
    sized = size_known(bodies)
    centre = place - np.where(sized[:, None], obstacles.facing @ turn, 0.0)
    status = np.add(pose.time_ns - obstacles.last_ns > slack_ns, CONFIRMED, dtype=np.int8)
    status[~obstacles.confirmed] = TENTATIVE
    if existence is None:
        existence = np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _HISTORY_LENGTH)
    found = Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=status,
        x=place[:, 0],
        y=place[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        ax=change[:, 0],
        ay=change[:, 1],
        east=mean[:, 0],
        north=mean[:, 1],
        ve=mean[:, 2],
        vn=mean[:, 3],
        sx=deviation[:, 0],
        sy=deviation[:, 1],
        svx=deviation[:, 2],
        svy=deviation[:, 3],
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=existence.copy(),
        sensors=obstacles.sensors.copy(),
        heading=np.where(obstacles.directed, np.arctan2(axis[:, 1], axis[:, 0]), np.nan),
        yaw_rate=np.where(speed > _LEAST_SPEED, mean[:, TURN], 0.0),
        length=np.where(sized, obstacles.length, np.nan),
        width=np.where(sized, obstacles.width, np.nan),
        center_x=centre[:, 0],
        center_y=centre[:, 1],
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
