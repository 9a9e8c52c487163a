"""Reference N: a constant-velocity Kalman filter for each slot of a radar, as one writes it with filterpy.

State [x, y, vx, vy] in the local frame; white acceleration; position and every speed that the sensor gives, range rate
linearised at the prediction (an extended filter); Joseph form of the update, as filterpy has it. It begins where the
slot's object is called new, jumps or comes back after a pause. Every slot of a sensor's latest scan is an obstacle, and
so is one that it misses for a few scans, where it had been seen a few times.

All slots, and all process noises of a grid, are computed at once; `tests/accuracy/test_references.py` holds that the
numbers are those of `filterpy.kalman.KalmanFilter`, one object a slot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import Measurement
from candaemon.evaluation.tables import TrackTable
from candaemon.radar.detections import Detections
from candaemon.simulation.scenario import NoiseOverride
from candaemon.tracking.obstacles import CONFIRMED
from tests.accuracy.simulated_runs import TrackRows

GRID: Final = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Power spectral densities of the white acceleration that are tried, m²/s³."""
FIRST_PLACE, FIRST_SPEED = 100.0, 10.0
"""Standard deviations before the first detection: m around it, m/s over ground around rest."""
JUMP = 5.0
"""m between prediction and detection from which the slot holds another object."""
PATIENCE = 3
"""Scans without a detection that a slot is held for, once it has had so many; after more it begins anew."""


class SlotFilters:
    """The filters of all slots of all sensors.

    Args:
        cycle_times: of each sensor, s.
        densities: of the white acceleration, shape (g,).
    """

    def __init__(self, cycle_times: tuple[float, ...], densities: tuple[float, ...] = GRID) -> None:
        self._patience_ns = [round((PATIENCE + 0.5) * each * 1e9) for each in cycle_times]
        self._densities = np.array(densities)
        self._row: dict[tuple[int, int], int] = {}
        self._time_ns = 0
        self._given = 0
        self.mean: Floats = np.zeros((0, len(densities), 4))
        self.covariance: Floats = np.zeros((0, len(densities), 4, 4))
        self._id: Integers = np.zeros(0, dtype=np.int64)
        self._last_ns: Integers = np.full(0, -(1 << 60), dtype=np.int64)
        self._sensor: Integers = np.zeros(0, dtype=np.int64)
        self._hits: Integers = np.zeros(0, dtype=np.int64)
        self._live: Booleans = np.zeros(0, dtype=bool)
        self._told: list[_Told] = []

    def step(self, detections: Detections | None, pose: EgoPose) -> None:
        """Advance to the pose's time, with a scan or with none, and note the obstacles."""
        self._predict((pose.time_ns - self._time_ns) * 1e-9 if self._time_ns else 0.0)
        self._time_ns = pose.time_ns
        if detections is not None:
            self._take(detections)
        self._tell(pose)

    def rows_of(self, grid: int) -> TrackRows:
        """Return what was noted of one process noise, as a table of tracks."""
        told = [one for one in self._told if len(one.id)]
        mean = np.concatenate([np.empty((0, 4)), *(one.mean[:, grid] for one in told)])
        covariance = np.concatenate([np.empty((0, 4, 4)), *(one.covariance[:, grid] for one in told)])
        identity = np.concatenate([np.empty(0, np.int64), *(one.id for one in told)])
        rows = len(identity)
        times = np.repeat(np.array([one.time_ns for one in told], dtype=np.int64), [len(one.id) for one in told])
        order = np.lexsort((identity, times))
        nothing = np.full(rows, math.nan)
        columns: dict[str, Any] = dict.fromkeys(TrackTable.__slots__, nothing)
        columns |= dict(zip(("x", "y", "vx", "vy"), mean[order].T, strict=True))
        table = TrackTable(
            **columns
            | {
                "time_ns": times[order],
                "id": identity[order],
                "state": np.full(rows, CONFIRMED, dtype=np.int8),
                "kind": np.zeros(rows, dtype=np.int8),
                "objects": np.full(rows, "", dtype=np.object_),
            }
        )
        return TrackRows(table, covariance[order])

    def _predict(self, dt: float) -> None:
        transition, noise = constant_velocity(dt)
        self.mean = self.mean @ transition.T
        self.covariance = transition @ self.covariance @ transition.T + self._densities[:, None, None] * noise

    def _take(self, detections: Detections) -> None:
        """Update the slots of a scan, and begin those that hold another object."""
        # an id that comes twice in a scan: the last one stands
        last = {key: k for k, key in enumerate(detections.object_id.tolist())}
        chosen = np.array(sorted(last.values()), dtype=np.intp)
        rows = self._rows(detections.sensor, detections.object_id[chosen].tolist())
        measurement = detections.measurement.take(chosen)
        middle = self.mean[rows, len(self._densities) // 2, :2]
        jumped = np.hypot(*(measurement.position - middle).T) > JUMP
        paused = self._time_ns - self._last_ns[rows] > self._patience_ns[detections.sensor]
        fresh = detections.new[chosen] | jumped | paused
        fresh_rows = rows[fresh]
        self._begin(fresh_rows, measurement.position[fresh])
        self._update(rows, measurement)
        self._hits[fresh_rows] = 0
        self._hits[rows] += 1
        self._last_ns[rows] = self._time_ns
        mine = self._sensor == detections.sensor
        silent = self._time_ns - self._last_ns
        held = (self._hits >= PATIENCE) & (silent <= self._patience_ns[detections.sensor])
        self._live[mine] = ((silent == 0) | held)[mine]

    def _rows(self, sensor: int, keys: list[int]) -> Indices:
        """Return the rows of a sensor's slots, with room for those that come for the first time."""
        fresh = [key for key in keys if (sensor, key) not in self._row]
        if fresh:
            self._row |= {(sensor, key): len(self._id) + k for k, key in enumerate(fresh)}
            more, grid = len(fresh), len(self._densities)
            self.mean = np.concatenate([self.mean, np.zeros((more, grid, 4))])
            self.covariance = np.concatenate([self.covariance, np.zeros((more, grid, 4, 4))])
            for name, value in (("_id", 0), ("_last_ns", -(1 << 60)), ("_sensor", sensor), ("_hits", 0)):
                setattr(self, name, np.concatenate([getattr(self, name), np.full(more, value, dtype=np.int64)]))
            self._live = np.concatenate([self._live, np.zeros(more, dtype=bool)])
        return np.array([self._row[sensor, key] for key in keys], dtype=np.intp)

    def _begin(self, rows: Indices, position: Floats) -> None:
        self.mean[rows] = 0.0
        self.mean[rows, :, :2] = position[:, None]
        self.covariance[rows] = np.diag([FIRST_PLACE**2, FIRST_PLACE**2, FIRST_SPEED**2, FIRST_SPEED**2])
        self._id[rows] = self._given + 1 + np.arange(len(rows))
        self._given += len(rows)

    def _update(self, rows: Indices, measurement: Measurement) -> None:
        """Update m slots, with all process noises each."""
        grid = len(self._densities)
        mean, covariance = self.mean[rows].reshape(-1, 4), self.covariance[rows].reshape(-1, 4, 4)
        every = measurement.take(np.repeat(np.arange(len(rows)), grid))
        innovation, h, r = every.linearised(mean)
        transposed = np.swapaxes(h, 1, 2)
        gain = covariance @ transposed @ np.linalg.inv(h @ covariance @ transposed + r)
        rest = np.eye(4) - gain @ h
        mean = mean + (gain @ innovation[:, :, None])[:, :, 0]
        covariance = rest @ covariance @ np.swapaxes(rest, 1, 2) + gain @ r @ np.swapaxes(gain, 1, 2)
        self.mean[rows], self.covariance[rows] = mean.reshape(-1, grid, 4), covariance.reshape(-1, grid, 4, 4)

    def _tell(self, pose: EgoPose) -> None:
        """Note the slots of the latest scans, in vehicle axes."""
        rows = np.flatnonzero(self._live)
        mean, covariance = self.mean[rows], self.covariance[rows]
        turn = np.kron(np.eye(2), pose.rotation)
        mean[..., 0] -= pose.east
        mean[..., 1] -= pose.north
        self._told.append(_Told(pose.time_ns, self._id[rows], mean @ turn, turn.T @ covariance @ turn))


@dataclass(frozen=True, slots=True)
class _Told:
    """The obstacles of one cycle: ids (n,), means (n, g, 4) and covariances (n, g, 4, 4), vehicle axes."""

    time_ns: int
    id: Integers
    mean: Floats
    covariance: Floats


def constant_velocity(dt: float) -> tuple[Floats, Floats]:
    """Return transition and noise, of unit power spectral density, of [x, y, vx, vy] over a time (s)."""
    plane = np.eye(2)
    transition = np.kron(np.array([[1.0, dt], [0.0, 1.0]]), plane)
    step = abs(dt)
    return transition, np.kron(np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]), plane)


