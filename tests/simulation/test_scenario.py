from __future__ import annotations

import cmath
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from candaemon.errors import ConfigError
from candaemon.simulation.actor_motion import Trajectory, trajectory
from candaemon.simulation.scenario import LONGEST_DRIVE, MOST_ACTORS, MOST_POSTS, Scenario, Segment, load_scenario
from candaemon.simulation.scene import Scene
from tests.support.effort import examples
from tests.support.paths import ROOT

SCENARIOS = sorted(
    path for path in (ROOT / "config" / "scenarios").glob("*.yaml") if not path.stem.startswith("traffic_")
)
"""Those without pedestrians, who may pass more closely: see `test_traffic_scenarios`."""


def _to_nano(value: float) -> float:
    """Return a number without digits beyond the ninth: none is next to nothing."""
    return round(value, 9)


segments = st.lists(
    st.one_of(
        st.builds(
            lambda duration, acceleration, turn: Segment(
                duration=duration, acceleration=acceleration, yaw_rate_deg=turn
            ),
            st.floats(0.1, 5),
            st.floats(-6, 4).map(_to_nano),
            st.sampled_from([0.0, 1e-4, 0.5, -20.0, 40.0]),
        ),
        st.builds(
            lambda duration, speed: Segment(duration=duration, speed=speed),
            st.floats(0.5, 5),
            st.floats(0, 40).map(_to_nano),
        ),
        st.builds(
            lambda duration, ax, ay: Segment(duration=duration, ax=ax, ay=ay),
            st.floats(0.1, 4),
            st.floats(-5, 5).map(_to_nano),
            st.floats(-3, 3).map(_to_nano),
        ),
        st.builds(
            lambda offset: Segment.model_validate({"lane_change": {"offset": offset, "duration": 3.0}}),
            st.floats(-4, 4).map(_to_nano),
        ),
    ),
    max_size=5,
)


def of(parts: list[Segment], speed: float = 15.0, yaw: float = 0.3) -> Trajectory:
    return trajectory(3 - 2j, cmath.rect(speed, yaw), yaw, parts, axes_yaw=0.3)


@settings(deadline=None, max_examples=examples(60))
@given(segments, st.floats(0, 30))
def test_velocity_and_acceleration_are_the_derivatives_of_position(parts: list[Segment], speed: float) -> None:
    track, h = of(parts, speed), 1e-4
    times = np.linspace(0.05, 18.0, 200)
    before, here, after = track.at(times - h), track.at(times), track.at(times + h)
    assert np.allclose((after.position - before.position) / (2 * h), here.velocity, atol=1e-2)
    # where a segment ends the acceleration jumps: one instant between neighbours on either side may differ
    difference = np.abs((after.velocity - before.velocity) / (2 * h) - here.acceleration)
    assert np.count_nonzero(difference > 1e-2 * (1 + np.abs(here.acceleration))) <= 2 * len(parts) + 1


@settings(deadline=None, max_examples=examples(30))
@given(segments)
def test_motion_is_continuous_and_in_any_order_of_times(parts: list[Segment]) -> None:
    track = of(parts)
    times = np.linspace(0.0, 20.0, 4001)
    motion = track.at(times)
    assert np.abs(np.diff(motion.position)).max() < 0.005 * 60
    shuffled = np.random.default_rng(1).permutation(len(times))
    assert np.array_equal(track.at(times[shuffled]).position, motion.position[shuffled])


def test_a_turn_through_a_right_angle_ends_where_the_circle_says() -> None:
    rate = 0.6
    turn = Segment(duration=math.pi / 2 / rate, yaw_rate_deg=math.degrees(rate))
    end = trajectory(0j, 10 + 0j, 0.0, [turn], axes_yaw=0.0).at(np.array([math.pi / 2 / rate]))
    assert complex(end.position[0]) == pytest.approx(10 / rate * (1 + 1j), abs=1e-9)
    assert float(end.yaw[0]) == pytest.approx(math.pi / 2)


