"""How noisy a sensor is: the white part of what it measures, from third differences of objects in successive scans.

What moves smoothly has small third differences; white noise of variance σ² has some of variance 20 σ². The median makes
it robust against jumps. Slow errors (a filter inside of the sensor, a reflection that wanders) are no part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.sensors import SensorSettings

_GAIN: Final = 20.0
"""Variance of third differences of white noise: 1 + 9 + 9 + 1."""
_NORMAL: Final = 0.6745
"""Median of the absolute value of a normal variate, in standard deviations."""
_LEAST: Final = 30
"""Fewer third differences say nothing."""


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """The noise of one quantity of a sensor.

    Attributes:
        sensor, quantity, unit: which.
        configured: one standard deviation; NaN where there is none.
        found: the white part; NaN where too little was seen.
        samples: third differences.
    """

    sensor: str
    quantity: str
    unit: str
    configured: float
    found: float
    samples: int


def noise_found(raw: Mapping[str, Floats], sensor: int, name: str, settings: SensorSettings) -> list[NoiseFound]:
    """Return the noise of each quantity that a sensor measures.

    Args:
        raw: columns of `DriveRecord.raw`.
        sensor: index.
        name: of the sensor.
        settings: of the sensor.
    """
    rows = np.flatnonzero(raw["sensor"] == sensor)
    order = rows[np.lexsort((raw["time"][rows], raw["object"][rows]))]
    time, key, new = raw["time"][order], raw["object"][order], raw["new"][order] > 0
    gap = np.diff(time)
    # a run goes on where the same object comes in the next scan and is not another one
    follows = (np.diff(key) == 0) & ~new[1:] & (gap > 0) & (gap < 1.5 * settings.cycle_time)
    whole = follows[2:] & follows[1:-1] & follows[:-2] if len(follows) > 2 else np.zeros(0, np.bool_)
    noise, polar = settings.noise, settings.signals.polar
    azimuth = None if noise.azimuth_deg is None else noise.azimuth_deg
    quantities = (
        (("range", "m", "first", noise.range, 1.0), ("azimuth", "deg", "second", azimuth, np.degrees(1.0)))
        if polar
        else (("x", "m", "first", noise.x, 1.0), ("y", "m", "second", noise.y, 1.0))
    )
    found = []
    for quantity, unit, column, configured, scale in (
        *quantities,
        ("range rate", "m/s", "rate", noise.range_rate, 1.0),
    ):
        if quantity == "azimuth" and not settings.signals.directed:
            continue
        third = np.diff(raw[column][order], 3)[whole] if len(order) > 3 else np.empty(0)
        third = np.abs(third[np.isfinite(third)])
        if not len(third):
            continue
        spread = float(np.median(third)) * scale / (_NORMAL * _GAIN**0.5) if len(third) >= _LEAST else nan
        found.append(NoiseFound(name, quantity, unit, nan if configured is None else configured, spread, len(third)))
    return found
