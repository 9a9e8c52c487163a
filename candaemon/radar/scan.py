"""A scan: what one sensor saw in one cycle, and the counts of the frames it was made from."""

from __future__ import annotations

from dataclasses import dataclass

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.protection.monitor import FrameFaults


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class Scan:
    """The n valid objects of one cycle of one sensor.

    Attributes:
        time_ns: measurement time: the stamp of the scan's first or last frame, as configured, less the latency.
        sensor: index of the sensor.
        object_id: (n,) the sensor's own identity of each object; its slot where the format has no identity signal.
        slot: (n,) slot from 0; the id in the payload where all objects share their messages. Ascending.
        new: (n,) the sensor says that the slot holds another object than before.
        values: (quantities, n) in SI and sensor axes, rows as the sensor's `reader.quantities`; NaN where an optional
            message did not come, or said that it is not known, and where a size cannot be.
        missing: frames that should have been in it and were not.
        look: which of the sensor's looks it is; −1 where it has none, or does not say.
        at_end: (n,) whether its place is at an end of its signal: it may lie anywhere beyond; None where none is.

    """

    time_ns: int
    sensor: int
    object_id: Integers
    slot: Integers
    new: Booleans
    values: Floats
    missing: int = 0
    look: int = -1
    at_end: Booleans | None = None

    def take(self, rows: Indices) -> Scan:
        """Return it with some of its objects."""
        return Scan(
            self.time_ns,
            self.sensor,
            self.object_id.take(rows),
            self.slot.take(rows),
            self.new.take(rows),
            self.values.take(rows, axis=1),
            self.missing,
            self.look,
            None if self.at_end is None else self.at_end.take(rows),
        )

    @property
    def complete(self) -> bool:
        """Whether no frame was missing."""
        return not self.missing


@dataclass(slots=True)
class ScanCounts(FrameFaults):
    """What became of one sensor's frames since the start.

    Each frame is once its scan is closed in exactly one of `used`, what is `failed`, `short`, `late`, `duplicate`,
    `surplus` and `discarded`; the rest count other things.

    Attributes:
        used: frames in a scan, and the headers and triggers that opened or closed one.
        short: frames shorter than their message.
        late: frames of a scan that was closed already.
        duplicate: second frames of the same message and object in one scan.
        surplus: frames of more objects than the format has slots, or of no object at all.
        discarded: frames of scans that were discarded whole.
        missing: frames that should have come and did not.
        unpaired: valid objects left out because their messages are of different cycles.
        rejected: objects left out because a required message or the position did not come.
        not_finite: valid objects left out because a value is no number.
        out_of_range: objects left out because a value is outside the DBC's range.
        impossible: objects left out because they moved as nothing can.
        at_end: objects left out because their place is at an end of its signal, where obstacles are vehicles.
        odd_sizes: lengths and widths not used because no body has them.
        scans: scans made.
        distrusted: scans discarded whole because too many of their frames failed.
        incomplete: scans with frames missing.
        skipped: scans that never came, by the header's measurement counter.
        unknown_look: scans that are none of the looks configured; nothing is expected in them.
        unstamped: scans without the sensor's time stamp, where it is configured; their arrival gives their time.
        odd_stamps: scans whose time stamp cannot be; likewise.
        unaligned: objects left out at the instant of another sensor's scan because they had not been seen twice yet.

    """

    used: int = 0
    short: int = 0
    late: int = 0
    duplicate: int = 0
    surplus: int = 0
    discarded: int = 0
    missing: int = 0
    unpaired: int = 0
    rejected: int = 0
    not_finite: int = 0
    out_of_range: int = 0
    impossible: int = 0
    at_end: int = 0
    odd_sizes: int = 0
    scans: int = 0
    distrusted: int = 0
    incomplete: int = 0
    skipped: int = 0
    unknown_look: int = 0
    unstamped: int = 0
    odd_stamps: int = 0
    unaligned: int = 0

    @property
    def frames(self) -> int:
        """Frames received; those of a scan still open are not among them yet."""
        return self.used + self.dropped

    @property
    def dropped(self) -> int:
        """Frames received and not used."""
        return self.failed + self.short + self.late + self.duplicate + self.surplus + self.discarded
