"""The tracker of vehicles: one obstacle a body, whoever sees it and however many reflections it shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.config.directions import AlongAcross
from candaemon.config.load import load_config
from candaemon.estimation.body_filter import BIAS, POSITION
from candaemon.estimation.measurement import Projection
from candaemon.estimation.outline import facing_point
from candaemon.pipeline.cycle import Cycle
from candaemon.playback.cycle_smoothing import CycleSmoother
from candaemon.radar.mounting import sensor_views
from candaemon.tracking.body_modes import STANDING as STANDS
from candaemon.tracking.obstacles import CAR, CONFIRMED, PEDESTRIAN, STANDING, TRUCK, TWO_WHEELER, Obstacles
from tests.support.builders import HandFedVehicles, Seen, assert_sane, car, detections, place, pose, times
from tests.support.effort import examples
from tests.support.paths import ROOT

SPEED = 20.0
LORRY = (0.0, 2.5, 5.0, 7.5)
"""m behind the first reflection: reflections of a lorry."""


def ids(told: Obstacles) -> list[int]:
    return [int(each) for each in told.id]


def lorry(t: float) -> list[Seen]:
    """Return the reflections of a lorry that drives ahead: one at first, then one more every half second."""
    shown = LORRY[: 1 + int(t / 0.5)]
    return [car(key, t, 40.0 + behind, 0.0, SPEED) for key, behind in enumerate(shown)]


def noisy(rng: np.random.Generator, seen: Sequence[Seen], deviation: float = 0.1) -> list[Seen]:
    shifts = rng.normal(size=(len(seen), 2)) * deviation
    return [replace(each, x=each.x + dx, y=each.y + dy) for each, (dx, dy) in zip(seen, shifts, strict=True)]


def test_reflections_of_one_vehicle_are_one_obstacle() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(1)
    for t in times(1, 60):
        told = fed.scan(t, noisy(rng, lorry(t)))
    assert len(told) == 1
    assert told.vx[0] == pytest.approx(SPEED, abs=0.3)
    assert told.length[0] > 7.0
    assert told.kind[0] == TRUCK
    assert len(told.used_row) == 4
    assert fed.tracker.counts.used == fed.tracker.counts.detections


def test_a_vehicle_is_as_long_as_its_reflections_of_all_sensors_show() -> None:
    """None of two sensors in turn sees all of it."""
    fed, rng = HandFedVehicles(), np.random.default_rng(4)
    for k, t in enumerate(times(1, 80)):
        shown = lorry(t)
        told = fed.scan(t, noisy(rng, shown[1:] or shown if k % 2 else shown[:-1] or shown), sensor=k % 2)
    assert len(told) == 1
    assert told.length[0] == pytest.approx(8.0, abs=0.6)


@pytest.mark.parametrize("sensors", [1, 4])
def test_a_length_once_shown_is_forgotten_no_faster_where_more_sensors_look(sensors: int) -> None:
    fed = HandFedVehicles()
    for t in times(1, 80):
        shown = fed.scan(t, lorry(t))
    for t in times(80, 180):
        for sensor in range(sensors):
            later = t + sensor * 0.05 / sensors
            told = fed.scan(later, [car(0, later, 40.0)], sensor=sensor)
    assert len(told) == 1
    assert told.length[0] == pytest.approx(4.5 + (shown.length[0] - 4.5) * np.exp(-5.0 / 25.0), abs=0.1)


def test_reflections_of_the_first_scan_are_joined() -> None:
    """The range rate tells the first speed: nothing of it goes to what would stand."""
    fed = HandFedVehicles()
    told = fed.scan(0.05, [car(key, 0.05, 40.0 + behind) for key, behind in enumerate(LORRY)])
    assert len(told) == 1
    assert told.vx[0] == pytest.approx(SPEED, abs=0.1)


def test_two_sensors_that_see_one_vehicle_have_one_obstacle() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(2)
    for k, t in enumerate(times(1, 60)):
        sensor = k % 2
        told = fed.scan(t, noisy(rng, [car(10 * sensor + 3, t, 40.0)]), sensor=sensor)
        assert len(told) == 1
    assert told.sensors.tolist() == [0b11]
    assert told.state[0] == CONFIRMED
    reflections = fed.tracker.state.tracks.reflections
    assert len(reflections) <= 2


@pytest.mark.parametrize("keys", [(1, 2), (7, 7)], ids=["of their own", "the same"])
def test_ids_of_two_sensors_do_not_meet(keys: tuple[int, int]) -> None:
    """Two cars in neighbouring lanes, each seen by one sensor, whatever their ids."""
    fed = HandFedVehicles()
    for k, t in enumerate(times(1, 60)):
        told = fed.scan(t, [car(keys[k % 2], t, 40.0, 4.0 * (k % 2))], sensor=k % 2)
    assert len(told) == 2
    assert sorted(told.y.round(1).tolist()) == [0.0, 4.0]
    assert sorted(told.sensors.tolist()) == [1, 2]


def test_another_leader_moves_nothing() -> None:
    """The leading reflection is seen no more: the obstacle neither jumps nor changes its speed."""
    fed, rng = HandFedVehicles(), np.random.default_rng(3)
    for t in times(1, 80):
        told = fed.scan(t, noisy(rng, lorry(t)))
    leader = int(fed.tracker.state.tracks.obstacles.leader[0])
    keys, before = fed.tracker.state.tracks.reflections.object_id, told
    gone = int(keys[leader])
    for t in times(80, 110):
        told = fed.scan(t, [each for each in noisy(rng, lorry(t)) if each.key != gone])
        assert ids(told) == ids(before)
        assert told.x[0] - before.x[0] == pytest.approx(SPEED * (told.time_ns - before.time_ns) * 1e-9, abs=0.35)
        assert told.vx[0] == pytest.approx(SPEED, abs=0.4)
        before = told
    assert int(fed.tracker.state.tracks.reflections.object_id[fed.tracker.state.tracks.obstacles.leader[0]]) != gone


def test_what_the_filter_expects_stays_where_it_is_when_another_leads() -> None:
    fed = HandFedVehicles()
    for t in times(1, 40):
        fed.scan(t, lorry(t))
    bodies = fed.tracker._bodies
    expected, _ = bodies.reflection_states()
    was = bodies.moments().mean[0, POSITION].copy()
    other = int(np.flatnonzero(np.arange(4) != bodies.obstacles.leader[0])[0])
    bodies.lead(np.array([0]), np.array([other]))
    after, _ = bodies.reflection_states()
    np.testing.assert_allclose(after, expected, atol=1e-9)
    np.testing.assert_allclose(bodies.moments().mean[0, POSITION], was, atol=1e-9)


def test_two_obstacles_of_one_course_merge_into_the_older() -> None:
    """They come nearer to each other slowly, as two tracks of one vehicle do that began apart."""
    fed = HandFedVehicles()
    for t in times(1, 30):
        told = fed.scan(t, [car(0, t, 40.0), car(1, t, 49.0, speed=SPEED - 1.2)])
    assert ids(told) == [1, 2]
    for t in times(30, 120):
        told = fed.scan(t, [car(0, t, 40.0), car(1, t, 49.0, speed=SPEED - 1.2)])
    assert ids(told) == [1]
    assert fed.tracker.counts.merged == 1


@pytest.mark.parametrize(("ahead", "speed", "count"), [(6.0, SPEED, 1), (9.0, SPEED, 2), (11.0, 40.0, 2)])
def test_nobody_follows_so_closely(ahead: float, speed: float, count: int) -> None:
    """What drives a metre or so ahead of a car, as fast, is another part of it; a driver keeps another distance.

    At 40 m/s some keep no more than 6.5 m, which are .16 s: nothing so fast is long.
    """
    fed, rng = HandFedVehicles(), np.random.default_rng(2)
    for t in times(1, 120):
        told = fed.scan(t, noisy(rng, [car(0, t, 40.0, speed=speed), car(1, t, 40.0 + ahead, speed=speed)]))
    assert len(told) == count


def test_a_detection_within_the_box_of_a_lorry_is_of_the_lorry() -> None:
    """Its rear alone is seen until its front is, ten metres ahead of that."""
    fed = HandFedVehicles()
    for t in times(1, 60):
        fed.scan(t, [car(0, t, 40.0)], length=np.array([12.0]))
    told = fed.scan(t + 0.05, [car(0, t + 0.05, 40.0), car(1, t + 0.05, 50.5)], length=np.array([12.0, 12.0]))
    assert len(told) == 1
    assert len(told.used_row) == 2


def test_a_reflection_seen_at_another_angle_is_of_the_body_that_passes() -> None:
    """Beside us one end of a car still comes nearer while the other goes away: both rates are of one velocity."""
    fed = HandFedVehicles()
    for t in times(1, 40):
        front = Seen(0, 12.0 * t - 21.0, 3.0, 12.0)
        told = fed.scan(t, [front] if front.x < 1.0 else [front, Seen(1, front.x - 3.0, 3.0, 12.0)])
        assert len(told) == 1
    assert len(told.used_row) == 2


def test_what_stands_is_where_it_is_nearest_to_us() -> None:
    """A lorry that stands is seen at its rear and along its side: its axis is not known."""
    fed, rng = HandFedVehicles(), np.random.default_rng(4)
    for t in times(1, 160):
        told = fed.scan(t, noisy(rng, [Seen(k, 30.0 + x, 0.0, 0.0, 0.0) for k, x in enumerate((0.0, 3.0, 6.0))]))
    assert len(told) == 1
    assert told.x[0] == pytest.approx(30.0, abs=0.5)


def test_neighbours_in_two_lanes_do_not_merge() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(5)
    for t in times(1, 150):
        told = fed.scan(t, noisy(rng, [car(0, t, 40.0), car(1, t, 41.0, 3.5)]))
    assert len(told) == 2


def test_a_reflection_that_drives_away_becomes_an_obstacle() -> None:
    fed = HandFedVehicles()
    for t in times(1, 60):
        told = fed.scan(t, [car(0, t, 40.0), car(1, t, 42.0)])
    first = ids(told)
    assert len(first) == 1
    for t in times(60, 120):
        away = 2.0 + 8.0 * (t - 3.0)
        told = fed.scan(t, [car(0, t, 40.0), Seen(1, 40.0 + SPEED * t + away, 0.0, SPEED + 8.0, 0.0)])
    assert len(told) == 2
    assert first[0] in ids(told)
    near, far = (place(told, each)[0] for each in sorted(ids(told)))
    assert far - near == pytest.approx(2.0 + 8.0 * (last_time(120) - 3.0), abs=1.5)


def last_time(last: int) -> float:
    return next(times(last - 1, last))


def test_detections_without_identity_keep_one_obstacle() -> None:
    """Slots that change with every scan: place and speed alone say who is who."""
    fed, rng = HandFedVehicles(), np.random.default_rng(6)
    identities: set[tuple[int, ...]] = set()
    for k, t in enumerate(times(1, 100)):
        cars = [car(0, t, 30.0, 0.0), car(0, t, 60.0, 3.6), car(0, t, 90.0, -3.6)]
        cars = [replace(cars[(row + k) % 3], key=row) for row in range(3)]
        told = fed.scan(t, noisy(rng, cars), identified=False)
        if k > 20:
            identities.add(tuple(sorted(ids(told))))
    assert len(told) == 3
    assert len(identities) == 1
    assert not fed.tracker.state.tracks.row_of
    assert fed.tracker.counts.slot_jumps == 0


def test_ids_that_flicker_each_scan_do_not_end_an_obstacle() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(7)
    for t in times(1, 100):
        told = fed.scan(t, noisy(rng, [car(int(rng.integers(0, 64)), t, 40.0)]))
        assert ids(told) == [1]
    assert len(fed.tracker.state.tracks.reflections) < 4


def test_two_objects_of_one_id_are_two_obstacles() -> None:
    fed = HandFedVehicles()
    for t in times(1, 40):
        told = fed.scan(t, [car(5, t, 40.0), car(5, t, 80.0, 3.5)])
    assert sorted(told.y.round(1).tolist()) == [0.0, 3.5]
    assert len(told) == 2


TOLD = st.sampled_from((4.2, 12.0, 1e-9, 300.0, float("nan"))) | st.floats(0.0, 40.0)


@settings(deadline=None, max_examples=examples(25))
@given(sizes=st.lists(st.tuples(TOLD, TOLD, st.floats(-pi, pi) | st.just(float("nan"))), min_size=20, max_size=20))
def test_whatever_sizes_are_told_the_box_is_possible(sizes: list[tuple[float, float, float]]) -> None:
    fed = HandFedVehicles()
    for t, (length, width, heading) in zip(times(1, 30), sizes, strict=False):
        told = fed.scan(
            t, [car(0, t, 40.0)], length=np.array([length]), width=np.array([width]), heading=np.array([heading])
        )
        assert_sane(told)
        obstacles = fed.tracker.state.tracks.obstacles
        for column in (obstacles.length, obstacles.width, obstacles.length_variance, obstacles.width_variance):
            assert np.isfinite(column).all()
            assert (column > 0.0).all()
        np.testing.assert_allclose(np.hypot(*obstacles.axis.T), 1.0, atol=1e-9)


def test_sizes_that_are_told_become_the_boxes() -> None:
    fed = HandFedVehicles()
    for t in times(1, 60):
        told = fed.scan(t, [car(0, t, 40.0)], length=np.array([5.2]), width=np.array([2.1]))
    assert told.length[0] == pytest.approx(5.2, abs=0.2)
    assert told.width[0] == pytest.approx(2.1, abs=0.1)


@pytest.mark.parametrize(
    ("length", "width", "kind"), [(0.5, 0.6, PEDESTRIAN), (1.9, 0.7, TWO_WHEELER), (4.5, 1.8, CAR), (12.0, 2.5, TRUCK)]
)
def test_a_length_that_is_told_alone_tells_a_width(length: float, width: float, kind: int) -> None:
    """A pedestrian of half a metre had the width of a car; a car close by that shows one reflection is no rider."""
    fed = HandFedVehicles()
    speed = 5.0 if length > 1.0 else 1.5
    for t in times(1, 60):
        told = fed.scan(t, [car(0, t, 15.0, speed=speed)], length=np.array([length]))
    assert told.length[0] == pytest.approx(length, abs=0.1 * length)
    assert told.width[0] == pytest.approx(width)
    assert told.kind[0] == kind


@pytest.mark.parametrize(("told", "longest", "length"), [(7.875, 7.875, 13.0), (7.5, 7.875, 7.5), (25.5, 25.5, 25.5)])
def test_a_length_at_the_end_of_its_signal_is_at_least_a_lorrys(told: float, longest: float, length: float) -> None:
    """What is longer than the signal can tell is told as that."""
    fed = HandFedVehicles()
    for t in times(1, 40):
        seen = fed.scan(t, [car(1, t, 30.0)], length=np.array([told]), longest=longest)
    assert seen.length[0] == pytest.approx(length, abs=0.1)
    assert seen.kind[0] == TRUCK


def test_the_reference_point_faces_us_and_belongs_to_the_box() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(8)
    for t in times(1, 100):
        told = fed.scan(t, noisy(rng, [car(0, t, 40.0, 6.0)]), length=np.array([4.4]), width=np.array([1.9]))
    centre = np.array([told.center_x[0], told.center_y[0]])
    turn = told.heading[0]
    rotation = np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
    expected = centre + rotation @ facing_point((-centre @ rotation)[None], told.length / 2, told.width / 2)[0]
    np.testing.assert_allclose([told.x[0], told.y[0]], expected, atol=0.05)
    assert told.center_x[0] > told.x[0]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_lorry_that_crosses_shows_its_front_then_its_rear(side: float) -> None:
    """The lorry moves as it did: it is its reference point that goes from the front to the rear."""
    fed = HandFedVehicles()
    for t in times(1, 100):
        ahead = 10.0 * t - 25.0
        shown = [5.5, 0.0] if ahead < 0.0 else [5.5, 0.0, -5.5] if ahead < 3.0 else [0.0, -5.5]
        keys = [{5.5: 0, 0.0: 1, -5.5: 2}[place] for place in shown]
        seen = [Seen(k, 10.0, side * (ahead + at), 0.0, side * 10.0) for k, at in zip(keys, shown, strict=True)]
        told = fed.scan(t, seen, length=np.full(len(seen), 12.0), width=np.full(len(seen), 2.5))
        if t > 1.0:
            assert len(told) == 1
            assert hypot(told.center_x[0] - 11.25, told.center_y[0] - side * ahead) < 2.7
            assert hypot(told.vx[0], told.vy[0] - side * 10.0) < 0.3


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_car_that_turns_off_is_one_obstacle_with_the_velocity_of_its_reference_point(side: float) -> None:
    """At 0.6 rad/s, what lies 1.6 m before and behind its centre moves 1 m/s to either side of the course."""
    fed, rng = HandFedVehicles(), np.random.default_rng(9)
    turn, speed = side * 0.6, 7.0
    for t in times(1, 80):
        yaw = turn * max(t - 1.0, 0.0)
        ahead, left = np.array([cos(yaw), sin(yaw)]), np.array([-sin(yaw), cos(yaw)])
        circled = speed / turn * np.array([sin(yaw), 1.0 - cos(yaw)])
        centre = np.array([18.0 + speed * min(t, 1.0), 0.0]) + circled
        arms = [arm * ahead for arm in (-1.6, 1.6)]
        swing = turn * left if t > 1.0 else np.zeros(2)
        ends = [(centre + arm, speed * ahead + (arm @ ahead) * swing) for arm in arms]
        seen = noisy(rng, [Seen(k, *place, *velocity) for k, (place, velocity) in enumerate(ends)])
        told = fed.scan(t, seen, length=np.full(2, 4.8), width=np.full(2, 1.9))
        assert len(told) == 1
        if t > 1.5:
            arm = [told.x[0] - told.center_x[0], told.y[0] - told.center_y[0]]
            there = speed * ahead + turn * np.array([-arm[1], arm[0]])
            assert hypot(told.vx[0] - there[0], told.vy[0] - there[1]) < 1.6


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_side_of_a_car_that_circles_us_keeps_up_with_its_centre(side: float) -> None:
    """The middle of its side is nearer to us than its centre, and slower by .36 m/s."""
    fed, rate = HandFedVehicles(), side * 0.4
    for t in times(1, 100):
        ahead, left = np.array([cos(rate * t), sin(rate * t)]), np.array([-sin(rate * t), cos(rate * t)])
        at, velocity = 19.1 * ahead, 19.1 * rate * left
        scan = detections(pose(t), [Seen(0, *at, *velocity)], sensor=0, noise=(0.3, 0.3, 0.1))
        told = tuple(Projection(line[None], line[None] @ velocity, np.array([0.01])) for line in (ahead, left))
        scan = replace(scan, measurement=replace(scan.measurement, projections=told), length=np.array([4.6]))
        found = fed.tracker.step(replace(scan, width=np.array([1.8])), pose(t))
        (expected,) = fed.tracker.expected_positions([0.25])
        if t > 2.0:
            assert len(found) == 1
            assert abs((np.array([found.x[0], found.y[0]]) - at) @ left) < 0.22
            later = 19.1 * np.array([cos(rate * (t + 0.25)), sin(rate * (t + 0.25))])
            assert np.hypot(*(expected[0] - later)) < 0.25
    before = fed.tracker.step(None, pose(t - 0.04))
    assert hypot(before.x[0] - found.x[0], before.y[0] - found.y[0]) == pytest.approx(19.1 * 0.4 * 0.04, abs=0.008)


def test_a_car_that_stops_beside_a_post_stays_a_car() -> None:
    """The post has stood all the time: it is none of what has moved."""
    fed, rng = HandFedVehicles(), np.random.default_rng(4)
    for t in times(1, 200):
        speed = max(8.0 - 2.0 * t, 0.0)
        place = 40.0 - 0.5 * (16.0 - speed * speed / 4.0)
        told = fed.scan(t, noisy(rng, [Seen(0, place, 0.0, -speed), Seen(1, 30.5, 1.0)]))
    assert len(told) == 2


@pytest.mark.parametrize(("apart", "obstacles"), [(3.0, 1), (5.0, 2)])
def test_a_car_that_stands_across_is_one_obstacle(apart: float, obstacles: int) -> None:
    """It never showed a course: its ends, of which a scan shows one, may lie in any direction from each other."""
    fed, rng = HandFedVehicles(), np.random.default_rng(6)
    for k, t in enumerate(times(1, 60)):
        told = fed.scan(t, noisy(rng, [Seen(k % 2, 15.0, apart * (k % 2))]))
    assert len(told) == obstacles


def test_what_is_about_to_be_a_part_of_an_obstacle_is_none_meanwhile() -> None:
    """The mirror of a car, farther from its rear than a new reflection may be: the two merge after a while."""
    fed = HandFedVehicles(noise=(0.3, 0.3, 0.06))
    for t in times(1, 100):
        seen = [car(0, t, 40.0)] if t < 2.0 else [car(0, t, 40.0), car(1, t, 43.9, 1.3)]
        told = fed.scan(t, seen)
        assert np.count_nonzero(told.state == CONFIRMED) <= 1
    assert len(told) == 1
    assert len(fed.tracker.state.tracks.reflections) == 2


def test_what_was_about_to_merge_with_an_obstacle_that_has_gone_is_confirmed() -> None:
    fed = HandFedVehicles()
    for t in times(1, 60):
        seen = [car(0, t, 40.0)] if t < 0.28 else [car(0, t, 40.0), car(1, t, 46.0)] if t < 0.33 else [car(1, t, 46.0)]
        told = fed.scan(t, seen)
    assert told.state.tolist() == [CONFIRMED]


@pytest.mark.parametrize("left", [2.2, 3.0])
def test_who_stands_beside_a_car_that_a_second_sensor_sees_alone_is_confirmed(left: float) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(9)
    for t in times(1, 60):
        told = fed.scan(t, noisy(rng, [Seen(0, 15.0, 0.0), Seen(1, 15.0, left)], 0.05))
        fed.scan(t + 0.025, noisy(rng, [Seen(0, 15.0, 0.0)], 0.05), sensor=1)
    assert np.count_nonzero(told.state == CONFIRMED) == 2


@pytest.mark.parametrize(("aside", "obstacles"), [(1.85, 1), (2.4, 2)])
def test_the_side_of_a_lorry_is_a_part_of_it_and_what_drives_abreast_is_another(aside: float, obstacles: int) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(11)
    for t in times(1, 100):
        seen = [*lorry(t), car(9, t, 42.0, aside)] if t > 2.0 else lorry(t)
        told = fed.scan(t, noisy(rng, seen, 0.05))
    assert len(told) == obstacles


@pytest.mark.parametrize(("between", "obstacles"), [((), 2), ((1.2, 2.6), 1)])
def test_both_ends_of_what_stands_across_are_one_where_reflections_lie_between(
    between: Sequence[float], obstacles: int
) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(7)
    for t in times(1, 100):
        shown = (0.0, 4.0) if t < 2.0 else (0.0, *between, 4.0)
        told = fed.scan(t, noisy(rng, [Seen(round(10 * left), 15.0, left) for left in shown], 0.05))
    assert len(told) == obstacles


@pytest.mark.parametrize("beside", [1.6, 2.5])
def test_who_stands_beside_a_car_and_walks_away_is_an_obstacle_of_its_own(beside: float) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(6)
    for t in times(1, 120):
        left = beside + 1.4 * max(t - 1.5, 0.0)
        told = fed.scan(t, noisy(rng, [Seen(0, 15.0, 0.0), Seen(1, 15.0, left, 0.0, 1.4 if t > 1.5 else 0.0)]))
    assert len(told) == 2
    assert told.vy.max() == pytest.approx(1.4, abs=0.3)


def test_a_sensor_that_tells_velocities_adds_to_what_one_without_them_has_just_found() -> None:
    """It crosses: its range rate tells nothing, and its reflection slides from one scan to the next."""
    fed = HandFedVehicles()
    for t in times(1, 6):
        fed.scan(t, [Seen(0, 20.0, 3.0 * t, 0.0, 3.0)])
    for t in times(6, 9):
        scan = detections(pose(t), [Seen(0, 20.0, 7.0 * t - 1.0, 0.0, 7.0)], sensor=1, noise=(0.1, 0.1, 0.06))
        across = (Projection(np.array([[0.0, 1.0]]), np.array([7.0]), np.array([0.09])),)
        told = fed.tracker.step(replace(scan, measurement=replace(scan.measurement, projections=across)), pose(t))
    assert len(told) == 1
    assert told.sensors.tolist() == [0b11]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_car_that_passes_shows_its_front_then_its_rear(side: float) -> None:
    """No sensor tells how long it is: it showed several reflections, and is as long as a car."""
    fed = HandFedVehicles()
    for t in times(1, 100):
        centre = 12.0 * t - 30.0
        shown = [2.2, 1.4] if centre < -3.0 else [0.8, -0.8] if centre < 3.0 else [-1.4, -2.2]
        seen = [Seen(round(10 * (at + 3.0)), centre + at, side * 3.5, 12.0) for at in shown]
        told = fed.scan(t, seen)
        assert len(told) == 1
        if abs(centre) > 8.0 and t > 0.5:
            assert told.x[0] - centre == pytest.approx(-2.2 if centre > 0.0 else 2.2, abs=1.2)


def test_a_size_or_heading_that_nothing_has_told_is_not_told() -> None:
    """One reflection, at first of a speed along the line of sight alone; later the course tells the heading."""
    fed, rng = HandFedVehicles(), np.random.default_rng(8)
    told = [fed.scan(t, noisy(rng, [Seen(0, 50.0 - 3.0 * t, -20.0 + 9.0 * t, -3.0, 9.0)])) for t in times(1, 80)]
    assert np.isnan(told[0].heading[0])
    assert told[-1].heading[0] == pytest.approx(np.arctan2(9.0, -3.0), abs=0.05)
    for each in told:
        assert np.isnan([each.length[0], each.width[0]]).all()
        assert (each.center_x[0], each.center_y[0]) == (each.x[0], each.y[0])


def test_what_shows_no_speed_along_the_line_of_sight_stands_at_first() -> None:
    """A post, and a car that drives as fast as we do, seen once."""
    fed, at = HandFedVehicles(), pose(0.05, ve=20.0)
    fed.scan(0.05, [Seen(0, 100.0, 4.0), Seen(1, 60.0, -4.0, 20.0)], ego=at)
    _, probability = fed.tracker.mode_probabilities()
    assert probability[0, STANDS] > 0.8
    assert probability[1, STANDS] < 0.01


@pytest.mark.parametrize("speed", [0.0, 90.0, 1e200])
def test_a_speed_at_range_0_leaves_numbers(speed: float) -> None:
    fed, at = HandFedVehicles(), pose(0.05, ve=20.0)
    assert_sane(fed.scan(0.05, [Seen(0, 0.0, 0.0)], ego=at))
    scan = detections(at, [Seen(1, 0.0, 0.0)], sensor=0, noise=(0.1, 0.1, 0.06))
    rate = np.array([speed])
    assert_sane(fed.tracker.step(replace(scan, measurement=replace(scan.measurement, range_rate=rate)), at))


@pytest.mark.parametrize("course", [0.0, 0.6, 2.5])
def test_the_axis_is_the_course_of_what_drives(course: float) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(9)
    for t in times(1, 100):
        x, y = 60.0 + 10.0 * t * cos(course), 10.0 * t * sin(course)
        told = fed.scan(t, noisy(rng, [Seen(0, x, y, 10.0 * cos(course), 10.0 * sin(course))]))
    turned = (told.heading[0] - course + pi) % (2 * pi) - pi
    assert abs(turned) < 0.05


def test_ids_of_what_brakes_hard_are_believed() -> None:
    """At 9 m/s², of a radar that measures ten times a second."""
    fed, x, speed = HandFedVehicles(noise=(0.4, 0.4, 0.06)), 50.0, 30.0
    for k in range(1, 60):
        speed -= 0.9 if k > 40 else 0.0
        x += 0.1 * speed
        told = fed.scan(0.1 * k, [Seen(1, x, 0.0, speed), Seen(2, x + 0.8, -0.8, speed)])
    assert fed.tracker.counts.slot_jumps == 0
    assert fed.tracker.counts.obstacles == len(told) == 1
    assert told.vx[0] == pytest.approx(speed, abs=0.2)


@pytest.mark.parametrize("interval", [0.05, 0.1])
def test_the_acceleration_of_what_brakes_hard_is_told(interval: float) -> None:
    """Whose speed was steady until then, by a precise range rate: its acceleration seemed well known."""
    fed, rng, x, speed = HandFedVehicles(noise=(0.4, 0.4, 0.06)), np.random.default_rng(14), 30.0, 22.0
    told: dict[float, float] = {}
    for k in range(1, round(5.2 / interval) + 1):
        t = round(k * interval, 3)
        speed -= 8.0 * interval if t > 3.0 else 0.0
        x += interval * speed
        told[t] = float(fed.scan(t, noisy(rng, [Seen(0, x, 0.0, speed)])).ax[0])
    assert abs(told[3.0]) < 0.5
    assert told[3.8] < -4.0
    assert told[5.2] == pytest.approx(-8.0, abs=1.0)


def test_what_stops_keeps_its_heading() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(10)
    x, speed = 40.0, 10.0
    headings = []
    for t in times(1, 300):
        speed = max(speed - 0.15, 0.0) if t > 3.0 else speed
        x += 0.05 * speed
        told = fed.scan(t, noisy(rng, [Seen(0, x, 0.0, speed)]))
        headings.append(float(told.heading[0]))
    assert np.abs(headings[60:]).max() < 0.15
    assert hypot(told.vx[0], told.vy[0]) < 0.3
    assert told.yaw_rate[0] == 0.0


def test_a_walker_is_small() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(11)
    for t in times(1, 120):
        told = fed.scan(t, noisy(rng, [Seen(0, 15.0, -4.0 + 1.4 * t, 0.0, 1.4)]))
    assert told.kind[0] == PEDESTRIAN
    assert told.length[0] < 1.0
    assert told.vy[0] == pytest.approx(1.4, abs=0.3)


def test_a_walker_that_once_seemed_to_run_is_small_before_long() -> None:
    fed, rng, lengths = HandFedVehicles(), np.random.default_rng(12), list[float]()
    for t in times(1, 240):
        slid = min(max(t - 1.5, 0.0), 0.8) * 4.0  # as a reflection does that is far away
        told = fed.scan(t, noisy(rng, [Seen(0, 15.0, -8.0 + 1.4 * t + slid, 0.0, 1.4)]))
        lengths.append(float(told.length[0]))
    assert 1.5 < lengths[90] < 2.0  # it runs, or rides
    assert lengths[-1] < 1.0


def test_a_car_that_stops_is_not_small_though_one_reflection_shows() -> None:
    fed, rng, x, speed = HandFedVehicles(), np.random.default_rng(13), 18.0, 15.0
    for t in times(1, 300):
        speed = max(speed - 0.25, 0.0) if t > 2.0 else speed
        x += 0.05 * speed
        own = pose(t, east=x - 18.0, ve=speed)
        fed.scan(t, noisy(rng, [Seen(0, x, 0.0, speed)]), ego=own)
    assert speed == 0.0
    assert fed.tracker.state.tracks.obstacles.length[0] > 4.0


@pytest.mark.parametrize(("aside", "small"), [(2.0, False), (6.0, True)], ids=["hidden", "in sight"])
def test_what_another_one_hides_is_not_small_though_one_reflection_shows(aside: float, small: bool) -> None:
    (radar,) = load_config(ROOT / "config" / "esr_ins.yaml").config.sensors.values()
    fed = HandFedVehicles(sensors={0: radar}, views=list(sensor_views(radar, 0).values()))
    rng, length, width = np.random.default_rng(18), np.array([4.5, np.nan]), np.array([1.9, np.nan])
    for t in times(1, 100):
        both = [Seen(0, 8.0 + 1.4 * t, 0.0, 1.4), Seen(1, 16.0 + 1.4 * t, aside, 1.4)]
        fed.scan(t, noisy(rng, both), length=length, width=width)
    assert (fed.tracker.state.tracks.obstacles.length[1] < 1.0) == small


@pytest.mark.parametrize(("across", "small"), [(True, True), (False, False)], ids=["across", "ahead"])
def test_who_rides_across_is_small_soon_and_what_drives_ahead_may_be_a_car(across: bool, small: bool) -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(15)
    for t in times(1, 80):
        seen = Seen(0, 15.0, -12.0 + 6.0 * t, 0.0, 6.0) if across else Seen(0, 6.0 + 6.0 * t, 0.0, 6.0)
        fed.scan(t, noisy(rng, [seen]))
    assert (fed.tracker.state.tracks.obstacles.length[0] < 2.0) == small


def test_what_seemed_to_ride_and_shows_to_be_long_is_as_wide_as_a_car() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(19)
    for t in times(1, 120):
        front = Seen(0, 15.0, -12.0 + 6.0 * t, 0.0, 6.0)
        rear = Seen(1, 15.0, -14.2 + 6.0 * t, 0.0, 6.0)
        fed.scan(t, noisy(rng, [front, rear] if t > 3.5 else [front]))
        if 3.0 < t < 3.5:
            assert fed.tracker.state.tracks.obstacles.width[0] < 1.0
    assert fed.tracker.state.tracks.obstacles.length[0] > 2.5
    assert fed.tracker.state.tracks.obstacles.width[0] > 1.5


def test_a_car_that_keeps_beside_us_in_a_queue_does_not_cross() -> None:
    fed, rng = HandFedVehicles(), np.random.default_rng(16)
    for t in times(1, 120):
        fed.scan(t, noisy(rng, [Seen(0, 2.0 + 6.0 * t, 3.2, 6.0)]), ego=pose(t, east=6.0 * t, ve=6.0))
    assert fed.tracker.state.tracks.obstacles.length[0] > 4.0


@pytest.mark.parametrize(("decelerated", "small"), [(True, False), (False, True)], ids=["stops", "goes on"])
def test_what_stops_in_a_queue_is_no_walker_though_it_was_as_slow_when_it_was_seen_first(
    decelerated: bool, small: bool
) -> None:
    fed, rng, x, speed = HandFedVehicles(), np.random.default_rng(14), 12.0, 3.0
    for t in times(1, 120):
        speed = max(speed - 0.05 * 1.4, 0.0) if decelerated and t > 0.5 else speed
        x += 0.05 * speed
        fed.scan(t, noisy(rng, [Seen(0, x, 3.0, speed)]))
    assert (fed.tracker.state.tracks.obstacles.length[0] < 1.0) == small


@pytest.mark.parametrize("seed", [23, 24, 25])
@pytest.mark.parametrize("speed", [0.8, -0.8, 1.0])
def test_what_walks_across_moves_though_its_reflections_might_walk(speed: float, seed: int) -> None:
    """Neither range rates nor a walk of a second tell it from what stands: it does not stay within a box."""
    front = load_config(ROOT / "config" / "toyota_rav4.yaml").config.sensors["front"]
    walk = AlongAcross(along=0.03, across=0.1)
    filtering = front.model_copy(update={"noise": front.noise.model_copy(update={"walk": walk})})
    fed, rng, errors = HandFedVehicles(sensors={0: filtering}), np.random.default_rng(seed), list[tuple[float, float]]()
    for t in times(1, 200):
        told = fed.scan(t, noisy(rng, [Seen(0, 30.0, -4.0 + speed * t, 0.0, speed)]))
        errors.append((float(told.y[0]) + 4.0 - speed * t, float(told.vy[0]) - speed))
    place, velocity = np.mean(errors[140:], axis=0)
    assert place == pytest.approx(0.0, abs=0.6)
    assert velocity == pytest.approx(0.0, abs=0.4)


@pytest.mark.parametrize("deviation", [0.06, 0.3])
def test_what_stands_is_told_to_stand(deviation: float) -> None:
    fed, rng = HandFedVehicles(noise=(0.2, 0.2, deviation)), np.random.default_rng(14)
    for t in times(1, 100):
        told = fed.scan(t, noisy(rng, [Seen(0, 60.0, 3.0)], 0.2))
    assert told.kind[0] == STANDING
    assert hypot(told.vx[0], told.vy[0]) < 0.3


def test_predictions_are_where_things_will_be() -> None:
    fed = HandFedVehicles()
    for t in times(1, 80):
        fed.scan(t, lorry(t))
    (_, expected), update = fed.tracker.expected_positions((0.5, 1.0)), fed.tracker.update
    assert update is not None
    assert len(expected) == len(update.reflection) == 4
    truth = [each.x + SPEED for each in lorry(last_time(80))]
    np.testing.assert_allclose(expected[np.argsort(update.detection), 0], truth, atol=0.6)
    np.testing.assert_allclose(expected[:, 1], 0.0, atol=0.3)
    fed.coast(4.2)
    assert fed.tracker.expected_positions((0.5,))[0].shape == (0, 2)


def test_a_scan_from_before_moves_back_and_forth_again() -> None:
    """A late scan is taken where the obstacles were; what they are told later does not suffer."""
    fed, straight = HandFedVehicles(), HandFedVehicles()
    for t in times(1, 40):
        straight.scan(t, [car(0, t, 40.0)])
        fed.scan(t, [car(0, t, 40.0)])
    t = last_time(40)
    told = fed.scan(t - 0.03, [car(8, t - 0.03, 40.0)], sensor=1)
    assert len(told) == 1
    assert told.time_ns == round((t - 0.03) * 1e9)
    assert told.x[0] == pytest.approx(40.0 + SPEED * (t - 0.03), abs=0.3)
    for t in times(40, 60):
        told, beside = fed.scan(t, [car(0, t, 40.0)]), straight.scan(t, [car(0, t, 40.0)])
        assert told.x[0] == pytest.approx(beside.x[0], abs=0.3)
        assert told.vx[0] == pytest.approx(SPEED, abs=0.3)


def test_sensors_get_other_numbers_and_are_forgotten() -> None:
    fed = HandFedVehicles()
    for k, t in enumerate(times(1, 40)):
        fed.scan(t, [car(0, t, 40.0, 5.0 * (k % 2))], sensor=k % 2)
    fed.tracker.renumber_sensors({1: 3})
    told = fed.coast(2.0)
    assert told.sensors.tolist() == [0b1000]
    assert told.y.round(0).tolist() == [5.0]
    assert set(fed.tracker.state.tracks.row_of) == {(3, 0)}
    again = fed.scan(2.05, [car(0, 2.05, 40.0, 5.0)], sensor=3)
    assert ids(again) == ids(told)
    assert fed.tracker.counts.slot_jumps == 0


def test_the_room_for_reflections_is_bounded() -> None:
    fed = HandFedVehicles(max_tracks=4)
    for t in times(1, 5):
        told = fed.scan(t, [car(key, t, 20.0 + 15 * key) for key in range(7)])
    assert len(told) == 4
    assert fed.tracker.counts.crowded == 3 * 4


def test_smoothing_tells_the_first_second_better() -> None:
    rng, fed = np.random.default_rng(12), HandFedVehicles(noise=(0.3, 0.3, 0.1))
    smoother = CycleSmoother([fed.tracker], 1.0)
    before, after = list[Obstacles](), list[Obstacles]()
    for t in times(1, 80):
        told = fed.scan(t, noisy(rng, [replace(car(0, t, 40.0), rated=False)], 0.3))
        before.append(told)
        cycle = Cycle(told.time_ns, told, [], pose(t), None, None)
        after += [each.obstacles for each in smoother.add(cycle)]
    after += [each.obstacles for each in smoother.finish()]
    assert [each.time_ns for each in after] == [each.time_ns for each in before]

    def errors(told: list[Obstacles]) -> Floats:
        truth = np.array([40.0 + SPEED * each.time_ns * 1e-9 for each in told[5:]])
        found = np.array([[each.x[0], each.vx[0]] for each in told[5:]])
        return np.asarray(np.sqrt(np.square(found - np.column_stack([truth, np.full(len(truth), SPEED)])).mean(axis=0)))

    for each in after:
        assert_sane(each)
    assert errors(after)[1] < 0.7 * errors(before)[1]
    assert errors(after)[0] < 1.1 * errors(before)[0]


def test_the_smoother_is_fed_without_changing_what_is_told() -> None:
    plain, kept = HandFedVehicles(), HandFedVehicles()
    kept.tracker.keep_smoother_history()
    rng = np.random.default_rng(13)
    for t in times(1, 40):
        seen = noisy(rng, lorry(t)[: 1 + int(rng.integers(0, 4))])
        told, beside = plain.scan(t, seen), kept.scan(t, seen)
        for name in ("id", "x", "y", "vx", "vy", "covariance", "length"):
            np.testing.assert_array_equal(getattr(told, name), getattr(beside, name))
        history = kept.tracker.smoother_history
        assert history is not None
        assert history.id.tolist() == ids(told)
        np.testing.assert_allclose(history.state[:, :2], np.column_stack([told.east, told.north]))
        assert len(history.linked) == len(history.link.mean)
        assert np.isfinite(history.link.gain).all()


SCANS = st.lists(
    st.tuples(
        st.sampled_from((-0.1, 0.0, 0.05, 0.05, 0.3, 5.0)),
        st.integers(0, 1),
        st.lists(
            st.builds(
                Seen,
                st.integers(0, 5),
                st.floats(-200, 200),
                st.floats(-200, 200),
                st.floats(-40, 40),
                rated=st.booleans(),
            ),
            max_size=6,
        ),
        st.booleans(),
    ),
    max_size=20,
)


@settings(deadline=None, max_examples=examples(40))
@given(scans=SCANS)
def test_any_detections_leave_it_sane(scans: list[tuple[float, int, list[Seen], bool]]) -> None:
    fed, t = HandFedVehicles(), 1.0
    for dt, sensor, seen, identified in scans:
        t += dt
        told = fed.scan(t, seen, sensor=sensor, identified=identified)
        assert_sane(told)
        assert len(told.used_row) == len(seen)
        again = HandFedVehicles()
        again.tracker.state = fed.tracker.state
    bodies = fed.tracker._bodies
    assert len(bodies.filter) == len(bodies.obstacles)
    assert np.isfinite(bodies.moments().mean[:, BIAS]).all()


def test_a_scan_an_hour_older_moves_nothing() -> None:
    """A late scan takes obstacles back along their velocities, but only one that is late by less than half a second."""
    fed = HandFedVehicles()
    for t in times(1, 80):
        told = fed.scan(t, lorry(t))
    late = fed.coast(told.time_ns * 1e-9 - 3600.0)
    assert np.abs(late.east - told.east).max() < 1.0


def test_the_reference_point_of_a_lorry_ahead_is_its_rear() -> None:
    """It is the end that faces us, not the middle of what is seen."""
    fed, rng = HandFedVehicles(), np.random.default_rng(5)
    for t in times(1, 160):
        told = fed.scan(t, noisy(rng, lorry(t)))
    assert len(told) == 1
    assert told.x[0] - (40.0 + SPEED * t) == pytest.approx(0.0, abs=0.6)


def test_a_wrong_heading_of_ours_shows_in_what_is_said_of_velocities() -> None:
    own = replace(pose(ve=20.0, vn=0.0, speed_variance=0.05**2), heading_variance=0.01**2)
    along, across = np.sqrt(np.diagonal(own.velocity_covariance))
    assert along == pytest.approx(0.05)
    assert across == pytest.approx(hypot(0.05, 20.0 * 0.01))
    exact, turned = HandFedVehicles(), HandFedVehicles()
    for t in times(1, 100):
        at = pose(t, east=20.0 * t, ve=20.0)
        told = exact.scan(t, [car(1, t, 40.0)], ego=at)
        other = turned.scan(t, [car(1, t, 40.0)], ego=replace(at, heading_variance=0.01**2))
    assert other.svy[0] == pytest.approx(hypot(told.svy[0], 0.2))
    assert other.svx[0] == pytest.approx(told.svx[0])
    assert (other.x == told.x).all()


def test_where_on_its_side_a_car_is_seen_is_not_known() -> None:
    """A car that crosses may show any place along its side: so much is said of its place and speed along it."""
    ahead, crossing = HandFedVehicles(), HandFedVehicles()
    for t in times(1, 60):
        behind = ahead.scan(t, [car(1, t, 40.0)])
        beside = crossing.scan(t, [Seen(1, 40.0, 10.0 * t - 15.0, 0.0, 10.0)])
    assert behind.sy[0] < 0.5
    assert 0.25 * 4.5 < beside.sy[0] < 0.35 * 4.5
    assert beside.sx[0] < 0.6
    assert beside.svy[0] > 0.5 > beside.svx[0]


def test_what_passes_close_by_keeps_its_velocity() -> None:
    """A lorry overtakes us in the next lane: each of its reflections comes nearer, or goes, at a speed of its own."""
    fed, rng = HandFedVehicles(), np.random.default_rng(7)
    for t in times(1, 140):
        along = -30.0 + 8.0 * t + np.array(LORRY)
        told = fed.scan(t, noisy(rng, [Seen(key, x, 4.0, 8.0, 0.0) for key, x in enumerate(along.tolist())]))
        if t > 2.0:
            assert len(told) == 1
            assert hypot(told.vx[0] - 8.0, told.vy[0]) < 0.7


def test_cars_side_by_side_at_a_light_stay_two() -> None:
    """One was merged into the other as soon as the radar lost it for half a second, or noise brought them together."""
    fed, rng = HandFedVehicles(), np.random.default_rng(3)
    lead, beside = Seen(0, 14.0, 0.0, 0.0, 0.0), Seen(1, 12.0, -2.8, 0.0, 0.0)
    for t in times(0, 100):
        told = fed.scan(t, noisy(rng, [lead, beside]))
    identities = set(told.id.tolist())
    assert len(identities) == 2
    for t in times(100, 115):
        fed.scan(t, noisy(rng, [beside]))
    for t in times(115, 150):
        told = fed.scan(t, noisy(rng, [lead, beside]))
    assert set(told.id.tolist()) == identities
    np.testing.assert_allclose(np.sort(told.y), [-2.8, 0.0], atol=0.5)


def test_no_reflection_lies_beyond_its_body_for_long() -> None:
    """What the filter takes for a bias of metres is where the body is."""
    fed = HandFedVehicles()
    for t in times(1, 60):
        fed.scan(t, [car(0, t, 40.0)])
    bodies = fed.tracker._bodies
    bodies.filter.settle(np.array([[-9.0, 0.0]]))
    bodies.changed()
    for t in times(60, 80):
        fed.scan(t, [car(0, t, 40.0)])
    assert abs(bodies.moments().mean[0, BIAS][0]) < bodies.obstacles.length[0] / 2 + 0.2


def test_the_reference_point_of_a_known_box_lies_where_its_rear_is_seen() -> None:
    """It was two metres ahead of that, with a bias as great: no reflection lies so far behind a box."""
    fed, length, width = HandFedVehicles(), np.array([4.5]), np.array([1.8])
    for t in times(1, 60):
        fed.scan(t, [car(0, t, 40.0)], length=length, width=width)
    fed.tracker._bodies.filter.settle(np.array([[2.0, 0.0]]))
    fed.tracker._bodies.changed()
    for t in times(60, 90):
        told = fed.scan(t, [car(0, t, 40.0)], length=length, width=width)
    assert told.x[0] - 40.0 - SPEED * t == pytest.approx(0.0, abs=0.5)
    assert told.vx[0] == pytest.approx(SPEED, abs=0.3)


def test_scans_of_sensors_that_see_nothing_change_nothing_of_where_a_body_is() -> None:
    """The reference point returns to the middle of what is seen by time, not by the scans of whatever sensor."""
    alone, among = HandFedVehicles(), HandFedVehicles()
    for t in times(1, 30):
        seen = [car(key, t, 30.0, across) for key, across in enumerate((0.0, 1.0) if t > 0.5 else (0.0,))]
        expected = alone.scan(t, seen)
        for sensor in range(1, 12):
            among.scan(t - 0.05 + sensor * 0.05 / 12, [], sensor=sensor)
        told = among.scan(t, seen)
    assert expected.y[0] == pytest.approx(0.3, abs=0.1)
    assert told.y[0] == pytest.approx(expected.y[0], abs=0.05)


def test_the_first_reflection_does_not_lead_for_long() -> None:
    """A car enters a view with its front: it is in the middle of what is seen of it as soon as that is seen."""
    fed = HandFedVehicles()
    for t in times(1, 8):
        told = fed.scan(t, [car(0, t, 30.0)] + [car(1, t, 30.0, 1.0)] * (t > 0.06))
    assert told.y[0] == pytest.approx(0.5, abs=0.15)


def test_a_sensor_that_sees_an_end_does_not_outweigh_one_that_sees_more() -> None:
    """A crossing car's side shows five reflections to one sensor, and its front to another: as all six to one do."""
    side, front = np.linspace(-1.0, 1.0, 5), np.array([2.2])
    found = []
    for views in ([side, front], [np.append(side, front)]):
        fed = HandFedVehicles()
        for t in times(1, 80):
            for sensor, shown in enumerate(views):
                at = t + 0.02 * sensor
                seen = [Seen(key, 20.0, -20.0 + along + 8.0 * at, 0.0, 8.0) for key, along in enumerate(shown.tolist())]
                told = fed.scan(at, seen, sensor=sensor)
        assert len(told) == 1
        found.append(told.y[0] + 20.0 - 8.0 * at)
    assert found[0] == pytest.approx(found[1], abs=0.2)
    assert -1.0 < found[0] < 2.2 / 6  # it lies on what is seen, behind its middle: what has passed shows its rear
