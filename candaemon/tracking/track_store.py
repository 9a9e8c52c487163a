"""All tracks of a group of sensors: reflections, the obstacles that they make up, and their filter.

The tables and the filter keep the same rows in the same order; rows are appended and deleted here alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.arrays.rows import checked_state
from candaemon.config.tracker import TrackerSettings
from candaemon.estimation.estimator_state import EstimatorState
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.smoothing import Link
from candaemon.radar.detections import Detections
from candaemon.tracking.columns import ObstacleTable, ReflectionTable
from candaemon.tracking.estimator_factory import make_estimator
from candaemon.tracking.id_rows import IdRows
from candaemon.tracking.identities import Identities
from candaemon.tracking.reflections import RigidMotion, change_reference, decay_offsets, from_travel_axes, rigid_motion
from candaemon.tracking.table_rows import check_rows, renumbered, renumbered_bits, renumbered_ids


@dataclass(slots=True)
class TrackStoreState:
    """All that is remembered of the tracks.

    Attributes:
        reflections: one row a detected point.
        obstacles: one row a vehicle.
        estimator: of the filter, one row a reflection.
        row_of: row of the reflection that a sensor's object id stands for, by the sensor's number and the id. Where
            the sensors' noise is estimated, a reflection keeps an id of each sensor, since only the id shows what a
            sensor gone bad still detects; else that of the sensor that reported it last.
    """

    reflections: ReflectionTable
    obstacles: ObstacleTable
    estimator: EstimatorState
    row_of: dict[tuple[int, int], int] = field(default_factory=dict)


@dataclass(slots=True)  # made each cycle
class RowsOfScan:
    """What the ids of a sensor's scan stand for; the arrays are not to be written to.

    Attributes:
        ids: of the scan, as bytes.
        track_of: rows of tracks (m,), −1 where an id stands for nothing.
        distinct: whether no id comes twice, nor a row.
        tracks, detections: rows of tracks and of detections that belong together, without those that stand for nothing.
    """

    ids: bytes
    track_of: Indices
    distinct: bool
    tracks: Indices
    detections: Indices


class TrackStore:
    """The tracks that live.

    Args:
        settings: of the tracker.
        identities: the numbers of new obstacles.

    Attributes:
        reflections: one row a detected point.
        obstacles: one row a vehicle.
        estimator: one row a reflection.
    """

    def __init__(self, settings: TrackerSettings, identities: Identities) -> None:
        self._identities = identities
        self._settings = settings.reflections
        self.reflections = ReflectionTable()
        self.obstacles = ObstacleTable()
        self.estimator = make_estimator(settings.estimator)
        self._state = TrackStoreState(self.reflections, self.obstacles, self.estimator.state)
        # computed from the state when first asked for
        self._rows_of_scan: dict[int, RowsOfScan] = {}
        self._id_rows = IdRows()
        self._moments: tuple[Floats, Floats] | None = None

    @property
    def state(self) -> TrackStoreState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit the settings, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: TrackStoreState) -> None:
        obstacles = checked_state(state.obstacles, ObstacleTable())
        reflections = checked_state(state.reflections, ReflectionTable())
        self.estimator.state = state.estimator
        if len(reflections) != len(self.estimator):
            raise ValueError(f"found {len(self.estimator)} filters for {len(reflections)} reflections")
        check_rows(reflections.obstacle, obstacles.leader, obstacles.id, state.row_of.values())
        self._state, self.reflections, self.obstacles = state, reflections, obstacles
        self._forget_rows()
        self._moments = None

    @property
    def row_of(self) -> Mapping[tuple[int, int], int]:
        """Row of the reflection that a sensor's object id stands for, by the sensor's number and the id."""
        return self._state.row_of

    @property
    def direction(self) -> Floats:
        """Direction of travel of each reflection (n, 2)."""
        return self.obstacles.direction.take(self.reflections.obstacle, axis=0)

    def states(self) -> tuple[Floats, Floats]:
        """Return combined means (n, 6) and covariances (n, 6, 6) of the reflections."""
        if self._moments is None:
            self._moments = self.estimator.combined()
        return self._moments

    def motion(self) -> RigidMotion:
        """Return the motion of the obstacles."""
        return rigid_motion(self.obstacles, self.reflections, *self.states())

    def reference_points(self) -> Floats:
        """Return the obstacles' reference points (k, 2), local frame, m."""
        obstacles = self.obstacles
        return self.states()[0][obstacles.leader, :2] + from_travel_axes(obstacles.offset, obstacles.direction)

    def predict(self, dt: float) -> None:
        """Predict all tracks by dt, s.

        The reference points' return to their leading reflections is a part of the prediction, so that a smoother does
        not take it for a correction.
        """
        self.estimator.predict(dt, self.direction)
        decay_offsets(self.obstacles, dt, self._settings)
        self._moments = None

    def retrodict(self, dt: float) -> None:
        """Retrodict all tracks by a short dt, s."""
        self.estimator.retrodict(dt)
        self._moments = None

    def smoother_link(self, moved: bool) -> tuple[Integers, Link]:
        """Return the obstacles' identities and what a smoother needs of their prediction; to be called right after it.

        Where time has not moved on, as in a scan that comes after a younger one, the gain is the identity: a correction
        of the state is one of the state before, and the smoother's chain does not break.

        Args:
            moved: whether the tracks were predicted.
        """
        motion, link = self.motion(), self.estimator.link
        gain = np.broadcast_to(np.eye(6), motion.covariance.shape)
        if moved and link is not None:
            gain = link.gain[self.obstacles.leader]
        return self.obstacles.id, Link(motion.state, motion.covariance, gain)

    def update(self, tracks: Indices, measurement: Measurement) -> Floats:
        """Update reflections with a measurement each; return the normalised innovations squared."""
        nis = self.estimator.update(tracks, measurement)
        self._moments = None
        return nis

    def record(self, tracks: Indices, rows: Indices, detections: Detections) -> None:
        """Record which detections updated which reflections."""
        reflections, obstacles, sensor = self.reflections, self.obstacles, detections.sensor
        if compiled.in_use:
            renamings = compiled.kernels.record_detections(
                tracks,
                rows,
                detections.object_id,
                reflections.object_id,
                reflections.sensor,
                reflections.obstacle,
                reflections.last_ns,
                obstacles.last_ns,
                obstacles.history,
                obstacles.sensors,
                sensor,
                detections.time_ns,
            )
            if not (renamings and detections.identified):
                return
        keys = detections.object_id[rows]
        renamed = (reflections.object_id[tracks] != keys) | (reflections.sensor[tracks] != sensor)
        if detections.identified and renamed.any():
            for track, key in zip(tracks[renamed].tolist(), keys[renamed].tolist(), strict=True):
                self.assign_id(track, sensor, key)
        reflections.last_ns[tracks] = detections.time_ns
        owners = reflections.obstacle[tracks]
        obstacles.last_ns[owners] = detections.time_ns
        obstacles.history[owners] |= 1
        obstacles.sensors[owners] |= 1 << sensor

    def rows_of(self, sensor: int, object_id: Integers) -> RowsOfScan:
        """Return the rows that a sensor's ids stand for.

        A scan whose ids are those of the sensor's scan before costs a comparison.
        """
        ids, known = object_id.tobytes(), self._rows_of_scan.get(sensor)
        if known is not None and known.ids == ids:
            return known
        rows, distinct = self._id_rows.of(self._state.row_of, sensor, object_id)
        detections = (rows >= 0).nonzero()[0]
        found = RowsOfScan(ids, rows, distinct, rows.take(detections), detections)
        self._rows_of_scan[sensor] = found
        return found

    def _forget_rows(self) -> None:
        """Forget what ids stand for, as far as it was computed from the state."""
        self._rows_of_scan.clear()
        self._id_rows.clear()

    def assign_id(self, track: int, sensor: int, key: int) -> None:
        """Assign a sensor's object id to a reflection; it no longer stands for another."""
        self._forget_rows()
        reflections = self.reflections
        row_of = self._state.row_of
        former = row_of.get((sensor, key))
        if former != track:
            for replaced in self._replaced_ids(track, sensor):
                del row_of[replaced]
        if former is not None and reflections.sensor[former] == sensor:
            reflections.object_id[former] = -1
        row_of[sensor, key] = track
        reflections.sensor[track], reflections.object_id[track] = sensor, key

    def _replaced_ids(self, track: int, sensor: int) -> list[tuple[int, int]]:
        """Return the ids that a reflection loses once a sensor gives it another."""
        if self.estimator.adapting:
            return [each for each, row in self.row_of.items() if row == track and each[0] == sensor]
        latest = int(self.reflections.sensor[track]), int(self.reflections.object_id[track])
        return [latest] if self.row_of.get(latest) == track else []

    def add_obstacle(self, time_ns: int, direction: Floats) -> int:
        """Append an obstacle that the next reflection will lead; return its row.

        Args:
            time_ns: of its first detection.
            direction: of travel (2,).
        """
        zero = np.zeros(1, dtype=np.int64)
        self.obstacles.append(
            id=np.array([self._identities.new()]),
            first_ns=np.array([time_ns]),
            last_ns=np.array([time_ns]),
            history=zero,
            scans=zero,
            confirmed=np.zeros(1, dtype=np.bool_),
            leader=np.array([len(self.reflections)]),
            offset=np.zeros((1, 2)),
            direction=direction[None],
            forward=np.zeros(1),
            alongside_ns=zero,
            sensors=zero,
        )
        return len(self.obstacles) - 1

    def add_reflection(self, owner: int, sensor: int, key: int | None, time_ns: int) -> None:
        """Append the reflection whose row the filter has just appended, as one of an obstacle.

        Args:
            owner: row of the obstacle.
            sensor: that detected it.
            key: the sensor's object id; None where it tells none.
            time_ns: of the detection.
        """
        track = len(self.reflections)
        self.reflections.append(
            sensor=np.array([sensor]),
            object_id=np.array([-1]),
            obstacle=np.array([owner]),
            last_ns=np.array([time_ns]),
        )
        if key is not None:
            self.assign_id(track, sensor, key)
        self.obstacles.last_ns[owner] = time_ns
        self.obstacles.history[owner] |= 1
        self.obstacles.sensors[owner] |= 1 << sensor
        self._moments = None

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers, and forget those left out: their ids, and the obstacles that only they have seen.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        obstacles, reflections = self.obstacles, self.reflections
        self._forget_rows()
        self._state.row_of = renumbered_ids(self._state.row_of, sensors)
        reflections.sensor = renumbered(reflections.sensor, sensors)
        reflections.object_id[reflections.sensor < 0] = -1
        obstacles.sensors = renumbered_bits(obstacles.sensors, sensors)
        self.estimator.renumber_sensors(sensors)
        ended = obstacles.sensors == 0
        if ended.any():
            self.delete(ended[reflections.obstacle], ended)

    def split(self, splitting: Indices) -> None:
        """Give each of the reflections a tentative obstacle of its own, as old as the one that it leaves."""
        obstacles, reflections = self.obstacles, self.reflections
        owner = reflections.obstacle[splitting]
        first = len(obstacles)
        obstacles.append(
            id=np.array([self._identities.new() for _ in splitting], dtype=np.int64),
            first_ns=obstacles.first_ns[owner],
            last_ns=reflections.last_ns[splitting],
            history=np.ones(len(splitting), dtype=np.int64),
            scans=np.zeros(len(splitting), dtype=np.int64),
            confirmed=np.zeros(len(splitting), dtype=np.bool_),
            leader=splitting.astype(np.int64),
            offset=np.zeros((len(splitting), 2)),
            direction=obstacles.direction[owner],
            forward=obstacles.forward[owner],
            alongside_ns=np.zeros(len(splitting), dtype=np.int64),
            sensors=obstacles.sensors[owner],
        )
        reflections.obstacle[splitting] = np.arange(first, len(obstacles))

    def merge(self, young: int, old: int) -> None:
        """Merge an obstacle into an older one; the row that is left without reflections is to be deleted."""
        obstacles = self.obstacles
        self.reflections.obstacle[self.reflections.obstacle == young] = old
        if obstacles.last_ns[young] > obstacles.last_ns[old]:
            change_reference(obstacles, np.array([old]), obstacles.leader[[young]], self.states()[0])
        obstacles.last_ns[old] = max(obstacles.last_ns[old], obstacles.last_ns[young])
        obstacles.history[old] |= obstacles.history[young]
        obstacles.scans[old] = max(obstacles.scans[old], obstacles.scans[young])
        obstacles.sensors[old] |= obstacles.sensors[young]

    def delete(self, lost: Booleans, ended: Booleans) -> Indices:
        """Delete reflections and obstacles.

        Args:
            lost: reflections (n,) to delete, among them all those of an ended obstacle.
            ended: obstacles (k,) to delete.

        Returns:
            The new row of each reflection kept, by its old row.
        """
        new_row = np.cumsum(~lost) - 1
        new_owner = np.cumsum(~ended) - 1
        self.estimator.keep(~lost)
        self.reflections.keep(~lost)
        self.reflections.obstacle = new_owner[self.reflections.obstacle]
        self.obstacles.keep(~ended)
        self.obstacles.leader = new_row[self.obstacles.leader]
        gone = lost.tolist()
        self._forget_rows()
        row_of = self._state.row_of
        self._state.row_of = {key: int(new_row[row]) for key, row in row_of.items() if not gone[row]}
        self._moments = None
        return new_row
