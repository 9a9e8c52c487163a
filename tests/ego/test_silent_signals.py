"""Own motion of which only a part comes: at low speed, after a restart, at different rates."""

from __future__ import annotations

from math import atan2, degrees, nan, pi, radians
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.config.ego import InsSettings
from candaemon.ego.ins import InsMotion
from candaemon.ego.pose import EgoStatus
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.schedule import start_ns
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.builders import Circle, known, ns

VELOCITY = ("velocity_north", "velocity_east")


def ins(*optional: str, **more: Any) -> InsMotion:
    """Return own motion from an INS with velocity, heading and these."""
    signals = {name: f"M.{name}" for name in ("heading", *VELOCITY, *optional)}
    return InsMotion(InsSettings.model_validate({"kind": "ins", "bus": "b", "dbc": "d", "signals": signals} | more))


def drive(
    motion: InsMotion, circle: Circle, times: np.ndarray, *, heading: bool = True, curvature: bool = True
) -> None:
    """Tell the frames of a drive round a circle: velocity, heading, curvature."""
    for t in times:
        ve, vn = circle.velocity(t)
        motion.update(ns(t), VELOCITY, (vn, ve))
        if heading:
            motion.update(ns(t), ("heading",), ((pi / 2 - circle.heading(t)) % (2 * pi),))
        if curvature:
            motion.update(ns(t), ("curvature",), (circle.rate / circle.speed,))


def every(step: float, begin: float, end: float) -> np.ndarray:
    return np.arange(round(begin / step), round(end / step)) * step


def error(motion: InsMotion, circle: Circle, t: float) -> tuple[float, float]:
    """Return how far the pose is from the truth: m, deg."""
    pose = known(motion.pose(ns(t)))
    return (
        float(np.hypot(*np.subtract((pose.east, pose.north), circle.position(t)))),
        abs(degrees(pose.heading - circle.heading(t))),
    )


def test_without_a_curvature_that_is_configured_there_are_samples_from_the_second_velocity_on() -> None:
    motion = ins("curvature")
    for t in every(0.01, 0.0, 0.03):
        motion.update(ns(t), VELOCITY, (0.0, 0.0))
        motion.update(ns(t), ("heading",), (0.3,))
    pose = known(motion.pose(ns(0.02)))
    assert (pose.ve, pose.vn, pose.yaw_rate, pose.status) == (0.0, 0.0, 0.0, EgoStatus.VALID)
    assert motion.known_until_ns == ns(0.02)


def test_a_car_that_stops_stands_though_its_curvature_is_silent() -> None:
    motion = ins("curvature")
    for t in every(0.05, 0.0, 60.0):
        speed = max(8.0 - 2.0 * t, 0.0)
        motion.update(ns(t), VELOCITY, (0.0, speed))
        motion.update(ns(t), ("heading",), (pi / 2,))
        if speed > 2.0:
            motion.update(ns(t), ("curvature",), (0.0,))
    for t in (5.0, 30.0, 59.99, 60.1):
        pose = known(motion.pose(ns(t)))
        assert pose.east == pytest.approx(16.0, abs=0.01)
        assert (pose.ve, pose.status) == (0.0, EgoStatus.VALID)
    assert motion.counts.samples == 1200
    assert motion.counts.yaw_rate_from_curvature == pytest.approx(60, abs=3)
    assert motion.counts.yaw_rate_from_heading == 1200 - motion.counts.yaw_rate_from_curvature


@pytest.mark.parametrize("source", ["yaw_rate", "curvature"])
def test_what_falls_silent_is_derived_and_what_comes_again_is_used(source: str) -> None:
    motion, circle = ins(source, bias_time=0.0), Circle(15.0, 0.3, 0.0)
    for t in every(0.02, 0.0, 9.0):
        drive(motion, circle, np.array([t]), curvature=False)
        if not 3.0 <= t < 6.0:
            motion.update(ns(t), (source,), (0.25 if source == "yaw_rate" else 0.25 / 15.0,))
    assert known(motion.pose(ns(2.5))).yaw_rate == pytest.approx(0.25)
    assert known(motion.pose(ns(4.5))).yaw_rate == pytest.approx(0.3, abs=1e-3)
    assert known(motion.pose(ns(8.9))).yaw_rate == pytest.approx(0.25)


