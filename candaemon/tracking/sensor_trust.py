"""How far each sensor can be trusted: silent, frozen, biased and noisy ones are noticed, taken back when well again.

What is looked at are raw innovations: detections against where the tracks of confirmed obstacles are predicted, not
corrected by anything that the sensor itself is found to be. They are compared with those that the sensor had before, so
that neither a badly stated noise nor reflections that slide on a body make a fault.

Noise is what makes the innovations of an obstacle greater than they were, and other ones from scan to scan. Greater
alone they are, too, where other sensors have led the tracks to another end of the body. The fewer obstacles there are,
the greater it has to be: of a single one that passes close by, a sensor sees now this part and now that. A lasting one
shows in more than half of the obstacles; a single scan is weighted down by their median already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from math import exp, expm1, log, radians
from typing import Final
from zlib import crc32

import numpy as np

from candaemon.arrays import Floats, Indices, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.config.trust import TrustSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import Measurement
from candaemon.radar.detections import Detections
from candaemon.radar.scan import Scan
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.update import PredictedReflections

REACH: Final = 8.0
"""m between a detection and the reflection it may be of."""
MOST_PAIRS: Final = 256
"""Detections and reflections within reach, of which an offset that is common to them is told."""
MOST: Final = 400.0
"""Factor on the variance from which on a scan is not used at all."""
_NONE = np.empty(0, dtype=np.intp)
_NO_OBSTACLES = np.empty(0, dtype=np.int64)
_GREATEST = log(4.0 * MOST)  # of the variance; more would take longer to fade
_LEAST_RATIO = 0.1  # of the innovations' variance to the stated one; less says nothing of a sensor
_BODY = 2.5  # m from the middle of a car to its end
_FEW = 0.5  # obstacles, of which the noise has to be twice as great as of many
_DEVIATIONS = 4.0  # of the noise, by which a single object may be off
_FORGET = 2.0  # s, with which noise is forgotten that cannot be compared
_FORGIVEN = 5.0  # s without a comparison, after which a sensor that was biased is used again
_MEDIAN = log(2.0)  # of a squared innovation in the plane, halved and normalised
_OF_MEDIAN = 1  # of both levels of a scan
_SHORT, _LONG = 0.4, 30.0  # s, of the means of late and of all along
_LEARNING = 2.0  # s of detections of obstacles that others see too, until a sensor's noise is judged
_BURST = 0.15  # s, with which the effect of a noisy scan fades
_BIAS = 0.3  # s, of the mean by which it is off
_HOLD = 0.4  # s, for which the noise must be greater
_FADED = 2.0  # times the variance: less is no more than usual
_OFFSET = 0.3  # s, of the mean of an obstacle's innovations, from which noise is told
_LED_AWAY = 0.4  # of the limit of a bias, that this mean may be: by no more do others lead tracks away
_SINCE_NS = 1_000_000_000  # without innovations, after which that mean begins anew
_LEAST_SPEED = 0.5  # m/s; slower, nothing changes from scan to scan, and the same objects may be true
_CLEARLY = 0.15  # of `REACH`, by which objects must lie nearer there to fit better elsewhere
_IN_PLACE = 1.0  # m by which objects are off as a rule: of less no other explanation is sought
_COMMON = 1.0  # m, within which objects are off by as much
_NEARLY = 4  # of so many detections another offset may explain one less
_AGREES = 0.6  # of the limits of a bias, within which a sensor is right again


class Fault(IntEnum):
    """What is wrong with a sensor."""

    NONE = 0
    SILENT = 1
    FROZEN = 2
    BIASED = 3
    NOISY = 4

    @property
    def cuts_off(self) -> bool:
        """Whether its scans are not used at all."""
        return self in _CUTTING_OFF


_CUTTING_OFF: Final = (Fault.FROZEN, Fault.BIASED)


@dataclass(slots=True)
class TrustCounts:
    """What was noticed of a sensor.

    Attributes:
        silent, frozen, biased, noisy: times that it was found to be so.
        recovered: times that it was all right again.
        cut_off: scans not used.
        weighted_down: scans used as noisier than the configuration says.
    """

    silent: int = 0
    frozen: int = 0
    biased: int = 0
    noisy: int = 0
    recovered: int = 0
    cut_off: int = 0
    weighted_down: int = 0


@dataclass(slots=True)
class SensorTrustState:
    """What is remembered of a sensor.

    Attributes:
        fault: as `Fault`.
        last_ns: its latest scan.
        right_ns: since when it has been right, while it is cut off.
        compared_ns: when it was last compared with others, while it is cut off.
        noisy_ns: since when its noise has been greater; 0: it is not.
        restless_ns: its latest scan with greater noise.
        digest: of its latest objects.
        repeated: scans in succession with these.
        since_ns: the first of them.
        froze_noisy: whether its noise was greater before it froze.
        judged: time for which it detected what others see too, s.
        excess: mean by which its noise is greater of late than all along, as logarithm of the variance.
        innovation, deviation: means of the logarithm of its normalised squared innovations, and of those less their
            late mean, all along.
        burst: factor on the variance left of its latest noisy scans.
        along, across: mean by which its objects are off of late, times the limit.
        off_along, off_across: by how much they were when it was found to be biased, m.
        obstacles, seen_ns: identities of obstacles that it saw of late, ascending, and its latest scan of each (n,).
        offsets: late means of their innovations (n, 2), m.
        counts: what was noticed.
    """

    fault: int = 0
    last_ns: int = 0
    right_ns: int = 0
    compared_ns: int = 0
    noisy_ns: int = 0
    restless_ns: int = 0
    digest: int = 0
    repeated: int = 0
    since_ns: int = 0
    froze_noisy: bool = False
    judged: float = 0.0
    excess: float = 0.0
    innovation: float = 0.0
    deviation: float = 0.0
    burst: float = 1.0
    along: float = 0.0
    across: float = 0.0
    off_along: float = 0.0
    off_across: float = 0.0
    obstacles: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    seen_ns: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    offsets: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    counts: TrustCounts = field(default_factory=TrustCounts)

    def validate(self) -> None:
        """Raise a ValueError where it contradicts itself."""
        if self.fault not in set(Fault):
            raise ValueError(f"there is no fault {self.fault}")
        if self.offsets.shape != (len(self.obstacles), 2) or len(self.seen_ns) != len(self.obstacles):
            raise ValueError(f"offsets {self.offsets.shape} of {len(self.obstacles)} obstacles")
        if not (np.diff(self.obstacles) > 0).all() or not np.isfinite(self.offsets).all():
            raise ValueError("offsets of obstacles that are not in order, or that are no numbers")


@dataclass(slots=True)
class TrustState:
    """What a `SensorTrust` remembers.

    Attributes:
        sensors: of each sensor.
    """

    sensors: list[SensorTrustState]


class SensorTrust:
    """Judges the sensors by their scans.

    Args:
        settings: the limits.
        sensors: settings of the sensors, in their order.
        others: those in each one's group.
        lost_after: s without a scan after which each is silent.
    """

    def __init__(
        self,
        settings: TrustSettings,
        sensors: Sequence[SensorSettings],
        others: Sequence[Sequence[int]],
        lost_after: Sequence[float],
    ) -> None:
        self._settings = settings
        self._angle = radians(settings.bias_angle_deg)
        self._silent_ns = [round(each * 1e9) for each in lost_after]
        self._others = others
        self._compared = [bool(there) and each.signals.directed for each, there in zip(sensors, others, strict=True)]
        self._state = TrustState([SensorTrustState() for _ in sensors])

    @property
    def state(self) -> TrustState:
        """What it remembers.

        Raises:
            ValueError: a state that is set is of another number of sensors.
        """
        return self._state

    @state.setter
    def state(self, state: TrustState) -> None:
        if len(state.sensors) != len(self._silent_ns):
            raise ValueError(f"trust of {len(state.sensors)} sensors, expected {len(self._silent_ns)}")
        self._state = state

    def fault(self, sensor: int) -> Fault:
        """Return what is wrong with a sensor."""
        return Fault(self._state.sensors[sensor].fault)

    def counts(self, sensor: int) -> TrustCounts:
        """Return what was noticed of a sensor."""
        return self._state.sensors[sensor].counts

    def weight(self, sensor: int) -> float:
        """Return the share of its stated information with which a sensor is used, 0 to 1."""
        state = self._state.sensors[sensor]
        return 0.0 if state.fault in {Fault.SILENT, Fault.FROZEN, Fault.BIASED} else 1.0 / self._factor(state)

    def watch(self, now_ns: int) -> None:
        """Notice what sensors have been silent for too long."""
        for each, silent_ns in zip(self._state.sensors, self._silent_ns, strict=True):
            self._note_clock(each, now_ns)
            if each.last_ns == 0:
                each.last_ns = now_ns
            elif now_ns - each.last_ns > silent_ns and each.fault != Fault.SILENT:
                self._found(each, Fault.SILENT)

    def judged(
        self, scan: Scan, detections: Detections, tracker: AnyTracker, pose: EgoPose, now_ns: int
    ) -> Detections | None:
        """Return a scan's detections as noisy as they can be trusted; None where they are not to be used.

        Args:
            scan: the scan.
            detections: what it sees from the ground.
            tracker: of the sensor's group, before it takes them.
            pose: ego pose at the scan's time.
            now_ns: when the scan was closed.
        """
        state = self._state.sensors[scan.sensor]
        self._note_clock(state, now_ns)
        dt = min(max(now_ns - state.last_ns, 0) * 1e-9, 1.0)
        state.last_ns = now_ns
        if state.fault == Fault.SILENT:
            self._recovered(state)
        if not self._settings.enabled:
            return detections
        self._note_objects(state, scan, pose, now_ns)
        if self._compared[scan.sensor]:
            state.burst = max(1.0, state.burst * exp(-dt / _BURST))
            if self._has_company(scan.sensor):
                self._compare(state, detections, tracker, dt, now_ns)
            else:
                self._forget_noise(state, dt, now_ns)
                self._note_bias(state, _NO_MATCHES, detections, dt, now_ns)
        if state.fault in _CUTTING_OFF:
            state.counts.cut_off += 1
            return None
        factor = self._factor(state)
        if factor == 1.0:
            return detections
        if factor >= MOST:
            state.counts.cut_off += 1
            return None
        state.counts.weighted_down += 1
        measurement = detections.measurement
        return replace(detections, measurement=measurement.weakened(np.full(len(measurement.position), factor)))

    def _note_clock(self, state: SensorTrustState, now_ns: int) -> None:
        """Let nothing that is remembered lie ahead, where the clock was set back."""
        if now_ns < state.last_ns:
            for name in ("last_ns", "right_ns", "compared_ns", "noisy_ns", "restless_ns", "since_ns"):
                setattr(state, name, min(getattr(state, name), now_ns))

    def _factor(self, state: SensorTrustState) -> float:
        """Return the factor on the stated variance that a sensor's detections deserve."""
        lasting = exp(state.excess) if state.fault == Fault.NOISY else 1.0
        factor = max(lasting, state.burst)
        return 1.0 if factor < _FADED else min(factor, MOST)

    def _note_objects(self, state: SensorTrustState, scan: Scan, pose: EgoPose, now_ns: int) -> None:
        """Notice scans that repeat the one before, while something moves."""
        digest = crc32(scan.object_id.tobytes(), crc32(scan.values.tobytes()))
        moves = pose.ve * pose.ve + pose.vn * pose.vn > _LEAST_SPEED**2
        repeats = digest == state.digest and len(scan.object_id) > 0 and moves
        state.repeated, state.digest = (state.repeated + 1 if repeats else 0), digest
        state.since_ns = state.since_ns if repeats else now_ns
        if state.repeated + 1 >= self._settings.frozen_after:
            if state.fault != Fault.FROZEN:
                self._found(state, Fault.FROZEN)
                state.froze_noisy = 0 < state.noisy_ns < state.since_ns
            state.right_ns = now_ns
        elif state.fault == Fault.FROZEN:
            if repeats or not len(scan.object_id):
                state.right_ns = now_ns
            elif now_ns - state.right_ns >= self._settings.recovery * 1e9:
                self._recovered(state)

    def _has_company(self, sensor: int) -> bool:
        """Return whether another of its group is used: the last is not judged by tracks that a bad one led astray."""
        others = (self.fault(each) for each in self._others[sensor])
        return any(not (fault.cuts_off or fault == Fault.SILENT) for fault in others)

    def _has_witness(self, sensor: int) -> bool:
        """Return whether another of its group is not off itself: where one is, the other seems to be."""
        others = [self._state.sensors[each] for each in self._others[sensor]]
        return any(
            each.fault == Fault.NONE
            or (each.fault == Fault.NOISY and max(abs(each.along), abs(each.across)) <= _AGREES)
            for each in others
        )

    def _compare(
        self, state: SensorTrustState, detections: Detections, tracker: AnyTracker, dt: float, now_ns: int
    ) -> None:
        """Compare a scan's detections with where the tracks that other sensors share in are predicted."""
        expected = tracker.predicted_reflections(detections.time_ns, detections.sensor)
        found = _nearest(detections, expected)
        told = _by_others(found, detections, expected)
        if state.fault == Fault.BIASED:
            elsewhere = _moved_back(detections, expected, state.off_along, state.off_across)
            if _fits_clearly_better(elsewhere, told):
                state.right_ns = state.compared_ns = now_ns
        self._note_bias(state, _of_a_common_offset(told, detections, expected), detections, dt, now_ns)
        if not len(found.rows):
            self._forget_noise(state, dt, now_ns)
            return
        levels = self._levels(state, found, detections, expected)
        if levels is None:
            self._forget_noise(state, dt, now_ns)
            return
        innovation, deviation, obstacles = levels
        above = np.minimum(innovation - state.innovation, deviation - state.deviation) - log(1.0 + _FEW / obstacles)
        most, median = np.minimum(above, _GREATEST).tolist()
        if state.judged >= _LEARNING and median >= log(self._settings.burst):
            state.burst = max(state.burst, exp(median))
        if most >= log(self._settings.noise):
            state.restless_ns = now_ns
        state.excess += -expm1(-dt / _SHORT) * (most - state.excess)
        if state.fault == Fault.NONE and not state.noisy_ns and state.burst < _FADED:
            state.judged = min(state.judged + dt, _LONG)
            share = min(dt / state.judged, 1.0) if state.judged else 0.0
            state.innovation += share * float(innovation[_OF_MEDIAN] - state.innovation)
            state.deviation += share * float(deviation[_OF_MEDIAN] - state.deviation)
        self._note_noise(state, now_ns)

    def _levels(
        self, state: SensorTrustState, found: _Matches, detections: Detections, expected: PredictedReflections
    ) -> tuple[Floats, Floats, int] | None:
        """Return the levels of the innovations, and of these less their late mean, each as `_levels_of` tells.

        And how many obstacles those are of. None: there is no mean yet of any of these obstacles.
        """
        obstacles, of = np.unique(expected.obstacle[found.tracks], return_inverse=True)
        share = 1.0 / np.bincount(of)
        innovations = np.stack([share * np.bincount(of, each) for each in found.innovation.T], axis=1)
        noise = detections.measurement.noise[found.rows].trace(axis1=1, axis2=2)
        rows, deviations = self._deviations(state, obstacles, innovations, detections.time_ns)
        if not len(rows):
            return None
        stated = (share * np.bincount(of, noise))[rows]
        greater = (found.innovation * found.innovation).sum(axis=1) - expected.variance[found.tracks]
        return _levels_of(np.maximum(greater, 0.0) / noise), _levels_of((deviations**2).sum(axis=1) / stated), len(rows)

    def _deviations(
        self, state: SensorTrustState, obstacles: Integers, innovations: Floats, time_ns: int
    ) -> tuple[Indices, Floats]:
        """Return which obstacles have a late mean of their innovations, and what these are off it; update the means."""
        recent = np.abs(time_ns - state.seen_ns) <= _SINCE_NS
        known, seen_ns, means = state.obstacles[recent], state.seen_ns[recent], state.offsets[recent]
        _, rows, earlier = np.intersect1d(obstacles, known, assume_unique=True, return_indices=True)
        deviations = innovations[rows] - means[earlier]
        share = -np.expm1(np.minimum(seen_ns[earlier] - time_ns, 0) * (1e-9 / _OFFSET))
        updated = innovations.copy()
        updated[rows] = means[earlier] + share[:, None] * deviations
        unseen = np.ones(len(known), np.bool_)
        unseen[earlier] = False
        of_all = np.concatenate([known[unseen], obstacles])
        order = of_all.argsort()
        state.obstacles = of_all[order]
        state.seen_ns = np.concatenate([seen_ns[unseen], np.full(len(obstacles), time_ns)])[order]
        updated = _no_longer(updated, _LED_AWAY * self._settings.bias)
        state.offsets = np.concatenate([means[unseen], updated])[order]
        return rows, deviations

    def _forget_noise(self, state: SensorTrustState, dt: float, now_ns: int) -> None:
        """Let go of noise that cannot be compared."""
        state.excess *= exp(-dt / _FORGET)
        self._note_noise(state, now_ns)

    def _note_noise(self, state: SensorTrustState, now_ns: int) -> None:
        """Notice that a sensor's innovations are greater than they were, and that they are as before."""
        greater = exp(state.excess) if state.judged >= _LEARNING else 0.0
        if state.fault == Fault.NOISY:
            calm = now_ns - state.restless_ns >= self._settings.recovery * 1e9
            if greater < _FADED or calm:
                state.noisy_ns, state.excess = 0, min(state.excess, 0.0)
                self._recovered(state)
        elif greater < self._settings.noise:
            state.noisy_ns = 0
        elif not state.noisy_ns:
            state.noisy_ns = now_ns
        elif now_ns - state.noisy_ns >= _HOLD * 1e9 and state.fault == Fault.NONE:
            self._found(state, Fault.NOISY)

    def _note_bias(
        self, state: SensorTrustState, found: _Matches, detections: Detections, dt: float, now_ns: int
    ) -> None:
        """Notice that a sensor's objects are off to one side, and that they are not any longer.

        Of a single body the sensors may see different ends. So the fewer there are, the farther off they have to be.
        """
        settings = self._settings
        if len(found.rows):
            measurement = detections.measurement
            distance, sight, across = _lines_of_sight(measurement.take(found.rows))
            deviation = np.sqrt(0.5 * measurement.noise[found.rows].trace(axis1=1, axis2=2))
            limit = settings.bias + _BODY / len(found.rows) + _DEVIATIONS * deviation
            off = (
                float(np.median((found.innovation * sight).sum(axis=1) / limit)),
                float(np.median((found.innovation * across).sum(axis=1) / (limit + self._angle * distance))),
            )
            share = -expm1(-dt / _BIAS)
            state.along += share * (off[0] - state.along)
            state.across += share * (off[1] - state.across)
        worst = max(abs(state.along), abs(state.across))
        if state.fault == Fault.BIASED:
            if len(found.rows) and worst > _AGREES:
                state.right_ns, state.compared_ns = now_ns, now_ns
            elif len(found.rows):
                state.compared_ns = now_ns
            confirmed = len(found.rows) > 0 and now_ns - state.right_ns >= settings.recovery * 1e9
            if confirmed or now_ns - state.compared_ns >= _FORGIVEN * 1e9:
                state.along = state.across = 0.0
                self._recovered(state)
        elif (
            len(found.rows)
            and worst > 1.0
            and state.fault in {Fault.NONE, Fault.NOISY}
            and self._has_witness(detections.sensor)
        ):
            self._found(state, Fault.BIASED)
            state.right_ns = state.compared_ns = now_ns
            state.off_along = float(np.median((found.innovation * sight).sum(axis=1)))
            state.off_across = float(np.median((found.innovation * across).sum(axis=1)))

    def _found(self, state: SensorTrustState, fault: Fault) -> None:
        state.fault = int(fault)
        name = fault.name.lower()
        setattr(state.counts, name, getattr(state.counts, name) + 1)

    def _recovered(self, state: SensorTrustState) -> None:
        fault = Fault(state.fault)
        if fault.cuts_off and not (fault == Fault.FROZEN and state.froze_noisy):  # what stood out was that fault
            state.obstacles = state.seen_ns = _NO_OBSTACLES
            state.offsets = np.zeros((0, 2))
            state.burst, state.noisy_ns, state.excess = 1.0, 0, 0.0
        state.fault = int(Fault.NONE)
        state.counts.recovered += 1


