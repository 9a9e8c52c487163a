"""Own motion from wheels and yaw rate, and what is learnt of their errors."""

from __future__ import annotations

from math import degrees, nan, radians, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.config.ego import BiasSettings, OdometrySettings
from candaemon.ego.bias import MotionBias
from candaemon.ego.motion import StationaryReturns
from candaemon.ego.odometry import OdometryMotion
from candaemon.ego.pose import EgoStatus
from candaemon.objects.conditions import CompiledCondition
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.builders import Circle, known, ns
from tests.support.effort import examples

WHEELS = {"left_wheels": ["M.fl", "M.rl"], "right_wheels": ["M.fr", "M.rr"], "yaw_rate": "M.w"}


def odometry(signals: dict[str, Any] | None = None, **more: Any) -> OdometryMotion:
    told = {"kind": "odometry", "bus": "b", "dbc": "d", "signals": signals or {"speed": ["M.v"], "yaw_rate": "M.w"}}
    return OdometryMotion(OdometrySettings.model_validate(told | more))


def test_odometry_on_a_circle() -> None:
    motion, circle = odometry(), Circle(15.0, 0.3, 0.0)
    motion.update(0, ("speed",), (15.0,))
    assert motion.pose(0) is None  # no yaw rate yet
    for k in range(1001):
        motion.update(ns(0.02 * k), ("yaw_rate",), (0.3,))
        motion.update(ns(0.02 * k), ("speed",), (15.0,))
    for t in (3.333, 11.0, 19.99, 20.05):
        pose = known(motion.pose(ns(t)))
        assert np.hypot(*np.subtract((pose.east, pose.north), circle.position(t))) < 0.01
        assert pose.heading == pytest.approx(circle.heading(t), abs=1e-6)


def test_odometry_takes_the_mean_of_its_speeds_and_leaves_out_what_is_nan() -> None:
    motion = odometry({"speed": ["M.a", "M.b"], "yaw_rate": "M.w"})
    names = ("speed", "speed", "yaw_rate")
    motion.update(0, names, (nan, nan, 0.0))
    assert motion.pose(0) is None
    motion.update(ns(0.1), names, (10.0, 12.0, nan))
    assert known(motion.pose(ns(0.1))).ve == pytest.approx(11.0)
    motion.update(ns(0.2), names, (nan, 12.0, nan))
    assert known(motion.pose(ns(0.2))).ve == pytest.approx(12.0)
    motion.update(ns(0.3), names, (nan, nan, nan))
    assert motion.known_until_ns == ns(0.2)


@pytest.mark.parametrize("signed", [False, True])
def test_in_reverse_speeds_without_a_sign_count_as_below_0(signed: bool) -> None:
    told = {"kind": "odometry", "bus": "b", "dbc": "d", "signals": WHEELS | {"reverse": {"signal": "M.g", "in": [1]}}}
    motion = OdometryMotion(OdometrySettings.model_validate(told), CompiledCondition((1.0,), ()))
    sign = -1.0 if signed else 1.0
    motion.update(0, ("yaw_rate", "reverse"), (0.2, 1.0))
    motion.update(ns(0.1), ("left_wheels", "right_wheels"), (sign * 3.2, sign * 2.8))
    assert known(motion.pose(ns(0.1))).ve == pytest.approx(-3.0, rel=0.01)
    motion.update(ns(0.15), ("reverse",), (0.0,))
    motion.update(ns(0.2), ("left_wheels", "right_wheels"), (3.2, 2.8))
    assert known(motion.pose(ns(0.2))).ve == pytest.approx(3.0, rel=0.01)


