"""Sensors that fail are noticed, named, and used again when they are well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.pipeline.health import Health
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import TENTATIVE
from candaemon.tracking.sensor_trust import Fault, SensorTrustState
from tests.support.bound import binding
from tests.support.paths import ROOT

RADAR, LIDAR = 0, 1
FAILURES = (("frozen", 4.0, 5.2), ("biased", 7.0, 8.2), ("silent", 10.0, 10.8), ("noisy", 12.3, 13.2))
NOTICED_S, USED_AGAIN_S = 2.0, 1.0


def scenario(faults: Sequence[Mapping[str, Any]], duration: float, measurement: Mapping[str, Any]) -> Scenario:
    """Return a drive behind a car that brakes, with one beside on either hand."""
    braking = ({"until": 5.0}, {"until": 8.0, "acceleration": -1.5}, {"until": 11.0, "acceleration": 1.5})
    actors = (
        {"name": "ahead", "start": {"x": 30.0, "y": 0.0, "speed": 15.0}, "segments": braking},
        {"name": "left", "start": {"x": 20.0, "y": 3.5, "speed": 16.0}},
        {"name": "right", "start": {"x": 45.0, "y": -3.5, "speed": 14.0}},
    )
    told = {"duration": duration, "ego": {"start": {"speed": 15.0}}, "actors": actors, "sensor_faults": tuple(faults)}
    return Scenario.model_validate(told | {"measurement": dict(measurement)})


def failing(*failures: tuple[str, float, float], amount: float | None = None) -> list[dict[str, Any]]:
    found = []
    for kind, begin, end in failures:
        told: dict[str, Any] = {"sensor": "lidar", "kind": kind, "begin": begin, "end": end}
        found.append(told | ({"amount": 5.0} if kind == "biased" else {} if amount is None else {"amount": amount}))
    return found


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
    trust = Pipeline(binding("radar_lidar")).trust
    state = trust.state
    state.sensors.pop()
    with pytest.raises(ValueError, match="trust of 1 sensors, expected 2"):
        trust.state = state


def alone(folder: Path) -> Binding:
    """Return the configuration with the radar alone."""
    tree = yaml.safe_load((ROOT / "config" / "radar_lidar.yaml").read_text(encoding="utf-8"))
    del tree["sensors"]["lidar"]
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    path = folder / "radar.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return bind(load_config(path))


def errors(of: Binding, drive: Scenario, seed: int) -> Iterator[tuple[float, float]]:
    """Yield the squared errors of position and velocity of each actor in each cycle from 3 s on."""
    simulation, pipeline = simulate(drive, of, seed), Pipeline(of)
    truth = {cycle.time_ns: cycle.columns for cycle in simulation.truth()}
    times = np.array(sorted(truth))
    for cycle in pipeline.run(simulation.frames()):
        found = cycle.reported
        if found is None or cycle.time_ns * 1e-9 - drive.start_time < 3.0:
            continue
        true = truth[int(times[np.abs(times - found.time_ns).argmin()])]
        for row in range(len(drive.actors)):
            apart = np.hypot(found.x - true["x"][row], found.y - true["y"][row])
            nearest = int(np.where(found.state != TENTATIVE, apart, np.inf).argmin())
            assert apart[nearest] < 4.0
            velocity = (found.vx[nearest] - true["vx"][row], found.vy[nearest] - true["vy"][row])
            yield float(apart[nearest]) ** 2, float(np.hypot(*velocity)) ** 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["noisy", "biased", "frozen", "silent"])
def test_with_a_failing_lidar_it_is_never_worse_than_the_radar_alone(kind: str, tmp_path: Path) -> None:
    bursts = failing((kind, 5.0, 6.0), (kind, 8.0, 10.0), amount=200.0 if kind == "noisy" else None)
    single, drive = alone(tmp_path), scenario(bursts, 12.0, {"traffic": {}})
    plain = drive.model_copy(update={"sensor_faults": ()})
    both, radar = (
        np.sqrt(np.mean([pair for seed in (1, 2) for pair in errors(of, run, seed)], axis=0))
        for of, run in ((binding("radar_lidar"), drive), (single, plain))
    )
    assert (both <= 1.05 * radar).all(), (both, radar)