def _lines_of_sight(measurement: Measurement) -> tuple[Floats, Floats, Floats]:
    """Return how far detections (m,) are, m, and unit vectors along and across their lines of sight (m, 2)."""
    place = measurement.position - measurement.origin
    distance = np.maximum(np.hypot(place[:, 0], place[:, 1]), 1.0)
    sight = place / distance[:, None]
    return distance, sight, np.stack([-sight[:, 1], sight[:, 0]], axis=1)


def _moved_back(
    detections: Detections, expected: PredictedReflections, off_along: float, off_across: float
) -> _Matches:
    """Return the matches with what other sensors show that detections have where they are moved back by some offset, m.

    A detection that is off lies beside another obstacle sooner or later, and seems right there.
    """
    measurement = detections.measurement
    _, sight, across = _lines_of_sight(measurement)
    place = measurement.position - off_along * sight - off_across * across
    moved = replace(detections, measurement=replace(measurement, position=place))
    return _by_others(_nearest(moved, expected), moved, expected)


def _fits_clearly_better(one: _Matches, other: _Matches) -> bool:
    """Return whether some matches fit better than others.

    A little better counts as no better: what is tolerated of a sensor may be half of what it was off.
    """
    return _fit(one) > _fit(other) + _CLEARLY * len(one.rows)


