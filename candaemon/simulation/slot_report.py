"""A sensor's report of one scan: which object in which slot, and what of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.radar_slots import RadarSlots
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene, SceneState
from candaemon.simulation.sensor_model import SensorModel
from candaemon.simulation.streams import stream

FALSE = -1
"""Owner of a false object in `Report.owner`."""


@dataclass(frozen=True, slots=True)
class Report:
    """The occupied slots of one scan, in the order of the slots.

    Attributes:
        slot: 0-based, shape (n,).
        new: whether the object took its slot in this scan, shape (n,).
        quantities: names of the rows of `values`.
        values: shape (quantities, n), SI, sensor axes.
        owner: 0-based index of the actor, actors + index of the stationary object, or `FALSE`, shape (n,).

    """

    slot: Indices
    new: Booleans
    quantities: tuple[str, ...]
    values: Floats
    owner: Indices


class Reporter:
    """One sensor that sees a scene and keeps its objects in slots, scan by scan.

    Args:
        scene: the truth.
        settings: the sensor's.
        scenario: how it measures.
        seed: of the simulation.
        source: the sensor's index.

    """

    def __init__(self, scene: Scene, settings: SensorSettings, scenario: Scenario, *, seed: int, source: int) -> None:
        measurement = scenario.measurement
        self._observer = SensorModel(scene, settings, measurement, seed=seed, source=source)
        self.quantities = self._observer.quantities
        slots = settings.objects.slots
        self._table = RadarSlots(
            slots, hold=measurement.hold, reuse=measurement.slot_reuse, random=stream(seed, source, "slots")
        )
        self._coast = measurement.missing == "coast"
        self._cycle = settings.cycle_time
        self._values = np.zeros((len(self.quantities), slots))
        self._owner = np.full(slots, FALSE, dtype=np.int64)

    def report(self, instant: SceneState) -> Report:
        """Return one scan's report; call it for each scan in order."""
        seen = self._observer.observe(instant)
        given = self._table.assign(seen.key.tolist(), seen.urgency.tolist(), seen.there)
        slot = np.array(given.slot, dtype=np.int64)
        placed = np.flatnonzero(slot >= 0)
        order = placed[np.argsort(slot[placed])]
        new = np.zeros(self._values.shape[1], dtype=bool)
        new[slot[order]] = np.array(given.new, dtype=bool)[order]
        self._values[:, slot[order]] = seen.values[:, order]
        self._owner[slot[order]] = self._observer.owner(seen.key[order])
        reported = slot[order]
        if self._coast and given.missed:
            missed = np.array(given.missed, dtype=np.int64)
            self._move_on(missed)
            reported = np.sort(np.concatenate([reported, missed]))
        return Report(reported, new[reported], self.quantities, self._values[:, reported], self._owner[reported])

    def _move_on(self, slot: Indices) -> None:
        """Move objects that were missed by their last reported rates."""
        row = {name: k for k, name in enumerate(self.quantities)}
        for position, rate in (("x", "vx"), ("y", "vy"), ("range", "range_rate")):
            if position in row and rate in row:
                self._values[row[position], slot] += self._cycle * self._values[row[rate], slot]
        if "x" in row and "range_rate" in row:
            # along the line of sight, which x and y give
            along = self._values[row["x"], slot] + 1j * self._values[row["y"], slot]
            step = self._cycle * self._values[row["range_rate"], slot] * along / np.maximum(np.abs(along), 1e-9)
            self._values[row["x"], slot] += step.real
            self._values[row["y"], slot] += step.imag
