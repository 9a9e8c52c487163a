"""How probable it is that a sensor detects an obstacle, and how many detections belong to nothing.

The probability of detection is a product. Its first factor, the share in sight, is geometry: the part of the angle an
obstacle subtends that lies in the field of view and that no nearer obstacle hides. The second, the rate with which the
sensor detects what is in sight, is learnt for each range, and apart for obstacles that the sensor detected when it last
could and for those it missed then: object radars lose an obstacle for several scans at once. A sensor whose list is
full tells nearly nothing of what is farther than all it lists.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp, pi, radians
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats
from candaemon.config.sensors import SensorSettings
from candaemon.frames.times import LONG_AGO_NS
from candaemon.radar.mounting import sensor_views

LEAST_PROBABILITY: Final = 0.01
"""Of detection, whatever hides an obstacle: a field of view is only known approximately, and radars see below cars."""
GREATEST_PROBABILITY: Final = 0.99
"""Of detection, however well a sensor has seen so far."""
_PROBABILITIES = LEAST_PROBABILITY, GREATEST_PROBABILITY
RANGE_BINS: Final = 8
"""Parts of a sensor's range whose detection rates are learnt apart."""
_ANGLE_MARGIN = radians(0.5)  # on either side of an obstacle: a field of view ends within a degree
_RANGE_MARGIN = 2.0  # m over which it ends; the least range within half of it
_NEAREST = 1e-6  # m from a mount, from which on a line of sight has a direction
_POINT = 1.0  # m, length and width of an obstacle whose size is not known
_CROWDED = 0.1  # share of obstacles that a full list has room for, though they are farther than what it lists
_HELD = 0.5  # s for which a list has no more room, as what the sensor has lost keeps its slot for a while
_CLEAR = 0.9  # share in sight from which a detection is expected without doubt
_PRIOR_WEIGHT = 40.0  # opportunities that the setting counts as
_MEMORY = 1000.0  # opportunities of a bin, or scans, after which what was learnt has faded to 1/e
_PERSISTENCE, _PERSISTENCE_WEIGHT = 0.2, 10.0  # probability that clutter comes again, and detections that counts as
_MOST_PERSISTENT = 1.0 - 1e-9  # what comes again for ever
_CLUTTER_SPREAD = 100.0  # factor by which the learnt density of clutter differs from the setting at most


def _unlearnt() -> Floats:
    return np.zeros((2, RANGE_BINS))


@dataclass(slots=True)
class LearntDetection:
    """What was learnt of the detections of one sensor; older experience counts less.

    Attributes:
        expected: opportunities by range, of obstacles detected (row 0) and missed (row 1) the time before.
        detected: those of them that were taken.
        scans: scans whose clutter was counted.
        false: detections that belonged to nothing, each where nothing was known.
        again: further detections of the same.
        full_ns: time of the last scan whose list was full.
    """

    expected: Floats = field(default_factory=_unlearnt)
    detected: Floats = field(default_factory=_unlearnt)
    scans: float = 0.0
    false: float = 0.0
    again: float = 0.0
    full_ns: int = LONG_AGO_NS

    def validate(self) -> None:
        """Refuse counts that cannot be.

        Raises:
            ValueError: a count is negative, or more was detected than expected.
        """
        counts = (self.expected, self.detected)
        if any(each.dtype != np.float64 or each.shape != (2, RANGE_BINS) for each in counts):
            raise ValueError(f"detection rates of other than 2 times {RANGE_BINS} parts")
        possible = (self.detected >= 0.0) & (self.detected <= self.expected) & (self.expected <= 2.0 * _MEMORY)
        if not (possible.all() and 0.0 <= self.scans <= 2.0 * _MEMORY and 0.0 <= min(self.false, self.again) < np.inf):
            raise ValueError("detections were counted that cannot be")


@dataclass(slots=True)
class VisibilityState:
    """What was learnt of each sensor, by its number."""

    sensors: dict[int, LearntDetection] = field(default_factory=dict)


