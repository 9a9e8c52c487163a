"""Sensors that fail are noticed, named, and used again when they are well."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.binding.bound import Binding
from candaemon.config.tracker import GroupSettings
from candaemon.config.trust import TrustSettings
from candaemon.errors import ConfigError
from candaemon.estimation.measurement import Measurement
from candaemon.frames.frame import Frame
from candaemon.pipeline.health import Health
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.detections import Detections
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.sensor_trust import MOST_PAIRS, REACH, Fault, SensorTrust, SensorTrustState
from candaemon.tracking.update import PredictedReflections
from tests.accuracy.simulated_runs import scenario_of
from tests.support.bound import binding
from tests.support.builders import pose
from tests.support.failing_lidar import alone, failing, scenario, squared_errors
from tests.support.paths import ROOT

RADAR, LIDAR = 0, 1
FAILURES = (("frozen", 4.0, 5.2), ("biased", 7.0, 8.2), ("silent", 10.0, 10.8), ("noisy", 12.3, 13.2))
NOTICED_S, USED_AGAIN_S = 2.0, 1.0


def faults(of: Binding, drive: Scenario) -> tuple[list[tuple[float, Fault, float, Health]], Pipeline]:
    """Return time, fault and weight of the lidar, and the health, at each output of a drive."""
    pipeline, found = Pipeline(of), []
    for cycle in pipeline.run(simulate(drive, of).frames()):
        if cycle.reported is not None:
            health = Health(pipeline._status(cycle.pose, cycle.time_ns).health)
            time = cycle.time_ns * 1e-9 - drive.start_time
            found.append((time, pipeline.trust.fault(LIDAR), pipeline.trust.weight(LIDAR), health))
    return found, pipeline


@cache
def history() -> tuple[list[tuple[float, Fault, float, Health]], Pipeline]:
    return faults(binding("radar_lidar"), scenario(failing(*FAILURES), 14.5, {}))


@pytest.mark.parametrize(("kind", "begin", "end"), FAILURES)
def test_a_failing_sensor_is_noticed_and_used_again(kind: str, begin: float, end: float) -> None:
    found, _ = history()
    named = [time for time, fault, _, _ in found if begin <= time < end + USED_AGAIN_S and fault is Fault[kind.upper()]]
    assert named
    assert named[0] - begin < NOTICED_S
    before = [fault for time, fault, _, _ in found if begin - 0.5 <= time < begin]
    after = [weight for time, _, weight, _ in found if end + USED_AGAIN_S <= time < end + USED_AGAIN_S + 0.1]
    assert set(before) == {Fault.NONE}
    assert after
    assert min(after) > 0.1


def test_a_sensor_that_is_cut_off_shows_in_the_health_and_the_counts() -> None:
    found, pipeline = history()
    assert {health for _, fault, _, health in found if fault is Fault.FROZEN} == {Health.SENSOR_LOST}
    counts = pipeline.trust.counts(LIDAR)
    assert (counts.frozen, counts.silent) == (1, 1)
    assert counts.biased >= 1
    assert counts.noisy >= 1
    assert counts.recovered >= 4
    assert counts.cut_off > 40
    assert counts.weighted_down > 0
    radar = pipeline.trust.counts(RADAR)
    assert (radar.frozen, radar.biased, radar.silent) == (0, 0, 0)


def test_a_fault_of_a_sensor_that_is_not_there_is_refused() -> None:
    wrong = [{"sensor": "lidra", "kind": "frozen", "begin": 0.0, "end": 1.0}]
    with pytest.raises(ConfigError, match=r"found sensor 'lidra', expected one of radar, lidar.*'lidar'"):
        simulate(scenario(wrong, 1.0, {}), binding("radar_lidar"))


def test_a_damaged_state_is_refused() -> None:
    with pytest.raises(ValueError, match="no fault 17"):
        SensorTrustState(fault=17).validate()
    with pytest.raises(ValueError, match=r"offsets \(0, 2\) of 1 obstacles"):
        SensorTrustState(obstacles=np.array([7]), seen_ns=np.array([0])).validate()
    for obstacles, offset in (([7, 7], 0.0), ([7, 8], np.nan)):
        with pytest.raises(ValueError, match="not in order, or that are no numbers"):
            SensorTrustState(
                obstacles=np.array(obstacles), seen_ns=np.array([0, 0]), offsets=np.full((2, 2), offset)
            ).validate()
    trust = Pipeline(binding("radar_lidar")).trust
    state = trust.state
    state.sensors.pop()
    with pytest.raises(ValueError, match="trust of 1 sensors, expected 2"):
        trust.state = state


def tracked(of: Binding, drive: Scenario, seed: int) -> Iterator[tuple[float, float, float]]:
    """Yield time and squared errors of a drive."""
    return squared_errors(Pipeline(of), simulate(drive, of, seed))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["noisy", "biased", "frozen", "silent"])
def test_with_a_failing_lidar_it_is_never_worse_than_the_radar_alone(kind: str, tmp_path: Path) -> None:
    bursts = failing((kind, 5.0, 6.0), (kind, 8.0, 10.0), amount=200.0 if kind == "noisy" else None)
    single, drive = alone(tmp_path), scenario(bursts, 12.0, {"traffic": {}})
    plain = drive.model_copy(update={"sensor_faults": ()})
    both, radar = (
        np.sqrt(np.mean([each[1:] for seed in range(1, 13) for each in tracked(of, run, seed)], axis=0))
        for of, run in ((binding("radar_lidar"), drive), (single, plain))
    )
    assert (both <= radar).all(), (both, radar)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["silent", "frozen", "biased", "noisy"])
def test_a_sensor_is_used_again_where_others_have_led_the_tracks_elsewhere(kind: str) -> None:
    begin, end = (8.84, 11.34) if kind == "noisy" else (8.11, 10.61)
    failure = failing((kind, begin, end), amount=200.0 if kind == "noisy" else None)
    found, _ = faults(binding("radar_lidar"), scenario(failure, end + 2.0, {"traffic": {}}))
    used = [time for time, _, weight, _ in found if time > end and weight > (0.1 if kind == "noisy" else 0.9)]
    assert used[0] - end < USED_AGAIN_S
    assert min(weight for time, _, weight, _ in found if used[0] <= time < used[0] + 0.5) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crossing_in_rain", "traffic_cut_ins", "traffic_junction"])
def test_sensors_that_are_all_right_are_not_found_faulty(name: str) -> None:
    of = binding("radar_lidar")
    for seed in (1, 2):
        pipeline = Pipeline(of)
        for _ in pipeline.run(simulate(scenario_of(ROOT / "config" / "scenarios" / f"{name}.yaml"), of, seed).frames()):
            pass
        for counts in map(pipeline.trust.counts, (RADAR, LIDAR)):
            assert (counts.frozen, counts.biased, counts.noisy) == (0, 0, 0)


def test_a_sensor_alone_in_its_group_is_not_compared_with_those_of_others() -> None:
    both = binding("radar_lidar")
    groups = {name: GroupSettings(sensors=[name]) for name in ("radar", "lidar")}
    config = both.settings.model_copy(update={"groups": groups})
    apart = replace(both, loaded=replace(both.loaded, config=config))
    run = scenario(failing(("noisy", 4.0, 6.0), amount=200.0), 6.0, {})
    weighted = []
    for of in (both, apart):
        pipeline = Pipeline(of)
        for _ in pipeline.run(simulate(run, of).frames()):
            pass
        weighted.append(pipeline.trust.counts(LIDAR).weighted_down)
    assert weighted[0] > 20
    assert weighted[1] == 0


def test_a_noisy_sensor_that_drops_out_again_and_again_is_not_used_at_each_return() -> None:
    of, gap = binding("radar_lidar"), 0.16
    run = scenario(failing(("noisy", 4.0, 8.0), amount=200.0), 8.0, {})
    pipeline, weights = Pipeline(of), []
    lidar = of.sensors[LIDAR].bus

    def torn() -> Iterator[Frame]:
        for frame in simulate(run, of).frames():
            time = frame.time_ns * 1e-9 - run.start_time
            if frame.bus != lidar or time < 4.5 or time % 0.5 >= gap:
                yield frame

    for cycle in pipeline.run(torn()):
        if cycle.detections is not None and cycle.detections.sensor == LIDAR:
            time = cycle.time_ns * 1e-9 - run.start_time
            weights += [pipeline.trust.weight(LIDAR)] if time > 5.5 else []
    assert weights
    assert max(weights) < 0.5


def test_the_last_sensor_that_is_used_is_not_cut_off() -> None:
    of, lost = binding("radar_lidar"), []
    pipeline, run = Pipeline(of), scenario(failing(("biased", 3.0, 5.5)), 6.0, {"traffic": {}})
    for _ in pipeline.run(simulate(run, of, 3).frames()):
        cut_off = [pipeline.trust.fault(sensor).cuts_off for sensor in (RADAR, LIDAR)]
        assert not all(cut_off)
        lost.append(cut_off[LIDAR])
    assert any(lost)


def test_a_sensor_is_compared_with_what_others_show_of_the_same_obstacle() -> None:
    """Where they show nothing of it any longer, the nearest of another obstacle says nothing of the sensor."""
    trust, rng = pair(), np.random.default_rng(1)
    own = np.array([[6.0, -4.0], [6.0, 1.0]])
    for scan in range(100):
        seen = own[:1] + rng.normal(0.0, 0.02, (1, 2))
        judged(trust, StandingTracker(own, by_others=np.array([False, True])), 1.0 + 0.05 * scan, seen)
    assert trust.fault(0) is Fault.NONE
    other_end = np.array([[6.0, -4.0], [6.0, 3.5]])
    tracker = StandingTracker(other_end, by_others=np.array([False, True]), obstacle=np.array([7, 7]))
    for scan in range(100):
        judged(trust, tracker, 6.0 + 0.05 * scan, own[:1] + rng.normal(0.0, 0.02, (1, 2)))
    assert trust.fault(0) is Fault.BIASED


def test_a_bias_that_puts_each_object_beside_another_is_found() -> None:
    """Of three cars each seems to be the one ahead in the next lane, and that one to be off to the side."""
    trust, rng = pair(), np.random.default_rng(1)
    cars = np.array([[20.0, 3.5], [25.0, 0.0], [30.0, -3.5]])
    for scan in range(100):
        judged(trust, StandingTracker(cars), 1.0 + 0.05 * scan, cars + rng.normal(0.0, 0.1, (3, 2)))
    for scan in range(100, 120):
        judged(
            trust, StandingTracker(cars), 1.0 + 0.05 * scan, cars + np.array([5.0, 0.0]) + rng.normal(0.0, 0.1, (3, 2))
        )
    assert trust.fault(0) is Fault.BIASED


def test_a_bias_of_many_objects_is_found_among_so_many_pairs() -> None:
    trust, rng = pair(), np.random.default_rng(1)
    things = np.stack([rng.uniform(10.0, 90.0, 80), rng.uniform(-20.0, 20.0, 80)], axis=1)
    apart = things[:, None] - things
    assert np.count_nonzero(np.hypot(apart[..., 0], apart[..., 1]) < REACH) > MOST_PAIRS
    for scan in range(60):
        off = np.array([5.0 if scan >= 40 else 0.0, 0.0])
        judged(trust, StandingTracker(things), 1.0 + 0.05 * scan, things + off + rng.normal(0.0, 0.05, things.shape))
        assert scan >= 40 or trust.fault(0) is Fault.NONE
    assert trust.fault(0) is Fault.BIASED


@pytest.mark.parametrize(("cars", "gap", "lanes"), [(5, 1.5, 1), (5, 2.0, 2), (6, 1.5, 3)])
def test_a_sensor_that_shows_the_other_ends_of_a_queue_is_not_off(cars: int, gap: float, lanes: int) -> None:
    """By a car's length all rears would lie where fronts are; by the gap, nearly all."""
    trust, rng = pair(), np.random.default_rng(1)
    rears = np.array(
        [(8.0 + 2.0 * lane + each * (4.5 + gap), 3.5 * lane) for lane in range(lanes) for each in range(cars)]
    )
    for scan in range(60):
        tracker = StandingTracker(rears + np.array([4.5, 0.0]), obstacle=np.arange(len(rears)))
        judged(trust, tracker, 1.0 + 0.05 * scan, rears + rng.normal(0.0, 0.1, rears.shape))
        assert trust.fault(0) is Fault.NONE


