"""What a filter is told: positions and speeds in the level frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Projection:
    """A measured component of the velocity over ground in a fixed direction, with one entry a detection.

    Attributes:
        direction: unit vectors (m, 2), level frame.
        value: m/s (m,); NaN where it was not measured.
        variance: (m/s)², (m,).
    """

    direction: Floats
    value: Floats
    variance: Floats


@dataclass(frozen=True, slots=True)
class Measurement:
    """m detections of one scan in the level frame.

    Attributes:
        position: (m, 2), m.
        noise: covariance of the position (m, 2, 2), m².
        origin: position of the sensor (2,), m.
        velocity: velocity of the sensor over ground (2,), m/s, the vehicle's turning included.
        range_rate: speed along the line of sight, positive away (m,), m/s; NaN where there is none; or None.
        range_rate_variance: (m,), (m/s)².
        projections: further velocity components.
    """

    position: Floats
    noise: Floats
    origin: Floats
    velocity: Floats
    range_rate: Floats | None = None
    range_rate_variance: Floats | None = None
    projections: tuple[Projection, ...] = ()

    def take(self, rows: NDArray[np.intp]) -> Measurement:
        """Return the detections of the given rows."""
        return Measurement(
            self.position[rows],
            self.noise[rows],
            self.origin,
            self.velocity,
            None if self.range_rate is None else self.range_rate[rows],
            None if self.range_rate_variance is None else self.range_rate_variance[rows],
            tuple(Projection(p.direction[rows], p.value[rows], p.variance[rows]) for p in self.projections),
        )
