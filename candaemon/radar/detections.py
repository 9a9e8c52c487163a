"""Detections: the valid objects of one scan, seen from the ground."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.estimation.measurement import Measurement


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class Detections:
    """n detections of one sensor at one instant.

    Attributes:
        time_ns: measurement time.
        sensor: index of the sensor.
        object_id: the sensor's own id of each object (n,): evidence, not identity; its slot where there is none.
        new: the sensor says that the id names another object than before (n,).
        measurement: positions and speeds in the local frame.
        x, y: positions in vehicle axes (n,), m.
        length, width: as the sensor says (n,), m; NaN where it does not, None where it never does.
        heading: likewise, of the front in the local frame, positive to the left from east, −π to π rad.
        identified: whether an object id says anything of another scan.
        look: which of the sensor's looks the scan is; −1 where it has none, or does not say.
        longest: the greatest length that the sensor can tell, m: what is longer is told as that.
    """

    time_ns: int
    sensor: int
    object_id: Integers
    new: Booleans
    measurement: Measurement
    x: Floats
    y: Floats
    length: Floats | None = None
    width: Floats | None = None
    heading: Floats | None = None
    identified: bool = True
    look: int = -1
    longest: float = inf

    def __len__(self) -> int:
        return len(self.object_id)