def test_a_gear_that_falls_silent_in_reverse_no_longer_counts_after_its_age_limit() -> None:
    told = {"kind": "odometry", "bus": "b", "dbc": "d", "signals": WHEELS | {"reverse": {"signal": "M.g", "in": [1]}}}
    limit = {"reverse_age_limit": 2.0}
    motion = OdometryMotion(OdometrySettings.model_validate(told | limit), CompiledCondition((1.0,), ()))
    along = []
    for k in range(60):
        gear = (("reverse", 1.0),) if k == 0 or k >= 50 else ()
        names, values = zip(("yaw_rate", 0.0), ("left_wheels", 2.0), ("right_wheels", 2.0), *gear, strict=True)
        motion.update(ns(0.1 * k), names, values)
        along.append(round(known(motion.pose(ns(0.1 * k))).ve))
        assert motion.lacks_gear(ns(0.1 * k)) == (20 < k < 50)
    assert along == [-2] * 21 + [2] * 29 + [-2] * 10
    assert (motion.counts.samples, motion.counts.direction_assumed) == (60, 29)


def test_in_reverse_the_wheels_difference_turns_the_vehicle_the_other_way() -> None:
    """Backwards and to the rear left: the heading turns to the right, and the right wheels are the slower ones."""
    signals = {name: value for name, value in WHEELS.items() if name != "yaw_rate"}
    told = {"kind": "odometry", "bus": "b", "dbc": "d", "track_width": 1.6}
    reverse = {"signals": signals | {"reverse": {"signal": "M.g", "in": [1]}}}
    motion = OdometryMotion(OdometrySettings.model_validate(told | reverse), CompiledCondition((1.0,), ()))
    motion.update(0, ("reverse",), (1.0,))
    for k in range(50):
        motion.update(ns(0.02 * k), ("left_wheels", "right_wheels"), (3.16, 2.84))
    assert known(motion.pose(ns(0.98))).yaw_rate == pytest.approx(0.2, abs=0.01)


def test_wheels_in_one_message_give_their_mean() -> None:
    motion = odometry(WHEELS)
    motion.update(0, ("yaw_rate",), (0.1,))
    names = ("left_wheels", "right_wheels", "left_wheels", "right_wheels")
    motion.update(ns(0.1), names, (9.0, 11.0, 9.2, 10.8))
    assert known(motion.pose(ns(0.1))).speed_variance > 0
    assert np.hypot(known(motion.pose(ns(0.1))).ve, known(motion.pose(ns(0.1))).vn) == pytest.approx(10.0)


@pytest.mark.parametrize(
    "frames",
    [
        ((("left_wheels", "right_wheels", "left_wheels", "right_wheels"), (10.0, nan, 10.0, 10.0)),),
        ((("left_wheels", "left_wheels"), (10.0, 10.0)), (("right_wheels", "right_wheels"), (10.0, 10.0))),
        ((("left_wheels",), (10.0,)), (("right_wheels",), (10.0,))),
    ],
    ids=["one wheel unknown", "a message a side", "a message a wheel"],
)
def test_wheels_told_apart_or_in_part_never_halve_the_speed(
    frames: tuple[tuple[tuple[str, ...], tuple[float, ...]], ...],
) -> None:
    motion = odometry(WHEELS)
    motion.update(0, ("yaw_rate",), (0.0,))
    for k in range(20):
        for i, (names, values) in enumerate(frames):
            motion.update(ns(0.02 * k + 0.001 * i), names, values)
    pose = known(motion.pose(ns(0.39)))
    assert np.hypot(pose.ve, pose.vn) == pytest.approx(10.0)
    assert abs(motion.bias.yaw_rate) < 1e-6


def test_the_wheels_difference_finds_the_yaw_rates_bias() -> None:
    rng, motion = np.random.default_rng(1), odometry(WHEELS, track_width=1.6)
    bias, names = radians(0.7), ("left_wheels", "right_wheels")
    for k in range(12_000):
        turn = 0.2 * sin(0.01 * k)
        motion.update(ns(0.0125 * k), ("yaw_rate",), (turn + bias,))
        noise = rng.normal(size=2) * 0.02
        motion.update(ns(0.0125 * k), names, (15 - 0.8 * turn + noise[0], 15 + 0.8 * turn + noise[1]))
    mismatch = motion.bias._settings.wheel_mismatch_deg
    assert degrees(motion.bias.yaw_rate) == pytest.approx(0.7, abs=mismatch)
    assert degrees(motion.bias.yaw_rate) > 0.4
    assert motion.bias.scale == 1.0


