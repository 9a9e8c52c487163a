"""What a sensor read over a window, in its own axes: the scans of the window as columns of one batch."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, radians
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.radar.scan import Scan

MOST_OBJECTS: Final = 64
"""Objects of a scan from which is learnt; of more, the first."""
WANDERING: Final = 0.1
"""m, added to the noise of a position: reflections wander on what they are of."""

_UNKNOWN: Final = 1e6
"""m or m/s: stands for what is not known, for a saved state holds numbers only."""
_FARTHEST: Final = 1e5
"""m."""

_USED: Final = ("range", "azimuth", "x", "y", "range_rate", "vx", "vy")


@dataclass(slots=True)
class HeldScan:
    """A scan that waits for its window to be complete.

    Attributes:
        time_ns: its time as stamped, less the configured latency.
        scale: factor in the ego's speed then.
        bias: rad/s taken out of the ego's yaw rate then.
        object_id: (n,).
        new: (n,) the id names another object than before.
        values: (quantities, n) of positions and speeds in sensor axes; `_UNKNOWN` where one is not known.
    """

    time_ns: int
    scale: float
    bias: float
    object_id: Integers
    new: Booleans
    values: Floats

    def validate(self) -> None:
        """Refuse a scan whose parts do not fit.

        Raises:
            ValueError: they are of different lengths, or there are too many.
        """
        n = len(self.object_id)
        if self.object_id.ndim != 1 or self.new.shape != (n,) or self.values.ndim != 2 or n > MOST_OBJECTS:
            raise ValueError(f"a held scan of {n} objects, expected {MOST_OBJECTS} at most, with all their values")
        if self.values.shape[1] != n:
            raise ValueError("a held scan with values of another number of objects")


@dataclass(frozen=True, slots=True)
class Speeds:
    """One kind of speed of n objects.

    Attributes:
        name: `range_rate`, `vx` or `vy`.
        value: m/s (n,), NaN where it is not known.
        noise: one standard deviation, m/s (n,).
    """

    name: str
    value: Floats
    noise: Floats

    def take(self, rows: Indices | Booleans) -> Speeds:
        """Return those of some of the objects."""
        return Speeds(self.name, self.value[rows], self.noise[rows])


@dataclass(frozen=True, slots=True)
class Readings:
    """n objects of several scans.

    Attributes:
        scan: number of the scan of each (n,), ascending.
        object_id: (n,).
        new: (n,).
        place: in sensor axes, x + iy, m (n,).
        along, across: one standard deviation of the place along and across the line of sight, m (n,).
        speeds: what is known of their velocity, as measured.
    """

    scan: Indices
    object_id: Integers
    new: Booleans
    place: ComplexPlane
    along: Floats
    across: Floats
    speeds: tuple[Speeds, ...]

    def take(self, rows: Indices | Booleans) -> Readings:
        """Return some of them."""
        return Readings(
            self.scan[rows],
            self.object_id[rows],
            self.new[rows],
            self.place[rows],
            self.along[rows],
            self.across[rows],
            tuple(each.take(rows) for each in self.speeds),
        )

    @property
    def sight_speeds(self) -> tuple[Speeds, ...]:
        """The speeds from which is learnt: of a velocity its part along the line of sight.

        The part across is that of a filter, not of the Doppler effect; in turning axes most of it is distance times yaw
        rate, which at 100 m is metres a second wrong wherever the yaw rate changes faster than it is sampled.
        """
        named = {each.name: each for each in self.speeds}
        if "vx" not in named or "vy" not in named:
            return self.speeds
        vx, vy = named["vx"], named["vy"]
        unit = self.place / np.maximum(np.abs(self.place), 1e-9)
        along = Speeds(
            "range_rate",
            vx.value * unit.real + vy.value * unit.imag,
            np.hypot(vx.noise * unit.real, vy.noise * unit.imag),
        )
        return (along, *(each for each in self.speeds if each.name == "range_rate"))


@dataclass(frozen=True)
class SensorReader:
    """How a sensor's scans are read.

    Attributes:
        settings: of the sensor.
        quantities: rows of `Scan.values`.
        rows: of what is held of a scan.
        taken: rows of `Scan.values` that are held.
        locates: whether the sensor tells directions: without, nothing can be seen to stand.
    """

    settings: SensorSettings
    quantities: tuple[str, ...]
    rows: dict[str, int] = field(init=False)
    taken: Indices = field(init=False)
    locates: bool = field(init=False)

    def __post_init__(self) -> None:
        used = [name for name in _USED if name in self.quantities]
        object.__setattr__(self, "rows", {name: k for k, name in enumerate(used)})
        object.__setattr__(self, "taken", np.array([self.quantities.index(name) for name in used]))
        locates = {"range", "azimuth"} <= self.rows.keys() or {"x", "y"} <= self.rows.keys()
        object.__setattr__(self, "locates", locates)

    @property
    def relative(self) -> tuple[str, ...]:
        """Speeds that the sensor measures against itself; what it makes absolute says nothing of it."""
        settings = self.settings
        along = ("range_rate",) if settings.range_rates == "relative" else ()
        return (*along, *(("vx", "vy") if settings.rates != "absolute" else ()))

    def hold(self, scan: Scan, scale: float, bias: float) -> HeldScan:
        """Return what is needed of a scan."""
        values = scan.values.take(self.taken, axis=0)
        if not isfinite(np.vdot(values, values)):
            values = np.nan_to_num(values, copy=False, nan=_UNKNOWN)
        if len(scan.object_id) <= MOST_OBJECTS:
            return HeldScan(scan.time_ns, scale, bias, scan.object_id, scan.new, values)
        first = slice(MOST_OBJECTS)
        return HeldScan(scan.time_ns, scale, bias, scan.object_id[first], scan.new[first], values[:, first])

    def read(self, scans: list[HeldScan]) -> Readings:
        """Return the objects of scans together."""
        settings, rows = self.settings, self.rows
        values = np.concatenate([each.values for each in scans], axis=1)
        counts = [len(each.object_id) for each in scans]
        noise = settings.noise
        if settings.signals.polar:
            distance, angle = values[rows["range"]], values[rows["azimuth"]]
            place = np.empty(len(distance), np.complex128)
            place.real, place.imag = distance * np.cos(angle), distance * np.sin(angle)
            along = np.full(len(distance), np.hypot(noise.range or 0.0, WANDERING))
            across = distance * radians(noise.azimuth_deg or 0.0)
        else:
            place = values[rows["x"]] + 1j * values[rows["y"]]
            unit = place / np.maximum(np.abs(place), 1e-9)
            x, y = noise.x or 0.0, noise.y or 0.0
            along = np.hypot(np.hypot(x * unit.real, y * unit.imag), WANDERING)
            across = np.hypot(x * unit.imag, y * unit.real)
        speeds = tuple(
            Speeds(
                name,
                np.where(values[rows[name]] == _UNKNOWN, np.nan, values[rows[name]]),
                np.full(len(place), getattr(noise, name) or 1.0),
            )
            for name in self.relative
            if name in rows
        )
        readings = Readings(
            np.arange(len(scans)).repeat(counts),
            np.concatenate([each.object_id for each in scans]),
            np.concatenate([each.new for each in scans]),
            place,
            along,
            np.hypot(across, WANDERING),
            speeds,
        )
        if abs(np.vdot(place, place)) < _FARTHEST**2:  # then every one is near
            return readings
        return readings.take((np.abs(place.real) < _FARTHEST) & (np.abs(place.imag) < _FARTHEST))
