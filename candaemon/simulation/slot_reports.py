"""A sensor's report of one scan: the objects, the slots that hold them and their quantities.

Slots are assigned as real radars do: kept while an object is detected, reused without warning.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene, SceneState
from candaemon.simulation.sensor_model import FALSE, SensorModel, SimulatedDetections


@dataclass(frozen=True, slots=True)
class SlotReport:
    """The occupied slots of one scan, in the order of the slots.

    Attributes:
        slot: 0-based, shape (n,).
        new: whether the object was assigned its slot in this scan, shape (n,).
        quantities: names of the rows of `values`.
        values: shape (quantities, n), SI, sensor axes.
        owner: 0-based index of the actor, actors + index of the stationary object, or `FALSE`, shape (n,).

    """

    slot: Indices
    new: Booleans
    quantities: tuple[str, ...]
    values: Floats
    owner: Indices


class SlotReporter:
    """One sensor that observes a scene and reports its objects in slots, scan by scan.

    Args:
        scene: the truth.
        settings: the sensor's.
        scenario: gives the measurement effects.
        seed: of the simulation.
        source: the sensor's index.

    """

    def __init__(self, scene: Scene, settings: SensorSettings, scenario: Scenario, *, seed: int, source: int) -> None:
        measurement = scenario.measurement
        self._sensor = SensorModel(scene, settings, measurement, seed=seed, source=source)
        self.quantities = self._sensor.quantities
        slots = settings.objects.slots
        self._table = RadarSlots(
            slots, hold=measurement.hold, reuse=measurement.slot_reuse, random=stream(seed, source, "slots")
        )
        self._coasting = 1.0 if measurement.missing == "coast" else 0.0
        self._swaps, self._swap_distance = 0.0, 0.0
        tracks = settings.identified and len(settings.views) == 1  # else it has nothing to follow an object by
        if measurement.traffic is not None and tracks:
            if not {"vx", "range_rate"}.isdisjoint(self.quantities):  # by which it moves on what it misses
                self._coasting = max(self._coasting, measurement.traffic.coasting)
            self._swaps = measurement.traffic.swaps * settings.cycle_time
            self._swap_distance = measurement.traffic.swap_distance
        self._random = stream(seed, source, "swaps")
        self._cycle = settings.cycle_time
        self._values = np.zeros((len(self.quantities), slots))
        self._owner = np.full(slots, FALSE, dtype=np.int64)

    def report(self, instant: SceneState) -> SlotReport:
        """Return one scan's report; call it for each scan in order."""
        seen = self._sensor.observe(instant)
        self._swap_neighbours(seen)
        assigned = self._table.assign(seen.key.tolist(), seen.urgency.tolist(), seen.detectable)
        slot = np.array(assigned.slot, dtype=np.int64)
        placed = np.flatnonzero(slot >= 0)
        order = placed[np.argsort(slot[placed])]
        new = np.zeros(self._values.shape[1], dtype=bool)
        new[slot[order]] = np.array(assigned.new, dtype=bool)[order]
        self._values[:, slot[order]] = seen.values[:, order]
        self._owner[slot[order]] = seen.owner[order]
        reported = slot[order]
        if self._coasting > 0.0 and assigned.missed:
            missed = np.array(assigned.missed, dtype=np.int64)
            self._extrapolate(missed)
            coasted = missed[self._random.random(len(missed)) < self._coasting]
            reported = np.sort(np.concatenate([reported, coasted]))
        return SlotReport(reported, new[reported], self.quantities, self._values[:, reported], self._owner[reported])

    def _swap_neighbours(self, seen: SimulatedDetections) -> None:
        """Let neighbours exchange their slots now and then."""
        if self._swaps == 0.0:
            return
        held = np.array([self._table.holds(key) for key in seen.key.tolist()], dtype=bool)
        key, place = seen.key[held], seen.place[held]
        one, other = np.nonzero(np.triu(np.abs(place[:, None] - place) <= self._swap_distance, 1))
        for k in np.flatnonzero(self._random.random(len(one)) < self._swaps).tolist():
            slots = self._table.swap(int(key[one[k]]), int(key[other[k]]))
            self._values[:, slots] = self._values[:, slots[::-1]]
            self._owner[slots] = self._owner[slots[::-1]]

    def _extrapolate(self, slot: Indices) -> None:
        """Extrapolate objects that were missed by their last reported rates."""
        row = {name: k for k, name in enumerate(self.quantities)}
        if "range" in row:
            azimuth = self._values[row["azimuth"], slot] if "azimuth" in row else np.zeros(len(slot))
        else:
            azimuth = np.arctan2(self._values[row["y"], slot], self._values[row["x"], slot])

        def rate(name: str) -> Floats:
            found: Floats = self._values[row[name], slot] - self._sensor.own_part(name, azimuth)
            return found

        for position, name in (("x", "vx"), ("y", "vy"), ("range", "range_rate")):
            if position in row and name in row:
                self._values[row[position], slot] += self._cycle * rate(name)
        if "x" in row and "range_rate" in row:
            # the range rate acts along the line of sight, which follows from x and y
            along = self._values[row["x"], slot] + 1j * self._values[row["y"], slot]
            step = self._cycle * rate("range_rate") * along / np.maximum(np.abs(along), 1e-9)
            self._values[row["x"], slot] += step.real
            self._values[row["y"], slot] += step.imag