def with_simulated_noise(
    detections: Detections, sensor: SensorSettings, noise: NoiseOverride, pose: EgoPose
) -> Detections:
    """Return detections with the noise of the simulation in place of that of the configuration.

    Args:
        detections: of the sensor.
        sensor: its settings.
        noise: what the scenario has in place of them.
        pose: at the detections' time.
    """
    override = noise.model_dump(exclude_none=True)
    stated = {**sensor.noise.model_dump(exclude_none=True), **override}
    measurement = detections.measurement
    offset = measurement.position - measurement.origin
    if not override.keys() & sensor.noise.model_dump(exclude_none=True).keys():
        return detections
    if sensor.signals.polar:
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        along, across = stated["range"], math.radians(stated["azimuth_deg"]) * np.hypot(*offset.T)
    else:
        angle = np.full(len(offset), pose.heading + math.radians(sensor.mount.yaw_deg))
        along, across = stated["x"], stated["y"]
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normal = np.stack([-axis[:, 1], axis[:, 0]], axis=1) * np.reshape(across, (-1, 1))
    spread = np.einsum("ni,nj->nij", along * axis, along * axis) + np.einsum("ni,nj->nij", normal, normal)
    rate = measurement.range_rate_variance
    if rate is not None:
        rate = rate + stated["range_rate"] ** 2 - (sensor.noise.range_rate or 0.0) ** 2
    speeds = tuple(
        replace(part, variance=part.variance + stated[name] ** 2 - (getattr(sensor.noise, name) or 0.0) ** 2)
        for part, name in zip(measurement.projections, _speeds(sensor), strict=True)
    )
    return replace(
        detections, measurement=replace(measurement, noise=spread, range_rate_variance=rate, projections=speeds)
    )


def _speeds(sensor: SensorSettings) -> list[str]:
    """Return the velocity components that a sensor measures, in the order of the measurement's projections."""
    return [name for name in ("vx", "vy") if getattr(sensor.noise, name) is not None]
