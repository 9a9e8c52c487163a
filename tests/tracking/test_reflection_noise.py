"""The noise of reflections, learnt: white part and walk are found, slides do not spoil them, memory is bounded."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.config.directions import AlongAcross
from candaemon.config.load import load_config
from candaemon.evaluation.object_runs import ObjectRuns
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.reflection_noise import (
    MOST_DISPLACEMENTS,
    MOST_FOLLOWED,
    ReflectionNoise,
    ReflectionNoiseState,
    StandingScan,
    growing,
)
from tests.support.bound import binding
from tests.support.paths import ROOT
from tests.support.simulated import scenario

FRONT = load_config(ROOT / "config" / "toyota_rav4.yaml").config.sensors["front"]
CYCLE_NS = 50_000_000


def _observed(
    white: tuple[float, float] = (0.0, 0.0),
    walk: tuple[float, float] = (0.0, 0.0),
    *,
    seconds: float = 20.0,
    returns: int = 8,
    sliding: int = 0,
    own_speed: float = 20.0,
    heading: float = 0.7,
    noise: ReflectionNoise | None = None,
    grows: bool = False,
) -> ReflectionNoise:
    """Feed standing returns whose noise is known, along and across a direction; some of them slide now and then."""
    random = np.random.default_rng(11)
    noise = noise or ReflectionNoise({0: FRONT})
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    drift: Floats = np.zeros((returns, 2))
    keys, standing = np.arange(returns), np.ones(returns, dtype=bool)
    distance = np.linspace(20.0, 140.0, returns)
    farther = np.stack([np.ones(returns), distance / 60.0 if grows else np.ones(returns)], axis=1)
    for k in range(round(seconds / 0.05)):
        drift += random.normal(size=drift.shape) * farther * np.sqrt(np.array(walk) * 0.05)
        if k // 10 % 4 == 0:
            drift[:sliding, 1] += 5.0 * 0.05
        place = drift + random.normal(size=drift.shape) * white
        direction = np.tile(turn[0], (returns, 1))
        noise.observe(0, k * CYCLE_NS, keys, place @ turn, direction, standing, own_speed, distance)
    return noise


def test_until_it_is_learnt_the_settings_tell_whether_a_sensor_filters_by_itself() -> None:
    polar = load_config(ROOT / "config" / "esr_ins.yaml").config.sensors["front"]
    noise = ReflectionNoise({0: FRONT, 1: polar})
    assert noise.filters(0)
    assert not noise.filters(1)
    assert 0.0 < noise.walking(0) < 1.0
    assert noise.walking(1) == 0.0
    assert noise.walk(0)[1] > noise.walk(0)[0] > 0.0
    assert noise.walk(1) == (0.0, 0.0)
    noise.renumber_sensors({1: 0})
    assert not noise.filters(0)
    assert _observed(walk=(0.06, 0.3)).walking(0) == 1.0
    assert _observed(white=(0.1, 0.1)).walking(0) == 0.0


def test_white_noise_has_no_walk() -> None:
    noise = _observed(white=(0.1, 0.4))
    assert noise.known(0)
    assert noise.white(0) == pytest.approx((0.1, 0.4), rel=0.15)
    assert noise.walk(0) == (0.0, 0.0)
    assert max(noise.ratio(0)) < 2.5


@pytest.mark.parametrize("sliding", [0, 1])
def test_the_walk_of_a_radar_that_filters_is_found_whatever_slides(sliding: int) -> None:
    noise = _observed(white=(0.05, 0.05), walk=(0.06, 0.3), sliding=sliding)
    assert noise.walk(0) == pytest.approx((0.06, 0.3), rel=0.4)
    assert noise.white(0) == pytest.approx((0.05, 0.05), abs=0.04)
    assert min(noise.ratio(0)) > 5.0


def test_whether_a_walk_grows_with_the_range_is_found() -> None:
    steady = _observed(white=(0.05, 0.05), walk=(0.06, 0.3), seconds=40.0)
    growing_one = _observed(white=(0.05, 0.05), walk=(0.06, 0.3), seconds=40.0, grows=True)
    assert steady.growth(0)[0] < 0.3
    share, told = growing_one.growth(0)
    assert share > 0.7
    found = growing_one.walk(0)[1] * growing(share, told, np.array([30.0, 60.0, 120.0]))
    np.testing.assert_allclose(found, [0.3 / 4, 0.3, 0.3 * 4], rtol=0.5)


def test_until_it_is_known_noise_is_as_stated() -> None:
    noise = _observed(walk=(0.1, 0.1), seconds=0.8)
    assert not noise.known(0)
    assert noise.white(0) == (FRONT.noise.x, FRONT.noise.y)
    assert noise.walk(0)[1] > noise.walk(0)[0] > 0.0
    assert np.isnan(noise.ratio(0)).all()


def test_a_few_reflections_are_not_enough() -> None:
    assert not _observed(walk=(0.1, 0.1), seconds=60.0, returns=4).known(0)
    assert _observed(walk=(0.1, 0.1), seconds=60.0, returns=5).known(0)


def test_nothing_is_learnt_while_we_stand() -> None:
    noise = _observed(white=(0.1, 0.1))
    before = noise.state.sensors[0].taken
    assert _observed(own_speed=0.5, noise=noise).state.sensors[0].taken == before


def test_a_walk_that_is_given_stands() -> None:
    given = FRONT.model_copy(
        update={"noise": FRONT.noise.model_copy(update={"walk": AlongAcross(along=0.2, across=0.5)})}
    )
    noise = _observed(white=(0.1, 0.1), noise=ReflectionNoise({0: given}))
    assert noise.known(0)
    assert noise.walk(0) == (0.2, 0.5)
    assert noise.walking(0) == 1.0


def test_a_sensor_that_is_said_not_to_walk_does_not() -> None:
    still = AlongAcross(along=0.0, across=0.0)
    given = FRONT.model_copy(update={"noise": FRONT.noise.model_copy(update={"walk": still})})
    noise = _observed(white=(0.03, 0.03), walk=(0.1, 0.1), noise=ReflectionNoise({0: given}))
    assert noise.known(0)
    assert (noise.walk(0), noise.walking(0)) == ((0.0, 0.0), 0.0)


def test_what_is_no_number_and_a_scan_out_of_order_teach_nothing() -> None:
    noise = ReflectionNoise({0: FRONT})
    keys, ahead, standing = np.arange(6), np.tile([1.0, 0.0], (6, 1)), np.ones(6, dtype=bool)
    for k in range(400):
        place = np.zeros((6, 2))
        place[0] = np.nan
        noise.observe(0, k * CYCLE_NS, keys, place, ahead, standing, 20.0, np.full(len(standing), 60.0))
        noise.observe(0, (k - 3) * CYCLE_NS, keys, place + 2.0, ahead, standing, 20.0, np.full(len(standing), 60.0))
    assert noise.known(0)
    assert noise.walk(0) == (0.0, 0.0)
    assert 0 not in noise.state.sensors[0].of[: noise.state.sensors[0].taken]


def test_a_scan_is_expected_some_time_after_the_latest_and_right_after_it_while_the_vehicle_drives() -> None:
    noise = ReflectionNoise({0: FRONT})
    keys, ahead, standing = np.arange(6), np.tile([1.0, 0.0], (6, 1)), np.ones(6, dtype=bool)
    expected = []
    for k in range(10):
        expected.append(noise.expects(0, k * CYCLE_NS, 20.0))
        noise.observe(0, k * CYCLE_NS, keys, np.zeros((6, 2)), ahead, standing, 20.0, np.full(len(standing), 60.0))
    assert expected == [True, True, False, False, False] * 2
    assert not noise.expects(0, 0, 20.0)
    assert noise.state.sensors[0].scans
    assert noise.expects(0, -600 * 10**9, 20.0)  # the clock was set back
    assert not noise.state.sensors[0].scans
    assert not noise.expects(0, 20 * CYCLE_NS, 0.0)
    assert not noise.state.sensors[0].scans


def test_a_key_that_goes_to_something_else_teaches_nothing() -> None:
    noise = ReflectionNoise({0: FRONT})
    ahead, standing = np.tile([1.0, 0.0], (8, 1)), np.ones(8, dtype=bool)
    for k in range(400):
        place = np.full((8, 2), 100.0 * (k % 2))
        noise.observe(0, k * CYCLE_NS, np.arange(8), place, ahead, standing, 20.0, np.full(len(standing), 60.0))
    assert noise.state.sensors[0].taken == 0


def test_memory_is_bounded() -> None:
    noise = ReflectionNoise({0: FRONT})
    crowd = MOST_FOLLOWED + 1
    ahead, standing = np.tile([1.0, 0.0], (crowd, 1)), np.ones(crowd, dtype=bool)
    distance = np.full(crowd, 60.0)
    for k in range(100):
        noise.observe(0, k * CYCLE_NS, np.arange(crowd), np.zeros((crowd, 2)), ahead, standing, 20.0, distance)
    returns = noise.state.sensors[0]
    assert returns.taken > MOST_DISPLACEMENTS
    assert max(len(scan.key) for scan in returns.scans) == MOST_FOLLOWED
    assert len(returns.scans) <= 10
    returns.validate()


def test_a_state_goes_on_elsewhere_and_a_wrong_one_is_refused() -> None:
    first, second = _observed(walk=(0.1, 0.3)), ReflectionNoise({0: FRONT})
    second.state = first.state
    assert second.walk(0) == first.walk(0)
    with pytest.raises(ValueError, match="other sensors"):
        second.state = ReflectionNoiseState({1: first.state.sensors[0]})
    assert second.known(0)
    second.state = ReflectionNoiseState({})  # as of a sensor that another configuration adds
    assert not second.known(0)
    first.state.sensors[0].scans.append(StandingScan(0, np.zeros(0, dtype=np.int64), np.zeros((0, 2))))
    with pytest.raises(ValueError, match="out of order"):
        second.state = first.state


def test_what_is_known_follows_a_sensors_number() -> None:
    noise = _observed(walk=(0.1, 0.3))
    walk = noise.walk(0)
    noise.renumber_sensors({0: 4})
    assert noise.walk(4) == walk
    assert noise.state.sensors.keys() == {4}


def learnt_from(bound: Binding, frames: Iterable[Frame], seconds: float) -> ReflectionNoise:
    """Return what the first seconds of a drive teach; what stands is told by range rate alone."""
    noise, runs = ReflectionNoise({0: FRONT}), ObjectRuns([0.05])
    first_ns: int | None = None
    for cycle in Pipeline(bound).run(frames):
        seen, pose = cycle.detections, cycle.pose
        if seen is None:
            continue
        first_ns = first_ns or seen.time_ns
        if seen.time_ns - first_ns > seconds * 1e9:
            break
        measurement = seen.measurement
        sight = measurement.position - measurement.origin
        distance = np.hypot(sight[:, 0], sight[:, 1])
        sight /= distance[:, None]
        assert measurement.range_rate is not None
        standing = np.abs(measurement.range_rate + sight @ measurement.velocity) < 0.4
        run = runs.update(0, seen.time_ns, seen.object_id, seen.new)
        heading = np.tile([np.cos(pose.heading), np.sin(pose.heading)], (len(run), 1))
        speed = float(np.hypot(pose.ve, pose.vn))
        noise.observe(0, seen.time_ns, run, measurement.position, heading, standing, speed, distance)
    return noise


@pytest.mark.parametrize(
    ("log", "config"), [("drive.log.gz", "toyota_rav4"), ("drive_with_ins.log.gz", "toyota_rav4_ins")]
)
def test_the_recorded_radar_filters_by_itself_and_shows_it_in_ten_seconds(drive: Path, log: str, config: str) -> None:
    bound = binding(config)
    channels = {bus.settings.channel: bus.index for bus in bound.buses}
    noise = learnt_from(bound, read_log(drive / log, channels, LogCounts()), 12.0)
    assert noise.known(0)
    assert noise.ratio(0)[1] > 9.0
    assert 0.04 < noise.walk(0)[1] < 0.4
    assert max(noise.white(0)) < 0.06


@pytest.mark.parametrize("filters", [False, True])
def test_a_simulated_radar_shows_in_eight_seconds_whether_it_filters(filters: bool) -> None:
    effects = {"own_filter": {"white": 0.05, "walk": 0.15}} if filters else {}
    told = scenario("traffic_town").model_dump() | {"measurement": {"traffic": effects}, "duration": 8.0}
    bound = binding("esr_ins")
    noise = learnt_from(bound, simulate(Scenario.model_validate(told), bound, seed=3).frames(), 8.0)
    assert noise.known(0)
    if filters:
        assert noise.walk(0)[1] == pytest.approx(0.15, rel=0.5)
        assert noise.white(0) == pytest.approx((0.05, 0.05), abs=0.04)
    else:
        assert noise.walk(0) == (0.0, 0.0)
