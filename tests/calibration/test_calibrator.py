"""What is estimated from standing returns, how sure that is, and how it is applied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import degrees, radians

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.calibration.calibrator import MOST_HELD, Calibrator
from candaemon.calibration.parameters import BIAS, LATENCY, SCALE, YAW, Estimate
from candaemon.calibration.readings import MOST_OBJECTS, SensorReader
from candaemon.calibration.window import WindowReader
from candaemon.calibration.windows import MOST_WINDOWS
from candaemon.config.calibration import CalibrationSettings
from candaemon.radar.scan import Scan
from tests.calibration.standing import Drive, scans
from tests.support.bound import binding


def _calibrated(
    config: str,
    drive: Drive,
    seconds: float,
    *,
    apply: bool = False,
    latency: float = 0.0,
    yaw_deg: float = 0.0,
    radar: str = "demo",
) -> Calibrator:
    of = binding(config)
    sensors = [binding(radar).sensors[0]]
    calibrator = Calibrator(CalibrationSettings(apply=apply), sensors, drive, of.settings.ego)
    for scan in scans(sensors[0], drive, seconds, latency=latency, yaw_deg=yaw_deg):
        if apply:
            calibrator.corrected(scan)
        calibrator.learn(scan)
    return calibrator


@pytest.mark.parametrize(("latency", "yaw_deg"), [(0.0, 0.0), (0.25, 4.0), (0.12, -2.5), (-0.05, 1.0)])
def test_latency_and_yaw_are_found_within_twenty_seconds(latency: float, yaw_deg: float) -> None:
    calibrator = _calibrated("demo", Drive(), 20.0, apply=True, latency=latency, yaw_deg=yaw_deg)
    state = calibrator.state.sensors[0]
    deviation = state.estimate.deviation
    assert abs(state.mean[LATENCY] - latency) < 0.02
    assert abs(degrees(state.mean[YAW]) - yaw_deg) < 0.3
    assert abs(state.mean[LATENCY] - latency) < 3 * deviation[LATENCY] < 0.06
    assert abs(state.mean[YAW] - radians(yaw_deg)) < 3 * deviation[YAW] < radians(0.6)
    assert calibrator.latency_ns(0) * 1e-9 == pytest.approx(state.mean[LATENCY] if latency else 0.0, abs=0.005)
    assert degrees(calibrator.yaw(0)) == pytest.approx(degrees(state.mean[YAW]) if yaw_deg else 0.0, abs=0.1)


@pytest.mark.parametrize("radar", ["demo", "ars408"])
@pytest.mark.parametrize(("latency", "yaw_deg"), [(0.0, 0.0), (0.25, 4.0)])
def test_nothing_that_stands_is_left_out_by_its_ends(
    latency: float, yaw_deg: float, radar: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the estimate is off by within its deviations: only what drives is told by the ends alone."""
    found = []
    for _ in range(2):
        calibrator = _calibrated("demo", Drive(), 20.0, latency=latency, yaw_deg=yaw_deg, radar=radar)
        found.append(calibrator.state.sensors[0])
        monkeypatch.setattr(WindowReader, "_likely_drift", lambda *_: np.inf)
    np.testing.assert_array_equal(found[0].mean, found[1].mean)
    np.testing.assert_array_equal(found[0].covariance, found[1].covariance)


@pytest.mark.parametrize("radar", ["tesla_continental", "ars408"])
def test_velocities_in_turning_axes_do_not_mislead_where_the_yaw_rate_jumps(radar: str) -> None:
    """Of what is 100 m away, they are metres a second wrong as long as the yaw rate is not that of the sample."""
    calibrator = _calibrated(radar, Drive(abrupt=True), 20.0, latency=0.2, yaw_deg=2.0, radar=radar)
    state = calibrator.state.sensors[0]
    assert abs(state.mean[LATENCY] - 0.2) < min(0.02, 3 * state.estimate.deviation[LATENCY])
    assert abs(degrees(state.mean[YAW]) - 2.0) < 0.3


def test_what_odometry_reads_wrongly_is_told_from_a_turned_sensor() -> None:
    drive = Drive(scale=1.02, bias=radians(0.4))
    calibrator = _calibrated("toyota_rav4", drive, 30.0, apply=True, yaw_deg=2.0)
    (scale, bias), deviation = calibrator.ego
    assert abs(scale - 0.02) < 3 * deviation[0] < 0.015
    assert abs(bias - radians(0.4)) < 3 * deviation[1] < radians(0.3)
    assert abs(degrees(calibrator.state.sensors[0].mean[YAW]) - 2.0) < 0.3
    assert drive.corrected is not None
    assert drive.corrected[:2] == pytest.approx((1.0 + scale, bias))


def test_what_ego_motion_corrects_by_itself_is_undone_first() -> None:
    corrected = Drive(scale=1.02, bias=radians(0.4), corrections=(1.02, radians(0.4)))
    state = _calibrated("toyota_rav4", corrected, 20.0).state.sensors[0]
    assert abs(state.mean[SCALE] - 0.02) < 3 * state.estimate.deviation[SCALE] < 0.015
    assert abs(state.mean[BIAS] - radians(0.4)) < 3 * state.estimate.deviation[BIAS] < radians(0.3)


