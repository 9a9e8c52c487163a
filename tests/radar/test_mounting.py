"""From sensor axes to the ground, against truth, Monte Carlo, and what the simulation says."""

from __future__ import annotations

from math import radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.config.sensors import FieldOfView, Mount, SensorSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.measurement import line_of_sight
from candaemon.radar.mounting import Mounting, SensorView
from candaemon.radar.scan import Scan
from tests.support.builders import pose, rotation

NOISE = {"range": 0.3, "azimuth_deg": 1.0, "range_rate": 0.1, "x": 0.2, "y": 0.5, "vx": 0.1, "vy": 0.4}
MOUNT = (3.6, -0.7, radians(-35.0))
TURNING = pose(5.0, east=120.0, north=-40.0, heading=2.1, ve=-8.0, vn=12.0, yaw_rate=0.4, speed_variance=0.0025)
PLACES = st.tuples(st.floats(5, 150), st.floats(-1.2, 1.2))


def mounting(*quantities: str, mount: tuple[float, float, float] = MOUNT, **more: Any) -> Mounting:
    noise = {name: NOISE[name] for name in ("azimuth_deg" if each == "azimuth" else each for each in quantities)}
    told = {
        "bus": "b",
        "dbc": "d",
        "cycle_time": 0.05,
        "mount": {"x": mount[0], "y": mount[1], "yaw_deg": float(np.degrees(mount[2]))},
        "objects": {"messages": ["O{slot}"], "slots": 8},
        "scan": {"close": "timeout"},
        "signals": {name: f"S_{name}" for name in quantities},
        "noise": noise,
    }
    return Mounting(SensorSettings.model_validate(told | more), quantities)


def scan(values: Floats) -> Scan:
    n = values.shape[1]
    return Scan(TURNING.time_ns, 2, np.arange(n) + 10, np.arange(n), np.arange(n) % 2 == 1, values)


class Target:
    """A point on the ground seen by a sensor of a moving vehicle, by plain geometry."""

    def __init__(self, at: EgoPose, distance: float, azimuth: float, velocity: tuple[float, float]) -> None:
        self.at, self.velocity = at, np.array(velocity)
        self.sensor, self.own = at.place(MOUNT[0], MOUNT[1])
        self.yaw = at.heading + MOUNT[2]
        line = rotation(self.yaw + azimuth)[:, 0]
        self.position = self.sensor + distance * line
        self.rate = float((self.velocity - self.own) @ line)

    @property
    def local(self) -> Floats:
        """Position in sensor axes."""
        place: Floats = rotation(-self.yaw) @ (self.position - self.sensor)
        return place

    @property
    def over_ground(self) -> Floats:
        """Velocity relative to the sensor, along the sensor's axes."""
        difference: Floats = rotation(-self.yaw) @ (self.velocity - self.own)
        return difference

    @property
    def of_position(self) -> Floats:
        """Rate of the position in sensor axes, by central differences of the motion of both."""
        step = 1e-5
        places = []
        for dt in (-step, step):
            yaw = self.yaw + self.at.yaw_rate * dt
            arm = rotation(yaw - MOUNT[2]) @ np.array(MOUNT[:2])
            sensor = np.array([self.at.east + self.at.ve * dt, self.at.north + self.at.vn * dt]) + arm
            places.append(rotation(-yaw) @ (self.position + self.velocity * dt - sensor))
        rate: Floats = (places[1] - places[0]) / (2 * step)
        return rate


@settings(deadline=None)
@given(place=PLACES, velocity=st.tuples(st.floats(-30, 30), st.floats(-30, 30)))
def test_polar_and_cartesian_sensors_see_the_same_point(
    place: tuple[float, float], velocity: tuple[float, float]
) -> None:
    target = Target(TURNING, *place, velocity)
    polar = mounting("range", "azimuth", "range_rate").detections(
        scan(np.array([[place[0]], [place[1]], [target.rate]])), TURNING
    )
    cartesian = mounting("x", "y", "range_rate").detections(
        scan(np.array([*target.local, target.rate])[:, None]), TURNING
    )
    for found in (polar, cartesian):
        np.testing.assert_allclose(found.measurement.position[0], target.position, atol=1e-9)
        np.testing.assert_allclose(found.measurement.origin, target.sensor, atol=1e-12)
        in_vehicle = rotation(-TURNING.heading) @ (target.position - (TURNING.east, TURNING.north))
        np.testing.assert_allclose((found.x[0], found.y[0]), in_vehicle, atol=1e-9)
        state = np.array([[*target.position, *velocity, 0.0, 0.0]])
        expected, _ = line_of_sight(state, found.measurement.origin, found.measurement.velocity)
        assert found.measurement.range_rate is not None
        assert found.measurement.range_rate[0] == pytest.approx(expected[0], abs=1e-9)


@settings(deadline=None)
@given(place=PLACES)
def test_what_stands_has_no_velocity_over_ground_from_a_turning_vehicle(place: tuple[float, float]) -> None:
    """The sensor's arm moves sideways in a turn; without it a post at the side would seem to move."""
    target = Target(TURNING, *place, (0.0, 0.0))
    found = mounting("range", "azimuth", "range_rate").detections(
        scan(np.array([[place[0]], [place[1]], [target.rate]])), TURNING
    )
    measurement = found.measurement
    line = (measurement.position[0] - measurement.origin) / place[0]
    assert measurement.range_rate is not None
    assert measurement.range_rate[0] + line @ measurement.velocity == pytest.approx(0.0, abs=1e-9)
    arm = TURNING.yaw_rate * np.hypot(*MOUNT[:2])
    assert np.hypot(*(measurement.velocity - (TURNING.ve, TURNING.vn))) == pytest.approx(arm)


