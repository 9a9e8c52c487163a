"""The tracker: detections of a scan in, obstacles with a lasting identity out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import Measurement
from candaemon.frames.times import LATEST_NS
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView, in_look
from candaemon.tracking.association import nearest_neighbours, pair_nis
from candaemon.tracking.columns import longer_ago
from candaemon.tracking.identities import Identities
from candaemon.tracking.initiation import TrackInitiation
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.range_association import RangeAssociation, UnpairedRanges
from candaemon.tracking.reflections import (
    RigidMotion,
    align_with_course,
    hand_over_reference,
    merge_candidates,
    split_candidates,
)
from candaemon.tracking.reporting import report
from candaemon.tracking.smoother_history import SmootherHistory
from candaemon.tracking.track_store import TrackStore, TrackStoreState
from candaemon.tracking.update import PredictedReflections, TrackerCounts, Update, Used

MISSED_SCAN = 2.4  # cycles: two, and the jitter of a scan
EARLIEST_NS = -LATEST_NS // 2  # a measurement may lie before the first instant, by a latency
LATEST_RETRODICTION = 1.5
"""s by which a scan may be older than the one before it; what is older still, a clock that was set back has stamped.

Latencies from -0.5 to 0.5 s and a scan that closes late lie between.
"""
_HISTORY = (1 << 32) - 1
_NONE = np.empty(0, dtype=np.intp)


@dataclass(slots=True)
class TrackerState:
    """All that a tracker remembers.

    Attributes:
        time_ns: the instant that its tracks hold for.
        counts: what it did.
        tracks: the tracks.
        unpaired: by the numbers of sensors that tell no direction, their ranges that are of no track.
    """

    time_ns: int
    counts: TrackerCounts
    tracks: TrackStoreState
    unpaired: dict[int, UnpairedRanges] = field(default_factory=dict)


class Tracker:
    """Tracks the objects of a group of sensors.

    Args:
        settings: of estimator, association, reflections and life cycle.
        identities: the numbers of new obstacles; shared by the trackers of a run. None: its own.
        cycle_time: the longest of its sensors, s; a tentative obstacle survives one missed scan of it.
        slack_ns: how long an obstacle may be without a detection and not count as coasting: 0 where every cycle is a
            scan of the one sensor, the longest cycle where others come between.
        views: what the sensors can see; an obstacle that has left all of them and is not detected ends early. Without
            any, obstacles end by time alone.
        ranging: the sensors tell ranges and no direction; the place of an object is found by several together.

    Attributes:
        settings: as given.
        detections: those of the latest step as they were taken, placed where the sensor told no direction; None where
            it had none.
        update: what the latest step's detections updated; None where it had none.
        smoother_history: what a smoother needs of the latest step; None unless `keep_smoother_history` was called.
    """

    STAGES: ClassVar[Mapping[str, str]] = {
        "_predict": "predict",
        "_associate": "associate",
        "_place": "associate",
        "_update_tracks": "update",
        "_initiate": "initiate, confirm, delete",
        "_confirm_and_delete": "initiate, confirm, delete",
        "_merge_and_split": "merge and split",
    }
    """What the parts of a step are called where their time is told."""

    def __init__(
        self,
        settings: TrackerSettings,
        identities: Identities | None = None,
        *,
        cycle_time: float = 0.05,
        slack_ns: int = 0,
        views: Sequence[SensorView] = (),
        ranging: bool = False,
    ) -> None:
        self._tentative_coast = max(settings.lifecycle.tentative_coast, MISSED_SCAN * cycle_time)
        self.settings = settings
        self._views = views
        self._slack_ns = slack_ns
        self._initiation = TrackInitiation(settings)
        self._tracks = TrackStore(settings, identities or Identities())
        self._state = TrackerState(0, TrackerCounts(), self._tracks.state)
        self._dt = 0.0
        self._ranges: RangeAssociation | None = None
        if ranging:
            gate, first_speed = settings.association.gate, settings.lifecycle.first_speed
            self._ranges = RangeAssociation(views, gate, first_speed, cycle_time)
        self.update: Update | None = None
        self.detections: Detections | None = None
        self.smoother_history: SmootherHistory | None = None

    def __len__(self) -> int:
        return len(self._tracks.obstacles)

    @property
    def state(self) -> TrackerState:
        """All that it remembers, beside the identities that it shares with others.

        Raises:
            ValueError: a state that is set does not fit the settings, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: TrackerState) -> None:
        if not EARLIEST_NS <= state.time_ns <= LATEST_NS:
            raise ValueError("the tracks' time is out of range")
        if self._ranges is not None:
            self._ranges.check(state.unpaired)
        self._tracks.state = state.tracks
        self._state = state
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
        self._tracks.renumber_sensors(sensors)
        unpaired = self._state.unpaired
        self._state.unpaired = {sensors[of]: ranges for of, ranges in unpaired.items() if of in sensors}

    def keep_smoother_history(self) -> None:
        """Give a `smoother_history` after each step from here on; the obstacles reported do not change by it."""
        self._tracks.estimator.linking = True

    def step(self, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance to the pose's time, with the detections of one scan, or with none to let the tracks coast.

        Predict, associate, update, initiate, confirm and delete, merge and split, report.

        Args:
            detections: of one sensor, at the pose's time.
            pose: ego pose; its time is that of the obstacles reported.

        Returns:
            The obstacles, the tentative ones too.
        """
        self.update = None
        self._predict(pose.time_ns)
        link = self._tracks.smoother_link(self._dt > 0.0) if self._tracks.estimator.linking else None
        if detections is not None:
            if self._ranges is None:
                tracks, rows = self._associate(detections)
            else:
                detections, tracks, rows = self._place(self._ranges, detections, pose)
            nis = self._update_tracks(tracks, rows, detections, pose)
            initiated, unassociated = self._initiate(rows, detections, pose)
            self._record_update(tracks, rows, nis, initiated, unassociated, detections)
        self.detections = detections
        self._confirm_and_delete(pose)
        if detections is not None and self.settings.reflections.merge and len(self):
            motion = self._merge_and_split()
        else:
            motion = self._tracks.motion()
        align_with_course(self._tracks.obstacles, motion.velocity, self._dt, self.settings.travel)
        if link is not None:
            none = np.zeros((len(motion.state), 2))
            self.smoother_history = SmootherHistory(
                self._tracks.obstacles.id, motion.state, motion.covariance, *link, none
            )
        used, travel = self._used(detections), self.settings.travel
        return report(self._tracks, motion, pose, used, self._slack_ns, travel.min_speed)

    def expected_positions(self, horizons: Sequence[float]) -> list[Floats]:
        """Return where each detection of the latest update is expected after times: (m, 2) of each, local frame, m."""
        if self.update is None:
            return [np.zeros((0, 2)) for _ in horizons]
        rows = self.update.reflection
        direction = self._tracks.direction[rows]
        return [self._tracks.estimator.expected_position(rows, horizon, direction) for horizon in horizons]

    def mode_probabilities(self) -> tuple[Integers, Floats]:
        """Return the obstacles' identities (k,) and the weights of the models of their leading reflections (k, M)."""
        obstacles = self._tracks.obstacles
        return obstacles.id, self._tracks.estimator.probability[obstacles.leader]

    def predicted_reflections(self, time_ns: int, sensor: int) -> PredictedReflections:
        """Return where the reflections of confirmed obstacles are expected at a time; the tracks do not change.

        Args:
            time_ns: the instant; at most `LATEST_RETRODICTION` from the latest step.
            sensor: number of the sensor that asks.
        """
        obstacles, reflections = self._tracks.obstacles, self._tracks.reflections
        mean, covariance = self._tracks.states()
        ahead = (time_ns - self._state.time_ns) * 1e-9
        ahead = min(max(ahead, -LATEST_RETRODICTION), LATEST_RETRODICTION)
        owner = reflections.obstacle
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
        return Used(self.update.reflection, detections.sensor, detections.object_id.take(self.update.detection))

    def _predict(self, time_ns: int) -> None:
        """Predict all tracks to an instant, or retrodict them: scans of several sensors may come out of order."""
        dt = (time_ns - self._state.time_ns) * 1e-9 if len(self._tracks.reflections) else 0.0
        self._dt = max(dt, 0.0)
        self._state.time_ns = time_ns
        if dt > 0.0:
            self._tracks.predict(dt)
        elif -LATEST_RETRODICTION < dt < 0.0:
            self._tracks.retrodict(-dt)

    def _associate(self, detections: Detections) -> tuple[Indices, Indices]:
        """Return rows of tracks and of detections that belong together.

        First by the sensor's object ids, where the detection lies within the gate of the id's track; the tracks and
        detections left over by global nearest neighbour.
        """
        tracks, rows = self._tracks_of_ids(detections)
        if self.settings.association.method == "id":
            return tracks, rows
        mean, covariance = self._tracks.states()
        measurement, gate = detections.measurement, self.settings.association.gate
        within = self._within_gate(tracks, measurement.take(rows))
        if not within.all():
            self.counts.slot_jumps += int(len(within) - within.sum())
            tracks, rows = tracks[within], rows[within]
        if len(rows) == len(detections):
            return tracks, rows
        free_tracks, free_rows = np.ones(len(mean), dtype=np.bool_), np.ones(len(detections), dtype=np.bool_)
        free_tracks[tracks] = False
        free_rows[rows] = False
        more_tracks, more_rows = nearest_neighbours(
            mean, covariance, np.flatnonzero(free_tracks), measurement, np.flatnonzero(free_rows), gate
        )
        return np.concatenate([tracks, more_tracks]), np.concatenate([rows, more_rows])

    def _place(
        self, ranges: RangeAssociation, detections: Detections, pose: EgoPose
    ) -> tuple[Detections, Indices, Indices]:
        """Return the ranges whose place is known, as detections, and rows of tracks and of these that belong together.

        The rest of the detections is where the ranges of two sensors meet: these initiate tracks.
        """
        confirmed = self._tracks.obstacles.confirmed[self._tracks.reflections.obstacle]
        placed = ranges.placed(detections, *self._tracks.states(), confirmed, pose, self._state.unpaired)
        self.counts.detections += len(detections) - len(placed.detections)  # given, and not used
        return placed.detections, placed.tracks, np.arange(len(placed.tracks))

    def _within_gate(self, tracks: Indices, measurement: Measurement) -> Booleans:
        """Return which detections (m,) lie within the gate of the tracks (m,) that their ids stand for.

        Where the sensors' noise is estimated, a detection beyond the stated noise is how a sensor gone bad shows: for a
        confirmed obstacle the gate is then as wide as the largest noise that the sensor may have.
        """
        association, estimator = self.settings.association, self._tracks.estimator
        mean, covariance = self._tracks.states()
        confirmed = self._tracks.obstacles.confirmed[self._tracks.reflections.obstacle[tracks]]
        nis = pair_nis(mean[tracks], covariance[tracks], measurement)
        within = nis <= np.where(confirmed, association.id_gate, association.gate)
        outside = np.flatnonzero(confirmed & ~within)
        if estimator.adapting and len(outside):
            far = tracks[outside]
            inflated = estimator.inflated(far, measurement.take(outside))
            within[outside] = pair_nis(mean[far], covariance[far], inflated) <= association.id_gate
        return within

    def _tracks_of_ids(self, detections: Detections) -> tuple[Indices, Indices]:
        """Return the tracks that the sensor's ids stand for, and the rows of their detections.

        An id that comes twice in a scan stands for nothing, nor does that of an object which the sensor calls new, nor
        any of a sensor that tells no identity.
        """
        if not detections.identified:
            return _NONE, _NONE
        found = self._tracks.rows_of(detections.sensor, detections.object_id)
        any_new = np.count_nonzero(detections.new)
        if found.distinct and not any_new:
            return found.tracks, found.detections
        track_of = np.where(detections.new, -1, found.track_of) if any_new else found.track_of
        if not found.distinct:
            track_of = track_of.copy()
            values, first, counts = np.unique(track_of, return_index=True, return_counts=True)
            unique = first[(counts == 1) & (values >= 0)]
            track_of[np.setdiff1d(np.arange(len(track_of)), unique)] = -1
        rows = (track_of >= 0).nonzero()[0]
        return track_of.take(rows), rows

    def _update_tracks(self, tracks: Indices, rows: Indices, detections: Detections, pose: EgoPose) -> Floats:
        """Update the tracks with their detections; return the normalised innovations squared."""
        self.counts.cycles += 1
        self.counts.detections += len(detections)
        obstacles, sensor = self._tracks.obstacles, 1 << detections.sensor
        if compiled.in_use and detections.look < 0:
            compiled.kernels.expect_detections(obstacles.history, obstacles.scans, obstacles.sensors, sensor, _HISTORY)
        else:
            expected = obstacles.sensors & sensor != 0
            if detections.look >= 0:
                expected &= in_look(self._views, detections, pose.to_vehicle(self._tracks.reference_points()))
            obstacles.history = obstacles.history << expected & _HISTORY
            obstacles.scans += expected
        measurement = detections.measurement
        nis = self._tracks.update(tracks, measurement.take(rows))
        self._tracks.record(tracks, rows, detections)
        return nis

    def _initiate(self, rows: Indices, detections: Detections, pose: EgoPose) -> tuple[Indices, Indices]:
        """Initiate a track for each unassociated detection; return the rows of the tracks and of the detections."""
        if len(rows) == len(detections):
            return _NONE, _NONE
        associated = np.zeros(len(detections), dtype=np.bool_)
        associated[rows] = True
        unassociated = np.flatnonzero(~associated)
        first, obstacles = len(self._tracks.reflections), len(self)
        room = max(self.settings.max_tracks - first, 0)
        self.counts.crowded += max(len(unassociated) - room, 0)
        unassociated = unassociated[:room]
        self._initiation.initiate(unassociated, detections, pose, self._tracks)
        self.counts.obstacles += len(self) - obstacles
        return np.arange(first, first + len(unassociated), dtype=np.intp), unassociated

    def _record_update(
        self,
        tracks: Indices,
        rows: Indices,
        nis: Floats,
        initiated: Indices,
        unassociated: Indices,
        detections: Detections,
    ) -> None:
        """Keep what the scan's detections updated or initiated, for those who ask after the step."""
        self.counts.used += len(rows) + len(unassociated)
        if len(unassociated):
            tracks, rows = np.concatenate([tracks, initiated]), np.concatenate([rows, unassociated])
            nis = np.concatenate([nis, np.full(len(unassociated), np.nan)])
        measured = detections.measurement.measured.take(rows)
        if self._ranges is not None:
            measured = measured - 1  # of a place, its distance
        self.update = Update(rows, tracks, nis, measured)

    def _confirm_and_delete(self, pose: EgoPose) -> None:
        """Confirm obstacles detected M times in N scans; delete what is not detected, out of view or too uncertain."""
        obstacles, reflections, lifecycle = self._tracks.obstacles, self._tracks.reflections, self.settings.lifecycle
        settled = np.count_nonzero(obstacles.confirmed) == len(obstacles) == len(reflections)
        if settled and longer_ago(obstacles.last_ns, self._state.time_ns, self._tentative_coast) is None:
            return
        coasted = (self._state.time_ns - obstacles.last_ns) * 1e-9
        missed = coasted > self._tentative_coast
        hits = np.bitwise_count(obstacles.history & (1 << lifecycle.window) - 1)
        promoted = (hits >= lifecycle.confirm) & ~obstacles.confirmed
        if promoted.any():
            obstacles.confirmed |= promoted
            self.counts.confirmed += int(promoted.sum())
        tracked = (obstacles.last_ns - obstacles.first_ns) * 1e-9
        ended = missed & (~obstacles.confirmed | (coasted > np.minimum(lifecycle.coast, tracked)))
        if missed.any():
            ended |= missed & (self._uncertainty() > lifecycle.uncertainty)
            if self._views:
                ended |= missed & ~self._in_view(pose)
        lost = ended[reflections.obstacle]
        if len(reflections) != len(obstacles):
            silent = (self._state.time_ns - reflections.last_ns) * 1e-9 > lifecycle.reflection_coast
            silent[obstacles.leader] = False
            lost |= silent
        if lost.any():
            self._delete(lost, ended)

    def _uncertainty(self) -> Floats:
        """Return the standard deviation of each obstacle's position, m."""
        _, covariance = self._tracks.states()
        lead = self._tracks.obstacles.leader
        return np.asarray(np.sqrt(covariance[lead, 0, 0] + covariance[lead, 1, 1]))

    def _in_view(self, pose: EgoPose) -> Booleans:
        """Return which obstacles lie within some sensor's field of view."""
        points = pose.to_vehicle(self._tracks.reference_points())
        return np.asarray(np.any([view.sees(points) for view in self._views], axis=0))

    def _merge_and_split(self) -> RigidMotion:
        """Hand over reference points, split what moves apart, merge what moves together; return how all move."""
        tracks, settings = self._tracks, self.settings.reflections
        obstacles, reflections = tracks.obstacles, tracks.reflections
        mean, _ = tracks.states()
        hand_over_reference(obstacles, reflections, mean, self._state.time_ns, settings)
        motion = tracks.motion()
        splitting = split_candidates(obstacles, reflections, mean, motion, settings)
        if splitting.any():
            detected = reflections.last_ns == self._state.time_ns
            before = len(obstacles)
            tracks.split(np.flatnonzero(splitting & detected))
            self.counts.obstacles += len(obstacles) - before
            self._delete(splitting & ~detected, np.zeros(len(obstacles), dtype=np.bool_))
            motion = tracks.motion()
        if len(obstacles) > 1 and self._merge(motion):
            motion = tracks.motion()
        return motion

    def _merge(self, motion: RigidMotion) -> bool:
        """Merge the younger of two obstacles that stay alongside each other into the older; return whether any was."""
        tracks, settings = self._tracks, self.settings.reflections
        obstacles = tracks.obstacles
        older = merge_candidates(obstacles, motion, settings)
        alongside = older >= 0
        obstacles.alongside_ns = np.where(alongside, obstacles.alongside_ns + int(self._dt * 1e9), 0)
        merging = np.flatnonzero(alongside & (obstacles.alongside_ns >= int(settings.merge_time * 1e9)))
        if not len(merging):
            return False
        merged = np.zeros(len(obstacles), dtype=np.bool_)
        for young, old in zip(merging.tolist(), older[merging].tolist(), strict=True):
            if not merged[old]:
                tracks.merge(young, old)
                merged[young] = True
        self.counts.merged += int(merged.sum())
        self._delete(np.zeros(len(tracks.reflections), dtype=np.bool_), merged)
        return True

    def _delete(self, lost: Booleans, ended: Booleans) -> None:
        """Delete reflections and obstacles; the latest update keeps the rows that are left."""
        new_row = self._tracks.delete(lost, ended)
        if self.update is not None:
            kept = ~lost[self.update.reflection]
            self.update = Update(
                self.update.detection[kept],
                new_row[self.update.reflection[kept]],
                self.update.nis[kept],
                self.update.degrees_of_freedom[kept],
            )
