"""The true scene at an instant: motion of the ego and the actors, positions of the stationary objects."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.config.sensors import Mount
from candaemon.simulation.actor_motion import Trajectory, TrueMotion, trajectory
from candaemon.simulation.scenario import Actor, PostRow, Scenario, Stationary


@dataclass(frozen=True, slots=True)
class Pose:
    """True motion of one rigid body at one instant, local axes (east + i·north), over ground.

    Attributes:
        position, velocity, acceleration: m, m/s, m/s².
        yaw: direction of its x axis, rad, counter-clockwise from east.
        yaw_rate: rad/s, positive to the left.

    """

    position: complex
    velocity: complex
    acceleration: complex
    yaw: float
    yaw_rate: float

    def at_mount(self, mount: Mount) -> Pose:
        """Return the motion of a sensor mounted on the body; the body's yaw acceleration is neglected."""
        arm = complex(mount.x, mount.y) * cmath.exp(1j * self.yaw)
        return Pose(
            self.position + arm,
            self.velocity + 1j * self.yaw_rate * arm,
            self.acceleration - self.yaw_rate**2 * arm,
            self.yaw + math.radians(mount.yaw_deg),
            self.yaw_rate,
        )


@dataclass(frozen=True, slots=True)
class Points:
    """Motion of n points at one instant, local axes, over ground: m, m/s, m/s²."""

    position: ComplexPlane
    velocity: ComplexPlane
    acceleration: ComplexPlane


@dataclass(frozen=True, slots=True)
class SceneState:
    """The scene at one instant.

    Attributes:
        time: s since the scenario's start.
        ego: the ego's motion; its position is that of the vehicle axes' origin.
        actors: motion of each actor's centre, shape (actors,).

    """

    time: float
    ego: Pose
    actors: TrueMotion

    def on_actors(self, actor: np.ndarray[tuple[int], np.dtype[np.int64]], offset: ComplexPlane) -> Points:
        """Return the motion of points fixed to actors.

        Args:
            actor: index of the actor that each point belongs to, shape (n,).
            offset: from the actor's centre in its own axes, m, shape (n,).

        """
        actors = self.actors
        arm = offset * np.exp(1j * actors.yaw[actor])
        rate = actors.yaw_rate[actor]
        return Points(
            actors.position[actor] + arm,
            actors.velocity[actor] + 1j * rate * arm,
            actors.acceleration[actor] - rate**2 * arm,
        )


@dataclass(frozen=True, slots=True)
class Reflectors:
    """Stationary points, shape (n,) each.

    Attributes:
        position: in the scenario's axes, m.
        near, far: m, between which one is seen, besides the limits of the sensor.
        detection: factor on the probability of detection.
    """

    position: ComplexPlane
    near: Floats
    far: Floats
    detection: Floats


_PARKED = np.array([-2.1, 0.0, 2.1])
"""Reflections of a parked car along the row, m from its middle."""


def _row_of(row: PostRow) -> ComplexPlane:
    """Return the places of a row in the scenario's axes, both ends included."""
    begin, end = complex(row.begin.x, row.begin.y), complex(row.end.x, row.end.y)
    return np.asarray(begin + (end - begin) * np.linspace(0.0, 1.0, row.spans + 1))


def _parked_of(row: PostRow) -> ComplexPlane:
    """Return the reflections of a row of parked cars in the scenario's axes."""
    along = complex(row.end.x - row.begin.x, row.end.y - row.begin.y)
    direction = along / abs(along) if along else 1.0 + 0j
    return (_row_of(row)[:, None] + direction * _PARKED).ravel()


def reflectors(stationary: Stationary) -> Reflectors:
    """Return the points of all stationary objects: posts, rails, parked cars, bridges, drains."""
    plain = [np.array([complex(post.x, post.y) for post in stationary.posts], dtype=np.complex128)]
    plain += [_row_of(rail) for rail in stationary.rails] + [_parked_of(row) for row in stationary.parked]
    parts = [(points, 0.0, np.inf, 1.0) for points in plain]
    parts += [(_row_of(bridge), bridge.near, bridge.far, 1.0) for bridge in stationary.bridges]
    parts += [(np.array([complex(one.x, one.y)]), 0.0, one.far, one.detection) for one in stationary.drains]
    counts = [len(points) for points, *_ in parts]
    near, far, detection = (np.repeat([part[k] for part in parts], counts) for k in (1, 2, 3))
    return Reflectors(np.concatenate([points for points, *_ in parts]), near, far, detection)