def test_a_vehicle_that_brakes_stands_and_goes_on_where_it_stood() -> None:
    track = of([Segment(duration=6, acceleration=-5), Segment(speed=8, acceleration=2)], speed=10)
    stopped = track.at(np.array([2.0, 4.0, 6.0]))
    assert np.abs(stopped.velocity) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(stopped.position - (3 - 2j)) == pytest.approx(10.0)
    assert abs(track.at(np.array([10.0])).velocity[0]) == pytest.approx(8.0)
    assert abs(track.at(np.array([30.0])).velocity[0]) == pytest.approx(8.0)


def test_a_vehicle_drives_backwards_only_where_it_is_told_so() -> None:
    track = of([Segment(duration=2, speed=-3), Segment(duration=4), Segment(duration=2, speed=1)], speed=1)
    motion = track.at(np.array([0.0, 0.5, 2.0, 6.0, 7.5, 20.0]))
    along = np.real(motion.velocity * np.exp(-0.3j))
    assert along == pytest.approx([1.0, 0.0, -3.0, -3.0, 0.0, 1.0])
    assert motion.yaw == pytest.approx([0.3] * 6)
    brakes = of([Segment(duration=4, acceleration=1), Segment(duration=3)], speed=-2)
    motion = brakes.at(np.array([0.0, 1.0, 2.0, 4.0, 9.0]))
    assert np.real(motion.velocity * np.exp(-0.3j)) == pytest.approx([-2.0, -1.0, 0.0, 0.0, 0.0])
    for part in ({"lane_change": {"offset": 2, "duration": 4}}, {"duration": 2, "ax": 0, "ay": 0.1}):
        aside = of([Segment.model_validate(part)], speed=-3).at(np.linspace(0.0, 6.0, 13))
        assert np.abs(np.angle(np.exp(1j * (aside.yaw - 0.3)))).max() < 0.6
    lasting = of([], speed=-2).at(np.array([5.0]))
    assert lasting.yaw == pytest.approx(0.3)
    assert np.real(lasting.velocity * np.exp(-0.3j)) == pytest.approx(-2.0)


def test_a_lane_change_ends_beside_its_lane_with_its_heading() -> None:
    change = Segment.model_validate({"lane_change": {"offset": 3.5, "duration": 4.0}})
    end = trajectory(0j, 20 + 0j, 0.0, [change], axes_yaw=0.0).at(np.array([4.0, 6.0]))
    assert end.position.imag == pytest.approx(3.5)
    assert end.yaw == pytest.approx(0.0)
    assert end.position.real == pytest.approx([80.0, 120.0])


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_scenarios_load_and_actors_do_not_drive_through_one_another(path: Path) -> None:
    scenario = load_scenario(path)
    scene = Scene(scenario)
    solid = scene.half_width > 0
    for instant in scene.states(np.arange(0.0, scenario.duration, 0.2)):
        centre = np.append(instant.actors.position[solid], instant.ego.position)
        gap = np.abs(centre[:, None] - centre) + 100 * np.eye(len(centre))
        assert gap.min() > 2.2, f"at {instant.time:.1f} s"


def test_the_brake_of_the_automotive_set_is_the_one_of_the_notes() -> None:
    scene = Scene(load_scenario(ROOT / "config" / "scenarios" / "automotive_brake.yaml"))
    instants = list(scene.states(np.array([0.0, 8.0, 14.0])))
    relative = [complex(i.actors.position[0] - i.ego.position) for i in instants]
    speeds = [float((i.actors.velocity[0] - i.ego.velocity).real) for i in instants]
    assert relative == pytest.approx([103.6 + 1j, 91.6 + 1j, 43.6 + 1j])
    assert speeds == pytest.approx([0.0, -12.0, 0.0])


