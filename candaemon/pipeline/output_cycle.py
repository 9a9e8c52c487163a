"""Which scans are followed by an output: each one, or the one nearest to every instant of a raster."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from candaemon.arrays import Integers
from candaemon.config.settings import Config
from candaemon.tracking.obstacles import Obstacles


def _none() -> Integers:
    return np.empty(0, dtype=np.int64)


@dataclass(slots=True)
class OutputCycleState:
    """What an `OutputCycle` remembers.

    Attributes:
        due_ns: the next instant of the raster.
        identity, sensor, object_id: the detections used since the latest output, (m,): of which obstacle, by which
            sensor, and that sensor's own id.
    """

    due_ns: int = 0
    identity: Integers = field(default_factory=_none)
    sensor: Integers = field(default_factory=_none)
    object_id: Integers = field(default_factory=_none)

    def validate(self) -> None:
        """Raise a ValueError where the detections contradict one another."""
        if not len(self.identity) == len(self.sensor) == len(self.object_id):
            raise ValueError("the detections used since the latest output have not one row each")


class OutputCycle:
    """Says after which scans obstacles go out, and gathers the detections used since the latest output.

    The raster goes on evenly whatever the scans' jitter: a scan is followed by an output if the next one is expected
    farther from the raster's instant. After a pause the raster begins anew.

    Args:
        config: with the time between outputs and the sensors.
    """

    def __init__(self, config: Config) -> None:
        self._cycle_ns = round(config.output_cycle_time * 1e9)
        rate = sum(1 / sensor.cycle_time for sensor in config.sensors.values())
        self._early_ns = min(round(0.5e9 / rate), self._cycle_ns // 2)
        self._state = OutputCycleState()

    @property
    def state(self) -> OutputCycleState:
        """What it remembers."""
        return self._state

    @state.setter
    def state(self, state: OutputCycleState) -> None:
        self._state = state

    def reported(self, obstacles: Obstacles, now_ns: int) -> Obstacles | None:
        """Return what goes out after a scan; None where nothing does.

        Args:
            obstacles: after the scan, with the detections that it used.
            now_ns: when it was closed.
        """
        if not self._cycle_ns:
            return obstacles
        state = self._state
        identity = obstacles.id[obstacles.used_row]
        is_early = self._early_ns < state.due_ns - now_ns <= self._early_ns + self._cycle_ns
        if is_early or len(state.identity):
            state.identity = np.concatenate([state.identity, identity])
            state.sensor = np.concatenate([state.sensor, obstacles.used_sensor])
            state.object_id = np.concatenate([state.object_id, obstacles.used_object])
        if is_early:
            return None
        state.due_ns += self._cycle_ns
        if not now_ns < state.due_ns <= now_ns + self._early_ns + self._cycle_ns:
            state.due_ns = now_ns + self._cycle_ns
        return self._gathered(obstacles)

    def _gathered(self, obstacles: Obstacles) -> Obstacles:
        """Return obstacles with all detections used since the latest output, and forget these."""
        state = self._state
        if not len(state.identity):
            return obstacles
        order = np.argsort(obstacles.id)
        place = np.searchsorted(obstacles.id, state.identity, sorter=order)
        row = order[np.minimum(place, len(order) - 1)] if len(order) else np.zeros(len(place), dtype=np.int64)
        lives = obstacles.id[row] == state.identity if len(order) else np.zeros(len(place), dtype=np.bool_)
        gathered = replace(
            obstacles, used_row=row[lives], used_sensor=state.sensor[lives], used_object=state.object_id[lives]
        )
        state.identity, state.sensor, state.object_id = _none(), _none(), _none()
        return gathered
