"""Several reflections of one vehicle: its reference point, its motion, and when obstacles merge or split.

The reference point of an obstacle is its leading reflection, the oldest one that is still detected. At a hand-over to
another reflection the reference point stays where it is on the vehicle and then returns to that reflection slowly, so
that neither position nor identity jumps. Velocity and acceleration are the mean of all reflections, weighted by how
well each knows its velocity: a vehicle is rigid, and its reflections' noise is not shared.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, expm1

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.tracker import ReflectionSettings, TravelSettings
from candaemon.tracking.columns import ObstacleTable, ReflectionTable


@dataclass(slots=True)  # made each cycle
class RigidMotion:
    """States [x, y, vx, vy, ax, ay] of k reference points, local frame, (k, 6), and covariances (k, 6, 6)."""

    state: Floats
    covariance: Floats

    @property
    def position(self) -> Floats:
        """Positions (k, 2), m."""
        return self.state[:, :2]

    @property
    def velocity(self) -> Floats:
        """Velocities over ground (k, 2), m/s."""
        return self.state[:, 2:4]


def to_travel_axes(vectors: Floats, direction: Floats) -> Floats:
    """Turn local-frame vectors (…, 2) into components along and across the direction (…, 2), positive to the left."""
    if compiled.in_use and vectors.ndim == direction.ndim == 2 and len(vectors) == len(direction):
        return compiled.kernels.to_travel_axes(vectors, direction)
    x, y, c, s = vectors[..., 0], vectors[..., 1], direction[..., 0], direction[..., 1]
    return np.stack([x * c + y * s, y * c - x * s], axis=-1)


def from_travel_axes(components: Floats, direction: Floats) -> Floats:
    """Undo `to_travel_axes`."""
    if compiled.in_use and components.ndim == direction.ndim == 2 and len(components) == len(direction):
        return compiled.kernels.from_travel_axes(components, direction)
    x, y, c, s = components[..., 0], components[..., 1], direction[..., 0], direction[..., 1]
    return np.stack([x * c - y * s, y * c + x * s], axis=-1)


def lengths(vectors: Floats) -> Floats:
    """Return the lengths of vectors (…, 2)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def rigid_motion(
    obstacles: ObstacleTable, reflections: ReflectionTable, mean: Floats, covariance: Floats
) -> RigidMotion:
    """Return the motion of each obstacle from its reflections' states (n, 6) and covariances (n, 6, 6)."""
    lead = obstacles.leader
    state, uncertain = mean.take(lead, axis=0), covariance.take(lead, axis=0)  # faster than by index
    if np.count_nonzero(obstacles.offset):
        state[:, :2] += from_travel_axes(obstacles.offset, obstacles.direction)
    if len(reflections) > len(obstacles):
        weight = 1.0 / (covariance[:, 2, 2] + covariance[:, 3, 3])
        total = np.bincount(reflections.obstacle, weight, len(obstacles))
        for c in range(2, 6):
            state[:, c] = np.bincount(reflections.obstacle, weight * mean[:, c], len(obstacles)) / total
    return RigidMotion(state, uncertain)


def decay_offsets(obstacles: ObstacleTable, dt: float, settings: ReflectionSettings) -> None:
    """Let each reference point return to its leading reflection over dt, s, exponentially."""
    obstacles.offset *= exp(-dt / settings.return_time)


def hand_over_reference(
    obstacles: ObstacleTable, reflections: ReflectionTable, mean: Floats, time_ns: int, settings: ReflectionSettings
) -> None:
    """Hand over the reference point where its reflection has not been detected for the hand-over delay."""
    silent = time_ns - reflections.last_ns[obstacles.leader] > int(settings.patience * 1e9)
    if not silent.any():
        return
    detected = np.flatnonzero(reflections.last_ns == time_ns)[::-1]
    successor = np.full(len(obstacles), -1, dtype=np.int64)
    successor[reflections.obstacle[detected]] = detected  # reversed, so that the oldest one is written last
    rows = np.flatnonzero(silent & (successor >= 0))
    change_reference(obstacles, rows, successor[rows], mean)


