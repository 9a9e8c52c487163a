"""Obstacles as the vehicle sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candaemon.sensing.pose import EgoPose
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.population import Population
from candaemon.tracking.reflections import Motion
from candaemon.tracking.update import Used

_REMEMBERED = 32  # scans in an obstacle's history


def tell(population: Population, motion: Motion, pose: EgoPose, used: Used, slack_ns: int) -> Obstacles:
    """Return the obstacles in vehicle axes and in the level frame.

    Args:
        population: the tracks, predicted to the pose's time.
        motion: of the obstacles.
        pose: own pose.
        used: the detections of this cycle and the reflections they updated.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
    """
    obstacles, reflections = population.obstacles, population.reflections
    state, turn = motion.state, pose.rotation
    seen = (state.reshape(-1, 2) @ turn).reshape(-1, 3, 2)
    seen[:, 0] -= np.array([pose.east, pose.north]) @ turn
    deviation = np.sqrt(np.maximum(motion.covariance.reshape(-1, 36) @ _in_vehicle_axes(turn), 0.0))
    silent = pose.time_ns - obstacles.last_ns > slack_ns
    told = np.where(obstacles.confirmed, CONFIRMED + silent, TENTATIVE).astype(np.int8)
    return Obstacles(
        time_ns=pose.time_ns,
        id=obstacles.id.copy(),
        state=told,
        x=seen[:, 0, 0],
        y=seen[:, 0, 1],
        vx=seen[:, 1, 0],
        vy=seen[:, 1, 1],
        ax=seen[:, 2, 0],
        ay=seen[:, 2, 1],
        east=state[:, 0],
        north=state[:, 1],
        ve=state[:, 2],
        vn=state[:, 3],
        sx=deviation[:, 0],
        sy=deviation[:, 1],
        svx=deviation[:, 2],
        svy=deviation[:, 3],
        age=np.maximum(pose.time_ns - obstacles.first_ns, 0) * 1e-9,
        existence=np.bitwise_count(obstacles.history) / np.minimum(obstacles.scans + 1, _REMEMBERED),
        sensors=obstacles.sensors.copy(),
        used_row=reflections.obstacle[used.reflection],
        used_sensor=np.full(len(used.objects), used.sensor),
        used_object=used.objects,
    )


def _in_vehicle_axes(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (36, 4): a flat covariance times this gives the variances of x, y, vx, vy in vehicle axes."""
    axes = np.zeros((4, 6))
    axes[:2, :2] = axes[2:, 2:4] = turn.T
    return (axes[:, :, None] * axes[:, None, :]).reshape(4, 36).T
