"""What a report draws of a drive, gathered as arrays while it is replayed; in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats, Indices
from candaemon.ego.pose import EgoStatus
from candaemon.evaluation.drive_score import DriveScore
from candaemon.exports.drive_sink import DriveSink
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.detections import Detections

MOST_ROWS: Final = 2_000_000
"""Rows of obstacles, or predictions, that are kept for the drawings; figures count all of them."""
_MOST_WAITING: Final = 2000
"""Scans whose expected errors wait for the measurements of later ones."""


@dataclass(slots=True)
class Columns:
    """Arrays that grow by parts.

    Attributes:
        rows: so far.
        left_out: rows that came when `MOST_ROWS` were there.
    """

    names: tuple[str, ...]
    rows: int = 0
    left_out: int = 0
    _parts: list[tuple[Floats, ...]] = field(default_factory=list)

    def add(self, *parts: NDArray[Any]) -> None:
        """Add rows, one array for each name."""
        rows = len(parts[0])
        if self.rows + rows > MOST_ROWS:
            self.left_out += rows
            return
        self.rows += rows
        self._parts.append(tuple(np.asarray(part, np.float64) for part in parts))

    def arrays(self) -> dict[str, Floats]:
        """Return the whole columns."""
        if not self._parts:
            return {name: np.empty(0) for name in self.names}
        return dict(zip(self.names, map(np.concatenate, zip(*self._parts, strict=True)), strict=True))


class DriveRecord(DriveSink):
    """Gathers what is drawn. Times are s since the drive's first cycle, which is at `begin_ns`.

    Args:
        sensors: names by index.

    Attributes:
        begin_ns: of the first cycle; None before it.
        obstacles: rows of all obstacles: cycle's time, id, state, place in the local frame and, where it is known, on
            earth (deg).
        cycles: time, time of closing, sensor (−1: none), sum of NIS, of degrees of freedom, updates, frames lost so
            far, own place, own place on earth.
        predictions: due time, sensor, horizon's index, errors along and across, their expected standard deviations.
        moments: of updates: time, obstacle, NIS, degrees of freedom.
        raw: of detections: time, sensor, run of the same object, first and second coordinate, range rate.
    """

    def __init__(self, sensors: tuple[str, ...]) -> None:
        self.sensors = sensors
        self.begin_ns: int | None = None
        self.obstacles = Columns(("time", "id", "state", "east", "north", "latitude", "longitude"))
        self.cycles = Columns(
            ("time", "closed", "sensor", "nis", "freedom", "updates", "lost", "east", "north", "latitude", "longitude")
        )
        self.predictions = Columns(("time", "sensor", "horizon", "x", "y", "sx", "sy"))
        self.moments = Columns(("time", "id", "nis", "freedom"))
        self.raw = Columns(("time", "sensor", "object", "new", "first", "second", "rate"))
        self._expected: dict[tuple[int, int], Floats] = {}
        self._horizons: tuple[float, ...] = ()

    def attach(self, score: DriveScore) -> None:
        """Take the errors of predictions as they are found."""
        score.predictions.listener = self._predicted
        self._horizons = score.predictions.horizons

    def add_cycle(self, cycle: Cycle, pipeline: Pipeline) -> None:
        """Take a cycle."""
        obstacles, pose = cycle.obstacles, cycle.pose
        if self.begin_ns is None:
            self.begin_ns = obstacles.time_ns
        time = (obstacles.time_ns - self.begin_ns) * 1e-9
        n, unknown = len(obstacles), np.full(len(obstacles), np.nan)
        latitude = longitude = unknown
        own = [pose.east, pose.north, np.nan, np.nan] if pose.status is not EgoStatus.LOST else [np.nan] * 4
        if cycle.georeference is not None:
            places = np.append(obstacles.east, pose.east), np.append(obstacles.north, pose.north)
            latitude, longitude = map(np.degrees, cycle.georeference.to_earth(*places))
            own[2:], latitude, longitude = [latitude[-1], longitude[-1]], latitude[:-1], longitude[:-1]
        self.obstacles.add(
            np.full(n, time), obstacles.id, obstacles.state, obstacles.east, obstacles.north, latitude, longitude
        )
        update = cycle.update
        nis, freedom, owners = np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64)
        if update is not None and cycle.detections is not None:
            known = np.isfinite(update.nis)
            nis, freedom = update.nis[known], update.degrees_of_freedom[known]
            owners = obstacles.id[obstacles.used_row][known]
            self._expect(cycle, cycle.detections, update.detection)
        self.moments.add(np.full(len(nis), time), owners, nis, freedom)
        figures = [
            time,
            (cycle.time_ns - self.begin_ns) * 1e-9,
            -1 if cycle.detections is None else cycle.detections.sensor,
            nis.sum(),
            freedom.sum(),
            len(nis),
            pipeline.drops,
            *own,
        ]
        self.cycles.add(*(np.array([figure]) for figure in figures))
        if cycle.detections is not None:
            self._add_raw(time, cycle.detections, pipeline)

    def _expect(self, cycle: Cycle, detections: Detections, rows: Indices) -> None:
        """Keep how far the detections of a scan may be from where they are expected later.

        Of each used detection and axis: variance of place and measurement, covariance of place and velocity, variance
        of the velocity, in vehicle axes; (2, 3, m).
        """
        covariance = cycle.obstacles.covariance[cycle.obstacles.used_row]
        turn = cycle.pose.rotation
        noise = turn.T @ detections.measurement.noise[rows] @ turn
        self._expected[detections.sensor, detections.time_ns] = np.array(
            [
                [covariance[:, k, k] + noise[:, k, k], covariance[:, k, k + 2], covariance[:, k + 2, k + 2]]
                for k in (0, 1)
            ]
        )
        if len(self._expected) > _MOST_WAITING:
            del self._expected[next(iter(self._expected))]

    def _predicted(self, sensor: int, made_ns: int, horizon: int, rows: Indices, x: Floats, y: Floats) -> None:
        """Take the errors of predictions that are due: of some rows of the detections used at a time."""
        expected = self._expected.get((sensor, made_ns))
        if expected is None or self.begin_ns is None:
            return
        ahead = self._horizons[horizon]
        place, both, velocity = np.moveaxis(expected[:, :, rows], 1, 0)
        deviation = np.sqrt(np.maximum(place + 2 * ahead * both + ahead * ahead * velocity, 0.0))
        due = (made_ns - self.begin_ns) * 1e-9 + ahead
        n = len(rows)
        self.predictions.add(np.full(n, due), np.full(n, sensor), np.full(n, horizon), x, y, deviation[0], deviation[1])

    def _add_raw(self, time: float, detections: Detections, pipeline: Pipeline) -> None:
        """Take what the sensor measured, in its own axes and coordinates."""
        settings = pipeline.binding.sensors[detections.sensor].settings
        mount, yaw = settings.mount, np.radians(settings.mount.yaw_deg)
        place = (detections.x - mount.x + 1j * (detections.y - mount.y)) * np.exp(-1j * yaw)
        polar = settings.signals.polar
        rate = detections.measurement.range_rate
        self.raw.add(
            np.full(len(detections), time),
            np.full(len(detections), detections.sensor),
            detections.object_id,
            detections.new,
            np.abs(place) if polar else place.real,
            np.angle(place) if polar else place.imag,
            np.full(len(detections), np.nan) if rate is None else rate,
        )