def test_stationary_returns_find_the_speeds_factor() -> None:
    bias, rng = MotionBias(BiasSettings()), np.random.default_rng(2)
    for _ in range(500):
        own = 20.0
        cosines = rng.uniform(0.9, 1.0, 4)
        speeds = tuple((1.015 * own * c + 0.1 * rng.normal(), float(c)) for c in cosines)
        bias.learn_from_returns(StationaryReturns(0, own, speeds, ()), own)
    assert bias.scale == pytest.approx(1.015, abs=0.001)
    assert bias.yaw_rate == 0.0


def test_what_is_fixed_is_not_learnt() -> None:
    motion = odometry(WHEELS, bias={"speed_scale_sd": 0, "yaw_rate_bias_sd_deg": 0})
    motion.update(0, ("yaw_rate",), (0.1,))
    for k in range(100):
        motion.update(ns(0.01 * k), ("left_wheels", "right_wheels"), (10.0, 12.0))
        motion.learn(StationaryReturns(ns(0.01 * k), 11.0, ((15.0, 1.0),), ((1.0, 20.0),)))
    assert motion.bias.scale == 1.0
    assert motion.bias.yaw_rate == 0.0


@pytest.mark.parametrize(("bias", "until"), [({}, 5.0), ({"speed_scale_sd": 0}, 0.5), ({"learning_time": 0}, 0.0)])
def test_until_the_biases_are_learnt_it_is_initialising(bias: dict[str, Any], until: float) -> None:
    """The wheels' difference shows the yaw rate's within half a second; nothing shows the speed's factor here."""
    motion = odometry(WHEELS, bias=bias)
    motion.update(0, ("yaw_rate",), (0.0,))
    told = {}
    for k in range(600):
        motion.update(ns(0.01 * k), ("yaw_rate",), (0.0,))
        motion.update(ns(0.01 * k), ("left_wheels", "right_wheels"), (10.0, 10.0))
        told[0.01 * k] = known(motion.pose(ns(0.01 * k))).status
    last = max((time for time, status in told.items() if status is EgoStatus.INITIALISING), default=0.0)
    assert last == pytest.approx(until, abs=0.3)
    assert all(status is EgoStatus.VALID for time, status in told.items() if time > last)


@settings(deadline=None, max_examples=examples(200))
@given(
    frames=st.lists(
        st.tuples(
            st.integers(-(10**10), 10**12),
            st.sampled_from(("yaw_rate", "left_wheels", "right_wheels")),
            st.one_of(st.just(nan), st.floats(-100, 100)),
        ),
        max_size=60,
    )
)
def test_any_frames_of_odometry_give_a_finite_pose(frames: list[tuple[int, str, float]]) -> None:
    motion = odometry(WHEELS)
    for time_ns, name, value in frames:
        motion.update(time_ns, (name,), (value,))
        pose = motion.pose(time_ns)
        if pose is not None:
            numbers = (pose.east, pose.north, pose.heading, pose.ve, pose.vn, pose.yaw_rate, pose.speed_variance)
            assert np.isfinite(numbers).all()


def test_a_yaw_rate_that_is_not_given_is_that_of_the_wheels() -> None:
    wheels = {name: WHEELS[name] for name in ("left_wheels", "right_wheels")}
    motion, circle = odometry(wheels, track_width=1.6), Circle(15.0, 0.3, 0.0)
    for k in range(501):
        motion.update(ns(0.02 * k), ("left_wheels", "right_wheels"), (15 - 0.24, 15 + 0.24))
    pose = known(motion.pose(ns(9.99)))
    assert np.hypot(*np.subtract((pose.east, pose.north), circle.position(9.99))) < 3.0  # begins half a second later
    assert pose.yaw_rate == pytest.approx(0.3)
    assert motion.counts.yaw_rate_from_wheels == motion.counts.samples == 501