@pytest.mark.parametrize("heading_step", [0.01, 0.02, 0.1, 0.2])
@pytest.mark.parametrize("curvature_step", [0.01, 0.05])
def test_messages_may_come_at_rates_of_their_own(heading_step: float, curvature_step: float) -> None:
    motion, circle = ins("curvature"), Circle(15.0, 0.3, 0.4)
    for t in every(0.01, 0.0, 8.0):
        for name, step, at in (("curvature", curvature_step, 0.003), ("heading", heading_step, 0.006)):
            if round(t / 0.01) % round(step / 0.01) == 0:
                late = t + at
                value = circle.rate / 15.0 if name == "curvature" else (pi / 2 - circle.heading(late)) % (2 * pi)
                motion.update(ns(late), (name,), (value,))
        ve, vn = circle.velocity(t + 0.008)
        motion.update(ns(t + 0.008), VELOCITY, (vn, ve))
    assert motion.counts.samples >= 0.95 * 800
    begin, end = known(motion.pose(ns(1.0))), known(motion.pose(ns(7.5)))
    moved = np.subtract(circle.position(7.5), circle.position(1.0))
    np.testing.assert_allclose((end.east - begin.east, end.north - begin.north), moved, atol=0.05)
    for t in every(0.013, 1.0, 7.9):
        assert error(motion, circle, t)[1] < 0.1


def test_a_heading_that_is_silent_at_rest_is_kept() -> None:
    motion = ins()
    for t in every(0.02, 0.0, 40.0):
        motion.update(ns(t), VELOCITY, (0.0, max(5.0 - 5.0 * t, 0.0)))
        if t < 0.9:
            motion.update(ns(t), ("heading",), (pi / 2,))
    pose = known(motion.pose(ns(39.99)))
    assert pose.heading == pytest.approx(0.0, abs=1e-3)
    assert (pose.yaw_rate, pose.status) == (0.0, EgoStatus.VALID)
    assert pose.east == pytest.approx(2.5, abs=0.01)
    assert motion.counts.heading_kept >= 1950


@pytest.mark.parametrize("gives_curvature", [True, False])
def test_a_heading_that_is_silent_in_a_bend_is_bridged(gives_curvature: bool) -> None:
    motion, circle = ins("curvature"), Circle(10.0, 0.2, 0.0)
    drive(motion, circle, every(0.02, 0.0, 3.0), curvature=gives_curvature)
    drive(motion, circle, every(0.02, 3.0, 9.0), heading=False, curvature=gives_curvature)
    assert error(motion, circle, 8.9)[1] < 0.5
    assert known(motion.pose(ns(8.9))).status is EgoStatus.VALID
    drive(motion, circle, every(0.02, 9.0, 10.0), curvature=gives_curvature)
    assert error(motion, circle, 9.9) < (0.2, 0.1)
    assert known(motion.pose(ns(9.9))).yaw_rate == pytest.approx(0.2, abs=0.01)
    counts = motion.counts
    assert (counts.heading_from_yaw_rate if gives_curvature else counts.heading_from_course) == pytest.approx(
        300, abs=5
    )


def test_who_reverses_without_a_heading_does_not_turn_round() -> None:
    motion = ins()
    for t in every(0.02, 0.0, 6.0):
        motion.update(ns(t), VELOCITY, (0.0, 4.0 - 2.0 * t if t < 4.0 else -4.0))
        if t < 1.0:
            motion.update(ns(t), ("heading",), (pi / 2,))
    pose = known(motion.pose(ns(5.9)))
    assert pose.heading == pytest.approx(0.0, abs=0.01)
    assert pose.ve == -4.0


def test_a_heading_that_was_never_told_makes_no_sample_and_one_lost_for_good_ends_them() -> None:
    motion = ins()
    for t in every(0.05, 0.0, 5.0):
        motion.update(ns(t), VELOCITY, (0.0, 0.0))
    assert motion.pose(ns(5.0)) is None
    motion.update(ns(5.0), ("heading",), (pi / 2,))
    for t in every(0.05, 5.0, 30.0):  # too slow for a course
        motion.update(ns(t), VELOCITY, (0.0, 1.5))
    assert motion.known_until_ns == pytest.approx(ns(15.0), abs=ns(0.2))
    assert known(motion.pose(ns(29.0))).status is EgoStatus.LOST