def test_without_apply_nothing_is_corrected() -> None:
    calibrator = _calibrated("demo", Drive(), 12.0, latency=0.2, yaw_deg=3.0)
    assert abs(calibrator.state.sensors[0].mean[YAW]) > radians(2.0)
    assert calibrator.latency_ns(0) == 0
    assert calibrator.yaw(0) == 0.0


def test_a_correction_comes_gradually() -> None:
    calibrator = _calibrated("demo", Drive(), 0.5, apply=True)
    state = calibrator.state.sensors[0]
    state.mean, state.applied = np.array([0.1, 0.05, 0.0, 0.0]), [True, True]
    scan = next(scans(binding("demo").sensors[0], Drive(), 1.0))
    assert state.corrected_ns is not None
    for k in range(20):
        assert calibrator.latency_ns(0) * 1e-9 == pytest.approx(0.1 * (1 - np.exp(-0.05 * k)), abs=1e-6)
        moved = calibrator.corrected(_at(scan, state.corrected_ns + 50_000_000))
        assert moved.time_ns == state.corrected_ns - calibrator.latency_ns(0)


def test_what_is_known_before_is_in_force_at_once() -> None:
    calibrator = _calibrated("demo", Drive(), 0.0, apply=True)
    calibrator.begin_with(0, Estimate(np.array([0.1, 0.001, 0.0, 0.0]), np.diag([1e-6, 1e-4, 1e-6, 1e-6])))
    assert calibrator.latency_ns(0) == 100_000_000
    assert calibrator.yaw(0) == 0.0  # it may be none


def test_a_clock_that_was_set_begins_a_window_anew() -> None:
    calibrator = _calibrated("demo", Drive(), 0.6)
    scan = next(scans(binding("demo").sensors[0], Drive(), 1.0))
    assert not calibrator.learn(_at(scan, scan.time_ns - 10**12))
    assert len(calibrator.state.sensors[0].held) == 1


def test_memory_is_bounded() -> None:
    calibrator = _calibrated("demo", Drive(), MOST_WINDOWS + 5.0)
    state = calibrator.state.sensors[0]
    assert len(state.windows.information) < MOST_WINDOWS < state.windows.windows + 3
    assert abs(state.mean[YAW]) < radians(0.3)
    scan = next(scans(binding("demo").sensors[0], Drive(), 1.0))
    crowd = MOST_OBJECTS + 1
    ids = np.arange(crowd)
    full = type(scan)(scan.time_ns, 0, ids, ids, np.zeros(crowd, np.bool_), np.ones((len(scan.values), crowd)))
    state.held.clear()
    for k in range(2 * MOST_HELD):
        calibrator.learn(_at(full, scan.time_ns + k * 1_000_000))
        assert len(state.held) <= MOST_HELD
    assert len(state.held[0].object_id) == MOST_OBJECTS


def test_a_state_of_other_sensors_is_refused() -> None:
    calibrator = _calibrated("demo", Drive(), 0.0)
    state = calibrator.state
    with pytest.raises(ValueError, match="other sensors"):
        calibrator.state = type(state)([])


def _at(scan: Scan, time_ns: int) -> Scan:
    return replace(scan, time_ns=time_ns)


def test_speeds_that_the_sensor_makes_absolute_are_left_out() -> None:
    sensor = binding("demo").sensors[0]
    quantities = sensor.reader.quantities
    assert SensorReader(sensor.settings, quantities).relative == ("range_rate", "vx", "vy")
    absolute = sensor.settings.model_copy(update={"range_rates": "absolute", "rates": "absolute"})
    assert SensorReader(absolute, quantities).relative == ()
    assert SensorReader(absolute, quantities).locates
    assert not SensorReader(absolute, ("range", "range_rate")).locates


def _coasting(of: Iterator[Scan], names: tuple[str, ...], cycle: float) -> Iterator[Scan]:
    """Yield scans of what is to the left; half a second of each second is what the radar believes, not what it sees."""
    distance, angle, speed = (names.index(each) for each in ("range", "azimuth", "range_rate"))
    believed: dict[int, Floats] = {}
    for number, scan in enumerate(of):
        rows = np.flatnonzero(scan.values[angle] > 0.0)
        values, ids = scan.values[:, rows].copy(), scan.object_id[rows]
        for column, each in enumerate(ids.tolist()):
            if number % 20 >= 10 and each in believed:
                values[:, column] = believed[each]
                values[distance, column] += cycle * believed[each][speed]
            believed[each] = values[:, column].copy()
        yield Scan(scan.time_ns, scan.sensor, ids, ids, np.zeros(len(ids), np.bool_), values)


def test_what_a_radar_reports_without_seeing_it_does_not_turn_it() -> None:
    sensor, drive = binding("demo").sensors[0], Drive()
    calibrator = Calibrator(CalibrationSettings(), [sensor], drive, binding("demo").settings.ego)
    for scan in _coasting(scans(sensor, drive, 20.0), sensor.reader.quantities, sensor.settings.cycle_time):
        calibrator.learn(scan)
    assert calibrator.state.sensors[0].windows.windows >= 10
    assert abs(degrees(calibrator.state.sensors[0].mean[YAW])) < 0.3