def test_a_curvature_gives_the_yaw_rate_while_that_is_silent() -> None:
    motion, circle = odometry({"speed": ["M.v"], "yaw_rate": "M.w", "curvature": "M.c"}), Circle(15.0, 0.3, 0.0)
    for k in range(501):
        if not 100 <= k < 300:
            motion.update(ns(0.02 * k), ("yaw_rate",), (0.3,))
        motion.update(ns(0.02 * k), ("curvature",), (0.02,))
        motion.update(ns(0.02 * k), ("speed",), (15.0,))
    pose = known(motion.pose(ns(9.99)))
    assert np.hypot(*np.subtract((pose.east, pose.north), circle.position(9.99))) < 0.02
    assert motion.counts.samples == 501
    assert motion.counts.yaw_rate_from_curvature == pytest.approx(200 - 25, abs=2)


@pytest.mark.parametrize("signals", [WHEELS, {"speed": ["M.v"], "yaw_rate": "M.w"}], ids=["wheels", "speedometer"])
@pytest.mark.parametrize("silent_at_rest", [True, False])
def test_who_stands_neither_moves_nor_turns(signals: dict[str, Any], silent_at_rest: bool) -> None:
    motion = odometry(signals)
    names = ("left_wheels", "right_wheels") if "left_wheels" in signals else ("speed",)
    for k in range(3000):
        speed, bias = max(5.0 - 0.05 * k, 0.0), radians(0.5)
        if speed > 0 or not silent_at_rest:
            motion.update(ns(0.02 * k), ("yaw_rate",), (bias,))
        motion.update(ns(0.02 * k), names, (speed,) * len(names))
    begin, end = known(motion.pose(ns(2.1))), known(motion.pose(ns(59.9)))
    assert np.hypot(end.east - begin.east, end.north - begin.north) < 0.01
    assert abs(end.heading - begin.heading) < radians(0.3)
    assert (end.ve, end.vn, end.status) == (0.0, 0.0, EgoStatus.VALID)
    assert (degrees(motion.bias.yaw_rate) == pytest.approx(0.5, abs=0.1)) or silent_at_rest


def test_a_robot_that_turns_on_the_spot_turns() -> None:
    motion = odometry()
    for k in range(200):
        motion.update(ns(0.02 * k), ("yaw_rate",), (0.5,))
        motion.update(ns(0.02 * k), ("speed",), (0.0,))
    assert known(motion.pose(ns(3.98))).heading == pytest.approx(0.5 * 3.98, abs=0.05)


def test_without_speed_the_car_coasts_round_its_bend_then_is_lost() -> None:
    motion, circle = odometry(bias={"learning_time": 0}), Circle(15.0, 0.3, 0.0)
    for k in range(800):
        motion.update(ns(0.02 * k), ("yaw_rate",), (0.3,))
        if k < 100:
            motion.update(ns(0.02 * k), ("speed",), (15.0,))
    for t, status in ((2.3, EgoStatus.VALID), (8.0, EgoStatus.DEAD_RECKONING), (15.0, EgoStatus.LOST)):
        assert known(motion.pose(ns(t))).status is status
    pose = known(motion.pose(ns(11.0)))
    assert pose.heading == pytest.approx(circle.heading(11.0), abs=0.01)
    assert np.hypot(*np.subtract((pose.east, pose.north), circle.position(11.0))) < 0.6


def test_odometry_without_anything_that_tells_a_turn_is_refused() -> None:
    with pytest.raises(ValueError, match="no yaw rate; give yaw_rate or curvature"):
        odometry({"speed": ["M.v"]})


@pytest.mark.parametrize(("wrong_rate_deg", "factor"), [(0.6, 1.0), (-0.5, 1.012)])
def test_a_drive_past_guard_rails_finds_bias_and_factor(wrong_rate_deg: float, factor: float) -> None:
    """Through the whole pipeline: frames of the car and the radar, returns of a rail and of posts."""
    scenario = Scenario.model_validate(
        {
            "duration": 40,
            "ego": {
                "start": {"speed": 20},
                "own_motion": {"yaw_rate_bias_deg": wrong_rate_deg, "speed_factor": factor},
            },
            "stationary": {
                "rails": [{"begin": {"x": 20, "y": y}, "end": {"x": 900, "y": y}, "spacing": 17} for y in (-5, 6)],
            },
        }
    )
    bound = binding("toyota_rav4")
    pipeline = Pipeline(bound)
    for _ in pipeline.run(simulate(scenario, bound).frames()):
        pass
    ego = pipeline.ego
    assert isinstance(ego, OdometryMotion)
    assert degrees(ego.bias.yaw_rate) == pytest.approx(wrong_rate_deg, abs=0.12)
    assert ego.bias.scale * factor == pytest.approx(1.0, abs=0.003)


