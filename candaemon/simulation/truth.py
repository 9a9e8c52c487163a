"""Truth tables: the obstacles that an ideal tracker would report at each scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.scene import Points, Scene, SceneState
from candaemon.simulation.visibility import VisibleReflections, hidden, in_view, reference_offsets, seen_from

_MARGIN = 20.0
"""Stationary objects are listed up to this far beyond the longest range of a sensor, m."""


@dataclass(frozen=True, slots=True)
class TruthCycle:
    """The truth at one instant: n objects, the actors first.

    Attributes:
        time_ns: measurement time, in the log's clock.
        columns: column of `--truth` → values, each of length n. `id` is 1 for the scenario's first actor, …; stationary
            objects follow. `state` is `actor`, `hidden` (an actor that no sensor can see at this instant) or
            `stationary`. The others describe the reference point, as in `candaemon.evaluation.tables`; `objects`
            and the columns that only a tracker can fill are absent.

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
        self._reach = max((settings.field_of_view.range for settings in self._sensors), default=0.0) + _MARGIN

    def visible(self, instant: SceneState) -> Booleans:
        """Return which actors are visible to any sensor at an instant, by any of their reflections, shape (actors,)."""
        seen = np.zeros(len(self._scene.actors), dtype=bool)
        actor = self._reflections.actor
        for settings in self._sensors:
            sensor = instant.ego.at_mount(settings.mount)
            offset = self._reflections.offsets(seen_from(instant, sensor.position), self._no_drift)
            point = instant.on_actors(actor, offset).position
            local = (point - sensor.position) * np.exp(-1j * sensor.yaw)
            in_sight = in_view(local, settings.field_of_view)
            if self._occlusion:
                in_sight &= ~hidden(self._scene, instant, sensor, local, actor)
            np.logical_or.at(seen, actor, in_sight)
        return seen

    def references(self, instant: SceneState) -> Points:
        """Return the motion of each actor's reference point, as seen from the origin of the ego's vehicle axes."""
        scene = self._scene
        eye = seen_from(instant, instant.ego.position)
        offset = reference_offsets(eye, scene.half_length, scene.half_width)
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
        return TruthCycle(time_ns, {"id": identity, "state": state, **plane, **local_frame})
