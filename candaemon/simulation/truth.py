"""Truth tables: the obstacles that an ideal tracker would report at each scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, ComplexPlane, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.estimation.outline import facing_point
from candaemon.simulation.scene import Points, Scene, SceneState
from candaemon.simulation.visibility import VisibleReflections, hidden, in_view, seen_from, sides_seen

_MARGIN = 20.0
"""Stationary objects are listed up to this far beyond the longest range of a sensor, m."""


@dataclass(frozen=True, slots=True)
class TruthCycle:
    """The truth at one instant: n objects, the actors first.

    Attributes:
        time_ns: measurement time, in the log's clock.
        columns: column of `--truth` → values, each of length n. `id` is 1 for the scenario's first actor, …; stationary
            objects follow. `state` is `actor`, `hidden` (an actor that no sensor can see at this instant) or
            `stationary`. The others are as in `candaemon.evaluation.tables`, the motion that of the reference point;
            `objects` and the columns that only a tracker can fill are absent.

    """

    time_ns: int
    columns: dict[str, NDArray[Any]]


class Truth:
    """The truth of a scenario, with the actors' visibility to the given sensors.

    Args:
        scene: the scenario's scene.
        sensors: the sensors' settings: mounts and fields of view.
        occlusion: whether actors occlude one another.

    """

    def __init__(self, scene: Scene, sensors: Sequence[SensorSettings], *, occlusion: bool) -> None:
        self._scene = scene
        self._sensors = tuple(sensors)
        self._occlusion = occlusion
        self._reflections = VisibleReflections(scene)
        self._no_drift = np.zeros(len(self._reflections.actor))
        views = [view for settings in self._sensors for view in settings.views.values()]
        self._reach = max((view.range for view in views), default=0.0) + _MARGIN

    def visible(self, instant: SceneState) -> Booleans:
        """Return which actors are visible to any sensor at an instant, by any of their reflections, shape (actors,)."""
        seen = np.zeros(len(self._scene.actors), dtype=bool)
        actor = self._reflections.actor
        for settings in self._sensors:
            sensor = instant.ego.at_mount(settings.mount)
            offset = self._reflections.offsets(seen_from(instant, sensor.position), self._no_drift)
            point = instant.on_actors(actor, offset).position
            local = (point - sensor.position) * np.exp(-1j * sensor.yaw)
            in_sight = np.any([in_view(local, view) for view in settings.views.values()], axis=0)
            in_sight &= np.abs(local) <= self._reflections.reach
            if self._occlusion:
                in_sight &= ~hidden(self._scene, instant, sensor, local, actor)
            np.logical_or.at(seen, actor, in_sight)
        return seen

    def sides(self, instant: SceneState) -> Integers:
        """Return how many sides of each actor any sensor sees at an instant, at most 2, shape (actors,)."""
        seen = np.zeros((len(self._scene.actors), 4), dtype=bool)
        for settings in self._sensors:
            sensor = instant.ego.at_mount(settings.mount)
            for view in settings.views.values():
                seen |= sides_seen(self._scene, instant, sensor, view, occlusion=self._occlusion)
        return np.asarray(np.minimum(np.count_nonzero(seen, axis=1), 2), dtype=np.int64)

    def references(self, instant: SceneState) -> Points:
        """Return the motion of each actor's reference point, as seen from the origin of the ego's vehicle axes."""
        scene = self._scene
        eye = seen_from(instant, instant.ego.position)
        facing = facing_point(np.stack([eye.real, eye.imag], axis=1), scene.half_length, scene.half_width)
        offset = np.where(scene.half_length > 0.0, facing[:, 0] + 1j * facing[:, 1], 0.0)
        return instant.on_actors(np.arange(len(scene.actors), dtype=np.int64), offset)

    def cycle(self, instant: SceneState, time_ns: int) -> TruthCycle:
        """Return the truth at one instant: all actors, and the stationary objects within reach of the sensors."""
        ego, scene = instant.ego, self._scene
        turn = np.exp(-1j * ego.yaw)
        actors, seen = self.references(instant), self.visible(instant)
        near = np.flatnonzero(np.abs(scene.stationary - ego.position) <= self._reach)
        still = np.zeros(len(near), dtype=np.complex128)
        position = np.concatenate([actors.position, scene.stationary[near]])
        velocity = np.concatenate([actors.velocity, still])
        local, speed = (position - ego.position) * turn, velocity * turn
        acceleration = np.concatenate([actors.acceleration, still]) * turn
        count = len(scene.actors)
        plane = {
            "x": local.real,
            "y": local.imag,
            "vx": speed.real,
            "vy": speed.imag,
            "ax": acceleration.real,
            "ay": acceleration.imag,
        }
        local_frame = {"east": position.real, "north": position.imag, "ve": velocity.real, "vn": velocity.imag}
        identity = np.concatenate([np.arange(1, count + 1), count + 1 + near])
        state = np.concatenate([np.where(seen, "actor", "hidden"), np.full(len(near), "stationary")])
        return TruthCycle(
            time_ns, {"id": identity, "state": state, **plane, **local_frame, **self._bodies(instant, local)}
        )

    def _bodies(self, instant: SceneState, local: ComplexPlane) -> dict[str, NDArray[Any]]:
        """Return the columns of the bodies, of the actors and of stationary objects (positions local, vehicle axes)."""
        ego, actors, scene = instant.ego, instant.actors, self._scene
        still = len(local) - len(scene.actors)
        solid = scene.half_length > 0.0
        heading = np.angle(np.exp(1j * (actors.yaw - ego.yaw)))
        centre = (actors.position - ego.position) * np.exp(-1j * ego.yaw)
        centre = np.concatenate([centre, local[len(scene.actors) :]])
        unknown, zero = np.full(still, np.nan), np.zeros(still)
        return {
            "heading": np.concatenate([np.where(solid, heading, np.nan), unknown]),
            "yaw_rate": np.concatenate([np.where(solid, actors.yaw_rate, np.nan), unknown]),
            "length": np.concatenate([2 * scene.half_length, zero]),
            "width": np.concatenate([2 * scene.half_width, zero]),
            "center_x": centre.real,
            "center_y": centre.imag,
            "class": np.array([actor.kind for actor in scene.actors] + ["standing"] * still, dtype=np.str_),
            "sides": np.concatenate([self.sides(instant), zero]),
        }
