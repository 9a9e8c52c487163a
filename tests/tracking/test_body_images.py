"""Images of vehicles, which a radar sees by echoes of two reflections, are held back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candaemon.config.tracker import TrackerSettings
from candaemon.tracking.body_images import images
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.obstacles import CONFIRMED, TENTATIVE
from candaemon.tracking.vehicle_tracker import VehicleTracker
from tests.support.builders import CYCLE, Seen, detections, pose

RAIL = 6.0  # m to the left


def _states(
    other: tuple[float, float, float],
    *,
    speed: float = 15.0,
    own: float = 20.0,
    rail: bool = True,
    cycles: int = 30,
    length: float = 4.5,
    strays: float = 0.0,
    shadow: float = 1.0,
) -> list[int]:
    """Return the state that another object had in each cycle beside a car 20 m ahead.

    Args:
        other: its first place ahead and to the left, m, and its speed, m/s.
        speed: of the car, m/s.
        own: of us, m/s.
        rail: whether posts of a guard rail stand beside.
        cycles: how many.
        length: of the car, m.
        strays: speed with which the other one's place errs to the left for its first five scans, m/s.
        shadow: as in the settings, s.
    """
    lifecycle = {"confirm": 4, "shadow": shadow}
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": lifecycle})
    tracker, states = VehicleTracker(settings, {}), []
    for k in range(cycles):
        time = k * CYCLE
        seen = [Seen(1, 30.0 + speed * time, 2.0, speed)]
        seen += [Seen(10 + i, 20.0 + 4.0 * i, RAIL) for i in range(24 if rail else 0)]
        if k >= 8:
            astray = strays * CYCLE * min(k - 8, 4)
            seen.append(Seen(2, other[0] + other[2] * (time - 8 * CYCLE), other[1] + astray, other[2]))
        at = pose(time, east=own * time, ve=own)
        scan = detections(at, seen, sensor=0, noise=(0.2, 0.2, 0.1))
        lengths = np.array([length if each.key == 1 else np.nan for each in seen])
        told = tracker.step(replace(scan, length=lengths), at)
        row = told.used_row[told.used_object == 2]
        if len(row):
            states.append(int(told.state[row[0]]))
    return states


AT_8 = 8 * CYCLE
ECHO = (20.0 * AT_8 + 2 * (30.0 - 5.0 * AT_8), 4.0, 10.0)
MIRRORED = (30.0 + 15.0 * AT_8, 2 * RAIL - 2.0, 15.0)


@pytest.mark.parametrize("other", [ECHO, MIRRORED], ids=["doubled", "mirrored"])
def test_an_image_is_not_confirmed(other: tuple[float, float, float]) -> None:
    assert set(_states(other)) == {TENTATIVE}


def test_an_image_whose_velocity_is_not_known_yet_is_not_confirmed() -> None:
    """An error of its place that lasts for some scans looks like six metres a second, give or take two."""
    assert set(_states(MIRRORED, strays=6.0)) == {TENTATIVE}


def test_an_image_is_of_any_part_of_a_lorry() -> None:
    """What is mirrored is its middle, eight metres ahead of its rear."""
    middle = (MIRRORED[0] + 8.0, *MIRRORED[1:])
    assert set(_states(middle, length=16.0)) == {TENTATIVE}
    assert _states(middle, length=4.0)[-1] == CONFIRMED


@pytest.mark.parametrize(("length", "last"), [(24.0, TENTATIVE), (4.5, CONFIRMED)])
def test_at_twice_the_distance_of_the_front_of_a_lorry_is_its_image(length: float, last: int) -> None:
    front = (ECHO[0] + 2 * 10.0, *ECHO[1:])
    assert _states(front, length=length, rail=False)[-1] == last


@pytest.mark.parametrize("length", [4.5, 16.0])
def test_what_stands_in_the_next_lane_at_twice_the_distance_is_there(length: float) -> None:
    """Of what is half as fast as we are an image would stand; so does the end of a queue."""
    away = 30.0 - 10.0 * AT_8
    states = _states((20.0 * AT_8 + 2 * away, 4.0 + 3.5, 0.0), speed=10.0, length=length, rail=False)
    assert states.index(CONFIRMED) < 8


def test_of_a_vehicle_of_unknown_length_the_middle_may_be_farther_ahead() -> None:
    middle = (MIRRORED[0] + 8.0, *MIRRORED[1:])
    assert set(_states(middle, length=np.nan)) == {TENTATIVE}
    assert _states(middle, length=4.0)[-1] == CONFIRMED


@pytest.mark.parametrize(
    ("speed", "own", "last"),
    [(1.4, 20.0, TENTATIVE), (0.0, 20.0, CONFIRMED), (1.4, 0.0, TENTATIVE)],
    ids=["walks", "stands", "walks while we stand"],
)
def test_a_walker_has_an_image_at_twice_the_distance_and_a_post_has_none(speed: float, own: float, last: int) -> None:
    """What comes as fast as we go is met more often than it is the image of something that stands."""
    away = 30.0 - (own - speed) * AT_8
    echo = (own * AT_8 + 2 * away, 4.0, 2 * speed - own)
    assert _states(echo, speed=speed, own=own, rail=False, cycles=50 if own == 0.0 else 20)[-1] == last


@pytest.mark.parametrize(("known", "held"), [(2.4, False), (1.0, True)], ids=["long", "not for long"])
def test_what_never_moved_has_no_image_though_its_filter_doubts_that_it_stands(known: float, held: bool) -> None:
    """A guard rail of a few posts, whose reflections wander, comes at us as fast as the traffic beyond it does not."""
    tracker = VehicleTracker(TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}}), {})
    for k in range(50):
        own = 20.0 * k * CYCLE
        shown = [Seen(1, 100.0, 2.0)] if k * CYCLE >= 2.4 - known else []
        shown += [Seen(2, 200.0 - own, 4.0, -20.0)] if k > 44 else []
        at = pose(k * CYCLE, east=own, ve=20.0)
        scan = detections(at, shown, sensor=0, noise=(0.2, 0.2, 0.1))
        told = tracker.step(scan, at)
    bodies = tracker._bodies
    bodies.obstacles.confirmed[:] = [True, False]
    bodies.filter.probability[0] = (1.0 - np.eye(bodies.filter.probability.shape[1])[STANDING]) / 3.0
    assert images(bodies, np.array([1]), scan, np.array([False])).tolist() == [held]
    assert len(told) == 2


def test_what_creeps_past_a_rail_in_a_jam_has_an_image_behind_it() -> None:
    mirrored = (30.0 + 3.0 * AT_8, 2 * RAIL - 2.0, 3.0)
    assert set(_states(mirrored, speed=3.0, own=3.0)) == {TENTATIVE}


@pytest.mark.parametrize(
    ("other", "rail"),
    [(MIRRORED, False), ((ECHO[0], 4.0, 15.0), True), ((MIRRORED[0], MIRRORED[1], 19.0), True)],
    ids=["no rail", "not twice as slow", "faster than in a mirror"],
)
def test_what_is_no_image_is_confirmed(other: tuple[float, float, float], rail: bool) -> None:
    assert _states(other, rail=rail)[-1] == CONFIRMED


def test_a_vehicle_that_stays_where_an_image_would_be_is_confirmed_at_last() -> None:
    states = _states(MIRRORED, cycles=80)
    assert CONFIRMED not in states[:55]
    assert states[-1] == CONFIRMED


@pytest.mark.parametrize(
    ("beside", "shadow", "held"),
    [(0.0, 1.0, 20), (2.5, 1.0, 0), (0.0, 0.0, 0)],
    ids=["in its shadow", "beside its shadow", "not asked for"],
)
def test_what_a_vehicle_of_our_speed_hides_is_held_for_a_second(beside: float, shadow: float, held: int) -> None:
    states = _states((20.0 * AT_8 + 60.0, 4.0 + beside, 20.0), speed=20.0, shadow=shadow)
    assert states.index(CONFIRMED) >= held
    assert held or states.index(CONFIRMED) < 6


@pytest.mark.parametrize("slower", [0.0, 1.2])
def test_of_a_convoy_none_is_held_for_an_image_of_another(slower: float) -> None:
    """One at half the distance is half as much slower than we are; that is nothing rare."""
    other = (20.0 * AT_8 + 2 * (30.0 - slower * AT_8), 4.0, 20.0 - 2 * slower)
    assert _states(other, speed=20.0 - slower)[-1] == CONFIRMED


def test_one_of_a_convoy_that_was_lost_sight_of_comes_back_at_once() -> None:
    """Where it drove, it is no echo of the vehicle ahead of it, though that hides it at just half the distance."""
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": {"confirm": 4}})
    tracker = VehicleTracker(settings, {})
    told: dict[tuple[int, int], tuple[int, int]] = {}
    for k in range(50):
        own = 20.0 * k * CYCLE
        seen = [Seen(1, own + 30.0, 2.0, 20.0)]
        if not 30 <= k < 42:
            seen.append(Seen(2, own + 60.0, 4.0, 20.0) if k < 30 else Seen(3, own + 58.0, 2.4, 18.7))
        at = pose(k * CYCLE, east=own, ve=20.0)
        obstacles = tracker.step(detections(at, seen, sensor=0, noise=(0.2, 0.2, 0.1)), at)
        told |= {
            (k, key): (int(obstacles.id[row]), int(obstacles.state[row]))
            for key, row in zip(obstacles.used_object.tolist(), obstacles.used_row.tolist(), strict=True)
        }
    assert told[49, 3] == told[29, 2]


@pytest.mark.parametrize(
    ("posts", "across", "last"),
    [
        (range(2, 6), 2 * RAIL - 2.0, TENTATIVE),
        (range(2, 4), 2 * RAIL - 2.0, CONFIRMED),
        (range(2, 6), 15.0, CONFIRMED),
    ],
    ids=["mirrored", "no row", "elsewhere"],
)
def test_what_stopped_beside_a_rail_has_an_image_behind_it(posts: range, across: float, last: int) -> None:
    """Other vehicles hide the part of the rail that mirrors it: its posts are seen nearer to us."""
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": {"confirm": 4}})
    tracker, states = VehicleTracker(settings, {}), []
    for k in range(70):
        braked = min(max(k * CYCLE - 0.5, 0.0), 2.0)
        x, speed = 30.0 + 8.0 * min(k * CYCLE, 0.5) + 8.0 * braked - 2.0 * braked**2, 8.0 - 4.0 * braked
        seen = [Seen(1, x, 2.0, speed), *(Seen(10 + i, 4.0 * i, RAIL) for i in posts)]
        if k >= 55:
            seen.append(Seen(2, x, across))
        at = pose(k * CYCLE)
        told = tracker.step(detections(at, seen, sensor=0, noise=(0.2, 0.2, 0.1)), at)
        row = told.used_row[told.used_object == 2]
        states += told.state[row].tolist()
    assert states[-1] == last


@pytest.mark.parametrize(("times", "held"), [(2.0, True), (1.0, False)], ids=["its echo", "as fast as it"])
def test_who_crosses_has_an_image_at_twice_the_distance(times: float, held: bool) -> None:
    """It nears not at all where it passes before us: that it crosses twice as fast tells its image."""
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": {"confirm": 4}})
    tracker, states = VehicleTracker(settings, {}), []
    rng = np.random.default_rng(1)
    for k in range(70):
        time, across = k * CYCLE, -15.0 + 9.0 * k * CYCLE
        shown = [Seen(1, 20.0, across, 0.0, 9.0)]
        if k >= 20:  # 6 m before it passes
            shown.append(Seen(2, 40.0, 2 * -6.0 + times * 9.0 * (time - 20 * CYCLE), 0.0, times * 9.0))
        noise = 0.1 * rng.normal(size=(len(shown), 2))
        seen = [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        at = pose(time)
        told = tracker.step(detections(at, seen, sensor=0, noise=(0.2, 0.2, 0.1)), at)
        states += told.state[told.used_row[told.used_object == 2]].tolist()
    assert (set(states) == {TENTATIVE}) == held
