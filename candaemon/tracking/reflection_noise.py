"""How the reflections that a sensor reports wander: the white part of their noise, and their walk, learnt on line.

A radar that reports what it measures has white noise: a standing return's displacement over ground spreads as much over
a second as from one scan to the next. An object radar that filters by itself reports places that are nearly a random
walk: over a second they spread several times as much. So two spreads of the same returns tell which kind it is and how
large both parts are. With σ² the variance of the white part and q the walk, the displacement over a time τ has the
variance 2 σ² + q τ.

A radar that filters angles wanders across by so many degrees, one that filters places by so many metres. Which of both
it is shows where the same walk is compared near and far: how it grows with the range is learnt too.

Now and then a reflection slides metres over what it is a reflection of. The spreads are trimmed: the largest fifth of
the displacements counts for nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan, pi, radians
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.arrays.rows import distinct
from candaemon.config.sensors import ObjectNoise, SensorSettings
from candaemon.config.settings import MOST_SENSORS

MOST_FOLLOWED: Final = 512
"""Reflections of a scan that are followed."""
MOST_DISPLACEMENTS: Final = 1024
"""Displacements of a sensor's reflections that are remembered."""
FEWEST_DISPLACEMENTS: Final = 24
"""Displacements over a second after which a sensor's noise is known, if they are of enough reflections."""
FEWEST_REFLECTIONS: Final = 5
"""Reflections that they must be of: one alone may be the corner of something that it wanders over."""
LEAST_OWN_SPEED: Final = 2.0
"""m/s of our own, below which nothing is learnt: to a standing vehicle a radar repeats what stands, without noise."""
_SPACING_NS = 220_000_000  # between two scans that displacements are taken from
_SET_BACK_NS = 2_000_000_000  # by which a scan is earlier than no late one is: the clock was set back
_SECOND_NS = 900_000_000  # from when on a displacement is one over a second
_LONGEST_NS = 2_000_000_000  # that a scan is kept
_MOST_KEPT = 10  # scans, more than come within that time
_LEAST_RATIO = 3  # of the two times, so that their displacements tell the parts apart
_FARTHEST = 3.0  # m from one scan to the next: it is another reflection
_TRIMMED = 0.8  # share of the displacements that count
_TRIMMED_VARIANCE = 0.43769  # variance of a standard normal variable whose largest fifth, by magnitude, is left out
_LEAST_WHITE = 0.03  # m; below it quantisation counts
_WALK = (0.03, 0.1)  # m²/s along and across, of a sensor that filters, as long as nothing is known
_NO_WALK = (0.0, 0.0)  # likewise, of one that tells what it measures
_RATIO_WHITE, _RATIO_WALK = 3.0, 6.0  # ratio of the variances up to which all is white, and from which it is a walk
_RATIO_WALKS = (2.5, 5.0)  # of the same: from which on settling begins, and from which it is whole
_UNKNOWN = 0.5  # how surely the reflections of a sensor that filters walk, as long as nothing is known
_TYPICAL_RANGE = 40.0  # m, at which an angle's noise counts
_USUAL_RANGE = 60.0  # m, at which the walk across is what is usual
_GROWTHS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # shares of a walk that grow with the square of the range
_NO_GROWTH, _UNKNOWN_GROWTH = (0.0, _USUAL_RANGE), (0.5, _USUAL_RANGE)
_LOG_VARIANCE = 0.5 * pi * pi  # of the logarithm of the square of what is normal
_LEAST_RANGE, _LEAST_SCALE = 1.0, 0.01  # m; of a walk close by
_TELLING = 0.25  # share of the displacements over a second that are independent: they overlap
_REFRESH = 16  # displacements until an estimate is made again
_NUMBERS = MOST_SENSORS + 1  # and one of no sensor