def _of_a_common_offset(told: _Matches, detections: Detections, expected: PredictedReflections) -> _Matches:
    """Return the matches of detections that are all off by as much, where these fit better; else those told.

    Beside a neighbour the nearest reflection is not that of the body itself.
    """
    off = np.hypot(told.innovation[:, 0], told.innovation[:, 1])
    if not len(off) or np.median(off) < _IN_PLACE:
        return told
    common = _moved_back(detections, expected, *_common_offset(detections, expected))
    if not _fits_clearly_better(common, told):
        return told
    innovation = detections.measurement.position[common.rows] - expected.position[common.tracks]
    return _Matches(common.rows, common.tracks, innovation)


def _common_offset(detections: Detections, expected: PredictedReflections) -> tuple[float, float]:
    """Return by how much most detections are off what other sensors show, along and across their lines of sight, m.

    Of a queue all but the last are as well off by the distance of two cars: of offsets that explain nearly as many, the
    least counts.
    """
    others = np.flatnonzero(expected.confirmed & expected.by_others)
    apart = detections.measurement.position[:, None] - expected.position[others]
    row, track = np.nonzero(np.hypot(apart[..., 0], apart[..., 1]) < REACH)
    if not len(row):
        return 0.0, 0.0
    if len(row) > MOST_PAIRS:
        some = np.linspace(0, len(row) - 1, MOST_PAIRS).astype(np.intp)
        row, track = row[some], track[some]
    _, sight, across = _lines_of_sight(detections.measurement)
    off = np.stack([(apart[row, track] * axis[row]).sum(axis=1) for axis in (sight, across)], axis=1)
    alike = (np.abs(off[:, None] - off) < _COMMON).all(axis=2)
    share_it = (alike.astype(np.float64) @ (row[:, None] == np.unique(row)) > 0.0).sum(axis=1)
    explaining = share_it >= share_it.max() - share_it.max() // _NEARLY
    least = np.where(explaining, np.hypot(off[:, 0], off[:, 1]), np.inf).argmin()
    along_sight, aside = np.median(off[alike[least]], axis=0).tolist()
    return along_sight, aside