@dataclass(frozen=True, slots=True)
class StandingTracker:
    """A tracker whose confirmed obstacles, known to several sensors, stand where they are.

    Attributes:
        places: of the obstacles (n, 2), m.
        by_others: whether another sensor saw it last (n,); None: all.
        obstacle: identities (n,); None: each has its own.
    """

    places: Floats
    by_others: Booleans | None = None
    obstacle: Integers | None = None

    def predicted_reflections(self, _time_ns: int, _sensor: int) -> PredictedReflections:
        """Return them."""
        count = len(self.places)
        sure = np.ones(count, np.bool_)
        numbers = np.arange(count) if self.obstacle is None else self.obstacle
        by_others = sure if self.by_others is None else self.by_others
        return PredictedReflections(self.places, np.full(count, 0.02), numbers, sure, sure, by_others)


def judged(trust: SensorTrust, tracker: StandingTracker, time: float, places: Floats) -> None:
    """Let the first of two sensors that stand beside each other have a scan of some places."""
    count = len(places)
    numbers, time_ns = np.arange(count), round(time * 1e9)
    told = Scan(time_ns, 0, numbers, numbers, np.zeros(count, np.bool_), places.T.copy(), 0)
    noise = np.tile(0.02 * np.eye(2), (count, 1, 1))
    measurement = Measurement(places, noise, origin=np.zeros(2), velocity=np.zeros(2))
    seen = Detections(time_ns, 0, numbers, np.zeros(count, np.bool_), measurement, places[:, 0], places[:, 1])
    trust.judged(told, seen, cast("Any", tracker), pose(time, ve=10.0), time_ns)


