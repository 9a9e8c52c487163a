"""What a smoother needs of a tracker, and obstacles with smoothed motion.

An obstacle's motion is that of its reference point, and its chain lasts as long as its identity: the reflections that
carry it may change in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from candaemon.arrays import Floats, Integers
from candaemon.ego.pose import EgoPose
from candaemon.estimation.smoothing import Link, Smoothed
from candaemon.tracking.obstacles import Obstacles


@dataclass(frozen=True, slots=True)
class SmootherHistory:
    """One step of a tracker; states are [x, y, vx, vy, ax, ay] of obstacles, local frame, SI units.

    Attributes:
        id: of the obstacles reported, (k,).
        state: the reference points' places, and velocities as the filter tells them (k, 6).
        covariance: of it (k, 6, 6).
        linked: identities of the obstacles that the step began with, (l,).
        link: their prediction to this step's instant, rows as `linked`.
        swing: what turning adds to those velocities to get the reference points' (k, 2), m/s.
    """

    id: Integers
    state: Floats
    covariance: Floats
    linked: Integers
    link: Link
    swing: Floats


def concatenated(histories: Sequence[SmootherHistory]) -> SmootherHistory:
    """Return the histories of several trackers' same step as one."""
    if len(histories) == 1:
        return histories[0]
    links = [history.link for history in histories]
    return SmootherHistory(
        np.concatenate([history.id for history in histories]),
        np.concatenate([history.state for history in histories]),
        np.concatenate([history.covariance for history in histories]),
        np.concatenate([history.linked for history in histories]),
        Link(
            np.concatenate([link.mean for link in links]),
            np.concatenate([link.covariance for link in links]),
            np.concatenate([link.gain for link in links]),
        ),
        np.concatenate([history.swing for history in histories]),
    )


def swing_of(history: SmootherHistory, obstacles: Obstacles) -> Floats:
    """Return what turning adds to the velocities of the obstacles of a step (k, 2), local frame, m/s."""
    order = np.argsort(history.id)
    rows = order[np.searchsorted(history.id, obstacles.id, sorter=order)]
    return np.asarray(history.swing[rows])


def with_motion(obstacles: Obstacles, smoothed: Smoothed, pose: EgoPose, swing: Floats) -> Obstacles:
    """Return obstacles with smoothed motion in place of their own; identity, state, age, heading and detections stay.

    Args:
        obstacles: of one cycle.
        smoothed: the motion of these, and of others that are not reported.
        pose: ego pose in that cycle.
        swing: what turning adds to the velocities (k, 2), local frame, m/s.
    """
    order = np.argsort(smoothed.keys)
    rows = order[np.searchsorted(smoothed.keys, obstacles.id, sorter=order)]
    state, turn = smoothed.mean[rows], pose.rotation
    state[:, 2:4] += swing
    place = pose.to_vehicle(state[:, :2])
    velocity, acceleration = state[:, 2:4] @ turn, state[:, 4:] @ turn
    turn_both = np.kron(np.eye(2), turn)
    covariance = turn_both.T @ smoothed.covariance[rows, :4, :4] @ turn_both
    deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    return replace(
        obstacles,
        x=place[:, 0],
        y=place[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        ax=acceleration[:, 0],
        ay=acceleration[:, 1],
        east=state[:, 0],
        north=state[:, 1],
        ve=state[:, 2],
        vn=state[:, 3],
        sx=deviation[:, 0],
        sy=deviation[:, 1],
        svx=deviation[:, 2],
        svy=deviation[:, 3],
        center_x=obstacles.center_x + (place[:, 0] - obstacles.x),
        center_y=obstacles.center_y + (place[:, 1] - obstacles.y),
        covariance=covariance,
    )