def _fit(found: _Matches) -> float:
    """Return how well detections fit: the more of them do, and the nearer they are, the better."""
    return float((1.0 - np.hypot(found.innovation[:, 0], found.innovation[:, 1]) / REACH).sum())


def _levels_of(ratios: Floats) -> Floats:
    """Return levels of normalised squares in the plane, logarithms, 0 where they are as stated (2,): most, median.

    That of most is reached by more than half of them: of four bodies, two that pass close by and show now this part,
    now that, do not make a sensor noisy. Where the same noise is in all of them, both are alike.
    """
    count = len(ratios)
    lower = (count - 1) // 2
    most, median = float(np.partition(ratios, lower)[lower]), float(np.median(ratios))
    if count % 2 == 0:  # such squares are exponentially distributed: the lower of both in the middle by as much less
        most *= 1.0 + 1.0 / (count * sum(1.0 / (count - each) for each in range(lower + 1)))
    return np.log(np.maximum(np.array([most, median]) / _MEDIAN, _LEAST_RATIO))


def _no_longer(vectors: Floats, length: float) -> Floats:
    """Return vectors (n, 2), those that are longer cut to a length."""
    return vectors * np.minimum(1.0, length / np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-9))[:, None]


@dataclass(frozen=True, slots=True)
class _Matches:
    """Detections and the reflections that they are nearest to, m pairs.

    Attributes:
        rows: of the detections (m,).
        tracks: of the reflections (m,).
        innovation: place measured minus place expected (m, 2), m.
    """

    rows: Indices
    tracks: Indices
    innovation: Floats


