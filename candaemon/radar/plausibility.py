"""Objects that cannot be true: outside the DBC's ranges, or farther from where they were than anything moves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices, Integers
from candaemon.binding.bound import BoundSensor
from candaemon.dbc.bits import value_count
from candaemon.frames.times import LONG_AGO_NS
from candaemon.objects.signals import dbc_range
from candaemon.radar.scan import ScanCounts

MOST_SLOTS: Final = 1 << 16
"""Objects with longer ids in the payload are not watched for jumps."""
FARTHEST: Final = 1e9
"""m, from where nothing was reported before."""


@dataclass(slots=True)
class ObjectPlausibilityState:
    """Where the objects of a sensor were last; k slots or ids, none where jumps are not watched.

    Attributes:
        place: positions in sensor axes, x + iy (k,), m.
        object_id: the sensor's identities (k,).
        time_ns: times of the positions (k,).
        suspects: by slot, position and time of an object that was too far off in the scan before.
    """

    place: ComplexPlane
    object_id: Integers
    time_ns: Integers
    suspects: dict[int, tuple[complex, int]] = field(default_factory=dict)


class ObjectPlausibility:
    """Judges the objects of each scan of a sensor.

    An object that claims to be the one before (same slot and identity, not new) may not have moved faster than the
    limit. Slots and identities are reused without a cycle between: formats that do not say of every object whether it
    is new are not watched, nor those without identities. An object that is refused and reported again near there is
    accepted: the first place was wrong.

    Args:
        sensor: the bound sensor.
        counts: where objects that are refused are counted; the owner's.

    Attributes:
        counts: as given.
        state: what it remembers.
        watches: whether there is anything to judge by.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts) -> None:
        settings, form, reader = sensor.settings.plausibility, sensor.settings.objects, sensor.reader
        self.counts = counts
        ranges = [dbc_range(binding) if settings.ranges else None for binding in reader.bindings]
        self._ranged = np.array([row for row, limits in enumerate(ranges) if limits is not None], np.intp)
        found = np.array([limits for limits in ranges if limits is not None]).reshape(-1, 2)
        self._low, self._high = found[:, :1], found[:, 1:]
        slots = count_keys(sensor) * sensor.reader.points
        self._speed = settings.max_speed if reader.reports_new and slots <= MOST_SLOTS else None
        self._polar = "range" in reader.quantities
        first, second = ("range", "azimuth") if self._polar else ("x", "y")
        self._first = reader.quantities.index(first)
        self._second = reader.quantities.index(second) if second in reader.quantities else None
        self._identified = bool(form.identity)
        self._least_ns = round(sensor.settings.cycle_time * 5e8)
        self.watches: Final = len(self._ranged) > 0 or self._speed is not None
        known = slots if self._speed is not None else 0
        self.state = ObjectPlausibilityState(
            np.zeros(known, np.complex128), np.zeros(known, np.int64), np.full(known, LONG_AGO_NS)
        )

    def keep(self, time_ns: int, slot: Integers, object_id: Integers, new: Booleans, values: Floats) -> Indices | None:
        """Choose the objects that can be true.

        Args:
            time_ns: of the scan.
            slot: (n,) each once.
            object_id: (n,) the sensor's identities.
            new: (n,) whether the slot holds another object than before.
            values: (quantities, n), SI.

        Returns:
            Their rows; None where all can.
        """
        wrong: Booleans | None = None
        if len(self._ranged):
            ranged = values.take(self._ranged, axis=0)
            outside = (ranged < self._low) | (ranged > self._high)  # NaN is not: an optional message did not come
            if np.count_nonzero(outside):
                wrong = np.logical_or.reduce(outside)
                self.counts.out_of_range += int(np.count_nonzero(wrong))
        if self._speed is not None:
            jumped = self._jumped(self._speed, time_ns, slot, object_id, new, values)
            if jumped is not None:
                self.counts.impossible += int(np.count_nonzero(jumped if wrong is None else jumped & ~wrong))
                wrong = jumped if wrong is None else wrong | jumped
        return None if wrong is None else np.flatnonzero(~wrong)

    def _jumped(
        self, speed: float, time_ns: int, slot: Integers, object_id: Integers, new: Booleans, values: Floats
    ) -> Booleans | None:
        """Return which objects are too far from where they were last accepted, None where none is."""
        state = self.state
        first = values[self._first]
        second = np.zeros(len(first)) if self._second is None else values[self._second]
        place: ComplexPlane = first * np.exp(1j * second) if self._polar else first + 1j * second
        reach = np.maximum(time_ns - state.time_ns.take(slot), self._least_ns) * (speed * 1e-9)
        far = (np.abs(place - state.place.take(slot)) > reach) & ~new
        if self._identified:
            far &= state.object_id.take(slot) == object_id
            state.object_id[slot] = object_id
        jumped = None
        if np.count_nonzero(far):
            refused = self._refused(speed, time_ns, slot, place, far)
            if np.count_nonzero(refused):
                jumped = refused
                slot, place = slot[~refused], place[~refused]
        state.place[slot] = place
        state.time_ns[slot] = time_ns
        return jumped

    def _refused(self, speed: float, time_ns: int, slot: Integers, place: ComplexPlane, far: Booleans) -> Booleans:
        """Return which of the objects too far off were not reported near there before; remember where they were."""
        suspects, self.state.suspects = self.state.suspects, {}
        refused = np.zeros(len(slot), np.bool_)
        for row in far.nonzero()[0].tolist():
            found = complex(place[row])
            before, before_ns = suspects.get(int(slot[row]), (found + FARTHEST, time_ns))
            reach = max(time_ns - before_ns, self._least_ns) * speed * 1e-9
            if abs(found - before) > reach:
                self.state.suspects[int(slot[row])] = found, time_ns
                refused[row] = True
        return refused


def count_keys(sensor: BoundSensor) -> int:
    """Count the places, or the ids in the payload, that distinguish the frames of a message."""
    identifying = [part.id_signal for part in sensor.reader.layouts if part.id_signal is not None]
    return max([sensor.reader.places, *(value_count(signal) for signal in identifying)])