def test_while_the_velocity_is_silent_the_car_coasts_along_its_heading_then_is_lost() -> None:
    motion, circle = ins(), Circle(10.0, 0.2, 0.0)
    drive(motion, circle, every(0.02, 0.0, 4.0), curvature=False)
    for t in every(0.02, 4.0, 16.0):
        motion.update(ns(t), ("heading",), ((pi / 2 - circle.heading(t)) % (2 * pi),))
    assert error(motion, circle, 4.4) < (0.2, 0.1)
    assert known(motion.pose(ns(4.4))).status is EgoStatus.VALID
    for t in (5.0, 9.0, 13.8):
        assert error(motion, circle, t)[0] < 0.5
        assert error(motion, circle, t)[1] < 0.2
        assert known(motion.pose(ns(t))).status is EgoStatus.DEAD_RECKONING
    variances = [known(motion.pose(ns(t))).speed_variance for t in (4.4, 5.0, 9.0, 13.0)]
    assert (np.diff(variances) > 0).all()
    assert known(motion.pose(ns(14.1))).status is EgoStatus.LOST
    seen = motion.history.unseen
    drive(motion, circle, every(0.02, 16.0, 17.0), curvature=False)
    assert known(motion.pose(ns(16.5))).status is EgoStatus.VALID
    assert motion.history.unseen - seen == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize("tells", [(), ("heading",)])
def test_who_stood_when_the_velocity_fell_silent_stands(tells: tuple[str, ...]) -> None:
    motion = ins()
    for t in every(0.02, 0.0, 20.0):
        if t < 2.0:
            motion.update(ns(t), VELOCITY, (0.03, max(6.0 - 4.0 * t, 0.05)))
        if t < 2.0 or tells:
            motion.update(ns(t), ("heading",), (pi / 2,))
    at = known(motion.pose(ns(2.5)))
    for t in (3.0, 10.0, 60.0):
        pose = known(motion.pose(ns(t)))
        assert np.hypot(pose.east - at.east, pose.north - at.north) < 0.03


def test_after_a_restart_with_another_heading_nothing_jumps_and_nothing_spins() -> None:
    motion = ins()
    for t in every(0.02, 0.0, 2.0):
        motion.update(ns(t), VELOCITY, (0.0, 0.0))
        motion.update(ns(t), ("heading",), (radians(10.0),))
    for t in every(0.02, 7.0, 9.0):
        motion.update(ns(t), VELOCITY, (0.0, 0.0))
        motion.update(ns(t), ("heading",), (radians(10.0 if t < 8.0 else 140.0),))
        pose = known(motion.pose(ns(t)))
        assert (pose.east, pose.north, pose.status) == (0.0, 0.0, EgoStatus.VALID)
        assert abs(pose.yaw_rate) < 0.01
    assert degrees(known(motion.pose(ns(8.9))).heading) == pytest.approx(-50.0)


def test_one_component_of_the_velocity_is_no_velocity() -> None:
    motion = ins()
    for t in every(0.02, 0.0, 3.0):
        motion.update(ns(t), ("velocity_north", "velocity_east"), (5.0, nan if t >= 1.0 else 0.0))
        motion.update(ns(t), ("heading",), (0.0,))
    assert motion.counts.samples == 50
    assert known(motion.pose(ns(2.0))).status is EgoStatus.DEAD_RECKONING


def test_a_speed_with_slip_gives_the_velocity() -> None:
    told = {"kind": "ins", "bus": "b", "dbc": "d", "lever_arm": {"x": 2.0},
            "signals": {name: f"M.{name}" for name in ("speed", "heading", "yaw_rate", "slip")}}  # fmt: skip
    motion, circle = InsMotion(InsSettings.model_validate(told)), Circle(10.0, 0.5, 0.0)
    for t in every(0.02, 0.0, 8.0):
        speed, slip = np.hypot(10.0, 1.0), atan2(1.0, 10.0)
        names: tuple[str, ...] = ("speed", "yaw_rate", "slip") if t < 4.0 else ("speed", "yaw_rate")
        motion.update(ns(t), ("heading",), ((pi / 2 - circle.heading(t)) % (2 * pi),))
        motion.update(ns(t), names, (speed, 0.5, slip)[: len(names)])
    for t in (3.9, 7.9):
        pose = known(motion.pose(ns(t)))
        np.testing.assert_allclose((pose.ve, pose.vn), circle.velocity(t), atol=1e-6)


