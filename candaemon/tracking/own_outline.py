"""Our own vehicle, as far as the places of its sensors tell: what lies on either side of it is two.

The configuration does not say how large our vehicle is. Its sensors sit on its outside, so the box around their mounts
is no larger than it is. Of one sensor that is a point, which hardly anything lies on either side of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from candaemon.arrays import Floats
from candaemon.radar.mounting import SensorView


@dataclass(frozen=True, slots=True)
class OwnOutline:
    """The box around the sensors of our vehicle.

    Attributes:
        low: its rear right corner in vehicle axes, m.
        high: its front left one.
    """

    low: tuple[float, float]
    high: tuple[float, float]

    @classmethod
    def around(cls, views: Sequence[SensorView]) -> Self | None:
        """Return the box around the mounts of sensors; None: there are none."""
        if not views:
            return None
        x, y = [view.mount.x for view in views], [view.mount.y for view in views]
        return cls((min(x), min(y)), (max(x), max(y)))

    def lies_between(self, one: Floats, other: Floats) -> bool:
        """Return whether the straight line from one place to another, in vehicle axes (2,), m, passes through the box.

        Of the line the part between two opposite sides of the box is kept, for each pair of sides in turn; it passes
        through where something is left.
        """
        begin, end = 0.0, 1.0
        for low, high, start, stop in zip(self.low, self.high, one.tolist(), other.tolist(), strict=True):
            way = stop - start
            if way == 0.0:
                if not low <= start <= high:
                    return False
                continue
            enters, leaves = sorted(((low - start) / way, (high - start) / way))
            begin, end = max(begin, enters), min(end, leaves)
        return begin <= end
