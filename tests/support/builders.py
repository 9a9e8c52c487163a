"""What the estimation tests share: poses, measurements, detections, and a tracker fed by hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import cos, sin
from typing import Any, Generic, TypeVar

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.sensors import SensorSettings
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.estimation.measurement import Measurement
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import CLASS_NAMES, Obstacles
from candaemon.tracking.tracker import Tracker
from candaemon.tracking.vehicle_tracker import VehicleTracker

AT_REST: Floats = np.zeros(2)


def pose(
    time: float = 0.0,
    *,
    east: float = 0.0,
    north: float = 0.0,
    heading: float = 0.0,
    ve: float = 0.0,
    vn: float = 0.0,
    yaw_rate: float = 0.0,
    speed_variance: float = 0.0,
) -> EgoPose:
    """Return a valid ego pose at a time in s."""
    return EgoPose(ns(time), east, north, heading, ve, vn, yaw_rate, speed_variance, EgoStatus.VALID)


def ns(time: float) -> int:
    """Return a time in s as integer nanoseconds."""
    return round(time * 1e9)


def known(at: EgoPose | None) -> EgoPose:
    """Hold that own motion is known."""
    assert at is not None
    return at


def rotation(angle: Floats | float) -> Floats:
    """Return the matrices that turn vectors to the left, (…, 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def polar_measurement(
    distance: Floats, azimuth: Floats, rate: Floats | None, noise: tuple[float, float, float]
) -> Measurement:
    """Return what a radar at rest in the origin measured.

    Args:
        distance: m, (n,).
        azimuth: rad, (n,).
        rate: m/s, (n,), or none.
        noise: standard deviations of distance, azimuth and rate.
    """
    turn = rotation(azimuth)
    spread = np.zeros((len(distance), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = noise[0] ** 2, (distance * noise[1]) ** 2
    return Measurement(
        distance[:, None] * turn[:, :, 0],
        turn @ spread @ np.swapaxes(turn, 1, 2),
        AT_REST,
        AT_REST,
        rate,
        None if rate is None else np.full(len(distance), noise[2] ** 2),
    )


def random_covariance(rng: np.random.Generator, size: int, count: int = 1) -> Floats:
    """Return well-conditioned random covariances (count, size, size)."""
    root = rng.normal(size=(count, size, size))
    covariance: Floats = root @ np.swapaxes(root, 1, 2) + 0.3 * np.eye(size)
    return covariance


class Circle:
    """A rear axle's centre at a steady speed (m/s) and yaw rate (rad/s), in the local frame from its first sample."""

    def __init__(self, speed: float, rate: float, heading: float) -> None:
        self.speed, self.rate, self.start = speed, rate, heading

    def heading(self, t: float) -> float:
        return self.start + self.rate * t

    def velocity(self, t: float) -> Floats:
        return self.speed * np.array([cos(self.heading(t)), sin(self.heading(t))])

    def position(self, t: float) -> Floats:
        radius, a, b = self.speed / self.rate, self.start, self.heading(t)
        return radius * np.array([sin(b) - sin(a), cos(a) - cos(b)])


@dataclass(frozen=True, slots=True)
class Seen:
    """One object of a scan: the sensor's id, where it is (m) and how it moves (m/s) over ground, local frame."""

    key: int
    x: float
    y: float
    vx: float = 0.0
    vy: float = 0.0
    new: bool = False
    rated: bool = True


TrackerT = TypeVar("TrackerT", bound=AnyTracker)


class Fed(Generic[TrackerT]):
    """A tracker whose scans are written by hand; own vehicle rests in the local frame's origin unless told.

    Args:
        tracker: of one kind or the other.
        noise: standard deviations of x, y and range rate that the scans tell.
    """

    def __init__(self, tracker: TrackerT, noise: tuple[float, float, float]) -> None:
        self.tracker, self._noise = tracker, noise

    def scan(
        self, time: float, seen: Sequence[Seen], *, sensor: int = 0, ego: EgoPose | None = None, **told: Any
    ) -> Obstacles:
        """Track one scan; positions and rates are exact, the noise is only told; further columns as told."""
        at = ego or pose(time)
        return self.tracker.step(replace(detections(at, seen, sensor=sensor, noise=self._noise), **told), at)

    def coast(self, time: float) -> Obstacles:
        """Go on without a scan."""
        return self.tracker.step(None, pose(time))


class HandFed(Fed[Tracker]):
    """The tracker of points, fed by hand.

    Args:
        slack: s, as the tracker's.
        identities: the numbers of obstacles.
        views: as the tracker's.
        noise: standard deviations of x, y and range rate that the scans tell.
        settings: of the tracker, as in the YAML.
    """

    def __init__(
        self,
        *,
        slack: float = 0.0,
        identities: Identities | None = None,
        views: Sequence[SensorView] = (),
        noise: tuple[float, float, float] = (0.1, 0.1, 0.06),
        **settings: Any,
    ) -> None:
        told = TrackerSettings.model_validate({"estimator": {"kind": "imm"}} | settings)
        super().__init__(Tracker(told, identities, slack_ns=ns(slack), views=views), noise)


class HandFedVehicles(Fed[VehicleTracker]):
    """The tracker of vehicles, fed by hand.

    Args:
        sensors: settings of those whose noise is learnt, by their number.
        slack: s, as the tracker's.
        identities: the numbers of obstacles.
        views: as the tracker's.
        noise: standard deviations of x, y and range rate that the scans tell.
        settings: of the tracker, as in the YAML.
    """

    def __init__(
        self,
        *,
        sensors: Mapping[int, SensorSettings] | None = None,
        slack: float = 0.0,
        identities: Identities | None = None,
        views: Sequence[SensorView] = (),
        noise: tuple[float, float, float] = (0.1, 0.1, 0.06),
        **settings: Any,
    ) -> None:
        told = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}} | settings)
        super().__init__(VehicleTracker(told, sensors or {}, identities, slack_ns=ns(slack), views=views), noise)


