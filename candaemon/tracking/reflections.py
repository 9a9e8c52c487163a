"""Several reflections of one vehicle: who leads, where the reference point is, who joins and who parts.

The reference point of an obstacle is its leading reflection, the oldest one that is still detected. When the lead
passes on, the reference point stays where it is on the vehicle and then returns to the new leader slowly, so that
neither position nor identity jumps. Velocity and acceleration are the mean of all reflections, weighted by how well
each knows its velocity: a vehicle is rigid, and its reflections' noise is not shared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candaemon.config.tracker import ReflectionSettings, TravelSettings
from candaemon.tracking.tables import ObstacleTable, Reflections

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Motion:
    """Position, velocity, acceleration and covariance of obstacles, level frame: (k, 2) each and (k, 6, 6)."""

    position: Floats
    velocity: Floats
    acceleration: Floats
    covariance: Floats


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


def rigid_motion(obstacles: ObstacleTable, reflections: Reflections, mean: Floats, covariance: Floats) -> Motion:
    """Return the motion of each obstacle from its reflections' states (n, 6) and covariances (n, 6, 6)."""
    lead = obstacles.leader
    position = mean[lead, :2] + from_travel_axes(obstacles.offset, obstacles.direction)
    if len(reflections) == len(obstacles):
        return Motion(position, mean[lead, 2:4], mean[lead, 4:6], covariance[lead])
    weight = 1.0 / (covariance[:, 2, 2] + covariance[:, 3, 3])
    total = np.bincount(reflections.obstacle, weight, len(obstacles))
    moving = np.stack(
        [np.bincount(reflections.obstacle, weight * mean[:, c], len(obstacles)) / total for c in (2, 3, 4, 5)], axis=1
    )
    return Motion(position, moving[:, :2], moving[:, 2:], covariance[lead])


def pass_the_lead(
    obstacles: ObstacleTable,
    reflections: Reflections,
    mean: Floats,
    time_ns: int,
    dt: float,
    settings: ReflectionSettings,
) -> None:
    """Draw each reference point back to its leader, and hand the lead on where the leader was not detected of late."""
    obstacles.offset *= np.exp(-dt / settings.return_time)
    silent = time_ns - reflections.last_ns[obstacles.leader] > int(settings.patience * 1e9)
    if not silent.any():
        return
    detected = np.flatnonzero(reflections.last_ns == time_ns)[::-1]
    heir = np.full(len(obstacles), -1, dtype=np.int64)
    heir[reflections.obstacle[detected]] = detected  # reversed, so that the oldest one is written last
    rows = np.flatnonzero(silent & (heir >= 0))
    change_leader(obstacles, rows, heir[rows], mean)


def change_leader(obstacles: ObstacleTable, rows: Rows, heirs: Integers, mean: Floats) -> None:
    """Make other reflections lead, the reference points staying where they are."""
    step = mean[obstacles.leader[rows], :2] - mean[heirs, :2]
    obstacles.offset[rows] += to_travel_axes(step, obstacles.direction[rows])
    obstacles.leader[rows] = heirs


def parted(
    obstacles: ObstacleTable, reflections: Reflections, mean: Floats, motion: Motion, settings: ReflectionSettings
) -> NDArray[np.bool_]:
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


def beside_an_older(obstacles: ObstacleTable, motion: Motion, settings: ReflectionSettings) -> Integers:
    """Return for each obstacle the row of an older one that it is side by side with, or −1."""
    direction = obstacles.direction
    place = to_travel_axes(motion.position[None, :] - motion.position[:, None], direction[:, None])
    speed = motion.velocity[None, :] - motion.velocity[:, None]
    near = (
        (np.abs(place[..., 0]) < settings.along)
        & (np.abs(place[..., 1]) < settings.across)
        & ((speed * speed).sum(axis=-1) < settings.speed**2)
        & (obstacles.id[None, :] < obstacles.id[:, None])
        & obstacles.confirmed[None, :]
    )
    found = near.any(axis=1)
    return np.where(found, near.argmax(axis=1), -1)


def turn_to_course(obstacles: ObstacleTable, velocity: Floats, dt: float, settings: TravelSettings) -> None:
    """Turn the directions of travel towards the courses over ground of what moves.

    Args:
        obstacles: whose directions turn.
        velocity: over ground (k, 2), level frame, m/s.
        dt: s since the last turn.
        settings: how fast, and from which speed on.
    """
    speed = np.sqrt((velocity * velocity).sum(axis=1))
    moving = speed > settings.min_speed
    if dt == 0.0 or not moving.any():
        return
    course = velocity / np.maximum(speed, settings.min_speed)[:, None]
    # an axis has no sign: what drives towards us turns the same axis
    course *= np.where(to_travel_axes(course, obstacles.direction)[:, :1] < 0, -1.0, 1.0)
    share = moving * -np.expm1(-dt / settings.time_constant)
    turned = obstacles.direction + share[:, None] * (course - obstacles.direction)
    obstacles.direction = turned / np.sqrt((turned * turned).sum(axis=1, keepdims=True))