def pair() -> SensorTrust:
    settings = [sensor.settings for sensor in binding("radar_lidar").sensors]
    return SensorTrust(TrustSettings(), settings, [[1], [0]], [0.5, 0.5])


def test_noise_is_noticed_where_each_scan_shows_other_obstacles() -> None:
    rng, trust = np.random.default_rng(1), pair()
    tracker = StandingTracker(np.array([[20.0, 0.0], [40.0, 10.0], [60.0, -10.0]]))
    full = 0
    for scan in range(300):
        deviation = 0.15 if scan < 200 else 1.5
        seen = tracker.places[[scan % 3]]
        judged(trust, tracker, 1.0 + 0.05 * scan, seen + rng.normal(0.0, deviation, seen.shape))
        full += scan >= 220 and trust.weight(0) > 0.5
    assert trust.fault(0) is Fault.NOISY
    assert full == 0


@pytest.mark.parametrize(("restless", "fault"), [(2, Fault.NONE), (3, Fault.NOISY)])
def test_noise_shows_in_more_than_half_of_the_obstacles(restless: int, fault: Fault) -> None:
    """Two bodies of four that pass close by, and show now this part, now that, do not make a sensor noisy."""
    rng, trust = np.random.default_rng(1), pair()
    tracker = StandingTracker(np.array([[4.0, 3.0], [6.0, -3.0], [40.0, 10.0], [60.0, -10.0]]))
    found = set()
    for scan in range(300):
        deviation = np.full((4, 1), 0.15)
        deviation[:restless] = 0.15 if scan < 200 else 0.8
        judged(trust, tracker, 1.0 + 0.05 * scan, tracker.places + deviation * rng.normal(0.0, 1.0, (4, 2)))
        found.add(trust.fault(0))
    assert found == {Fault.NONE, fault}


