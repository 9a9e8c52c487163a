"""The tracker: detections of a scan in, obstacles with a lasting identity out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import Measurement
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView
from candaemon.tracking.association import nearest_neighbours, pair_nis
from candaemon.tracking.identities import Identities
from candaemon.tracking.initiation import TrackInitiation
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.reflections import beside_an_older, parted, pass_the_lead, turn_to_course
from candaemon.tracking.reporting import tell
from candaemon.tracking.smoother_history import SmootherHistory
from candaemon.tracking.track_store import TrackStore, TrackStoreState
from candaemon.tracking.update import TrackerCounts, Update, Used

_MISSED_SCAN = 2.4  # cycles: two, and the jitter of a scan
_CROSSING = 0.5  # s by which a scan may come after a younger one and still tell where things were
_HISTORY = (1 << 32) - 1
_NONE = np.empty(0, dtype=np.intp)


@dataclass(slots=True)
class TrackerState:
    """All that a tracker remembers.

    Attributes:
        time_ns: the instant that its tracks hold for.
        counts: what it did.
        tracks: the tracks.
    """

    time_ns: int
    counts: TrackerCounts
    tracks: TrackStoreState


class Tracker:
    """Tracks the objects of a group of sensors.

    Args:
        settings: how.
        identities: the numbers of new obstacles; shared by the trackers of a run. None: its own.
        cycle_time: the longest of its sensors, s; a tentative obstacle survives one missed scan of it.
        slack_ns: how long an obstacle may be without a detection and not count as coasting: 0 where every cycle is a
            scan of the one sensor, the longest cycle where others come between.
        views: what the sensors can see; an obstacle that has left all of them and is not detected ends early. Without
            any, obstacles end by time alone.

    Attributes:
        settings: as given.
        update: what the latest step's detections updated; None where it had none.
        trail: what a smoother needs of the latest step; None unless `leave_trail` was called before.
    """

    def __init__(
        self,
        settings: TrackerSettings,
        identities: Identities | None = None,
        *,
        cycle_time: float = 0.05,
        slack_ns: int = 0,
        views: Sequence[SensorView] = (),
    ) -> None:
        self._tentative_coast = max(settings.lifecycle.tentative_coast, _MISSED_SCAN * cycle_time)
        self.settings = settings
        self._views = views
        self._slack_ns = slack_ns
        self._births = TrackInitiation(settings)
        self._tracks = TrackStore(settings, identities or Identities())
        self._uses_direction = settings.reflections.merge or self._tracks.estimator.directional
        self._state = TrackerState(0, TrackerCounts(), self._tracks.state)
        self._dt = 0.0
        self.update: Update | None = None
        self.trail: SmootherHistory | None = None

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
        self._tracks.state = state.tracks
        self._state = state
        self.update = None
        self.trail = None

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

    def leave_trail(self) -> None:
        """Leave a `trail` after each step from here on; nothing that is told changes by it."""
        self._tracks.estimator.linking = True

    def step(self, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance to the pose's time, with the detections of one scan, or with none to let the tracks coast.

        Args:
            detections: of one sensor, at the pose's time.
            pose: own pose; its time is that of the obstacles told.
        """
        self.update = None
        self._predict(pose.time_ns)
        linked = self._tracks.linked(self._dt > 0.0) if self._tracks.estimator.linking else None
        if detections is not None:
            tracks, rows = self._associate(detections)
            nis = self._correct(tracks, rows, detections)
            born, free = self._bear(rows, detections, pose)
            self._note_update(tracks, rows, nis, born, free, detections)
        self._end_lives(pose)
        if detections is not None and self.settings.reflections.merge and len(self):
            self._settle()
        motion = self._tracks.motion()
        if self._uses_direction:
            turn_to_course(self._tracks.obstacles, motion.velocity, self._dt, self.settings.travel)
        if linked is not None:
            self.trail = SmootherHistory(self._tracks.obstacles.id, motion.state, motion.covariance, *linked)
        return tell(self._tracks, motion, pose, self._used(detections), self._slack_ns)

    def expected_positions(self, horizon: float) -> Floats:
        """Return where each detection of the latest update is expected after a time: (m, 2), level frame, m."""
        if self.update is None:
            return np.zeros((0, 2))
        rows = self.update.reflection
        return self._tracks.estimator.expected_position(rows, horizon, self._tracks.direction[rows])

    def _used(self, detections: Detections | None) -> Used:
        """Return what this cycle's detections updated."""
        if self.update is None or detections is None:
            return Used(_NONE, 0, np.empty(0, dtype=np.int64))
        return Used(self.update.reflection, detections.sensor, detections.object_id[self.update.detection])

    def _predict(self, time_ns: int) -> None:
        """Predict all tracks to an instant, or take them back to one just passed: sensors' scans may cross."""
        dt = (time_ns - self._state.time_ns) * 1e-9 if len(self._tracks.reflections) else 0.0
        self._dt = max(dt, 0.0)
        self._state.time_ns = time_ns
        if dt > 0.0:
            self._tracks.predict(dt)
        elif -_CROSSING < dt < 0.0:
            self._tracks.retreat(-dt)

    def _associate(self, detections: Detections) -> tuple[Indices, Indices]:
        """Return rows of tracks and of detections that belong together.

        The sensor's id is the first guess, behind a gate; what is left over on both sides goes to the nearest.
        """
        tracks, rows = self._guess(detections)
        if self.settings.association.method == "id":
            return tracks, rows
        mean, covariance = self._tracks.states()
        measurement, gate = detections.measurement, self.settings.association.gate
        fits = self._fits(tracks, measurement.take(rows))
        if not fits.all():
            self.counts.slot_jumps += int(len(fits) - fits.sum())
            tracks, rows = tracks[fits], rows[fits]
        if len(rows) == len(detections):
            return tracks, rows
        busy, taken = np.zeros(len(mean), dtype=np.bool_), np.zeros(len(detections), dtype=np.bool_)
        busy[tracks] = True
        taken[rows] = True
        more_tracks, more_rows = nearest_neighbours(
            mean, covariance, np.flatnonzero(~busy), measurement, np.flatnonzero(~taken), gate
        )
        return np.concatenate([tracks, more_tracks]), np.concatenate([rows, more_rows])

    def _fits(self, tracks: Indices, measurement: Measurement) -> Booleans:
        """Tell which detections (m,) can be of the tracks (m,) that their ids stand for.

        What does not fit the stated noise is how a sensor gone bad is found out: where it is, the id of a confirmed
        obstacle is believed as far as the sensor may have become worse.
        """
        association, estimator = self.settings.association, self._tracks.estimator
        mean, covariance = self._tracks.states()
        sure = self._tracks.obstacles.confirmed[self._tracks.reflections.obstacle[tracks]]
        nis = pair_nis(mean[tracks], covariance[tracks], measurement)
        fits = nis <= np.where(sure, association.id_gate, association.gate)
        doubted = np.flatnonzero(sure & ~fits)
        if estimator.adapting and len(doubted):
            far = tracks[doubted]
            believed = estimator.believed(far, measurement.take(doubted))
            fits[doubted] = pair_nis(mean[far], covariance[far], believed) <= association.id_gate
        return fits

    def _guess(self, detections: Detections) -> tuple[Indices, Indices]:
        """Return the tracks that the sensor's ids stand for; an id that comes twice in a scan stands for nothing."""
        guess, distinct = self._tracks.rows_of(detections.sensor, detections.object_id)
        if np.count_nonzero(detections.new):
            guess = np.where(detections.new, -1, guess)
        if not distinct:
            guess = guess.copy()
            values, first, counts = np.unique(guess, return_index=True, return_counts=True)
            unique = first[(counts == 1) & (values >= 0)]
            guess[np.setdiff1d(np.arange(len(guess)), unique)] = -1
        rows = (guess >= 0).nonzero()[0]
        return guess.take(rows), rows

    def _correct(self, tracks: Indices, rows: Indices, detections: Detections) -> Floats:
        """Update the tracks with their detections; return the normalised innovations squared."""
        self.counts.cycles += 1
        self.counts.detections += len(detections)
        obstacles = self._tracks.obstacles
        expecting = obstacles.sensors & (1 << detections.sensor) != 0
        obstacles.history = obstacles.history << expecting & _HISTORY
        obstacles.scans += expecting
        measurement = detections.measurement
        nis = self._tracks.update(tracks, measurement.take(rows))
        self._tracks.note(tracks, rows, detections)
        return nis

    def _bear(self, rows: Indices, detections: Detections, pose: EgoPose) -> tuple[Indices, Indices]:
        """Begin a track for each detection that found none; return the rows of both."""
        if len(rows) == len(detections):
            return _NONE, _NONE
        taken = np.zeros(len(detections), dtype=np.bool_)
        taken[rows] = True
        free = np.flatnonzero(~taken)
        first, obstacles = len(self._tracks.reflections), len(self)
        room = max(self.settings.max_tracks - first, 0)
        self.counts.crowded += max(len(free) - room, 0)
        free = free[:room]
        self._births.bear(free, detections, pose, self._tracks)
        self.counts.obstacles += len(self) - obstacles
        return np.arange(first, first + len(free), dtype=np.intp), free

    def _note_update(
        self, tracks: Indices, rows: Indices, nis: Floats, born: Indices, free: Indices, detections: Detections
    ) -> None:
        self.counts.used += len(rows) + len(free)
        if len(free):
            tracks, rows = np.concatenate([tracks, born]), np.concatenate([rows, free])
            nis = np.concatenate([nis, np.full(len(free), np.nan)])
        self.update = Update(rows, tracks, nis, detections.measurement.measured[rows])

    def _end_lives(self, pose: EgoPose) -> None:
        """Confirm what was seen often enough; let go of what is unseen for too long, lost from view, or anywhere."""
        obstacles, reflections, lifecycle = self._tracks.obstacles, self._tracks.reflections, self.settings.lifecycle
        silent = (self._state.time_ns - obstacles.last_ns) * 1e-9
        unseen = silent > self._tentative_coast
        if len(reflections) == len(obstacles) and not (unseen | ~obstacles.confirmed).any():
            return
        hits = np.bitwise_count(obstacles.history & (1 << lifecycle.window) - 1)
        born = (hits >= lifecycle.confirm) & ~obstacles.confirmed
        if born.any():
            obstacles.confirmed |= born
            self.counts.confirmed += int(born.sum())
        seen = (obstacles.last_ns - obstacles.first_ns) * 1e-9
        over = unseen & (~obstacles.confirmed | (silent > np.minimum(lifecycle.coast, seen)))
        if unseen.any():
            over |= unseen & (self._uncertainty() > lifecycle.uncertainty)
            if self._views:
                over |= unseen & ~self._in_view(pose)
        lost = over[reflections.obstacle]
        if len(reflections) != len(obstacles):
            quiet = (self._state.time_ns - reflections.last_ns) * 1e-9 > lifecycle.reflection_coast
            quiet[obstacles.leader] = False
            lost |= quiet
        if lost.any():
            self._drop(lost, over)

    def _uncertainty(self) -> Floats:
        """Return the standard deviation of each obstacle's place, m."""
        _, covariance = self._tracks.states()
        lead = self._tracks.obstacles.leader
        return np.asarray(np.sqrt(covariance[lead, 0, 0] + covariance[lead, 1, 1]))

    def _in_view(self, pose: EgoPose) -> Booleans:
        """Tell which obstacles some sensor should see."""
        points = pose.to_vehicle(self._tracks.reference())
        return np.asarray(np.any([view.sees(points) for view in self._views], axis=0))

    def _settle(self) -> None:
        """Pass the lead, part what moves apart, join what moves together."""
        tracks, settings = self._tracks, self.settings.reflections
        obstacles, reflections = tracks.obstacles, tracks.reflections
        mean, _ = tracks.states()
        pass_the_lead(obstacles, reflections, mean, self._state.time_ns, settings)
        leaving = parted(obstacles, reflections, mean, tracks.motion(), settings)
        if leaving.any():
            detected = reflections.last_ns == self._state.time_ns
            before = len(obstacles)
            tracks.part(np.flatnonzero(leaving & detected))
            self.counts.obstacles += len(obstacles) - before
            self._drop(leaving & ~detected, np.zeros(len(obstacles), dtype=np.bool_))
        if len(obstacles) > 1:
            self._join()

    def _join(self) -> None:
        """Let the younger of two obstacles that stay side by side become part of the older."""
        tracks, settings = self._tracks, self.settings.reflections
        obstacles = tracks.obstacles
        older = beside_an_older(obstacles, tracks.motion(), settings)
        obstacles.beside_ns = np.where(older >= 0, obstacles.beside_ns + int(self._dt * 1e9), 0)
        joining = np.flatnonzero((older >= 0) & (obstacles.beside_ns >= int(settings.merge_time * 1e9)))
        over = np.zeros(len(obstacles), dtype=np.bool_)
        for young, old in zip(joining.tolist(), older[joining].tolist(), strict=True):
            if not over[old]:
                tracks.absorb(young, old)
                over[young] = True
        if over.any():
            self.counts.merged += int(over.sum())
            self._drop(np.zeros(len(tracks.reflections), dtype=np.bool_), over)

    def _drop(self, lost: Booleans, over: Booleans) -> None:
        """Forget tracks, and let the latest update point at the rows that are left."""
        new_row = self._tracks.drop(lost, over)
        if self.update is not None:
            kept = ~lost[self.update.reflection]
            self.update = Update(
                self.update.detection[kept],
                new_row[self.update.reflection[kept]],
                self.update.nis[kept],
                self.update.freedom[kept],
            )


def same_filter(former: Tracker, successor: Tracker) -> bool:
    """Return whether the state of one tracker means the same in another: both have the same filter and extent model."""
    before, after = former.settings, successor.settings
    return before.estimator == after.estimator and before.reflections == after.reflections