def test_an_acceleration_that_comes_is_believed() -> None:
    motion, plain = ins("ax"), ins()
    for t in every(0.1, 0.0, 1.1):
        for each in (motion, plain):
            each.update(ns(t), VELOCITY, (0.0, 10.0))
            each.update(ns(t), ("heading",), (pi / 2,))
        motion.update(ns(t), ("ax",), (-4.0,))
    assert known(plain.pose(ns(1.3))).ve == pytest.approx(10.0)
    assert known(motion.pose(ns(1.3))).ve == pytest.approx(10.0 - 4.0 * 0.3)
    assert motion.counts.acceleration_given == motion.counts.samples == 11


@settings(deadline=None, max_examples=150)
@given(
    frames=st.lists(
        st.tuples(
            st.integers(0, 10**11),
            st.sampled_from((*VELOCITY, "heading", "curvature", "yaw_rate", "ax")),
            st.one_of(st.just(nan), st.floats(-100, 100)),
        ),
        max_size=60,
    )
)
def test_any_frames_of_an_ins_give_a_finite_pose(frames: list[tuple[int, str, float]]) -> None:
    motion = ins("curvature", "yaw_rate", "ax")
    for time_ns, name, value in frames:
        motion.update(time_ns, (name,), (value,))
        pose = motion.pose(time_ns)
        if pose is not None:
            numbers = (pose.east, pose.north, pose.heading, pose.ve, pose.vn, pose.yaw_rate, pose.speed_variance)
            assert np.isfinite(numbers).all()
    motion.history.state.validate()


def test_a_state_waits_for_the_configurations_quantities_only() -> None:
    motion, other = ins("curvature"), ins("yaw_rate")
    motion.update(0, VELOCITY, (0.0, 0.0))
    with pytest.raises(ValueError, match="other quantities"):
        other.state = motion.state


def test_what_stands_stands_while_a_simulated_car_starts_and_stops() -> None:
    """Through the whole pipeline: standing, driving round a bend, standing again."""
    scenario = Scenario.model_validate(
        {
            "duration": 22,
            "ego": {
                "segments": [
                    {"until": 3},
                    {"speed": 8, "acceleration": 2},
                    {"until": 11, "yaw_rate_deg": 5},
                    {"speed": 0, "acceleration": 2},
                    {"until": 22},
                ],
                "own_motion": {
                    "noise": 0.05,
                    "silent_below": {"curvature": 2.0},
                    "silent": [{"quantity": "heading", "begin": 17, "end": 22}],
                },
            },
            "stationary": {"posts": [{"x": x, "y": y} for x, y in ((60, -6), (60, 8), (90, 20), (110, 50))]},
        }
    )
    bound = binding("esr_ins")
    pipeline, scene = Pipeline(bound), Scene(scenario)
    errors, speeds = [], []
    for cycle in pipeline.run(simulate(scenario, bound).frames()):
        t = (cycle.obstacles.time_ns - start_ns(scenario)) * 1e-9
        truth = scene.ego(np.array([t])).position[0]
        errors.append((t, complex(cycle.pose.east, cycle.pose.north) - truth, cycle.pose.status))
        settled = (cycle.obstacles.state == 1) & (cycle.obstacles.age > 2.0)
        speeds += [(t, speed) for speed in np.hypot(cycle.obstacles.ve, cycle.obstacles.vn)[settled]]
    standing = [offset for t, offset, _ in errors if t > 15.5]
    assert max(abs(offset - standing[0]) for offset in standing) < 0.06
    assert {status for _, _, status in errors} == {EgoStatus.VALID}
    assert len([speed for t, speed in speeds if t > 15.5]) > 200
    assert max(speed for t, speed in speeds if t > 16.0) < 0.3
    assert max(abs(offset) for t, offset, _ in errors if t < 3.0) < 0.03
    counts, came = pipeline.ego.counts, pipeline.ego_signals
    assert 0 < came["curvature"] < came["heading"] < came["velocity_north"] == came["velocity_east"]
    assert counts.yaw_rate_from_curvature > 0
    assert counts.yaw_rate_from_heading > 0