class Visibility:
    """Says what sensors should see, and learns how well they do.

    Args:
        sensors: settings of each sensor by its number.
    """

    def __init__(self, sensors: Mapping[int, SensorSettings]) -> None:
        self._models = {number: _DetectionModel(settings) for number, settings in sensors.items()}
        self._state = VisibilityState({number: LearntDetection() for number in sensors})

    @property
    def state(self) -> VisibilityState:
        """All that it has learnt. Of a sensor that a state does not have, nothing is learnt yet.

        Raises:
            ValueError: a state that is set is of other sensors, or holds what cannot be.
        """
        return self._state

    @state.setter
    def state(self, state: VisibilityState) -> None:
        if not state.sensors.keys() <= self._models.keys():
            raise ValueError("detection rates of other sensors than the configuration's")
        for learnt in state.sensors.values():
            learnt.validate()
        self._state = VisibilityState({number: LearntDetection() for number in self._models} | state.sensors)

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give what was learnt to the sensors' other numbers, and forget those left out.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        self._models = {sensors[old]: each for old, each in self._models.items() if old in sensors}
        learnt = self._state.sensors
        self._state.sensors = {sensors[old]: each for old, each in learnt.items() if old in sensors}

    def in_sight(
        self,
        centre: Floats,
        reference: Floats,
        axis: Floats,
        length: Floats,
        width: Floats,
        sensor: int,
        look: int = -1,
    ) -> tuple[Floats, Floats]:
        """Return the share of each obstacle in a sensor's sight (k,), 0 to 1, and its distance from it (k,), m.

        Args:
            centre: of the obstacles' boxes (k, 2), vehicle axes, m.
            reference: their points that face the vehicle (k, 2), vehicle axes, m.
            axis: unit vectors along the boxes (k, 2), vehicle axes; NaN where they are not known.
            length: (k,), m; NaN where it is not known.
            width: (k,), m; NaN where it is not known.
            sensor: its number.
            look: which of its looks the scan is; −1: it has none, or did not say which.
        """
        return self._models[sensor].sight(centre, reference, axis, length, width, look)

    def room(self, sensor: int, time_ns: int, x: Floats, y: Floats, distance: Floats) -> Floats | None:
        """Return the share of each obstacle that a scan had room for in its list (k,), 0 to 1; None: for all of all.

        Args:
            sensor: its number.
            time_ns: of the scan.
            x: of what the scan lists (m,), vehicle axes, m.
            y: likewise (m,), m.
            distance: of the obstacles from the sensor (k,), m.
        """
        return self._models[sensor].room(self._state.sensors[sensor], time_ns, x, y, distance)

    def detection_probability(
        self, sensor: int, share: Floats, distance: Floats, missed: Booleans | None = None
    ) -> Floats:
        """Return the probability (k,) with which a scan of a sensor holds a detection of each obstacle.

        Args:
            sensor: its number.
            share: in its sight (k,), as `in_sight` says, 0 to 1.
            distance: likewise (k,), m.
            missed: whether the sensor's last scan that should have held it did not (k,); None: held by all.
        """
        missed = np.zeros(len(share), dtype=np.bool_) if missed is None else missed
        return self._models[sensor].probability(self._state.sensors[sensor], share, distance, missed)

    def mean_probability(self, sensor: int) -> float:
        """Return the probability with which a scan of a sensor holds a detection of what is in its sight."""
        rate = self._models[sensor].mean_rate(self._state.sensors[sensor])
        return min(max(rate, LEAST_PROBABILITY), GREATEST_PROBABILITY)

    def learn(
        self,
        sensor: int,
        expected: Floats,
        detected: Booleans,
        distance: Floats,
        missed: Booleans | None = None,
        surely: Booleans | None = None,
    ) -> None:
        """Learn from a scan which obstacles the sensor detected.

        Args:
            sensor: its number.
            expected: share in sight (k,), 0 to 1; only those clearly in sight count.
            detected: whether the scan held it (k,).
            distance: from the sensor (k,), m.
            missed: as in `detection_probability`.
            surely: which of them surely exist (k,): only they count; None: all.
        """
        missed = np.zeros(len(expected), dtype=np.bool_) if missed is None else missed
        surely = np.ones(len(expected), dtype=np.bool_) if surely is None else surely
        counts = self._models[sensor].opportunities(expected, detected, distance, missed, surely)
        opportunities, taken = counts
        if not np.count_nonzero(opportunities):
            return
        learnt = self._state.sensors[sensor]
        fading = np.exp(-opportunities / _MEMORY)
        if compiled.in_use:
            compiled.kernels.learn_rates(learnt.expected, learnt.detected, counts, fading, _MEMORY / 2)
            return
        learnt.expected *= fading
        learnt.detected *= fading
        learnt.expected += np.minimum(opportunities, _MEMORY / 2)
        learnt.detected += taken * np.minimum(1.0, _MEMORY / 2 / np.maximum(opportunities, 1))

    def learn_clutter(self, sensor: int, false: int, scans: int = 1, again: int = 0) -> None:
        """Learn how many detections belonged to nothing.

        Args:
            sensor: its number.
            false: tracks that have died unconfirmed since it was last told.
            scans: of the sensor since then.
            again: detections of those tracks beside their first ones.
        """
        learnt = self._state.sensors[sensor]
        fading, share = exp(-scans / _MEMORY), min(1.0, _MEMORY / 2 / max(scans, 1))
        learnt.scans = learnt.scans * fading + min(scans, _MEMORY / 2)
        learnt.false = learnt.false * fading + false * share
        learnt.again = learnt.again * fading + again * share

    def false_beginnings(self, sensor: int) -> tuple[float, float]:
        """Return how many tracks of nothing begin in a scan, and with which probability one is detected once more."""
        learnt = self._state.sensors[sensor]
        persistence = (learnt.again + _PERSISTENCE * _PERSISTENCE_WEIGHT) / (
            learnt.false + learnt.again + _PERSISTENCE_WEIGHT
        )
        return self._models[sensor].clutter(learnt), min(persistence, _MOST_PERSISTENT)

    def sensors_with_clutter(self) -> int:
        """Return of how many sensors a false detection is remembered, at least 1."""
        return max(sum(each.false >= 1.0 for each in self._state.sensors.values()), 1)

    def clutter_density(self, sensor: int) -> float:
        """Return how many detections of a scan belong to nothing, per m² of the field of view."""
        return self._models[sensor].clutter_density(self._state.sensors[sensor])