def change_reference(obstacles: ObstacleTable, rows: Indices, successors: Integers, mean: Floats) -> None:
    """Give the reference points of the rows to other reflections without moving them."""
    step = mean[obstacles.leader[rows], :2] - mean[successors, :2]
    obstacles.offset[rows] += to_travel_axes(step, obstacles.direction[rows])
    obstacles.leader[rows] = successors


def split_candidates(
    obstacles: ObstacleTable,
    reflections: ReflectionTable,
    mean: Floats,
    motion: RigidMotion,
    settings: ReflectionSettings,
) -> Booleans:
    """Return which reflections no longer move with their obstacle, (n,).

    The bounds are twice those for merging, so that a reflection at the edge does not come and go.
    """
    if len(reflections) == len(obstacles):
        return np.zeros(len(reflections), dtype=np.bool_)
    owner = reflections.obstacle
    direction = obstacles.direction[owner]
    place = to_travel_axes(mean[:, :2] - motion.position[owner], direction)
    speed = to_travel_axes(mean[:, 2:4] - motion.velocity[owner], direction)
    away = (
        (np.abs(place[:, 0]) > settings.extent)
        | (np.abs(place[:, 1]) > 2 * settings.across)
        | (np.abs(speed[:, 0]) > 2 * settings.speed)
    )
    away[obstacles.leader] = False
    return away


def merge_candidates(obstacles: ObstacleTable, motion: RigidMotion, settings: ReflectionSettings) -> Integers:
    """Return for each obstacle the row of an older one that it is alongside of and moves like, or −1.

    Rows keep the order of initiation, so an older obstacle has a smaller row.
    """
    found = np.full(len(obstacles), -1, dtype=np.int64)
    young, old = near_pairs(motion.state[:, 0], motion.state[:, 1], settings.along + settings.across)
    if not len(young):
        return found
    place = to_travel_axes(motion.position[old] - motion.position[young], obstacles.direction[young])
    faster = motion.velocity[old] - motion.velocity[young]
    beside = (
        (np.abs(place[:, 0]) < settings.along)
        & (np.abs(place[:, 1]) < settings.across)
        & ((faster * faster).sum(axis=1) < settings.speed**2)
        & obstacles.confirmed[old]
    )
    found[young[beside][::-1]] = old[beside][::-1]  # reversed, so that the oldest of several is written last
    return found


def near_pairs(x: Floats, y: Floats, reach: float) -> tuple[Indices, Indices]:
    """Return the rows (k,) of points nearer to one another in x and in y than a reach: the later row, the earlier."""
    if compiled.in_use:
        return compiled.kernels.near_pairs(x, y, reach)
    near = (np.abs(x[:, None] - x) < reach) & (np.abs(y[:, None] - y) < reach)
    later, earlier = np.nonzero(near)
    once = earlier < later
    return later[once], earlier[once]


def align_with_course(obstacles: ObstacleTable, velocity: Floats, dt: float, settings: TravelSettings) -> None:
    """Turn the directions of travel towards the courses over ground of what moves.

    Args:
        obstacles: whose directions turn.
        velocity: over ground (k, 2), local frame, m/s.
        dt: s since the last turn.
        settings: how fast, and from which speed on.
    """
    if dt == 0.0:
        return
    share = -expm1(-dt / settings.time_constant)
    if compiled.in_use:
        turned = compiled.kernels.turned_towards(
            obstacles.direction, obstacles.forward, velocity, settings.min_speed, share
        )
        obstacles.direction, obstacles.forward = turned
        return
    speed = np.sqrt(velocity[:, 0] * velocity[:, 0] + velocity[:, 1] * velocity[:, 1])
    moving = speed > settings.min_speed
    velocity, axis = velocity[moving], obstacles.direction[moving]
    along = velocity[:, 0] * axis[:, 0] + velocity[:, 1] * axis[:, 1]
    obstacles.forward, obstacles.direction = obstacles.forward.copy(), obstacles.direction.copy()
    obstacles.forward[moving] = np.copysign(1.0, along)
    # an axis has no sign: what drives towards us turns the same axis
    axis += share * (velocity * np.copysign(1.0 / speed[moving], along)[:, None] - axis)
    obstacles.direction[moving] = axis / np.sqrt(axis[:, 0] * axis[:, 0] + axis[:, 1] * axis[:, 1])[:, None]