def test_the_level_frame_is_turned_by_the_ego_heading() -> None:
    ego = {"start": {"speed": 10.0, "heading_deg": 0.0, "east": 5.0}}
    actors = ({"name": "lead", "start": {"x": 20.0, "y": 1.0, "vx": 10.0, "vy": 2.0}},)
    scene = Scene(Scenario.model_validate({"duration": 2.0, "ego": ego, "actors": actors}))
    (instant,) = scene.states(np.array([1.0]))
    assert instant.ego.position == pytest.approx(5 + 10j)
    assert complex(instant.actors.position[0]) == pytest.approx(5 - 1 - 2 + 30j)
    assert complex(instant.actors.velocity[0]) == pytest.approx(-2 + 10j)


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        ("duration: 5\nego:\n  start: {sped: 3}\n", 3, "sped"),
        (
            "duration: 5\nactors:\n  - name: a\n    start: {x: 1, y: 0}\n    segments: [{ax: 1, speed: 3}]\n",
            5,
            "ax and ay stand alone",
        ),
        ("duration: soon\n", 1, "soon"),
        ("seed: 3\n", 1, "duration: missing"),
        ("duration: 5\nego:\n  segments:\n    - {acceleration: 1}\n    - {duration: 2}\n", 2, "segment 1 has no end"),
        ("duration: 5\nactors: [{name: a, start: {x: 1, y: 0, vx: 1, speed: 2}}]\n", 2, "either as vx and vy"),
    ],
)
def test_a_faulty_scenario_is_told_with_file_and_line(tmp_path: Path, text: str, line: int, told: str) -> None:
    path = tmp_path / "faulty.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert caught.value.line == line
    assert told in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "fields",
    [
        {"duration": 1.0, "until": 2.0},
        {"speed": 3.0},
        {"speed": 3.0, "acceleration": 1.0, "duration": 2.0},
        {"lane_change": {"offset": 1.0, "duration": 2.0}, "yaw_rate_deg": 3.0},
    ],
)
def test_a_segment_that_contradicts_itself_is_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Segment.model_validate(fields)


def _scenario(folder: Path, text: str) -> Scenario:
    path = folder / "scenario.yaml"
    path.write_text(f"duration: 10\n{text}", encoding="utf-8")
    return load_scenario(path)


def test_a_scenario_has_so_many_posts_and_no_more(tmp_path: Path) -> None:
    rail = "stationary:\n  rails: [{begin: {x: 0, y: 0}, end: {x: %d, y: 0}, spacing: 1.0}]\n"
    assert len(Scene(_scenario(tmp_path, rail % (MOST_POSTS - 1))).stationary) == MOST_POSTS
    with pytest.raises(
        ConfigError, match=r"scenario\.yaml:2: stationary: found 10,001 posts in all, expected 10,000 at"
    ):
        _scenario(tmp_path, rail % MOST_POSTS)


def test_a_scenario_has_so_many_actors_and_no_more() -> None:
    actors = [{"name": f"a{k}", "start": {"x": 0.0, "y": 0.0}} for k in range(MOST_ACTORS + 1)]
    assert len(Scenario.model_validate({"duration": 1.0, "actors": actors[1:]}).actors) == MOST_ACTORS
    with pytest.raises(ValidationError, match="at most 1000 items"):
        Scenario.model_validate({"duration": 1.0, "actors": actors})


@pytest.mark.parametrize(
    "text",
    [
        "stationary: {rails: [{begin: {x: 0, y: 0}, end: {x: 1e300, y: 0}}]}",
        "stationary: {rails: [{begin: {x: -1e6, y: 0}, end: {x: 1e6, y: 0}, spacing: 0.6}]}",
        "stationary: {posts: [{x: .inf, y: 0}]}",
        "start_time: 1e300",
        "seed: 9223372036854775808",
        "ego: {segments: [{duration: 1e300, speed: 3}]}",
        "measurement: {noise: {x: 1e300}}",
        "actors: [{name: 'a\\nb', start: {x: 0, y: 0}}]",
        "actors: [{name: a, start: {x: 1e300, y: 0}}]",
    ],
)
def test_what_would_take_all_memory_or_mean_nothing_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"scenario\.yaml:2: "):
        _scenario(tmp_path, text)


def test_a_scenario_lasts_a_day_at_most() -> None:
    assert Scenario(duration=LONGEST_DRIVE).duration == 86_400
    with pytest.raises(ValidationError, match="less than or equal to 86400"):
        Scenario(duration=86_401)