def test_a_noisy_sensor_that_freezes_again_and_again_is_not_used_at_each_return() -> None:
    rng, trust, full = np.random.default_rng(1), pair(), 0
    tracker = StandingTracker(np.array([[20.0, 0.0], [40.0, 10.0], [60.0, -10.0]]))
    kept = tracker.places
    for scan in range(400):
        deviation, frozen = 0.15 if scan < 100 else 2.0, scan > 120 and scan % 40 >= 20
        if not frozen:
            kept = tracker.places + rng.normal(0.0, deviation, (3, 2))
        judged(trust, tracker, 1.0 + 0.05 * scan, kept)
        full += scan >= 100 and not frozen and trust.weight(0) > 0.5
    assert trust.counts(0).frozen > 3
    assert full == 0


def test_a_biased_sensor_is_forgiven_that_nobody_is_left_to_be_compared_with() -> None:
    trust = pair()
    own, other = trust.state.sensors
    own.fault, other.fault = int(Fault.BIASED), int(Fault.SILENT)
    own.last_ns = own.right_ns = own.compared_ns = 1_000_000_000
    tracker = StandingTracker(np.zeros((0, 2)))
    for scan in range(120):
        judged(trust, tracker, 1.0 + 0.05 * scan, np.array([[20.0, 0.1 * scan]]))
    assert trust.fault(0) is Fault.NONE


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "off"), [("radar", 5.0), ("lidar", 8.0)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_biased_sensor_is_not_taken_back_while_it_is_and_the_other_not_cut_off(
    sensor: str, off: float, seed: int
) -> None:
    """What it shows of one car lies beside another in the next lane for a while."""
    fault = {"sensor": sensor, "kind": "biased", "begin": 13.0, "end": 22.0, "amount": off}
    told = scenario_of(ROOT / "config" / "scenarios" / "failing_lidar.yaml").model_dump()
    drive = Scenario.model_validate(told | {"duration": 22.0, "sensor_faults": [fault]})
    pipeline, wrong = Pipeline(binding("radar_lidar")), ("radar", "lidar").index(sensor)
    was_biased = False
    for _ in pipeline.run(simulate(drive, binding("radar_lidar"), seed).frames()):
        assert not pipeline.trust.fault(1 - wrong).cuts_off
        was_biased = was_biased or pipeline.trust.fault(wrong) == Fault.BIASED
        assert not was_biased or pipeline.trust.weight(wrong) < 1.0


def test_a_clock_that_is_set_back_puts_nothing_off() -> None:
    settings = [each.settings for each in binding("radar_lidar").sensors]
    trust = SensorTrust(TrustSettings(), settings, [[1], [0]], [0.5, 0.5])
    state = trust.state.sensors[0]
    state.last_ns = state.right_ns = state.compared_ns = state.noisy_ns = 10**12
    trust.watch(10**12 - 6 * 10**11)
    assert {state.last_ns, state.right_ns, state.compared_ns, state.noisy_ns} == {4 * 10**11}


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "seed"), [(200.0, 1), (50.0, 3)])
def test_a_bias_is_found_though_the_only_other_sensor_is_noisy(noise: float, seed: int) -> None:
    faults = (
        {"sensor": "lidar", "kind": "noisy", "begin": 4.0, "end": 30.0, "amount": noise},
        {"sensor": "radar", "kind": "biased", "begin": 9.0, "end": 20.0, "amount": 6.0},
    )
    told = scenario_of(ROOT / "config" / "scenarios" / "failing_lidar.yaml").model_dump()
    drive = Scenario.model_validate(told | {"duration": 11.0, "sensor_faults": faults})
    pipeline, found = Pipeline(binding("radar_lidar")), None
    for cycle in pipeline.run(simulate(drive, binding("radar_lidar"), seed).frames()):
        if found is None and pipeline.trust.fault(RADAR) is Fault.BIASED:
            found = cycle.time_ns * 1e-9 - drive.start_time
        assert pipeline.trust.fault(LIDAR) is not Fault.BIASED
    assert found is not None
    assert 9.0 < found < 10.0