class Scene:
    """A scenario's truth at any instant.

    Attributes:
        actors: the actors' settings, in the scenario's order.
        half_length, half_width: of each actor, m, shape (actors,); 0 for a point.
        reflectors: of the stationary objects, in the scenario's axes.
        stationary: their places in local axes, shape (stationary,).
        rails: both ends of each rail in local axes, shape (rails, 2).

    """

    def __init__(self, scenario: Scenario) -> None:
        start = scenario.ego.start
        yaw = math.pi / 2 - math.radians(start.heading_deg)
        axes = cmath.exp(1j * yaw)
        origin = complex(start.east, start.north)
        self._ego = trajectory(origin, start.speed * axes, yaw, scenario.ego.segments, axes_yaw=yaw)
        self._trajectories = tuple(_actor_trajectory(actor, origin, yaw) for actor in scenario.actors)
        self.actors = scenario.actors
        self.half_length: Floats = np.array([actor.size.length / 2 for actor in scenario.actors])
        self.half_width: Floats = np.array([actor.size.width / 2 for actor in scenario.actors])
        self.reflectors = reflectors(scenario.stationary)
        self.stationary: ComplexPlane = origin + axes * self.reflectors.position
        rails = [(complex(r.begin.x, r.begin.y), complex(r.end.x, r.end.y)) for r in scenario.stationary.rails]
        self.rails: ComplexPlane = origin + axes * np.array(rails, dtype=np.complex128).reshape(-1, 2)

    def ego(self, times: Floats) -> TrueMotion:
        """Return the ego's motion at seconds since the scenario's start, shape (n,)."""
        return self._ego.at(times)

    def states(self, times: Floats, *, block: int = 256) -> Iterator[SceneState]:
        """Yield the scene at each of the times (s since the start, shape (n,)), computed `block` at a time."""
        for first in range(0, len(times), block):
            part = times[first : first + block]
            ego = self._ego.at(part)
            actors = _stacked([one.at(part) for one in self._trajectories], len(part))
            for k, time in enumerate(part):
                yield SceneState(float(time), _pose(ego, k), _row(actors, k))


def _actor_trajectory(actor: Actor, origin: complex, axes_yaw: float) -> Trajectory:
    """Return an actor's trajectory in local axes."""
    start = actor.start
    if start.vx is not None or start.vy is not None:
        velocity = complex(start.vx or 0.0, start.vy or 0.0)
    else:
        velocity = cmath.rect(start.speed or 0.0, math.radians(start.heading_deg))
    heading = cmath.phase(velocity) if velocity else math.radians(start.heading_deg)
    axes = cmath.exp(1j * axes_yaw)
    position = origin + axes * complex(start.x, start.y)
    return trajectory(position, velocity * axes, axes_yaw + heading, actor.segments, axes_yaw=axes_yaw)


def _stacked(motions: list[TrueMotion], instants: int) -> TrueMotion:
    """Return the actors' motions as one, arrays of shape (instants, actors)."""
    if not motions:
        plane = np.empty((instants, 0), dtype=np.complex128)
        real = np.empty((instants, 0))
        return TrueMotion(plane, plane, plane, real, real)
    return TrueMotion(
        np.stack([one.position for one in motions], axis=1),
        np.stack([one.velocity for one in motions], axis=1),
        np.stack([one.acceleration for one in motions], axis=1),
        np.stack([one.yaw for one in motions], axis=1),
        np.stack([one.yaw_rate for one in motions], axis=1),
    )


def _row(motion: TrueMotion, k: int) -> TrueMotion:
    """Return the motion of all actors at index k of time."""
    return TrueMotion(motion.position[k], motion.velocity[k], motion.acceleration[k], motion.yaw[k], motion.yaw_rate[k])


def _pose(motion: TrueMotion, k: int) -> Pose:
    """Return the pose of one body at index k of time."""
    return Pose(
        complex(motion.position[k]),
        complex(motion.velocity[k]),
        complex(motion.acceleration[k]),
        float(motion.yaw[k]),
        float(motion.yaw_rate[k]),
    )
