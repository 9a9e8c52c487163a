"""Which objects of a scan are used."""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Integers
from candaemon.binding.bound import BoundSensor
from candaemon.objects.object_batch import ObjectBatch
from candaemon.radar.plausibility import ObjectPlausibility
from candaemon.radar.scan import Scan, ScanCounts

POSITION = ("x", "y", "range", "azimuth")
LONGEST_BODY: Final = 40.0
"""m; a greater length is none."""
WIDEST_BODY: Final = 6.0
"""m; a greater width is none."""


class Selection:
    """Makes scans of the objects that were read: of those that are valid, whole, placed, and can be true.

    Args:
        sensor: the bound sensor.
        counts: where objects left out are counted; the owner's.

    Attributes:
        counts: as given.
        plausibility: what judges whether an object can be true; it may remember nothing.
    """

    def __init__(self, sensor: BoundSensor, counts: ScanCounts) -> None:
        form, reader = sensor.settings.objects, sensor.reader
        self.counts, self._sensor = counts, sensor.index
        self._has_identity = bool(form.identity)
        self._has_pairs = len(form.pair) > 1
        self._may_lack = any(part.optional for part in reader.layouts) or any(
            bool(binding.unknown) for binding in reader.bindings
        )
        largest = {"length": LONGEST_BODY, "width": WIDEST_BODY}
        self._sizes = [(row, largest[name]) for row, name in enumerate(reader.quantities) if name in largest]
        self._position = [row for row, name in enumerate(reader.quantities) if name in POSITION]
        self.plausibility = ObjectPlausibility(sensor, counts)

    def scan(self, time_ns: int, batch: ObjectBatch, slot: Integers, missing: int) -> Scan:
        """Return the scan of the objects read.

        Args:
            time_ns: measurement time.
            batch: the objects.
            slot: of each (n,), ascending.
            missing: frames that should have been in it and were not.
        """
        counts, use = self.counts, batch.valid
        if batch.not_finite is not None:
            counts.not_finite += int(np.count_nonzero(batch.not_finite))
        if self._has_pairs:
            use = batch.valid & batch.paired
            counts.unpaired += int(np.count_nonzero(batch.valid)) - int(np.count_nonzero(use))
        if self._may_lack:
            placed = np.isfinite(batch.values[self._position]).all(axis=0)
            counts.rejected += int(np.count_nonzero(use & ~placed))
            use = use & placed
        object_id = batch.identity if self._has_identity else slot
        new, values, at_end = batch.new, batch.values, batch.at_end
        if np.count_nonzero(use) < len(use):
            rows = use.nonzero()[0]
            slot, object_id, new = slot.take(rows), object_id.take(rows), new.take(rows)
            values = values.take(rows, axis=1)
            at_end = None if at_end is None else at_end.take(rows)
        if self.plausibility.watches:
            kept = self.plausibility.keep(time_ns, slot, object_id, new, values)
            if kept is not None:
                slot, object_id, new = slot.take(kept), object_id.take(kept), new.take(kept)
                values = values.take(kept, axis=1)
                at_end = None if at_end is None else at_end.take(kept)
        for row, most in self._sizes:
            values = self._with_sizes(values, row, most)
        return Scan(time_ns, self._sensor, object_id, slot, new, values, missing, at_end=at_end)

    def _with_sizes(self, values: Floats, row: int, most: float) -> Floats:
        """Return the quantities with NaN for what is no size; count it unless nothing was said."""
        if compiled.in_use:
            possible, odd = compiled.kernels.possible_sizes(values, row, most)
            self.counts.odd_sizes += odd
            return values if possible is None else possible
        sizes = values[row]
        possible = (sizes > 0.0) & (sizes <= most)
        if np.count_nonzero(possible) == len(sizes):
            return values
        self.counts.odd_sizes += int(np.count_nonzero(~possible & ~np.isnan(sizes)))
        values = values.copy()
        values[row, ~possible] = np.nan
        return values