FOUR = {"left_wheels": ["F.l", "R.l"], "right_wheels": ["F.r", "R.r"]}
SIDES = ("left_wheels", "right_wheels")


def axle_frames(speed: float, front: float) -> list[tuple[float, tuple[float, float]]]:
    """Return times, s, and both wheels' speeds, m/s, of 2 s of frames: of the front axle, then of the rear one."""
    return [(0.01 * k, (speed * front, speed * front) if k % 2 == 0 else (speed, speed)) for k in range(200)]


def test_wheels_of_the_front_and_the_rear_in_two_messages_give_their_mean() -> None:
    motion = odometry(FOUR | {"yaw_rate": "M.w"})
    motion.update(0, ("yaw_rate",), (0.0,))
    for time, wheels in axle_frames(20.0, 1.02):
        motion.update(ns(time), ("yaw_rate",), (0.0,))
        motion.update(ns(time), SIDES, wheels)
    speeds = [each.ve for each in motion.history.state.samples]
    assert len(speeds) == 100
    assert speeds == pytest.approx([20.2] * 100)


def test_a_message_of_wheels_that_falls_silent_leaves_the_other_to_tell_the_speed() -> None:
    motion = odometry(FOUR | {"yaw_rate": "M.w"})
    for time, wheels in axle_frames(20.0, 1.02):
        motion.update(ns(time), ("yaw_rate",), (0.0,))
        if time < 1.0 or wheels[0] > 20.0:
            motion.update(ns(time), SIDES, wheels)
    pose = known(motion.pose(ns(1.98)))
    assert pose.status is not EgoStatus.DEAD_RECKONING
    assert pose.ve == pytest.approx(20.4)


@pytest.mark.parametrize("order", ["fl fr rl rr", "fl rl fr rr", "rr fr rl fl"])
def test_four_wheels_in_four_messages_do_not_turn_what_drives_straight_on(order: str) -> None:
    signals = {"left_wheels": ["A.fl", "B.rl"], "right_wheels": ["C.fr", "D.rr"]}
    motion, speeds = odometry(signals), {"fl": 20.2, "fr": 20.2, "rl": 20.0, "rr": 20.0}
    for k in range(400):
        wheel = order.split()[k % 4]
        motion.update(ns(0.005 * k), (SIDES[wheel[1] == "r"],), (speeds[wheel],))
    assert motion.counts.yaw_rate_from_wheels == 100
    assert [each.yaw_rate for each in motion.history.state.samples] == pytest.approx([0.0] * 100)


def test_a_wheel_from_before_a_silence_is_no_part_of_the_speed_after_it() -> None:
    motion = odometry(FOUR | {"yaw_rate": "M.w"}, age_limit=0.5)
    motion.update(0, (*SIDES, "yaw_rate"), (10.0, 10.0, 0.0))
    for time in (30.0, 30.01):
        motion.update(ns(time), (*SIDES, "yaw_rate"), (20.0, 20.0, 0.0))
    assert known(motion.pose(ns(30.01))).ve == pytest.approx(20.0)


def test_what_drifts_by_an_error_of_the_curvature_says_nothing_of_the_silent_sensors_bias() -> None:
    motion = odometry({"speed": ["M.v"], "yaw_rate": "M.w", "curvature": "M.c"})
    for k in range(3000):
        time_ns = ns(0.02 * k)
        if k < 500:
            motion.update(time_ns, ("yaw_rate",), (0.0,))
        motion.update(time_ns, ("curvature", "speed"), (0.0005, 20.0))
        if k > 600:
            motion.learn(StationaryReturns(time_ns, 20.0, (), ((0.5, 50.0),)))
    assert motion.counts.yaw_rate_from_curvature > 2000
    assert motion.bias.yaw_rate == 0.0
