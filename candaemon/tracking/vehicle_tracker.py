"""The tracker of vehicles: one filter an obstacle, updated by all its reflections of every sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import cos, exp, sin
from typing import ClassVar

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.config.tracker import TrackerSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import ACCELERATION, BIAS, POSITION, TURN, VELOCITY, reported
from candaemon.estimation.correlated_noise import inflations
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.smoothing import Link
from candaemon.frames.times import LATEST_NS
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView, in_look, seen_by_any
from candaemon.tracking import box
from candaemon.tracking.association import nis_over_modes
from candaemon.tracking.body_association import Association, associate, in_modes
from candaemon.tracking.body_axes import TIGHTEST, turned_axes
from candaemon.tracking.body_departures import departures
from candaemon.tracking.body_existence import BodyExistence
from candaemon.tracking.body_images import images
from candaemon.tracking.body_initiation import BodyInitiation
from candaemon.tracking.body_measurement import of_bodies
from candaemon.tracking.body_merging import alongside_long, inside_others, merge_candidates, split_candidates
from candaemon.tracking.body_modes import MANOEUVRING
from candaemon.tracking.body_report import report
from candaemon.tracking.body_riders import in_line, part_in_line
from candaemon.tracking.body_sizes import SMALL
from candaemon.tracking.body_store import Bodies, BodiesState
from candaemon.tracking.body_width import beside_widest, wide_together
from candaemon.tracking.columns import longer_ago
from candaemon.tracking.identities import Identities
from candaemon.tracking.innovation_correlation import InnovationCorrelation, InnovationCorrelationState
from candaemon.tracking.majority import contradicting
from candaemon.tracking.near_side import is_before
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.own_outline import OwnOutline
from candaemon.tracking.reflection_noise import ReflectionNoise, ReflectionNoiseState, growing, stated_white
from candaemon.tracking.reflections import from_travel_axes, to_travel_axes
from candaemon.tracking.sensor_visibility import VisibilityState
from candaemon.tracking.smoother_history import SmootherHistory
from candaemon.tracking.straying import abreast, note_strays, part, part_abreast, part_strays, strays
from candaemon.tracking.tracker import EARLIEST_NS, LATEST_RETRODICTION, MISSED_SCAN
from candaemon.tracking.turning import rate_and_pivot
from candaemon.tracking.update import PredictedReflections, TrackerCounts, Update, Used

_HISTORY = (1 << 32) - 1
_NONE = np.empty(0, dtype=np.intp)
_AXIS_TIME = 0.15  # s, with which the axis follows the course
_TURNS_ON_NS = 200_000_000  # since its last detection, for which a body is known to turn on
_CROSSING = 0.7  # m/s across the axis: faster than a walk or a slide looks, it is motion
_DRIFTING = 3.0  # a drift tells of motion as surely as a speed across that is so many times as great
_LEAST_SHARE = 0.02  # of the stated variance that a sensor's white part is taken to have at least
_LEAST_RATE = 1e-6  # 1/s
_STANDS = 0.6  # m/s along the line of sight; across it, a slide looks like motion
_REMEMBERED = 8.0  # times as uncertain as one that is reported, an obstacle is forgotten
_ALIKE = np.array([1.0, 1.0, 0.25, 0.25])  # m², (m/s)²: reflections of one body differ so
_FARTHEST = 8.0  # m between where an obstacle should be and one that takes up its identity
_OVERLAP = 0.5  # s, for which two obstacles may have been one: the second began while the first was still detected
_MERGING = 2.0  # times `merge_time`, the age up to which what is about to merge is held back
_RATE_MEMORY = 0.3  # s, of a reflection's range rate beside its body's


@dataclass(slots=True)
class VehicleTrackerState:
    """All that a tracker of vehicles remembers.

    Attributes:
        time_ns: the instant that its bodies hold for.
        counts: what it did.
        tracks: the bodies.
        noise: of the sensors' reflections.
        visibility: how well the sensors detect.
        correlation: how alike the sensors' errors are from scan to scan.
    """

    time_ns: int
    counts: TrackerCounts
    tracks: BodiesState
    noise: ReflectionNoiseState
    visibility: VisibilityState
    correlation: InnovationCorrelationState


class VehicleTracker:
    """Tracks the vehicles that a group of sensors sees.

    Args:
        settings: of a `vehicle` estimator, association, reflections and life cycle.
        sensors: settings of the sensors by their number; of one left out nothing is learnt, its noise is white.
        identities: the numbers of new obstacles; shared by the trackers of a run. None: its own.
        cycle_time: the longest of its sensors, s; a tentative obstacle survives one missed scan of it.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
        views: what the sensors can see; an obstacle that has left all of them and is not detected ends early.

    Attributes:
        settings: as given.
        update: what the latest step's detections updated; None where it had none.
        smoother_history: what a smoother needs of the latest step; None unless `keep_smoother_history` was called.
    """

    STAGES: ClassVar[Mapping[str, str]] = {
        "_predict": "predict",
        "_associate": "associate",
        "_observe_existence": "weigh existence",
        "_update": "update",
        "_record": "update",
        "_observe_noise": "update",
        "_turn_axes": "update",
        "_return_references": "update",
        "_face": "update",
        "_initiate": "initiate, confirm, delete",
        "_confirm_and_delete": "initiate, confirm, delete",
        "_hand_over": "merge and split",
        "_merge_and_split": "merge and split",
    }
    """What the parts of a step are called where their time is told."""

    def __init__(
        self,
        settings: TrackerSettings,
        sensors: Mapping[int, SensorSettings],
        identities: Identities | None = None,
        *,
        cycle_time: float = 0.05,
        slack_ns: int = 0,
        views: Sequence[SensorView] = (),
    ) -> None:
        estimator = settings.estimator
        if not isinstance(estimator, VehicleEstimatorSettings):
            raise TypeError(f"found the settings of a {estimator.kind} estimator, expected those of vehicle")
        self.settings = settings
        self._places, self._backing, self._memory = estimator.reflections, estimator.backing, estimator.memory
        self._tentative_coast = max(settings.lifecycle.tentative_coast, MISSED_SCAN * cycle_time)
        self._views, self._slack_ns = views, slack_ns
        self._outline = OwnOutline.around(views)
        self._bodies = Bodies(estimator, identities or Identities())
        self._initiation = BodyInitiation(settings, estimator)
        self._noise = ReflectionNoise(sensors)
        self._stated = {number: stated_white(each.noise) for number, each in sensors.items()}
        self._correlation = InnovationCorrelation(sensors)
        self._cycle_times = {number: each.cycle_time for number, each in sensors.items()}
        self._existence = BodyExistence(settings.lifecycle, sensors, views)
        self._bodies.first_existence = self._existence.first
        self._by_existence = settings.lifecycle.by == "existence"
        self._state = VehicleTrackerState(
            0,
            TrackerCounts(),
            self._bodies.state,
            self._noise.state,
            self._existence.state,
            self._correlation.state,
        )
        self._dt = 0.0
        self.update: Update | None = None
        self.smoother_history: SmootherHistory | None = None

    def __len__(self) -> int:
        return len(self._bodies.obstacles.id)

    @property
    def state(self) -> VehicleTrackerState:
        """All that it remembers, beside the identities that it shares with others.

        Raises:
            ValueError: a state that is set does not fit the settings, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: VehicleTrackerState) -> None:
        if not EARLIEST_NS <= state.time_ns <= LATEST_NS:
            raise ValueError("the obstacles' time is out of range")
        self._bodies.state = state.tracks
        self._noise.state = state.noise
        self._existence.state = state.visibility
        self._correlation.state = state.correlation
        self._state = replace(
            state,
            noise=self._noise.state,
            visibility=self._existence.state,
            correlation=self._correlation.state,
        )
        self.update = None
        self.smoother_history = None

    @property
    def counts(self) -> TrackerCounts:
        """What it did."""
        return self._state.counts

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers, and forget those left out: their ids, and the obstacles that only they have seen.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        self._bodies.renumber_sensors(sensors)
        self._noise.renumber_sensors(sensors)
        self._correlation.renumber_sensors(sensors)
        self._stated = {sensors[old]: each for old, each in self._stated.items() if old in sensors}
        self._cycle_times = {sensors[old]: each for old, each in self._cycle_times.items() if old in sensors}
        self._existence.renumber_sensors(sensors)

    def keep_smoother_history(self) -> None:
        """Give a `smoother_history` after each step from here on; the obstacles reported do not change by it."""
        self._bodies.filter.linking = True

    def step(self, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance to the pose's time, with the detections of one scan, or with none to let the obstacles coast.

        Predict, associate, update, initiate, confirm and delete, merge and split, report.

        Args:
            detections: of one sensor, at the pose's time.
            pose: ego pose; its time is that of the obstacles reported.

        Returns:
            The obstacles, the tentative ones too.
        """
        self.update = None
        self._predict(pose)
        link = self._smoother_link() if self._bodies.filter.linking else None
        if detections is not None:
            detections = self._as_noisy(detections)
            association = self._associate(detections)
            in_sight = self._observe_existence(association, detections, pose)
            self._update(association, detections, pose, in_sight)
            self._initiate(association, detections, pose)
            self._record(association, detections)
            self._observe_noise(detections, pose)
        self._turn_axes()
        self._confirm_and_delete(pose, detections)
        if detections is not None and self.settings.reflections.merge and len(self):
            self._hand_over()
            self._return_references()
            self._merge_and_split(pose)
        self._face(pose)
        if link is not None:
            state, covariance = reported(self._bodies.moments().mean, self._bodies.filter.combined()[1])
            swing = self._bodies.swing()
            more = np.zeros((len(self), 2)) if swing is None else swing[0]
            self.smoother_history = SmootherHistory(self._bodies.obstacles.id.copy(), state, covariance, *link, more)
        reported_existence = self._bodies.obstacles.existence if self._by_existence else None
        return report(
            self._bodies,
            pose,
            self._used(detections),
            self._slack_ns,
            self._places.spread_time,
            self._reported(pose),
            reported_existence,
        )

    def expected_positions(self, horizons: Sequence[float]) -> list[Floats]:
        """Return where each detection of the latest update is expected after times: (m, 2) of each, local frame, m."""
        if self.update is None:
            return [np.zeros((0, 2)) for _ in horizons]
        rows, bodies = self.update.reflection, self._bodies
        mean, axis = bodies.moments().mean, bodies.obstacles.axis
        settles = self._hidden()
        if settles.any():
            settles *= bodies.filter.unsteady(np.hypot(*mean[:, VELOCITY].T))
            settles *= 1.0 - bodies.filter.probability[:, MANOEUVRING]
        rate = np.maximum(settles / self._places.settling, _LEAST_RATE)
        owner, offsets, turning = bodies.reflections.body.take(rows), bodies.offsets(rows), bodies.sure_turning()
        swing = 0.0 if turning is None else turning.velocities(owner, bodies.moments().shown[owner, :2] + offsets)
        times = np.array(horizons)
        ahead = times[:, None]
        across, fade = -np.expm1(-rate * ahead) / (rate * ahead), np.exp(-ahead / self._bias_time())
        leading = expected_places(mean, axis, across, fade, times)
        return list(leading.take(owner, axis=1) + offsets + ahead[:, :, None] * swing)

    def mode_probabilities(self) -> tuple[Integers, Floats]:
        """Return the obstacles' identities (k,) and the probabilities of their modes (k, M)."""
        return self._bodies.obstacles.id, self._bodies.filter.probability

    def predicted_reflections(self, time_ns: int, sensor: int) -> PredictedReflections:
        """Return where the reflections of confirmed obstacles are expected at a time; the tracks do not change.

        Args:
            time_ns: the instant; at most `LATEST_RETRODICTION` from the latest step.
            sensor: number of the sensor that asks.
        """
        self._bodies.restart()
        obstacles, reflections = self._bodies.obstacles, self._bodies.reflections
        mean, covariance = self._bodies.reflection_states()
        ahead = (time_ns - self._state.time_ns) * 1e-9
        ahead = min(max(ahead, -LATEST_RETRODICTION), LATEST_RETRODICTION)
        owner = reflections.body
        return PredictedReflections(
            mean[:, :2] + ahead * mean[:, 2:4],
            covariance[:, 0, 0] + covariance[:, 1, 1],
            obstacles.id[owner],
            obstacles.confirmed[owner],
            (obstacles.sensors & ~(1 << sensor) != 0)[owner],
            reflections.sensor != sensor,
        )

    def _used(self, detections: Detections | None) -> Used:
        """Return what this cycle's detections updated."""
        if self.update is None or detections is None:
            return Used(_NONE, 0, np.empty(0, dtype=np.int64))
        body = self._bodies.reflections.body.take(self.update.reflection)
        return Used(body, detections.sensor, detections.object_id.take(self.update.detection))

    def _predict(self, pose: EgoPose) -> None:
        """Predict all bodies, and let the places of their reflections become uncertain again."""
        time_ns, bodies = pose.time_ns, self._bodies
        bodies.restart()
        dt = (time_ns - self._state.time_ns) * 1e-9 if len(self) else 0.0
        self._dt = max(dt, 0.0)
        self._state.time_ns = time_ns
        if dt > 0.0:
            sliding = box.slides(bodies, pose)
            walk, bias_time = self._walks(pose, sliding), self._bias_time()
            bodies.filter.predict(dt, bodies.obstacles.axis, walk, self._hidden(), bias_time)
            self._existence.predict(bodies, dt)
            self._let_wander(dt)
            bodies.changed()
            bodies.swing_references(dt)
            box.follow_aspect(bodies, pose, dt)
            if sliding is not None:
                box.follow_slides(bodies, sliding, dt)
            bodies.return_to_seen(dt, self._places.return_time)
        elif -LATEST_RETRODICTION < dt < 0.0:
            velocity = bodies.moments().mean[:, VELOCITY]
            bodies.filter.shift(dt * velocity)
            bodies.changed()
            bodies.swing_references(dt)
            box.follow_aspect(bodies, pose, dt)

    def _smoother_link(self) -> tuple[Integers, Link]:
        """Return the obstacles' identities and what a smoother needs of their prediction; to be called right after it.

        Where time has not moved on, as in a scan that comes after a younger one, the gain is the identity.
        """
        link = self._bodies.filter.link
        if self._dt == 0.0 or link is None:
            state, covariance = reported(self._bodies.moments().mean, self._bodies.filter.combined()[1])
            link = Link(state, covariance, np.broadcast_to(np.eye(6), covariance.shape))
        else:  # the reference points may have moved on their bodies since the filter predicted
            link.mean[:, POSITION] = self._bodies.moments().mean[:, POSITION]
        return self._bodies.obstacles.id.copy(), link

    def _of_leaders(self, told: Floats) -> Floats:
        """Return of each body (k, …) what is told of the sensor that its leading reflection is of."""
        return told.take(self._bodies.reflections.sensor.take(self._bodies.obstacles.leader), axis=0)

    def _hidden(self) -> Floats:
        """Return how surely the walk of its bias hides how each body moves across (k,), 0 to 1."""
        walks = self._noise.walks()
        if not walks.surely_some:
            return np.zeros(len(self))
        obstacles, mean = self._bodies.obstacles, self._bodies.moments().mean
        if compiled.in_use:
            seen_by, drift, axis = self._bodies.reflections.sensor, obstacles.drift, obstacles.axis
            hidden, power = compiled.kernels.hidden_motion(
                walks.surely, seen_by, obstacles.leader, mean, drift, axis, _DRIFTING, _CROSSING
            )
            return hidden if power is None else hidden * np.exp(power)
        hidden = self._of_leaders(walks.surely)
        if hidden.any():
            across = to_travel_axes(mean[:, VELOCITY], obstacles.axis)[:, 1]
            drift = to_travel_axes(obstacles.drift, obstacles.axis)[:, 1]
            hidden *= np.exp(-np.square((np.abs(across) + _DRIFTING * np.abs(drift)) / _CROSSING))
        return hidden

    def _walks(self, pose: EgoPose, sliding: Floats | None) -> Floats:
        """Return how the bodies' biases walk along and across (k, 2), m²/s.

        What slides along a body steadily, or not at all, walks as far in the time that it takes to pass.

        Args:
            pose: ego pose.
            sliding: how fast that would be (k,), m/s; None: of none.
        """
        walks = self._noise.walks()
        walk = self._of_leaders(walks.walk) if walks.some else np.zeros((len(self), 2))
        if sliding is not None:
            walk[:, 0] += self._places.passing * sliding * sliding
        if not walks.some:
            return walk
        if walk.any():
            distance = pose.to_vehicle(self._bodies.moments().mean[:, POSITION])
            share, told = self._of_leaders(walks.growth).T
            walk[:, 1] *= growing(share, told, np.hypot(distance[:, 0], distance[:, 1]))
        return walk

    def _walking(self, sensor: int) -> float:
        """Return how surely a sensor's reflections walk across, 0 to 1."""
        return self._noise.walking(sensor) if sensor in self._stated else 0.0

    def _bias_time(self) -> Floats:
        """Return the time constants with which the bodies' biases fade (k,), s."""
        places, walks = self._places, self._noise.walks()
        if not walks.surely_some:
            return np.full(len(self), places.bias_time)
        walking = self._of_leaders(walks.surely)
        return places.bias_time + walking * (places.walk_time - places.bias_time)

    def _alike(self, sensor: int) -> float:
        """Return how surely successive errors of a sensor are alike, 0 to 1: those of one that filters by itself."""
        if sensor not in self._stated:
            return 0.0
        return 1.0 if self._noise.filters(sensor) else self._noise.walking(sensor)

    def _as_alike(self, measurement: Measurement, body: Indices) -> Measurement:
        """Return detections (m,) of bodies as noisy as they are to a filter that takes alike errors for new ones.

        For what a scan tells on its own, as which body a detection is of, they are as noisy as their sensor says.
        """
        sensor = measurement.sensor
        share, time = self._correlation.share(sensor)
        if share > 0.0 and self._noise.walk_is_known(sensor):
            share *= 1.0 - self._walking(sensor)  # what walks, the bias follows
        if share <= 0.0:
            return measurement
        cycle_time, interval = self._cycle_times[sensor], self._bodies.obstacles.interval
        by_scans = inflations(share, time, cycle_time, self._memory)
        if compiled.in_use:
            factor = compiled.kernels.factors_of_scans(interval, body, cycle_time, by_scans)
        else:
            scans = np.minimum(np.rint(interval[body] / cycle_time), len(by_scans) - 1).astype(np.intp)
            factor = by_scans[scans]
        # how alike the speeds of a sensor that filters are, `speed_noise` tells
        return measurement.scaled(factor) if self._noise.filters(sensor) else measurement.weakened(factor)

    def _as_noisy(self, detections: Detections) -> Detections:
        """Return detections as noisy as their sensor was found to be, where its reflections walk."""
        measurement = detections.measurement
        sensor = measurement.sensor
        if not self._walking(sensor) or not self._noise.known(sensor):
            return detections
        white, stated = self._noise.white(sensor), self._stated[sensor]
        share = min(max((white[0] / stated[0]) ** 2, (white[1] / stated[1]) ** 2, _LEAST_SHARE), 1.0)
        return replace(detections, measurement=measurement.scaled(np.full(len(measurement.position), share)))

    def _observe_noise(self, detections: Detections, pose: EgoPose) -> None:
        """Let the noise of the sensor's reflections be learnt from what stands."""
        if self.update is None or not detections.identified or detections.sensor not in self._stated:
            return
        own_speed = float(np.hypot(pose.ve, pose.vn))
        if not self._noise.expects(detections.sensor, detections.time_ns, own_speed):
            return
        bodies, rows = self._bodies, self.update.reflection
        body = bodies.reflections.body.take(rows)
        position = detections.measurement.position.take(self.update.detection, axis=0)
        sight = position - detections.measurement.origin
        distance = np.hypot(sight[:, 0], sight[:, 1])
        standing = _standing(bodies.moments().mean[:, VELOCITY], sight, distance, body, bodies.obstacles.confirmed)
        ahead = np.array([cos(pose.heading), sin(pose.heading)])
        self._noise.observe(
            detections.sensor,
            detections.time_ns,
            bodies.reflections.serial.take(rows),
            position,
            np.full((len(rows), 2), ahead),
            standing,
            own_speed,
            distance,
        )

    def _let_wander(self, dt: float) -> None:
        """Let the variances of the offsets return towards the spread; the leading reflection is where it is."""
        places, reflections = self._places, self._bodies.reflections
        if len(reflections) == len(self):  # all of them lead
            reflections.variance = np.zeros(len(reflections))
            return
        keep, leader = exp(-dt / places.spread_time), self._bodies.obstacles.leader
        kept, added = keep * keep, places.spread**2 * (1.0 - keep * keep)
        if compiled.in_use:
            compiled.kernels.loosen_offsets(reflections.variance, leader, kept, added)
            return
        reflections.variance = kept * reflections.variance + added
        reflections.variance[leader] = 0.0

    def _associate(self, detections: Detections) -> Association:
        """Return which body and reflection each detection belongs to."""
        bodies, lifecycle = self._bodies, self.settings.lifecycle
        away = longer_ago(bodies.obstacles.last_ns, self._state.time_ns, self._tentative_coast)
        if away is None:
            vague = np.zeros(len(bodies), dtype=np.bool_)
        else:
            vague = away & (self._uncertain() > lifecycle.uncertainty)
        association, extent = self.settings.association, self.settings.reflections
        detecting = partial(self._existence.detecting, detections.sensor) if association.joint else None
        found = associate(bodies, detections, association, extent, vague, detecting)
        if extent.merge:
            found.leave_out(contradicting(bodies, found.body, detections.measurement, extent))
        self.counts.slot_jumps += found.slot_jumps
        return found

    def _observe_existence(self, association: Association, detections: Detections, pose: EgoPose) -> Floats:
        """Weigh by what a scan shows whether bodies exist; return the share of each that could be seen (k,)."""
        return self._existence.observe(self._bodies, association, detections, pose)

    def _update(self, association: Association, detections: Detections, pose: EgoPose, in_sight: Floats) -> None:
        """Update the bodies with all their detections, then the places of their reflections."""
        self.counts.cycles += 1
        self.counts.detections += len(detections)
        bodies = self._bodies
        obstacles, reflections = bodies.obstacles, bodies.reflections
        sensor = 1 << detections.sensor
        if compiled.in_use and detections.look < 0:
            compiled.kernels.expect_detections(obstacles.history, obstacles.scans, obstacles.sensors, sensor, _HISTORY)
        else:
            expected = obstacles.sensors & sensor != 0
            if detections.look >= 0:
                expected &= in_look(self._views, detections, pose.to_vehicle(bodies.moments().mean[:, POSITION]))
            obstacles.history = obstacles.history << expected & _HISTORY
            obstacles.scans += expected
        rows = (association.reflection >= 0).nonzero()[0]
        if not len(rows):
            return
        row, body, measurement = association.reflection, association.body, detections.measurement
        if len(rows) < len(row):
            row, body, measurement = row.take(rows), body.take(rows), measurement.take(rows)
        if association.doubt is not None:
            measurement = measurement.weakened(association.doubt[rows])
        offset = bodies.offsets(row)
        arm = None
        if (turning := bodies.turning()) is not None:
            shown = bodies.moments().shown
            arm = turning.arms(body, shown, offset)
            if measurement.projections:
                place = shown.take(body, axis=0)[:, :2] + offset
                measurement = turning.left_out(measurement, body, place)
        bodies.note_detections(body, detections.time_ns)
        self._note_rates(row, body, offset, measurement)
        if len(reflections) > len(bodies):
            note_strays(bodies, row, body, measurement, detections.time_ns, self.settings.reflections)
        self._correlation.observe(bodies, row, measurement, detections.time_ns)
        measurement = self._as_alike(measurement, body)
        alike = self._alike(detections.sensor)
        speed_share = 1.0 + alike * (self._places.speed_noise**2 - 1.0)
        seen, combined, rates = of_bodies(measurement, body, offset, reflections.variance.take(row), speed_share, arm)
        bodies.filter.update(seen, combined, alike, rates)
        bodies.changed()
        bodies.learn_offsets(row, measurement.position, measurement.noise, offset)
        keys = detections.object_id.take(rows) if detections.identified else None
        bodies.mark_detected(row, keys, detections.sensor, detections.time_ns)
        extent = self.settings.reflections
        box.learn(bodies, rows, row, detections, in_sight, extent.patience, extent.alone, self._backing.speed)

    def _note_rates(self, row: Indices, body: Indices, offset: Floats, measurement: Measurement) -> None:
        """Note how much faster than their bodies reflections come nearer."""
        if measurement.range_rate is None:
            return
        share = -np.expm1(-self._bodies.obstacles.interval / _RATE_MEMORY)
        noted, shown = self._bodies.reflections.rate_difference, self._bodies.moments().shown
        sensor, rates = (measurement.origin, measurement.velocity), measurement.range_rate
        turning = self._bodies.turning()
        if compiled.in_use:
            (x, y), (vx, vy) = measurement.origin.tolist(), measurement.velocity.tolist()
            turn, pivot = rate_and_pivot(turning)
            compiled.kernels.note_rates(noted, row, body, shown, offset, rates, x, y, vx, vy, share, turn, pivot)
            return
        mean = shown[body]
        mean[:, :2] += offset
        if turning is not None:
            mean[:, 2:] += turning.velocities(body, mean[:, :2])
        difference = rates - line_of_sight(mean, *sensor)[0]
        difference[~np.isfinite(difference)] = 0.0
        noted[row] += share[body] * (difference - noted[row])

    def _initiate(self, association: Association, detections: Detections, pose: EgoPose) -> None:
        """Initiate a reflection for each detection beside a known body, and bodies for the rest."""
        left = (association.reflection < 0).nonzero()[0]
        if not len(left):
            return
        room = max(self.settings.max_tracks - len(self._bodies.reflections), 0)
        self.counts.crowded += max(len(left) - room, 0)
        before = len(self)
        self._initiation.initiate(left[:room], association, detections, pose, self._bodies)
        self.counts.obstacles += len(self) - before

    def _record(self, association: Association, detections: Detections) -> None:
        """Keep what the scan's detections updated or initiated, for those who ask after the step."""
        rows = (association.reflection >= 0).nonzero()[0]
        self.counts.used += len(rows)
        reflection, nis, measured = association.reflection, association.nis, detections.measurement.measured
        if len(rows) < len(reflection):
            reflection, nis, measured = reflection.take(rows), nis.take(rows), measured.take(rows)
        self.update = Update(rows, reflection, nis, measured)

    def _turn_axes(self) -> None:
        """Turn the axes of what moves towards its course, the faster the better the course is known."""
        obstacles = self._bodies.obstacles
        if self._dt == 0.0 or not len(self):
            return
        moments, directed = self._bodies.moments(), obstacles.directed.copy()
        if self._noise.walks().surely_some:
            time = _AXIS_TIME + self._hidden() * (self.settings.travel.time_constant - _AXIS_TIME)
            part = -np.expm1(-self._dt / time)
        else:
            part = np.full(len(self), -np.expm1(-self._dt / _AXIS_TIME))
        axes, turned_round = turned_axes(
            moments.mean,
            moments.covariance,
            obstacles.axis,
            obstacles.directed,
            obstacles.ahead,
            part,
            np.where(self._state.time_ns - obstacles.last_ns > _TURNS_ON_NS, 0.0, self._dt),
            obstacles.facing,
            self._bodies.turning(),
            self._backing.speed,
            self._dt * self._backing.speed / self._backing.distance,
            np.where(obstacles.length < SMALL, np.inf, self._dt / TIGHTEST),
        )
        told = obstacles.directed != directed
        self._bodies.take_axes(axes, told)
        if turned_round is not None:
            self._bodies.keep_reflections(turned_round & ~told)

    def _confirm_and_delete(self, pose: EgoPose, detections: Detections | None) -> None:
        """Confirm what surely exists; delete what is not detected, out of view or too uncertain.

        Args:
            pose: ego pose.
            detections: of the scan; None: there was none.
        """
        bodies, lifecycle = self._bodies, self.settings.lifecycle
        obstacles, reflections = bodies.obstacles, bodies.reflections
        if not len(obstacles):
            if self._by_existence and detections is not None:
                self._existence.learn_clutter(detections.sensor, obstacles.history)
            return
        promoted, ended = self._promoted(detections), None
        if len(promoted):
            obstacles.confirmed[promoted] = True
            self.counts.confirmed += len(promoted)
            if self._by_existence:
                ended = self._taken_up(promoted)
        forgotten = self._forgotten() if self._by_existence else self._ended_by_hits(pose)
        if forgotten is not None:
            ended = forgotten if ended is None else ended | forgotten
        if ended is not None and not np.count_nonzero(ended):
            ended = None
        if self._by_existence and detections is not None:
            clutter = _NONE if ended is None else obstacles.history[ended & ~obstacles.confirmed]
            self._existence.learn_clutter(detections.sensor, clutter)
        silent = longer_ago(reflections.last_ns, self._state.time_ns, lifecycle.reflection_coast)
        if silent is not None:
            silent[obstacles.leader] = False
        if ended is not None or (silent is not None and silent.any()):
            ended = np.zeros(len(self), dtype=np.bool_) if ended is None else ended
            lost = ended.take(reflections.body)
            self._delete(lost if silent is None else lost | silent, ended)

    def _promoted(self, detections: Detections | None) -> Indices:
        """Return rows of the obstacles that are to be confirmed; by existence, none that may be a part of another."""
        obstacles, lifecycle = self._bodies.obstacles, self.settings.lifecycle
        if not self._by_existence:
            hits = np.bitwise_count(obstacles.history & (1 << lifecycle.window) - 1)
            return np.flatnonzero((hits >= lifecycle.confirm) & ~obstacles.confirmed)
        existence, last_ns, time_ns = obstacles.existence, obstacles.last_ns, self._state.time_ns
        if compiled.in_use:
            rows = compiled.kernels.bodies_to_confirm(existence, last_ns, obstacles.confirmed, time_ns, lifecycle.sure)
            promoted = np.array(rows, dtype=np.intp) if rows else _NONE
        else:
            promoted = np.flatnonzero((existence >= lifecycle.sure) & (last_ns == time_ns) & ~obstacles.confirmed)
        if len(promoted):
            promoted = promoted[~np.isin(promoted, self._joining(promoted))]
        if len(promoted) and self.settings.reflections.merge:
            promoted = promoted[~inside_others(self._bodies, promoted, self.settings.reflections, time_ns)]
        if detections is not None and len(promoted):
            promoted = promoted[~np.isin(promoted, self._images(promoted, detections))]
        return promoted

    def _joining(self, candidates: Indices) -> Indices:
        """Return those of some obstacles that are about to merge with an older one; none that was lost sight of.

        Two that one scan shows and the next does not are alongside every other scan, and never merge: nothing is held
        for longer than merging takes.
        """
        obstacles, longest_ns = self._bodies.obstacles, round(_MERGING * self.settings.reflections.merge_time * 1e9)
        young = self._state.time_ns - obstacles.first_ns[candidates] < longest_ns
        alongside = candidates[young & (obstacles.alongside_ns[candidates] > 0)]
        return alongside[~np.isfinite(self._continuations(alongside)[1]).any(axis=1)]

    def _images(self, candidates: Indices, detections: Detections) -> Indices:
        """Return those of some young obstacles that are held for images of others, for a while: they may be real."""
        age = (self._state.time_ns - self._bodies.obstacles.first_ns[candidates]) * 1e-9
        lifecycle = self.settings.lifecycle
        young, age = candidates[age < lifecycle.image], age[age < lifecycle.image]
        returns = np.isfinite(self._continuations(young)[1]).any(axis=1)
        return young[images(self._bodies, young, detections, (age < lifecycle.shadow) & ~returns)]

    def _ended_by_hits(self, pose: EgoPose) -> Booleans | None:
        """Return which obstacles not detected are to be deleted, by the time without a detection; None: none is."""
        obstacles, lifecycle = self._bodies.obstacles, self.settings.lifecycle
        missed = longer_ago(obstacles.last_ns, self._state.time_ns, self._tentative_coast)
        if missed is None:
            return None
        coasted = (self._state.time_ns - obstacles.last_ns) * 1e-9
        tracked = (obstacles.last_ns - obstacles.first_ns) * 1e-9
        ended = ~obstacles.confirmed | (coasted > np.minimum(lifecycle.coast, tracked))
        ended |= self._uncertain() > lifecycle.uncertainty
        return np.asarray(missed & (ended | ~self._in_view(pose)))

    def _forgotten(self) -> Booleans | None:
        """Return which obstacles not detected are to be deleted, by existence: not even remembered; None: none is."""
        obstacles, lifecycle = self._bodies.obstacles, self.settings.lifecycle
        first_ns, last_ns, time_ns = obstacles.first_ns, obstacles.last_ns, self._state.time_ns
        most, longest = _REMEMBERED * lifecycle.uncertainty, max(lifecycle.hidden, lifecycle.coast)
        if compiled.in_use:
            covariance, coast = self._bodies.moments().covariance, self._tentative_coast
            return compiled.kernels.bodies_to_forget(
                first_ns, last_ns, obstacles.confirmed, covariance, time_ns, coast, longest, most
            )
        missed = longer_ago(last_ns, self._state.time_ns, self._tentative_coast)
        if missed is None:
            return None
        away, tracked = (time_ns - last_ns) * 1e-9, (last_ns - first_ns) * 1e-9
        ended = ~obstacles.confirmed | (away > np.minimum(longest, tracked)) | (self._uncertain() > most)
        return np.asarray(missed & ended)

    def _uncertain(self) -> Floats:
        """Return the standard deviations of the places of the obstacles, m."""
        covariance = self._bodies.moments().covariance
        return np.asarray(np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1]))

    def _reported(self, pose: EgoPose) -> Booleans | None:
        """Return which obstacles are reported, None: all; not those only remembered.

        What is not detected is reported while its existence is probable and its place known, not longer than it may
        coast in sight, and within a field of view.
        """
        obstacles, lifecycle = self._bodies.obstacles, self.settings.lifecycle
        coasting = longer_ago(obstacles.last_ns, self._state.time_ns, self._tentative_coast)
        if not self._by_existence or coasting is None:
            return None
        in_view = self._in_view(pose)
        self._existence.leave(self._bodies, in_view)
        away, tracked = self._state.time_ns - obstacles.last_ns, obstacles.last_ns - obstacles.first_ns
        likely = (obstacles.existence > lifecycle.doubtful) & (obstacles.unseen <= lifecycle.coast)
        likely &= away <= lifecycle.coast_share * tracked
        return ~coasting | (likely & in_view & (self._uncertain() < lifecycle.uncertainty))

    def _taken_up(self, young: Indices) -> Booleans:
        """Let obstacles that are confirmed take up the identity of one that was lost sight of where they appear.

        Who drives off from what it stood over takes it along too: that is somebody else.

        Args:
            young: rows of those just confirmed.

        Returns:
            Which obstacles are continued by another one (k,).
        """
        ended = np.zeros(len(self), dtype=np.bool_)
        lost, cost = self._continuations(young)
        others = np.ones(len(young), dtype=np.bool_)
        while np.isfinite(cost).any():
            i, j = np.unravel_index(int(cost.argmin()), cost.shape)
            self._bodies.take_up(int(young[i]), int(lost[j]))
            ended[lost[j]], others[i] = True, False
            cost[i], cost[:, j] = np.inf, np.inf
        for row, left in departures(self._bodies, young[others], self.settings.reflections, self._state.time_ns):
            if not ended[left]:
                self._bodies.take_up(row, left)
                self._bodies.forget_shape(np.array([left]))
        return ended

    def _continuations(self, young: Indices) -> tuple[Indices, Floats]:
        """Return rows of obstacles lost sight of (n,), and how unlike them young ones are (m, n), infinite: not one.

        Args:
            young: rows of others (m,).
        """
        bodies = self._bodies
        obstacles = bodies.obstacles
        away = (self._state.time_ns - obstacles.last_ns) * 1e-9 > self.settings.reflections.patience
        lost = np.flatnonzero(obstacles.confirmed & away)
        if not len(young) or not len(lost):
            return lost, np.full((len(young), len(lost)), np.inf)
        moments = bodies.moments()
        probability, shown, covariance = in_modes(bodies, lost)
        apart = moments.shown[young, None] - moments.shown[lost]
        spread = moments.shown_covariance[young] + np.diag(_ALIKE)
        distance = nis_over_modes(
            probability,
            moments.shown[young, None, None] - shown,
            spread[:, None, None] + covariance,
            spread[:, None] + moments.shown_covariance[lost],
        )
        later = obstacles.first_ns[young, None] > obstacles.last_ns[lost] - int(_OVERLAP * 1e9)
        possible = later & (distance < self.settings.association.gate)
        possible &= np.hypot(apart[..., 0], apart[..., 1]) < _FARTHEST
        return lost, np.where(possible, distance, np.inf)

    def _in_view(self, pose: EgoPose) -> Booleans:
        """Return of which obstacles a part lies within some sensor's field of view: the reference point, or an end."""
        if not self._views:
            return np.ones(len(self), dtype=np.bool_)
        obstacles, place = self._bodies.obstacles, self._bodies.moments().mean[:, POSITION]
        centre, half = place - obstacles.facing, 0.5 * obstacles.length[:, None] * obstacles.axis
        points = np.concatenate([place, centre + half, centre - half])
        return np.asarray(seen_by_any(self._views, pose.to_vehicle(points)).reshape(3, -1).any(axis=0))

    def _hand_over(self) -> None:
        """Let another reflection lead where the leading one has not been detected for the hand-over delay."""
        bodies, patience_ns = self._bodies, int(self.settings.reflections.patience * 1e9)
        obstacles, reflections = bodies.obstacles, bodies.reflections
        if compiled.in_use:
            last_ns, time_ns = reflections.last_ns, self._state.time_ns
            compiled.kernels.hand_over(obstacles.leader, reflections.body, last_ns, time_ns, patience_ns)
            return
        silent = self._state.time_ns - reflections.last_ns[obstacles.leader] > patience_ns
        if not silent.any():
            return
        detected = np.flatnonzero(reflections.last_ns == self._state.time_ns)[::-1]
        successor = np.full(len(obstacles), -1, dtype=np.intp)
        successor[reflections.body[detected]] = detected  # reversed, so that the oldest one is written last
        rows = np.flatnonzero(silent & (successor >= 0))
        if len(rows):
            bodies.lead(rows, successor[rows])

    def _return_references(self) -> None:
        """Let the reference points return to what is seen of the bodies."""
        patience_ns = int(self.settings.reflections.patience * 1e9)
        self._bodies.return_reference(self._state.time_ns, self._places.return_time, patience_ns)

    def _face(self, pose: EgoPose) -> None:
        """Find where the reference points lie on the boxes, which face us."""
        self._bodies.obstacles.facing = box.facing_offsets(self._bodies, pose)
        self._bodies.forget_turning()

    def _merge_and_split(self, pose: EgoPose) -> None:
        """Split off reflections that move apart, merge bodies that move together."""
        bodies, settings = self._bodies, self.settings.reflections
        before = len(bodies)
        splitting = split_candidates(bodies, settings)
        if splitting is not None:
            detected = bodies.reflections.last_ns == self._state.time_ns
            part(bodies, np.flatnonzero(splitting & detected), settings)
            self.counts.obstacles += len(bodies) - before
            self._delete(splitting & ~detected, np.zeros(len(bodies), dtype=np.bool_))
        if len(bodies.reflections) > len(bodies):
            self._part(pose)
        self._merge(pose)

    def _part(self, pose: EgoPose) -> None:
        """Let several be several: who walks away from what stands, who walk abreast, riders, cars side by side."""
        bodies, settings, time_ns = self._bodies, self.settings.reflections, self._state.time_ns
        before = len(bodies)
        if (straying := strays(bodies, settings, time_ns)) is not None:
            part_strays(bodies, straying, settings)
        if (people := abreast(bodies, settings, time_ns)) is not None:
            part_abreast(bodies, people, settings)
        if (riders := in_line(bodies, settings, pose)) is not None:
            self.counts.confirmed += part_in_line(bodies, riders)
        if (beside := beside_widest(bodies, settings, time_ns, pose)) is not None:
            bodies.split_together(beside)
        self.counts.obstacles += len(bodies) - before

    def _merge(self, pose: EgoPose) -> None:
        """Merge the younger of two obstacles that stay alongside each other into the older."""
        bodies, settings = self._bodies, self.settings.reflections
        obstacles = bodies.obstacles
        older, needed = merge_candidates(bodies, settings, self._state.time_ns)
        merging = alongside_long(obstacles.alongside_ns, older, needed, int(self._dt * 1e9))
        if not merging:
            return
        merged = np.zeros(len(obstacles), dtype=np.bool_)
        for young, old in zip(merging, older[merging].tolist(), strict=True):
            if not merged[old] and not self._are_two(young, old, pose):
                bodies.merge(young, old)
                merged[young] = True
        if merged.any():
            self.counts.merged += int(merged.sum())
            self._delete(np.zeros(len(bodies.reflections), dtype=np.bool_), merged)

    def _are_two(self, young: int, old: int, pose: EgoPose) -> bool:
        """Return whether two bodies that seem one surely are two: side by side, astride of us, or one before another.

        Cars that we are parked between lie on either side of our own vehicle.
        """
        bodies, settings, time_ns = self._bodies, self.settings.reflections, self._state.time_ns
        if wide_together(bodies, young, old, settings, time_ns):
            return True
        one, other = pose.to_vehicle(bodies.moments().shown[[young, old], :2])
        if self._outline is not None and self._outline.lies_between(one, other):
            return True
        origins = {view.sensor: pose.place(view.mount.x, view.mount.y)[0] for view in self._views}
        return is_before(bodies, young, old, origins, settings, time_ns)

    def _delete(self, lost: Booleans, ended: Booleans) -> None:
        """Delete reflections and obstacles; the latest update keeps the rows that are left."""
        new_row = self._bodies.delete(lost, ended)
        if self.update is not None:
            kept = ~lost[self.update.reflection]
            self.update = Update(
                self.update.detection[kept],
                new_row[self.update.reflection[kept]],
                self.update.nis[kept],
                self.update.degrees_of_freedom[kept],
            )


