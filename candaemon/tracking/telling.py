"""Obstacles as the vehicle sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candaemon.sensing.pose import EgoPose
from candaemon.tracking.obstacles import COASTING, CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.population import Population

_REMEMBERED = 32  # scans in an obstacle's history


def tell(population: Population, pose: EgoPose, used: NDArray[np.intp], slack_ns: int) -> Obstacles:
    """Return the obstacles in vehicle axes and in the level frame.

    Args:
        population: the tracks, predicted to the pose's time.
        pose: own pose.
        used: rows of the reflections that were updated in this cycle.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
    """
    obstacles, reflections = population.obstacles, population.reflections
    motion = population.motion()
    turn = pose.rotation
    place = (motion.position - np.array([pose.east, pose.north])) @ turn
    velocity, acceleration = motion.velocity @ turn, motion.acceleration @ turn
    blocks = motion.covariance[:, :4, :4].reshape(-1, 2, 2, 2, 2)
    deviation = np.sqrt(np.maximum(np.einsum("nkakb,ai,bi->kin", blocks, turn, turn), 0.0))
    silent = pose.time_ns - obstacles.last_ns > slack_ns
    state = np.where(obstacles.confirmed, np.where(silent, COASTING, CONFIRMED), TENTATIVE).astype(np.int8)
    return Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=state,
        x=place[:, 0],
        y=place[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        ax=acceleration[:, 0],
        ay=acceleration[:, 1],
        east=motion.position[:, 0],
        north=motion.position[:, 1],
        ve=motion.velocity[:, 0],
        vn=motion.velocity[:, 1],
        sx=deviation[0, 0],
        sy=deviation[0, 1],
        svx=deviation[1, 0],
        svy=deviation[1, 1],
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _REMEMBERED),
        sensors=obstacles.sensors.copy(),
        used_row=reflections.obstacle[used],
        used_sensor=reflections.sensor[used],
        used_object=reflections.object_id[used],
    )