_NO_MATCHES: Final = _Matches(_NONE, _NONE, np.zeros((0, 2)))


def _nearest(detections: Detections, expected: PredictedReflections) -> _Matches:
    """Return which detection and reflection are the nearest to each other, of obstacles that other sensors share in.

    What only the sensor itself has seen takes its detections, so that these are not held for another obstacle's.
    """
    tracks, places = np.flatnonzero(expected.confirmed), detections.measurement.position
    if not len(tracks) or not len(places):
        return _NO_MATCHES
    apart = places[:, None] - expected.position[tracks]
    distance = np.hypot(apart[..., 0], apart[..., 1])
    nearest, every = distance.argmin(axis=1), np.arange(len(places))
    good = (distance.argmin(axis=0)[nearest] == every) & (distance[every, nearest] < REACH)
    good &= expected.shared[tracks[nearest]]
    rows = np.flatnonzero(good)
    return _Matches(rows, tracks[nearest[rows]], apart[rows, nearest[rows]])


def _by_others(found: _Matches, detections: Detections, expected: PredictedReflections) -> _Matches:
    """Return the matches with what other sensors show of the same obstacles: a sensor agrees with what itself showed.

    Where they show nothing of an obstacle any longer, nothing is told: the nearest of another one may be metres away.
    """
    own = ~expected.by_others[found.tracks]
    if not own.any():
        return found
    others = np.flatnonzero(expected.confirmed & expected.by_others)
    if not len(others):
        return _Matches(found.rows[~own], found.tracks[~own], found.innovation[~own])
    apart = detections.measurement.position[found.rows, None] - expected.position[others]
    distance = np.hypot(apart[..., 0], apart[..., 1])
    distance[expected.obstacle[found.tracks, None] != expected.obstacle[others]] = np.inf
    nearest = distance.argmin(axis=1)
    every = np.arange(len(nearest))
    tracks = np.where(own, others[nearest], found.tracks)
    innovation = np.where(own[:, None], apart[every, nearest], found.innovation)
    told = ~own | (distance[every, nearest] < REACH)
    return _Matches(found.rows[told], tracks[told], innovation[told])