_MARGIN = 5.0
"""Difference in urgency (m) from which a new object displaces another from its slot."""


@dataclass(frozen=True, slots=True)
class RadarSlotAssignment:
    """Slots after one scan.

    Attributes:
        slot: of each detected object, in the order of the argument; −1 where none was free.
        new: whether the slot was assigned in this scan, in the same order.
        missed: slots held by objects that are visible but were not detected in this scan.

    """

    slot: list[int]
    new: list[bool]
    missed: list[int]


@dataclass(slots=True)
class _Holder:
    """An object that holds a slot."""

    slot: int
    urgency: float
    misses: int = 0


class RadarSlots:
    """The assignment of objects to slots.

    Args:
        capacity: number of slots.
        hold: scans for which a visible but undetected object keeps its slot.
        reuse: probability that a new object is assigned a slot freed in the same scan, if there is one;
            otherwise it is assigned the lowest slot that was free before.
        random: generator for that choice.

    """

    def __init__(self, capacity: int, *, hold: int, reuse: float, random: np.random.Generator) -> None:
        self._hold = hold
        self._reuse = reuse
        self._random = random
        self._free = list(range(capacity))
        self._holders: dict[int, _Holder] = {}

    def assign(self, keys: Sequence[int], urgency: Sequence[float], visible: Collection[int]) -> RadarSlotAssignment:
        """Assign slots for one scan.

        Args:
            keys: identity of each detected object.
            urgency: of each detected object, the lowest first (m; its distance, increased for less important objects).
            visible: identities of all objects that could be detected, detected or not; all others lose their slot.

        """
        seen = set(keys)
        freed, missed = self._release(seen, visible)
        for key, urgent in zip(keys, urgency, strict=True):
            holder = self._holders.get(key)
            if holder is not None:
                holder.urgency, holder.misses = urgent, 0
        fresh = [k for k in np.argsort(np.asarray(urgency), kind="stable").tolist() if keys[k] not in self._holders]
        admitted: set[int] = set()
        for k in fresh:
            if not self._admit(keys[k], urgency[k], freed):
                break  # all further objects are less urgent
            admitted.add(keys[k])
        self._free = sorted(self._free + freed)
        holders = [self._holders.get(key) for key in keys]
        held = {holder.slot for holder in holders if holder is not None}
        return RadarSlotAssignment(
            [-1 if holder is None else holder.slot for holder in holders],
            [key in admitted and holder is not None for key, holder in zip(keys, holders, strict=True)],
            [slot for slot in missed if slot not in held],
        )

    def holds(self, key: int) -> bool:
        """Return whether an object has a slot."""
        return key in self._holders

    def swap(self, one: int, other: int) -> list[int]:
        """Exchange the slots of two objects that have one, and return these."""
        first, second = self._holders[one], self._holders[other]
        first.slot, second.slot = second.slot, first.slot
        return [first.slot, second.slot]

    def _release(self, seen: set[int], visible: Collection[int]) -> tuple[list[int], list[int]]:
        """Free the slots of objects that left or were missed too long; return the freed and the missed slots."""
        freed: list[int] = []
        missed: list[int] = []
        for key in [key for key in self._holders if key not in seen]:
            holder = self._holders[key]
            holder.misses += 1
            if key in visible and holder.misses <= self._hold:
                missed.append(holder.slot)
            else:
                freed.append(holder.slot)
                del self._holders[key]
        return freed, missed

    def _admit(self, key: int, urgency: float, freed: list[int]) -> bool:
        """Assign a slot to a new object, if need be that of a less urgent one; return whether it got one."""
        if freed and (not self._free or self._random.random() < self._reuse):
            slot = freed.pop(0)
        elif self._free:
            slot = self._free.pop(0)
        else:
            last = max(self._holders, key=lambda held: self._holders[held].urgency)
            if self._holders[last].urgency <= urgency + _MARGIN:
                return False
            slot = self._holders.pop(last).slot
        self._holders[key] = _Holder(slot, urgency)
        return True
