"""What the turning of bodies adds to the velocities of their points, and their axes."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.estimation.measurement import Measurement, Projection
from candaemon.tracking.body_axes import turned_axes
from candaemon.tracking.turning import Turning
from tests.support.builders import CYCLE, HandFedVehicles, Seen, car, times

TURNING = Turning(np.array([0.0, 0.5]), np.array([0.0, 0.04]), np.array([[0.0, 0.0], [20.0, 10.0]]))
BODY = np.array([1, 1, 0])
PLACE = np.array([[22.0, 10.0], [20.0, 9.0], [3.0, 4.0]])
"""2 m ahead of the centre of the body that turns to the left, 1 m to its right, and on one that does not turn."""

FREELY, HALTED = np.full(1, np.inf), np.zeros(1)


def test_the_front_of_what_turns_to_the_left_goes_to_the_left() -> None:
    np.testing.assert_allclose(TURNING.velocities(BODY, PLACE), [[0.0, 1.0], [0.5, 0.0], [0.0, 0.0]], atol=1e-12)


def test_what_turning_adds_is_left_out_of_velocities_and_what_is_unknown_of_it_is_noise() -> None:
    left, ahead = np.array([[0.0, 1.0]] * 3), np.array([[1.0, 0.0]] * 3)
    parts = tuple(Projection(each, np.full(3, 7.0), np.full(3, 0.1)) for each in (left, ahead))
    rate = np.array([1.0, 2.0, 3.0])
    seen = Measurement(PLACE, np.zeros((3, 2, 2)), np.zeros(2), np.zeros(2), rate, np.full(3, 0.01), parts)
    told = TURNING.left_out(seen, BODY, PLACE)
    np.testing.assert_allclose(told.projections[0].value, [6.0, 7.0, 7.0])
    np.testing.assert_allclose(told.projections[0].variance, [0.1 + 2.0**2 * 0.04, 0.1, 0.1])
    np.testing.assert_allclose(told.projections[1].value, [7.0, 6.5, 7.0])
    assert told.range_rate is rate


def test_only_what_is_beyond_the_deviations_of_a_turn_rate_is_sure() -> None:
    rates = Turning(np.array([0.5, -0.5, 0.3, 0.0]), np.full(4, 0.04), np.zeros((4, 2)))
    sure = rates.surely(2.0, np.array([1.0, 0.5, 1.0, 1.0])).rate
    np.testing.assert_allclose(sure, [0.1, -0.05, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("variance", [1e-6, 1.0])
def test_the_axis_follows_the_course_of_the_centre_unless_the_turn_rate_is_vague(variance: float) -> None:
    """The front of a car that turns to the left at .5 rad/s goes 1 m/s to the left of where it heads."""
    mean = np.array([[10.0, 0.0, 7.0, 1.0, 0.5, 0.0, 0.0, 0.0]])
    turning = Turning(np.array([0.5]), np.array([variance]), mean[:, :2])
    known = mean, 1e-6 * np.eye(4)[None], np.array([[1.0, 0.0]]), np.ones(1, np.bool_), np.zeros(1), np.ones(1)
    axis, _ = turned_axes(*known, HALTED, np.array([[2.0, 0.0]]), turning, 5.0, 0.0, FREELY)
    if variance < 1.0:
        np.testing.assert_allclose(axis, [[1.0, 0.0]], atol=1e-3)
    else:
        assert axis[0, 1] > 0.05


@pytest.mark.parametrize(("variance", "passed", "turned"), [(1e-6, 0.05, 0.02), (1.0, 0.05, 0.0), (1e-6, 0.0, 0.0)])
def test_the_axis_of_what_surely_turns_and_was_detected_of_late_turns_on(
    variance: float, passed: float, turned: float
) -> None:
    mean = np.array([[10.0, 0.0, 7.0, 0.0, 0.4, 0.0, 0.0, 0.0]])
    turning = Turning(np.array([0.4]), np.array([variance]), mean[:, :2])
    known = mean, 1e-6 * np.eye(4)[None], np.array([[1.0, 0.0]]), np.ones(1, np.bool_), np.zeros(1), np.zeros(1)
    axis, _ = turned_axes(*known, np.array([passed]), np.zeros((1, 2)), turning, 5.0, 0.0, FREELY)
    assert np.arctan2(axis[0, 1], axis[0, 0]) == pytest.approx(turned, abs=1e-4)


def test_the_heading_of_a_car_in_a_roundabout_keeps_up_with_it() -> None:
    """Five metres long, it shows its rear and its side, and drives to the left on a circle of 16 m at 7 m/s."""
    fed, errors = HandFedVehicles(noise=(0.2, 0.2, 0.1)), []
    for t in times(1, 70):
        heading = 7.0 / 16.0 * t
        ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        centre = np.array([30.0, 0.0]) - 16.0 * left
        seen = []
        for key, (along, aside) in enumerate(((-2.5, 0.0), (0.0, 0.9)), start=1):
            velocity = 7.0 * ahead + 7.0 / 16.0 * (along * left - aside * ahead)
            seen.append(Seen(key, *(centre + along * ahead + aside * left), *velocity))
        told = fed.scan(t, seen)
        errors.append(np.angle(np.exp(1j * (told.heading[0] - heading)), deg=True))
    assert np.mean(errors[50:]) == pytest.approx(0.0, abs=4.5)  # 6.4 to the right, were it turned by its course alone


@pytest.mark.parametrize(("ahead", "most"), [(3.0, 0.02), (1.0, np.pi / 4)])
def test_what_drove_turns_no_faster_than_its_way_bends(ahead: float, most: float) -> None:
    """A car that creeps at 1 m/s for .05 s along a circle of 2.5 m; who never drove may turn on the spot."""
    mean = np.array([[10.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    known = mean, 1e-6 * np.eye(4)[None], np.array([[1.0, 0.0]]), np.array([True]), np.array([ahead])
    axis, _ = turned_axes(*known, np.full(1, 0.5), HALTED, np.zeros((1, 2)), None, 5.0, 0.0, np.full(1, 0.05 / 2.5))
    turned = np.arctan2(axis[0, 1], axis[0, 0])
    assert 0.5 * most < turned < 1.05 * most


@pytest.mark.parametrize("directed", [False, True])
def test_who_showed_no_course_turns_round_with_the_first_and_who_did_backs(directed: bool) -> None:
    mean = np.array([[10.0, 0.0, 0.0, -1.3, 0.0, 0.0, 0.0, 0.0]])
    known = mean, 0.04 * np.eye(4)[None], np.array([[0.0, 1.0]]), np.array([directed]), np.zeros(1)
    axis, turned_round = turned_axes(*known, np.full(1, 0.1), HALTED, np.zeros((1, 2)), None, 5.0, 0.0, FREELY)
    np.testing.assert_allclose(axis, [[0.0, 1.0 if directed else -1.0]], atol=1e-9)
    assert (turned_round is not None) != directed


@pytest.mark.parametrize(
    ("ahead", "speed", "turned"),
    [(0.0, 2.2, True), (2.5, 2.2, False), (2.5, 2.8, True), (5.0, 4.8, False), (5.0, 5.2, True)],
)
def test_what_is_faster_than_it_went_ahead_or_than_anything_backs_turned_round(
    ahead: float, speed: float, turned: bool
) -> None:
    mean = np.array([[10.0, 0.0, -speed, 0.0, 0.0, 0.0, 0.0, 0.0]])
    known = mean, 1e-4 * np.eye(4)[None], np.array([[1.0, 0.0]]), np.array([True]), np.array([ahead])
    axis, _ = turned_axes(*known, np.full(1, 0.1), HALTED, np.zeros((1, 2)), None, 5.0, 0.0, FREELY)
    np.testing.assert_allclose(axis, [[-1.0 if turned else 1.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(known[-1], min(speed, 5.0) if turned else ahead)


def test_what_moves_across_its_axis_may_have_turned_round() -> None:
    mean, axis, ahead = np.zeros((1, 8)), np.array([[1.0, 0.0]]), np.array([5.0])
    for course in (0.6 * np.pi, 0.99 * np.pi):
        mean[0, 2:4] = 4.0 * np.cos(course), 4.0 * np.sin(course)
        known = mean, 1e-4 * np.eye(4)[None], axis, np.array([True]), ahead
        axis, _ = turned_axes(*known, np.full(1, 0.1), HALTED, np.zeros((1, 2)), None, 5.0, 0.0, FREELY)
    assert axis[0, 0] < -0.9


@pytest.mark.parametrize(("way", "turned"), [(9.0, False), (45.0, True)])
def test_a_car_that_stopped_and_comes_back_backs_unless_for_long(way: float, turned: bool) -> None:
    fed, x, speed = HandFedVehicles(), 15.0, 6.0
    for t in times(1, round((10.0 + way / 2.5) / CYCLE)):
        speed = 6.0 if t < 2.0 else max(6.0 - 2.0 * (t - 2.0), 0.0) if t < 6.0 else max(1.5 * (6.0 - t), -2.5)
        x += CYCLE * speed
        told = fed.scan(t, [Seen(1, x + 20.0, 0.0, speed)])
    assert (abs(told.heading[0]) > 3.0) == turned


@pytest.mark.parametrize("seed", range(8))
def test_walkers_head_where_they_walk(seed: int) -> None:
    fed, rng, speed = HandFedVehicles(noise=(0.15, 0.15, 0.1)), np.random.default_rng(seed), 1.3 - 2.6 * (seed % 2)
    for t in times(1, 160):
        dx, dy, rate = rng.normal(size=3) * (0.15, 0.15, 0.1)
        told = fed.scan(t, [Seen(1, 12.0 + dx, speed * (t - 4.0) + dy, rate, speed)])
    assert told.heading[0] == pytest.approx(np.copysign(np.pi / 2, speed), abs=0.4)


def test_reflections_of_what_turns_round_stay_where_they_are() -> None:
    """What stands may have either end ahead; it comes nearer."""
    fed = HandFedVehicles(noise=(0.1, 0.1, 0.05))
    x = 20.0
    for t in times(1, 100):
        speed = -min(1.5 * max(t - 2.0, 0.0), 1.5)
        x += CYCLE * speed
        told = fed.scan(t, [Seen(1, x, 0.0, speed), Seen(2, x + 1.5, 0.3, speed)])
    assert fed.tracker.counts.obstacles == len(told) == 1
    assert fed.tracker.counts.slot_jumps == 0
    assert fed.tracker.counts.used > 150
    assert abs(told.heading[0]) > 3.0


@pytest.mark.parametrize(("angle", "directed", "followed"), [(0.2, False, 0.1), (0.8, False, 1.0), (0.8, True, 0.1)])
def test_a_first_course_far_from_an_axis_that_was_a_guess_tells_it(
    angle: float, directed: bool, followed: float
) -> None:
    mean = np.array([[10.0, 0.0, 9.0 * np.cos(angle), 9.0 * np.sin(angle), 0.0, 0.0, 0.0, 0.0]])
    known = mean, 1e-4 * np.eye(4)[None], np.array([[1.0, 0.0]]), np.array([directed]), np.zeros(1)
    axis, _ = turned_axes(*known, np.full(1, 0.1), HALTED, np.zeros((1, 2)), None, 5.0, 0.0, FREELY)
    assert np.arctan2(axis[0, 1], axis[0, 0]) == pytest.approx(followed * angle, rel=0.1)


def test_who_drives_across_heads_there_as_soon_as_that_is_told() -> None:
    """A lorry with two reflections 6 m apart, seen for the first time as it crosses."""
    fed, headings = HandFedVehicles(noise=(0.1, 0.1, 0.05)), []
    for t in times(1, 40):
        y = 12.0 * (t - 1.0)
        told = fed.scan(t, [Seen(k, 40.0, y - 6.0 * k, 0.0, 12.0) for k in (0, 1)])
        headings += told.heading[np.isfinite(told.heading)].tolist()
    assert fed.tracker.counts.slot_jumps == 0
    assert fed.tracker.counts.used > 70
    assert len(headings) > 25
    np.testing.assert_allclose(headings, np.pi / 2, atol=0.15)


@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, np.pi])
@pytest.mark.parametrize("rate", [-0.05, 0.05])
def test_what_stands_heads_where_a_sensor_says(heading: float, rate: float) -> None:
    fed = HandFedVehicles()
    for t in times(1, 40):
        told = fed.scan(t, [Seen(1, 12.0, 0.0, rate)], heading=np.array([heading]))
        np.testing.assert_allclose(np.cos(told.heading - heading), [1.0], atol=1e-3)


def test_a_first_heading_that_is_an_outlier_is_outvoted() -> None:
    fed = HandFedVehicles()
    for t in times(1, 40):
        told = fed.scan(t, [Seen(1, 12.0, 0.0)], heading=np.array([np.pi if t < 0.15 else 0.0]))
    assert told.heading[0] == pytest.approx(0.0, abs=0.01)


def test_who_drove_against_an_orientation_that_knows_no_front_stays_directed() -> None:
    """It comes nearer at 8 m/s, stands, and drives on; the radar tells orientations within a right angle."""
    fed, x, headings = HandFedVehicles(), 60.0, []
    for t in times(1, 200):
        speed = -8.0 if t < 3.0 or t > 7.0 else -8.0 * max(abs(t - 5.0) - 1.0, 0.0)
        x += CYCLE * speed
        headings.append(fed.scan(t, [Seen(1, x, 0.5, speed)], heading=np.array([0.02])).heading[0])
    assert (np.cos(headings[2:]) < -0.99).all()


def test_a_heading_and_a_course_that_agree_overrule_the_axis_of_what_drove() -> None:
    """Slower than what surely does not back, as where it took up the identity of another one."""
    fed = HandFedVehicles()
    for t in times(1, 80):
        fed.scan(t, [car(1, t, 10.0, speed=3.5)], heading=np.zeros(1))
    fed.tracker.state.tracks.obstacles.axis *= -1.0
    for t in times(80, 100):
        told = fed.scan(t, [car(1, t, 10.0, speed=3.5)], heading=np.zeros(1))
    assert told.heading[0] == pytest.approx(0.0, abs=0.01)


def test_arms_are_those_of_bodies_that_are_known_to_turn() -> None:
    np.testing.assert_allclose(TURNING.arms(BODY, np.zeros((2, 4)), PLACE), [[2.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