def detections(at: EgoPose, seen: Sequence[Seen], *, sensor: int, noise: tuple[float, float, float]) -> Detections:
    """Return a scan of exact positions and range rates, seen from the rear axle's centre of a pose."""
    position = np.array([(each.x, each.y) for each in seen], dtype=np.float64).reshape(-1, 2)
    velocity = np.array([(each.vx, each.vy) for each in seen], dtype=np.float64).reshape(-1, 2)
    origin, own = at.place(0.0, 0.0)
    offset = position - origin
    line = offset / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)[:, None]
    rate = ((velocity - own) * line).sum(axis=1)
    rate[[not each.rated for each in seen]] = np.nan
    spread = np.tile(np.diag([noise[0] ** 2, noise[1] ** 2]), (len(seen), 1, 1))
    place = at.to_vehicle(position)
    return Detections(
        at.time_ns,
        sensor,
        np.array([each.key for each in seen], dtype=np.int64),
        np.array([each.new for each in seen], dtype=np.bool_),
        Measurement(position, spread, origin, own, rate, np.full(len(seen), noise[2] ** 2), sensor=sensor),
        place[:, 0],
        place[:, 1],
    )


CYCLE = 0.05
"""s between the scans of a tracker fed by hand."""


def car(key: int, t: float, x: float, y: float = 0.0, speed: float = 20.0, **more: bool) -> Seen:
    """Return a vehicle that drives ahead at a steady speed, x at time 0."""
    return Seen(key, x + speed * t, y, speed, **more)


def times(first: int, last: int) -> Iterator[float]:
    """Yield the times in s of the scans from `first` until before `last`."""
    return (k * CYCLE for k in range(first, last))


def states(told: Obstacles) -> dict[int, int]:
    """Return the state of each identity."""
    return dict(zip(told.id.tolist(), told.state.tolist(), strict=True))


def place(told: Obstacles, identity: int) -> tuple[float, float]:
    """Return where an identity is, vehicle axes."""
    row = told.id.tolist().index(identity)
    return float(told.x[row]), float(told.y[row])


def assert_sane(obstacles: Obstacles) -> None:
    """Hold that columns are of one length, all but a body's finite, ids unique and covariances positive."""
    unknown = {"heading", "yaw_rate", "length", "width", "kind_likelihood"}
    for field in fields(Obstacles):
        column = getattr(obstacles, field.name)
        if isinstance(column, np.ndarray):
            assert field.name in unknown or np.isfinite(column).all(), field.name
            if not field.name.startswith("used_"):
                row = (4, 4) if field.name == "covariance" else ()
                assert column.shape == (len(obstacles), *row), field.name
    assert len(set(obstacles.id.tolist())) == len(obstacles)
    assert obstacles.used_row.shape == obstacles.used_sensor.shape == obstacles.used_object.shape
    assert ((obstacles.used_row >= 0) & (obstacles.used_row < max(len(obstacles), 1))).all()
    for name in ("sx", "sy", "svx", "svy", "age", "existence"):
        assert (getattr(obstacles, name) >= 0).all(), name
    assert (obstacles.existence <= 1).all()
    assert not (np.abs(obstacles.heading) > np.pi).any()
    assert not ((obstacles.length <= 0.0) | (obstacles.width <= 0.0)).any()
    assert ((obstacles.kind >= 0) & (obstacles.kind < len(CLASS_NAMES))).all()
    assert not ((obstacles.kind_likelihood < 0.0) | (obstacles.kind_likelihood > 1.0)).any()
    if len(obstacles):
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(obstacles.covariance, axis1=1, axis2=2)),
            np.column_stack([obstacles.sx, obstacles.sy, obstacles.svx, obstacles.svy]),
            rtol=1e-6,
        )
        assert np.linalg.eigvalsh(obstacles.covariance).min() > -1e-9
    assert np.isin(obstacles.state, (0, 1, 2)).all()