@dataclass(slots=True)
class StandingScan:
    """The standing returns of a scan.

    Attributes:
        time_ns: measurement time.
        key: of each (n,), ascending.
        place: local frame (n, 2), m.
    """

    time_ns: int
    key: Integers
    place: Floats

    def validate(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            ValueError: there are too many, or not a place of each, or their keys are not in order.
        """
        if len(self.key) > MOST_FOLLOWED or self.key.ndim != 1 or self.place.shape != (len(self.key), 2):
            raise ValueError(f"standing returns of the shape {self.place.shape}, expected {MOST_FOLLOWED} at most")
        if (np.diff(self.key) <= 0).any():
            raise ValueError("the keys of standing returns are not in order")


def _no_places(*shape: int) -> Floats:
    return np.zeros((MOST_DISPLACEMENTS, *shape))


@dataclass(frozen=True, slots=True)
class LearntNoise:
    """What was learnt of a sensor's reflections, each along and across.

    Attributes:
        white: standard deviation of the white part, m.
        walk: m²/s; across, at the range that `growth` tells.
        growth: which share of that grows with the square of the range; and that range, m.
        ratio: of the variance of a displacement over a second to that over a scan.
    """

    white: tuple[float, float]
    walk: tuple[float, float]
    growth: tuple[float, float]
    ratio: tuple[float, float]

    def validate(self) -> None:
        """Refuse what cannot have been learnt.

        Raises:
            ValueError: a part is negative, there is no white part, or the growth is no share, or of no range.
        """
        is_negative = min(*self.walk, *self.ratio, self.growth[0]) < 0.0
        if is_negative or min(self.white) <= 0.0 or self.growth[0] > 1.0 or self.growth[1] < _LEAST_RANGE:
            raise ValueError(f"learnt noise {self}, of which a part is out of range")


@dataclass(slots=True)
class StandingDisplacements:
    """What is remembered of one sensor's standing returns.

    Attributes:
        scans: some of the last second or two, in order of time.
        is_due: whether displacements are to be taken from the latest of them to the scan that comes next.
        displacements: over one scan and over about a second, along and across; a ring (m, 2, 2), m.
        spans: the times of both (m, 2), s.
        of: key of the reflection that each displacement is of (m,).
        distance: of that from the sensor (m,), m.
        taken: displacements taken so far.
        learnt: what they showed when looked at last; None while they are too few, or of too few reflections.
    """

    scans: list[StandingScan] = field(default_factory=list)
    is_due: bool = False
    displacements: Floats = field(default_factory=lambda: _no_places(2, 2))
    spans: Floats = field(default_factory=lambda: _no_places(2))
    of: Integers = field(default_factory=lambda: np.zeros(MOST_DISPLACEMENTS, dtype=np.int64))
    distance: Floats = field(default_factory=_no_places)
    taken: int = 0
    learnt: LearntNoise | None = None

    def validate(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            ValueError: an array has another shape, a count is negative, or the scans are too many or out of order.
        """
        shapes = (self.displacements.shape, self.spans.shape, self.of.shape, self.distance.shape)
        if shapes != tuple((MOST_DISPLACEMENTS, *each) for each in ((2, 2), (2,), (), ())):
            raise ValueError(f"displacements of the shapes {shapes}, expected {MOST_DISPLACEMENTS} of each")
        times = [scan.time_ns for scan in self.scans]
        if self.taken < 0 or len(times) > _MOST_KEPT or times != sorted(set(times)) or (self.is_due and not times):
            raise ValueError("the scans that displacements are taken from are too many, or out of order")
        for scan in self.scans:
            scan.validate()


@dataclass(slots=True)
class ReflectionNoiseState:
    """What is remembered of each sensor, by its number."""

    sensors: dict[int, StandingDisplacements] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SensorWalks:
    """How the reflections of sensors walk: a row each by its number, and a last one of no sensor, −1.

    Attributes:
        walk: along and across, m²/s (S, 2).
        growth: which share of that across grows with the square of the range; and the range it is told for, m (S, 2).
        surely: how surely they walk across, 0 to 1 (S,).
        some: whether any walk is not 0.
        surely_some: whether any of `surely` is above 0.
    """

    walk: Floats
    growth: Floats
    surely: Floats
    some: bool
    surely_some: bool


class ReflectionNoise:
    """Learns the noise of each sensor's reflections from standing returns.

    Args:
        sensors: settings of each sensor by its number. A walk that they give stands, whatever is learnt.
    """

    def __init__(self, sensors: Mapping[int, SensorSettings]) -> None:
        self._stated = {number: stated_white(settings.noise) for number, settings in sensors.items()}
        self._given = {
            number: None if settings.noise.walk is None else (settings.noise.walk.along, settings.noise.walk.across)
            for number, settings in sensors.items()
        }
        self._filters = {number: settings.noise.azimuth_deg is None for number, settings in sensors.items()}
        self._state = ReflectionNoiseState({number: StandingDisplacements() for number in sensors})
        self._walks: SensorWalks | None = None  # follows from the state

    @property
    def state(self) -> ReflectionNoiseState:
        """All that it remembers. Of a sensor that a state does not have, nothing is known yet.

        Raises:
            ValueError: a state that is set is of other sensors, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: ReflectionNoiseState) -> None:
        if not state.sensors.keys() <= self._stated.keys():
            raise ValueError("standing returns of other sensors than the configuration's")
        for each in state.sensors.values():
            each.validate()
        begun = {number: StandingDisplacements() for number in self._stated}
        self._state = ReflectionNoiseState(begun | state.sensors)
        self._walks = None

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give what is known to the sensors' other numbers, and forget those left out.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        self._stated = {sensors[old]: each for old, each in self._stated.items() if old in sensors}
        self._given = {sensors[old]: each for old, each in self._given.items() if old in sensors}
        self._filters = {sensors[old]: each for old, each in self._filters.items() if old in sensors}
        remembered = self._state.sensors
        self._state.sensors = {sensors[old]: each for old, each in remembered.items() if old in sensors}
        self._walks = None

    def expects(self, sensor: int, time_ns: int, own_speed: float) -> bool:
        """Return whether a scan teaches anything; forget the scans before it where the vehicle is too slow.

        Args:
            sensor: its number.
            time_ns: measurement time; a scan older than the latest teaches nothing.
            own_speed: of the vehicle, m/s.
        """
        returns = self._state.sensors[sensor]
        if own_speed < LEAST_OWN_SPEED:
            returns.scans, returns.is_due = [], False
            return False
        if not returns.scans:
            return True
        passed_ns = time_ns - returns.scans[-1].time_ns
        if passed_ns < -_SET_BACK_NS:
            returns.scans, returns.is_due = [], False
            return True
        return passed_ns > 0 and (returns.is_due or passed_ns >= _SPACING_NS)

    def observe(
        self,
        sensor: int,
        time_ns: int,
        keys: Integers,
        position: Floats,
        direction: Floats,
        standing: Booleans,
        own_speed: float,
        distance: Floats,
    ) -> None:
        """Take the reflections of a scan.

        Args:
            sensor: its number.
            time_ns: measurement time.
            keys: of m reflections, the same as long as it is the same reflection, never of another one (m,); of two
                with one key the first counts.
            position: as measured, local frame (m, 2), m.
            direction: unit vectors that along and across refer to, local frame (m, 2).
            standing: which of them stand (m,).
            own_speed: of the vehicle, m/s.
            distance: of the reflections from the sensor (m,), m.
        """
        if not self.expects(sensor, time_ns, own_speed):
            return
        returns = self._state.sensors[sensor]
        is_spaced = not returns.scans or time_ns - returns.scans[-1].time_ns >= _SPACING_NS
        rows = np.flatnonzero(standing & np.isfinite(position[:, 0]) & np.isfinite(position[:, 1]))
        rows = rows[keys[rows].argsort(kind="stable")]
        key = keys[rows]
        if (key[1:] == key[:-1]).any():
            key, first = np.unique(key, return_index=True)
            rows = rows[first]
        rows, key = rows[:MOST_FOLLOWED], key[:MOST_FOLLOWED]
        scan = StandingScan(time_ns, key, position[rows])
        if returns.is_due:
            looked_at = returns.taken // _REFRESH
            _take(returns, scan, direction[rows], distance[rows])
            if returns.learnt is None or returns.taken // _REFRESH != looked_at:
                returns.learnt, self._walks = _learnt_noise(returns), None
        if is_spaced:
            kept = [each for each in returns.scans[1 - _MOST_KEPT :] if time_ns - each.time_ns <= _LONGEST_NS]
            returns.scans, returns.is_due = [*kept, scan], True

    def filters(self, sensor: int) -> bool:
        """Return whether a sensor filters by itself, as far as its settings tell.

        Who tells Cartesian places, whose noise does not grow with the range, tells what a filter of its own says; range
        and angle are what a radar measures.
        """
        return self._filters[sensor]

    def known(self, sensor: int) -> bool:
        """Return whether enough was observed of a sensor's reflections to tell their noise."""
        return self._state.sensors[sensor].learnt is not None

    def walk_is_known(self, sensor: int) -> bool:
        """Return whether a sensor's walk, be it none, is given or was learnt."""
        return self._given[sensor] is not None or self.known(sensor)

    def white(self, sensor: int) -> tuple[float, float]:
        """Return the standard deviation of the white part along and across, m; the stated noise until it is known."""
        learnt = self._state.sensors[sensor].learnt
        return self._stated[sensor] if learnt is None else learnt.white

    def walk(self, sensor: int) -> tuple[float, float]:
        """Return the walk along and across, m²/s: that of the settings, else the learnt one, else what is usual.

        Across it is that at the range which `growth` tells.
        """
        given, learnt = self._given[sensor], self._state.sensors[sensor].learnt
        usual = _WALK if self._filters[sensor] else _NO_WALK
        return given or (usual if learnt is None else learnt.walk)

    def growth(self, sensor: int) -> tuple[float, float]:
        """Return which share of the walk across grows with the square of the range, and the range it is told for, m."""
        learnt = self._state.sensors[sensor].learnt
        if self._given[sensor] is not None:
            return _NO_GROWTH
        return _UNKNOWN_GROWTH if learnt is None else learnt.growth

    def ratio(self, sensor: int) -> tuple[float, float]:
        """Return the variance over a second by that over a scan, along and across: 1 of white noise; NaN if unknown."""
        learnt = self._state.sensors[sensor].learnt
        return (nan, nan) if learnt is None else learnt.ratio

    def walking(self, sensor: int) -> float:
        """Return how surely a sensor's reflections walk across, 0 to 1."""
        given, learnt = self._given[sensor], self._state.sensors[sensor].learnt
        if given is not None:
            return float(given[1] > 0.0)
        if learnt is None:
            return _UNKNOWN if self._filters[sensor] else 0.0
        return min(max((learnt.ratio[1] - _RATIO_WALKS[0]) / (_RATIO_WALKS[1] - _RATIO_WALKS[0]), 0.0), 1.0)

    def walks(self) -> SensorWalks:
        """Return how the reflections of all sensors walk; those of a sensor without settings do not."""
        if self._walks is None:
            walk, growth, surely = np.zeros((_NUMBERS, 2)), np.tile(_NO_GROWTH, (_NUMBERS, 1)), np.zeros(_NUMBERS)
            for number in self._stated:
                walk[number], growth[number] = self.walk(number), self.growth(number)
                surely[number] = self.walking(number)
            self._walks = SensorWalks(walk, growth, surely, bool(walk.any()), bool(surely.any()))
        return self._walks


def stated_white(noise: ObjectNoise) -> tuple[float, float]:
    """Return the noise that a sensor's settings state, ahead and across, m; an angle's at a usual range."""
    across = noise.y if noise.azimuth_deg is None else radians(noise.azimuth_deg) * _TYPICAL_RANGE
    return noise.range or noise.x or _LEAST_WHITE, across or _LEAST_WHITE


def growing(share: Floats | float, told: Floats | float, distance: Floats) -> Floats:
    """Return what a walk across is at distances (n,), m, by what it is at others.

    Args:
        share: of it that grows with the square of the distance (n,).
        told: those others (n,), m.
        distance: m.
    """
    farther = distance / told
    return np.asarray((1.0 - share) + share * (farther * farther))


def _take(returns: StandingDisplacements, scan: StandingScan, direction: Floats, distance: Floats) -> None:
    """Take displacements to a scan: from the latest scan kept, and of the same reflections over about a second."""
    returns.is_due = False
    latest = returns.scans[-1]
    earlier = next((each for each in reversed(returns.scans) if scan.time_ns - each.time_ns >= _SECOND_NS), None)
    if earlier is None or scan.time_ns - earlier.time_ns < _LEAST_RATIO * (scan.time_ns - latest.time_ns):
        return
    at, before = _rows_of(scan.key, latest), _rows_of(scan.key, earlier)
    rows = np.flatnonzero((at >= 0) & (before >= 0))
    moved = scan.place[rows] - latest.place[at[rows]]
    near = np.square(moved).sum(axis=1) < _FARTHEST**2
    rows, moved = rows[near], moved[near]
    if not len(rows):
        return
    both = np.stack([moved, scan.place[rows] - earlier.place[before[rows]]], axis=1)
    unit = direction[rows, None]
    into = (returns.taken + np.arange(len(rows))) % MOST_DISPLACEMENTS
    returns.displacements[into, :, 0] = (both * unit).sum(axis=2)
    returns.displacements[into, :, 1] = both[..., 1] * unit[..., 0] - both[..., 0] * unit[..., 1]
    returns.spans[into] = np.array([scan.time_ns - latest.time_ns, scan.time_ns - earlier.time_ns]) * 1e-9
    returns.of[into] = scan.key[rows]
    returns.distance[into] = distance[rows]
    returns.taken += len(rows)


def _rows_of(keys: Integers, scan: StandingScan) -> Indices:
    """Return the row of each key in a scan, −1 where it has none."""
    if not len(scan.key):
        return np.full(len(keys), -1, dtype=np.intp)
    at = np.minimum(np.searchsorted(scan.key, keys), len(scan.key) - 1)
    return np.where(scan.key[at] == keys, at, -1)


def _learnt_noise(returns: StandingDisplacements) -> LearntNoise | None:
    """Return what displacements show of the noise; None where they are too few, or of too few reflections."""
    taken = min(returns.taken, MOST_DISPLACEMENTS)
    if taken < FEWEST_DISPLACEMENTS or len(distinct(returns.of[:taken])) < FEWEST_REFLECTIONS:
        return None
    squares = np.square(returns.displacements[:taken])
    short, long = _variances(squares)
    scan, second = np.median(returns.spans[:taken], axis=0)
    ratio = long / np.maximum(short, 1e-6)
    # Chance alone lets the ratio of white noise differ from 1: a small excess is no walk.
    share = np.clip((ratio - _RATIO_WHITE) / (_RATIO_WALK - _RATIO_WHITE), 0.0, 1.0)
    walk = share * np.maximum(long - short, 0.0) / max(second - scan, 1e-3)
    white = np.sqrt(np.maximum(short - walk * scan, 2.0 * _LEAST_WHITE**2) / 2.0)
    distance = returns.distance[:taken]
    told = max(float(np.sqrt(np.mean(distance * distance))), _LEAST_RANGE)
    growth = _learnt_growth(squares[:, 1, 1], told, distance)
    short, long = _variances(squares[:, :, 1] / growing(growth, told, distance)[:, None])
    walk[1] = share[1] * max(float(long - short), 0.0) / max(second - scan, 1e-3)
    return LearntNoise(_pair(white), _pair(walk), (growth, told), _pair(ratio))


def _variances(squares: Floats) -> Floats:
    """Return the variances (…) of what has these squares (n, …), its largest fifth left out."""
    count = int(_TRIMMED * len(squares))
    return np.asarray(np.partition(squares, count, axis=0)[:count].mean(axis=0) / _TRIMMED_VARIANCE)


def _learnt_growth(squares: Floats, told: float, distance: Floats) -> float:
    """Return the expected share of a walk that grows with the square of the range, all shares alike before.

    Args:
        squares: of displacements across (n,), m².
        told: range that the share is told for, m.
        distance: of what they are of (n,), m.
    """
    scale = np.maximum(growing(_GROWTHS[:, None], told, distance), _LEAST_SCALE)
    # logarithms, in which a slide counts for little, and all displacements spread alike
    logarithm = np.log(np.maximum(squares, _LEAST_WHITE**2)) - np.log(scale)
    fit = -0.5 * _TELLING * len(squares) * logarithm.var(axis=1) / _LOG_VARIANCE
    weight = np.exp(fit - fit.max())
    return float(weight @ _GROWTHS / weight.sum())


def _pair(values: Floats) -> tuple[float, float]:
    return float(values[0]), float(values[1])