class _DetectionModel:
    """What one sensor should see: its views, and what its settings say of it before it is learnt.

    Args:
        settings: of the sensor.
    """

    def __init__(self, settings: SensorSettings) -> None:
        self._views, self._mount = sensor_views(settings), settings.mount
        self._slots = settings.objects.slots
        detection = settings.detection
        prior = np.array([detection.probability, 1.0 - exp(-settings.revisit_time / detection.gap)])
        self._prior = prior[:, None] * _PRIOR_WEIGHT
        self._clutter = detection.clutter
        self._bin = max(view.field.range for view in self._views.values()) / RANGE_BINS
        self._area = float(np.mean([view.area for view in self._views.values()]))

    def sight(
        self, centre: Floats, reference: Floats, axis: Floats, length: Floats, width: Floats, look: int
    ) -> tuple[Floats, Floats]:
        """Return the share of each obstacle in sight (k,), and its distance (k,), m."""
        mount, view = (self._mount.x, self._mount.y), self._views.get(look)
        x, y, away, distance, across = _sight_lines(centre, reference, axis, length, width, mount)
        if view is None:  # a scan that does not say which of the looks it is: nothing is expected
            return np.zeros(len(distance)), distance
        bearing, half = np.arctan2(y, x), np.arctan2(across, 2.0 * away)
        opening, field = radians(view.field.azimuth_deg), view.field
        behind = opening > pi / 2
        if compiled.in_use:
            field_of_view = (view.yaw, opening, field.min_range, field.range, behind)
            share = compiled.kernels.shares_in_sight(
                bearing, half, away, distance, *field_of_view, _ANGLE_MARGIN, _RANGE_MARGIN, pi
            )
            return share, distance
        half = half + _ANGLE_MARGIN
        azimuth = np.remainder(bearing - view.yaw + pi, 2 * pi) - pi
        low, high = azimuth - half, azimuth + half
        share = 1.0 - _hidden(low, high, away, distance, behind=behind)
        if opening < pi:
            inside = np.minimum(high, opening) - np.maximum(low, -opening)
            share -= 1.0 - np.maximum(inside, 0.0) / np.minimum(2.0 * half, 2.0 * opening)
        within = np.minimum(distance - field.min_range, field.range - distance) / _RANGE_MARGIN + 0.5
        return np.clip(share, 0.0, 1.0) * np.clip(within, 0.0, 1.0), distance

    def room(self, learnt: LearntDetection, time_ns: int, x: Floats, y: Floats, distance: Floats) -> Floats | None:
        """Return the share of each obstacle that a list had room for (k,), None: all; a full one holds the nearest."""
        if len(x) >= self._slots:
            learnt.full_ns = time_ns
        if not len(x) or not 0 <= time_ns - learnt.full_ns <= _HELD * 1e9:
            return None
        farthest = np.hypot(x - self._mount.x, y - self._mount.y).max()
        return np.where(distance > farthest, _CROWDED, 1.0)

    def opportunities(
        self, share: Floats, seen: Booleans, distance: Floats, missed: Booleans, surely: Booleans
    ) -> Floats:
        """Return how often what surely exists was clearly in sight, and how often of that seen (2, 2, `RANGE_BINS`)."""
        if compiled.in_use:
            return compiled.kernels.opportunities(share, distance, seen, missed, surely, _CLEAR, self._bin, RANGE_BINS)
        clear = (share > _CLEAR) & np.isfinite(distance) & surely
        part = np.minimum(distance[clear] // self._bin, RANGE_BINS - 1).astype(np.intp)
        cell, shape = missed[clear] * RANGE_BINS + part, (2, RANGE_BINS)
        expected = np.bincount(cell, minlength=2 * RANGE_BINS).astype(np.float64)
        taken = np.bincount(cell, weights=seen[clear], minlength=2 * RANGE_BINS).astype(np.float64)
        return np.stack([expected.reshape(shape), taken.reshape(shape)])

    def probability(self, learnt: LearntDetection, share: Floats, distance: Floats, missed: Booleans) -> Floats:
        """Return with which probability obstacles are detected (k,), linear between the middles of parts."""
        limits = _PROBABILITIES
        if compiled.in_use:
            counts = learnt.detected, learnt.expected, self._prior, _PRIOR_WEIGHT
            return compiled.kernels.detection_probabilities(share, distance, missed, *counts, self._bin, *limits)
        rates = (learnt.detected + self._prior) / (learnt.expected + _PRIOR_WEIGHT)
        at = np.fmin(np.fmax(distance / self._bin - 0.5, 0.0), RANGE_BINS - 1)
        lower, row = np.minimum(at.astype(np.intp), RANGE_BINS - 2), missed.astype(np.intp)
        rate = rates[row, lower] + (at - lower) * (rates[row, lower + 1] - rates[row, lower])
        return np.asarray(np.minimum(np.maximum(share * rate, limits[0]), limits[1]))

    def mean_rate(self, learnt: LearntDetection) -> float:
        """Return with which probability what is in sight, at any range, is detected."""
        expected, detected = learnt.expected.sum(), learnt.detected.sum()
        return float((detected + self._prior[0, 0]) / (expected + _PRIOR_WEIGHT))

    def clutter(self, learnt: LearntDetection) -> float:
        """Return the detections of a scan that belong to nothing."""
        usual = self._clutter * self._area
        found = (learnt.false + usual * _PRIOR_WEIGHT) / (learnt.scans + _PRIOR_WEIGHT)
        return float(min(max(found, usual / _CLUTTER_SPREAD), usual * _CLUTTER_SPREAD))

    def clutter_density(self, learnt: LearntDetection) -> float:
        """Return the detections of a scan that belong to nothing, per m²."""
        return self.clutter(learnt) / self._area


def _sight_lines(
    centre: Floats, reference: Floats, axis: Floats, length: Floats, width: Floats, mount: tuple[float, float]
) -> Floats:
    """Return of boxes (5, k) x, y and distance of the centre from a mount, that of the reference point, extent across.

    That is across the line of sight; of what has no size or axis it is that of a point.
    """
    if compiled.in_use:
        return compiled.kernels.sight_lines(centre, reference, axis, length, width, *mount, _NEAREST, _POINT)
    x, y = centre[:, 0] - mount[0], centre[:, 1] - mount[1]
    away = np.sqrt(x * x + y * y)
    near, (axis_x, axis_y) = np.maximum(away, _NEAREST), axis.T
    sine, cosine = (axis_y * x - axis_x * y) / near, (axis_x * x + axis_y * y) / near
    sized = (length > 0.0) & (width > 0.0) & np.isfinite(axis).all(axis=1)
    across = np.where(sized, np.abs(sine) * length + np.abs(cosine) * width, _POINT)
    far_x, far_y = reference[:, 0] - mount[0], reference[:, 1] - mount[1]
    return np.stack([x, y, away, np.sqrt(far_x * far_x + far_y * far_y), across])


def _hidden(low: Floats, high: Floats, away: Floats, distance: Floats, *, behind: bool) -> Floats:
    """Return the share of each obstacle's angle that others hide, whose centres are nearer than its reference point.

    Args:
        low: least azimuth of each obstacle (k,), rad.
        high: greatest (k,), rad.
        away: distance of its centre (k,), m.
        distance: of its reference point (k,), m.
        behind: whether the sensor sees to where azimuths change their sign, in its back.
    """
    hiding_low, hiding_high, nearer = low + _ANGLE_MARGIN, high - _ANGLE_MARGIN, away[:, None] < distance
    np.fill_diagonal(nearer, val=False)  # nobody hides itself
    if behind:
        turn = np.where(low + high > 0.0, -2 * pi, 2 * pi)
        hiding_low = np.concatenate([hiding_low, hiding_low + turn])
        hiding_high = np.concatenate([hiding_high, hiding_high + turn])
        nearer = np.concatenate([nearer, away[:, None] < distance])
    shared = np.minimum(high, hiding_high[:, None])
    shared -= np.maximum(low, hiding_low[:, None])
    # summed row by row, from the first one to the last
    return np.asarray(np.where(nearer, np.maximum(shared, 0.0), 0.0).sum(axis=0) / (high - low))