@settings(deadline=None)
@given(place=PLACES, velocity=st.tuples(st.floats(-30, 30), st.floats(-30, 30)))
@pytest.mark.parametrize("rates", ["of_position", "over_ground"])
def test_velocity_signals_become_velocity_over_ground(
    rates: str, place: tuple[float, float], velocity: tuple[float, float]
) -> None:
    target = Target(TURNING, *place, velocity)
    values = np.array([*target.local, *(target.of_position if rates == "of_position" else target.over_ground)])[:, None]
    found = mounting("x", "y", "vx", "vy", rates=rates).detections(scan(values), TURNING)
    parts = found.measurement.projections
    assert found.measurement.range_rate is None
    for part, axis, variance in zip(parts, (0, 1), (0.1**2, 0.4**2), strict=True):
        np.testing.assert_allclose(part.direction[0], rotation(target.yaw)[:, axis], atol=1e-12)
        assert part.value[0] == pytest.approx(part.direction[0] @ np.array(velocity), abs=1e-5)
        assert part.variance[0] == pytest.approx(variance + TURNING.speed_variance)


@pytest.mark.parametrize("kind", ["polar", "cartesian"])
def test_covariance_is_that_of_noisy_readings(kind: str) -> None:
    draws, rng = 200_000, np.random.default_rng(6)
    if kind == "polar":
        names, exact, deviations = ("range", "azimuth"), (60.0, 0.5), (0.3, radians(1.0))
    else:
        names, exact, deviations = ("x", "y"), (50.0, 20.0), (0.2, 0.5)
    sensor = mounting(*names)
    told = sensor.detections(scan(np.array(exact)[:, None]), TURNING).measurement.noise[0]
    readings = np.array(exact)[:, None] + np.array(deviations)[:, None] * rng.normal(size=(2, draws))
    drawn = np.cov(sensor.detections(scan(readings), TURNING).measurement.position.T)
    np.testing.assert_allclose(told, drawn, atol=0.015 * np.trace(drawn))
    assert abs(told[0, 1]) > 0.05 * np.trace(told)  # it is a turned ellipse


def test_covariances_are_symmetric_positive_and_grow_with_distance() -> None:
    values = np.array([np.linspace(1, 200, 50), np.linspace(-1.5, 1.5, 50)])
    noise = mounting("range", "azimuth").detections(scan(values), TURNING).measurement.noise
    np.testing.assert_array_equal(noise, noise.transpose(0, 2, 1))
    np.testing.assert_allclose(np.linalg.det(noise), (0.3 * values[0] * radians(1.0)) ** 2, rtol=1e-9)
    np.testing.assert_allclose(np.trace(noise, axis1=1, axis2=2), 0.3**2 + (values[0] * radians(1.0)) ** 2, rtol=1e-9)


def test_uncertain_own_speed_makes_speeds_uncertain() -> None:
    values = np.array([[20.0, 30.0], [1.0, -2.0], [-5.0, np.nan], [0.1, 0.2]])
    found = mounting("x", "y", "vx", "vy").detections(scan(values), TURNING)
    assert found.measurement.projections[0].variance[0] == pytest.approx(0.01 + 0.0025)
    assert np.isnan(found.measurement.projections[0].value[1])
    assert np.isfinite(found.measurement.projections[1].value).all()
    rated = mounting("x", "y", "range_rate").detections(scan(values[:3]), TURNING).measurement
    assert rated.range_rate_variance is not None
    np.testing.assert_allclose(rated.range_rate_variance, 0.01 + 0.0025)
    assert rated.range_rate is not None
    assert np.isnan(rated.range_rate[1])


def test_a_scan_keeps_its_identities_and_may_be_empty() -> None:
    sensor = mounting("x", "y", "range_rate")
    found = sensor.detections(scan(np.zeros((3, 4)) + 10.0), TURNING)
    assert (found.time_ns, found.sensor, found.object_id.tolist()) == (TURNING.time_ns, 2, [10, 11, 12, 13])
    assert found.new.tolist() == [False, True, False, True]
    empty = sensor.detections(scan(np.zeros((3, 0))), TURNING)
    assert len(empty) == 0
    assert empty.measurement.position.shape == (0, 2)
    assert mounting("range", "azimuth", "vy").detections(scan(np.zeros((3, 0))), TURNING).measurement.projections


def test_a_view_is_a_sector_from_the_mount() -> None:
    rear = SensorView(Mount(x=-1.0, y=0.5, yaw_deg=170.0), FieldOfView(range=80, min_range=2, azimuth_deg=30))
    distance = np.array([10.0, 10.0, 10.0, 10.0, 81.0, 79.0, 1.0])
    bearing = np.radians([170.0, 141.0, -161.0, -159.0, 170.0, 170.0, 170.0])
    points = np.array([-1.0, 0.5]) + distance[:, None] * rotation(bearing)[:, :, 0]
    assert rear.sees(points).tolist() == [True, True, True, False, False, True, False]
