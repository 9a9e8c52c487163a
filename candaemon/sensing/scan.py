"""A scan: what one sensor saw in one cycle, and the counts of the frames it was made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Scan:
    """The n valid objects of one cycle of one sensor.

    Attributes:
        time_ns: measurement time: the stamp of the scan's first or last frame, as configured, less the latency.
        sensor: index of the sensor.
        object_id: (n,) the sensor's own identity of each object; its slot where the format has no identity.
        slot: (n,) slot from 0; the id in the payload where all objects share their messages. Ascending.
        new: (n,) the sensor says that the slot holds another object than before.
        values: (quantities, n) in SI and sensor axes, rows as the sensor's `reader.quantities`; NaN where an optional
            message did not come.
        missing: frames that should have been in it and were not.

    """

    time_ns: int
    sensor: int
    object_id: NDArray[np.int64]
    slot: NDArray[np.int64]
    new: NDArray[np.bool_]
    values: NDArray[np.float64]
    missing: int = 0

    @property
    def complete(self) -> bool:
        """Whether no frame was missing."""
        return not self.missing


@dataclass(slots=True)
class ScanCounts:
    """What became of one sensor's frames since the start.

    Each frame is in exactly one of the first six once its scan is closed; the rest count other things.

    Attributes:
        used: frames in a scan, and the headers and triggers that opened or closed one.
        short: frames shorter than their message.
        checksum: frames with a wrong checksum.
        late: frames of a scan that was closed already.
        duplicate: second frames of the same message and object in one scan.
        surplus: frames of more objects than the format has slots, or of no object at all.
        missing: frames that should have come and did not.
        unpaired: valid objects left out because their messages are of different cycles.
        rejected: objects left out because a required message or the position did not come.
        scans: scans made.
        incomplete: scans with frames missing.
        skipped: scans that never came, by the header's measurement counter.

    """

    used: int = 0
    short: int = 0
    checksum: int = 0
    late: int = 0
    duplicate: int = 0
    surplus: int = 0
    missing: int = 0
    unpaired: int = 0
    rejected: int = 0
    scans: int = 0
    incomplete: int = 0
    skipped: int = 0

    @property
    def frames(self) -> int:
        """Frames taken in; those of a scan still open are not among them yet."""
        return self.used + self.dropped

    @property
    def dropped(self) -> int:
        """Frames taken in and not used."""
        return self.short + self.checksum + self.late + self.duplicate + self.surplus