def _standing(velocity: Floats, sight: Floats, distance: Floats, body: Indices, confirmed: Booleans) -> Booleans:
    """Return which reflections (m,) are of confirmed bodies that stand, as far as their lines of sight tell.

    Args:
        velocity: of the bodies (k, 2), m/s.
        sight: from the sensor to each reflection (m, 2), m.
        distance: that is (m,), m.
        body: row of each one's body (m,).
        confirmed: which bodies are (k,).
    """
    fastest = (4.0 * _STANDS) ** 2
    if compiled.in_use:
        return compiled.kernels.standing_reflections(velocity, sight, distance, body, confirmed, _STANDS, fastest)
    velocity = velocity[body]
    along = (velocity * (sight / np.maximum(distance, 1.0)[:, None])).sum(axis=1)
    slow = (np.abs(along) < _STANDS) & ((velocity * velocity).sum(axis=1) < fastest)
    return np.asarray(slow & confirmed[body])


def expected_places(mean: Floats, axis: Floats, across: Floats, fade: Floats, times: Floats) -> Floats:
    """Return where the leading reflections of bodies are expected after times, (H, k, 2), m.

    Args:
        mean: states (k, 8) as in `BodyFilter`.
        axis: of the bodies (k, 2).
        across: share of the way across its axis that each goes (H, k).
        fade: share of each one's bias that is left (H, k).
        times: (H,), s.
    """
    ahead = times[:, None]
    turn = 0.5 * mean[:, TURN] * ahead
    c, s = np.cos(turn), np.sin(turn)
    if compiled.in_use:
        return compiled.kernels.expected_places(mean, axis, c, s, across, fade, times)
    vx, vy = mean[:, 2], mean[:, 3]
    way = 1.0 + 0.5 * ahead * mean[:, ACCELERATION] / np.maximum(np.sqrt(vx * vx + vy * vy), 1.0)
    way = ahead * np.maximum(way, 0.0)
    drift = to_travel_axes(np.stack([way * (c * vx - s * vy), way * (s * vx + c * vy)], axis=-1), axis)
    drift[..., 1] *= across
    return np.asarray(mean[:, POSITION] + from_travel_axes(drift, axis) + mean[:, BIAS] * fade[:, :, None])
