"""Several reflections of one vehicle: who leads, where the reference point is, who joins and who parts.

The reference point of an obstacle is its leading reflection, the oldest one that is still detected. When the lead
passes on, the reference point stays where it is on the vehicle and then returns to the new leader slowly, so that
neither position nor identity jumps. Velocity and acceleration are the mean of all reflections, weighted by how well
each knows its velocity: a vehicle is rigid, and its reflections' noise is not shared.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.tracker import ReflectionSettings, TravelSettings
from candaemon.tracking.columns import ObstacleTable, ReflectionTable


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """States [x, y, vx, vy, ax, ay] of k reference points, level frame, (k, 6), and covariances (k, 6, 6)."""

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
    """Turn level-frame vectors (…, 2) into components along and across the direction (…, 2), positive to the left."""
    along = vectors[..., 0] * direction[..., 0] + vectors[..., 1] * direction[..., 1]
    across = vectors[..., 1] * direction[..., 0] - vectors[..., 0] * direction[..., 1]
    return np.stack([along, across], axis=-1)


def from_travel_axes(components: Floats, direction: Floats) -> Floats:
    """Undo `to_travel_axes`."""
    along, across = components[..., 0], components[..., 1]
    return np.stack(
        [
            along * direction[..., 0] - across * direction[..., 1],
            along * direction[..., 1] + across * direction[..., 0],
        ],
        axis=-1,
    )


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


def draw_back(obstacles: ObstacleTable, dt: float, settings: ReflectionSettings) -> None:
    """Draw each reference point back to its leader over dt, s."""
    obstacles.offset *= exp(-dt / settings.return_time)


def pass_the_lead(
    obstacles: ObstacleTable, reflections: ReflectionTable, mean: Floats, time_ns: int, settings: ReflectionSettings
) -> None:
    """Hand the lead on where the leader was not detected of late."""
    silent = time_ns - reflections.last_ns[obstacles.leader] > int(settings.patience * 1e9)
    if not silent.any():
        return
    detected = np.flatnonzero(reflections.last_ns == time_ns)[::-1]
    heir = np.full(len(obstacles), -1, dtype=np.int64)
    heir[reflections.obstacle[detected]] = detected  # reversed, so that the oldest one is written last
    rows = np.flatnonzero(silent & (heir >= 0))
    change_leader(obstacles, rows, heir[rows], mean)


def change_leader(obstacles: ObstacleTable, rows: Indices, heirs: Integers, mean: Floats) -> None:
    """Make other reflections lead, the reference points staying where they are."""
    step = mean[obstacles.leader[rows], :2] - mean[heirs, :2]
    obstacles.offset[rows] += to_travel_axes(step, obstacles.direction[rows])
    obstacles.leader[rows] = heirs


def parted(
    obstacles: ObstacleTable,
    reflections: ReflectionTable,
    mean: Floats,
    motion: RigidMotion,
    settings: ReflectionSettings,
) -> Booleans:
    """Tell which reflections no longer move with their obstacle.

    The bounds are twice those for joining, so that a reflection at the edge does not come and go.
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


def beside_an_older(obstacles: ObstacleTable, motion: RigidMotion, settings: ReflectionSettings) -> Integers:
    """Return for each obstacle the row of an older one that it is side by side with, or −1.

    Rows keep the order of birth, so an older obstacle has a smaller row.
    """
    found = np.full(len(obstacles), -1, dtype=np.int64)
    reach = settings.along + settings.across
    east, north = motion.state[:, 0], motion.state[:, 1]
    near = (np.abs(east[:, None] - east) < reach) & (np.abs(north[:, None] - north) < reach)
    young, old = np.nonzero(near)
    earlier = old < young
    young, old = young[earlier], old[earlier]
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


def turn_to_course(obstacles: ObstacleTable, velocity: Floats, dt: float, settings: TravelSettings) -> None:
    """Turn the directions of travel towards the courses over ground of what moves.

    Args:
        obstacles: whose directions turn.
        velocity: over ground (k, 2), level frame, m/s.
        dt: s since the last turn.
        settings: how fast, and from which speed on.
    """
    vx, vy = velocity[:, 0], velocity[:, 1]
    speed = np.sqrt(vx * vx + vy * vy)
    moving = speed > settings.min_speed
    if dt == 0.0 or not moving.any():
        return
    dx, dy = obstacles.direction[:, 0], obstacles.direction[:, 1]
    # an axis has no sign: what drives towards us turns the same axis
    share = moving * -np.expm1(-dt / settings.time_constant)
    towards = np.copysign(share / np.maximum(speed, settings.min_speed), vx * dx + vy * dy)
    dx, dy = dx + towards * vx - share * dx, dy + towards * vy - share * dy
    norm = np.sqrt(dx * dx + dy * dy)
    obstacles.direction = np.stack([dx / norm, dy / norm], axis=1)
