"""What a simulated sensor reports while it fails."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from candaemon.arrays import Floats
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.effects import SensorFault
from candaemon.simulation.scenario import MOST_SENSOR_FAULTS, Scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding

EXACT = {"detection_probability": 1.0, "clutter": 0.0, "drift": 0.0, "noise": {"x": 0.0, "y": 0.0}, "cycle_jitter": 0.0}


def ranges(**fault: Any) -> dict[float, Floats]:
    """Return the distances that the lidar reports of a car 20 m ahead that goes as fast, by the time in s."""
    told = {
        "duration": 2.0,
        "ego": {"start": {"speed": 10.0}},
        "actors": ({"name": "ahead", "start": {"x": 20.0, "y": 0.0, "speed": 10.5}, "reflections": 1},),
        "measurement": EXACT,
        "sensor_faults": ({"sensor": "lidar", "begin": 0.5, "end": 1.5} | fault,),
    }
    drive = Scenario.model_validate(told)
    reports = simulate(drive, binding("radar_lidar")).reports(1)
    return {round(time * 1e-9 - drive.start_time, 3): report.values[0] for time, report in reports}


def apart(**fault: Any) -> dict[float, float]:
    """Return how much farther the car is than without the fault."""
    sound = ranges(kind="biased", amount=0.0)
    return {time: float((place - sound[time])[0]) for time, place in ranges(**fault).items()}


def test_a_silent_sensor_reports_nothing() -> None:
    assert [time for time in ranges(kind="silent") if 0.5 <= time < 1.5] == []


def test_a_frozen_sensor_reports_the_same_again() -> None:
    found = ranges(kind="frozen")
    assert len({place[0] for time, place in found.items() if 0.49 <= time < 1.5}) == 1
    assert len({place[0] for time, place in found.items() if time < 0.5}) > 5


def test_a_biased_sensor_is_off_and_a_drifting_one_more_and_more() -> None:
    off = apart(kind="biased", amount=3.0)
    assert {round(each, 1) for time, each in off.items() if 0.5 <= time < 1.5} == {3.0}
    assert {each for time, each in off.items() if not 0.5 <= time < 1.5} == {0.0}
    drift = apart(kind="drifting", amount=2.0)
    for time, each in drift.items():
        assert each == pytest.approx(2.0 * (time - 0.5) if 0.5 <= time < 1.5 else 0.0, abs=0.02)


def test_a_noisy_sensor_has_so_many_times_the_variance() -> None:
    noise = [each for time, each in apart(kind="noisy", amount=401.0).items() if 0.5 <= time < 1.5]
    assert np.std(noise) == pytest.approx(2.0, rel=0.5)  # 20 times the 0.1 m of the configuration


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ({"kind": "frozen", "begin": 2.0, "end": 1.0}, "end 1 is not after begin 2"),
        ({"kind": "frozen", "amount": 2.0}, "a frozen sensor has none"),
        ({"kind": "noisy", "amount": 0.5}, "expected 1 or more"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(fault: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        SensorFault.model_validate({"sensor": "lidar", "begin": 0.0, "end": 1.0} | fault)


def test_a_scenario_may_have_so_many_faults() -> None:
    fault = {"sensor": "lidar", "kind": "frozen", "begin": 0.0, "end": 1.0}
    most = Scenario.model_validate({"duration": 1.0, "sensor_faults": (fault,) * MOST_SENSOR_FAULTS})
    assert len(most.sensor_faults) == MOST_SENSOR_FAULTS
    with pytest.raises(ValidationError, match="at most 1000"):
        Scenario.model_validate({"duration": 1.0, "sensor_faults": (fault,) * (MOST_SENSOR_FAULTS + 1)})


@pytest.mark.parametrize("silent", [3, 4])
def test_after_a_silence_each_scan_is_still_of_its_look(silent: int) -> None:
    """ford_mrr sees 20 degrees to either side with its long range, 75 with its short one, in turns."""
    of = binding("ford_mrr")
    told = {
        "duration": 6.0,
        "ego": {"start": {"speed": 10.0}},
        "measurement": {"clutter": 0.0, "cycle_jitter": 0.0},
        "stationary": {"posts": [{"x": 20.0 + 3.0 * k, "y": y} for k in range(40) for y in (-12.0, 12.0)]},
        "sensor_faults": ({"sensor": "front", "kind": "silent", "begin": 2.0, "end": 2.0 + 0.03 * silent},),
    }
    widest: dict[tuple[bool, int], float] = {}
    pipeline = Pipeline(of)
    for cycle in pipeline.run(simulate(Scenario.model_validate(told), of, 1).frames()):
        seen = cycle.detections
        if seen is not None and len(seen.x):
            place = seen.measurement.position - seen.measurement.origin
            sight = np.degrees(np.arctan2(place[:, 1], place[:, 0]) - cycle.pose.heading)
            key = seen.time_ns * 1e-9 - 1_700_000_000.0 > 2.5, seen.look
            widest[key] = max(widest.get(key, 0.0), float(np.abs(np.remainder(sight + 180.0, 360.0) - 180.0).max()))
    looks = {look for _, look in widest}
    assert len(looks) == 4
    for look in looks:
        assert (widest[False, look] > 20.0) == (widest[True, look] > 20.0)
