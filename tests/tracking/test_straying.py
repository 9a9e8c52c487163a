"""Who stood beside what stands, and walks away from it, is another obstacle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from candaemon import compiled
from candaemon.config.tracker import ReflectionSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_association import beside
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import CONFIRMED, PEDESTRIAN, TENTATIVE, Obstacles
from candaemon.tracking.straying import note_strays
from tests.support.builders import HandFedVehicles, Seen, times

WALKS, STANDS_UNTIL = 1.4, 2.0
PARKED = ((25.0, -2.0), (28.0, -2.5), (31.0, -2.0))
"""m, reflections of cars parked one behind the other."""


def walker(t: float) -> Seen:
    """Return one who stands between the parked cars, then walks across the line of sight."""
    walked = WALKS * max(t - STANDS_UNTIL, 0.0)
    return Seen(9, 29.5, -2.2 + walked, 0.0, WALKS if walked else 0.0)


def parked(_: float) -> list[Seen]:
    return [Seen(key, x, y, 0.0) for key, (x, y) in enumerate(PARKED)]


def seen(
    walkers: Callable[[float], Seen], until: float, *, deviation: float = 0.25, told: float = 0.25, seed: int = 1
) -> tuple[HandFedVehicles, Obstacles]:
    """Return a tracker that saw parked cars and someone until a time, and the obstacles that it tells then."""
    fed, rng = HandFedVehicles(noise=(told, told, 0.1)), np.random.default_rng(seed)
    for t in times(1, round(until / 0.05)):
        shown = [*parked(t), walkers(t)]
        noise = rng.normal(size=(len(shown), 2)) * deviation
        there = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
    return fed, there


def obstacle_near(told: Obstacles, x: float, y: float) -> int:
    """Return the row of the obstacle nearest to a place."""
    return int(np.argmin(np.hypot(told.x - x, told.y - y)))


@pytest.mark.parametrize("seed", range(5))
def test_who_walks_away_from_parked_cars_is_an_obstacle(seed: int) -> None:
    _, told = seen(walker, 4.5, seed=seed)
    at = walker(4.5)
    row = obstacle_near(told, at.x, at.y)
    assert np.hypot(told.x[row] - at.x, told.y[row] - at.y) < 0.8
    assert told.vy[row] == pytest.approx(WALKS, abs=0.5)
    others = [k for k in range(len(told)) if k != row]
    assert others
    assert np.hypot(told.vx[others], told.vy[others]).max() < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_who_walks_away_and_is_lost_again_and_again_is_an_obstacle(seed: int) -> None:
    """By a radar that detects them in five scans, and not in the next three."""
    fed, rng = HandFedVehicles(noise=(0.25, 0.25, 0.1)), np.random.default_rng(seed)
    for k, t in enumerate(times(1, 90)):
        shown = [*parked(t), *([walker(t)] if t < STANDS_UNTIL or k % 8 < 5 else [])]
        noise = rng.normal(size=(len(shown), 2)) * 0.1
        told = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
    row = obstacle_near(told, 29.5, walker(4.5).y)
    assert np.hypot(told.x[row] - 29.5, told.y[row] - walker(4.5).y) < 1.0
    assert told.vy[row] == pytest.approx(WALKS, abs=0.6)


@pytest.mark.parametrize("seed", range(5))
def test_who_stands_between_parked_cars_is_no_further_obstacle(seed: int) -> None:
    fed, _ = seen(lambda t: walker(min(t, STANDS_UNTIL)), 6.0, seed=seed)
    before = fed.tracker.counts.obstacles
    fed, _ = seen(lambda t: walker(min(t, STANDS_UNTIL)), 2.0, seed=seed)
    assert fed.tracker.counts.obstacles == before


@pytest.mark.parametrize(("told", "slid"), [(0.25, 1.5), (0.3, 1.1), (0.4, 1.5), (0.5, 1.8), (0.7, 2.5), (1.0, 3.0)])
def test_a_reflection_that_slides_at_once_is_none_who_walks(told: float, slid: float) -> None:
    def slides(t: float) -> Seen:
        return Seen(9, 29.5 if t < 3.0 else 29.5 - slid, -2.2, 0.0)

    fed, _ = seen(slides, 6.0, deviation=0.05, told=told)
    stays, _ = seen(lambda _: slides(0.0), 6.0, deviation=0.05, told=told)
    assert fed.tracker.counts.obstacles == stays.tracker.counts.obstacles


@pytest.mark.parametrize("seed", range(5))
def test_cars_that_stood_behind_who_walks_stay_where_they_are(seed: int) -> None:
    """Their obstacle began with the walker, whose reflection leads it."""
    fed, rng = HandFedVehicles(noise=(0.25, 0.25, 0.1)), np.random.default_rng(seed)
    ids, numbers = set[int](), set[int]()
    for t in times(1, 120):
        shown = [walker(t), *(parked(t) if t > 0.3 else [])]
        noise = rng.normal(size=(len(shown), 2)) * 0.25
        told = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
        numbers |= {int(each) for each in told.id}
        if t > 5.0:
            at = walker(t)
            row = obstacle_near(told, at.x, at.y)
            assert np.hypot(told.x[row] - at.x, told.y[row] - at.y) < 0.8
            others = [k for k in range(len(told)) if k != row and told.state[k] != TENTATIVE]
            ids |= {int(each) for each in told.id[others]}
    assert np.hypot(told.vx[others], told.vy[others]).max() < 0.5
    assert fed.tracker.counts.obstacles >= int(told.id.max())
    assert 1 <= len(ids) <= 3
    assert fed.tracker.counts.obstacles == len(numbers)


def stops(t: float) -> list[Seen]:
    """Return both corners that a car beside us shows which drives at 6 m/s, then brakes to a stop within 2 s."""
    ahead, speed = (6.0 * t, 6.0) if t < 1.0 else (6.0 * t - 1.5 * (t - 1.0) ** 2, max(6.0 - 3.0 * (t - 1.0), 0.0))
    ahead = ahead if t < 3.0 else 12.0
    return [Seen(0, ahead, -3.0, speed), Seen(1, ahead + 4.5, -3.2, speed)]


def crosses(t: float) -> list[Seen]:
    """Return one who steps off the kerb just before the front of that car once it stands, and walks on before it."""
    return [Seen(9, 17.1, -4.4 + max(t - 5.0, 0.0), 0.0, 1.0 if t > 5.0 else 0.0)] if t > 4.0 else []


@pytest.mark.parametrize("seed", range(5))
def test_who_walks_on_before_a_car_that_has_stopped_does_not_take_it_along(seed: int) -> None:
    fed, rng = HandFedVehicles(noise=(0.1, 0.1, 0.1)), np.random.default_rng(seed)
    ids = list[int]()
    for t in times(1, 180):
        shown = stops(t) + crosses(t)
        noise = rng.normal(size=(len(shown), 2)) * 0.1
        told = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
        if t > 2.0:
            ids.append(int(told.id[obstacle_near(told, 14.2, -3.1)]))
    assert len(set(ids)) == 1
    car, walks = obstacle_near(told, 14.2, -3.1), obstacle_near(told, 17.1, -0.4)
    assert np.hypot(told.vx[car], told.vy[car]) < 0.3
    assert np.hypot(told.x[walks] - 17.1, told.y[walks] + 0.4) < 0.8
    assert told.vy[walks] == pytest.approx(1.0, abs=0.4)
    assert not told.length[walks] > 2.0


@pytest.mark.parametrize(
    ("fastest", "age", "body"), [(1.4, 3.0, -1), (8.0, 3.0, 0), (1.4, 1.0, 0)], ids=["walker", "car", "young"]
)
def test_what_is_slower_is_no_reflection_of_who_walks(fastest: float, age: float, body: int) -> None:
    """Of a car that brakes it may be one, and of what has not been known for long."""
    bodies, settings = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities()), ReflectionSettings()
    modes = bodies.filter.probability.shape[1]
    velocity, spread = np.tile([-1.3, 0.0], (1, modes, 1)), np.tile(np.eye(2) * 0.01, (1, modes, 1, 1))
    bodies.filter.spawn(
        np.array([[20.0, 0.0]]), np.eye(2)[None] * 0.04, velocity, spread, np.full((1, modes), 1 / modes)
    )
    bodies.add(0, np.array([-1.0, 0.0]), 4.5, 1.8)
    bodies.add_reflection(0, 0, 0, 0, np.zeros(2))
    bodies.obstacles.confirmed[:], bodies.obstacles.fastest[:] = True, fastest
    seen = Measurement(
        np.array([[18.0, 0.0]]), np.eye(2)[None] * 0.04, np.zeros(2), np.zeros(2), np.array([-0.3]), np.array([0.01])
    )
    mean, _ = bodies.reflection_states()
    assert beside(bodies, mean, seen, np.array([0]), settings, round(age * 1e9)).tolist() == [body]


@pytest.mark.parametrize("seed", range(5))
def test_a_post_is_left_behind_by_who_walks_past_it(seed: int) -> None:
    """To a radar without ids who comes out beside a post that it misses is a part of it; then their speeds differ."""
    fed, rng, walker_at = HandFedVehicles(noise=(0.25, 0.25, 0.1)), np.random.default_rng(seed), 0.0
    for t in times(1, 300):
        walker_at = 7.3 - 1.3 * max(t - 3.8, 0.0)
        shown = [Seen(0, 5.4, 5.5)] if not 3.2 < t < 4.15 else []
        shown += [Seen(1, 5.4, walker_at, 0.0, -1.3)] if t > 3.8 else []
        noise = rng.normal(size=(len(shown), 2)) * 0.15
        told = fed.scan(
            t,
            [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)],
            identified=False,
        )
    row = obstacle_near(told, 5.4, walker_at)
    assert np.hypot(told.x[row] - 5.4, told.y[row] - walker_at) < 0.8
    assert told.vy[row] == pytest.approx(-1.3, abs=0.3)
    post = obstacle_near(told, 5.4, 5.5)
    assert np.hypot(told.x[post] - 5.4, told.y[post] - 5.5) < 0.8


def side_by_side(t: float, apart: float, shown: int, *, across: bool = False) -> list[Seen]:
    """Return two who walk, each seen at one place or more, none nearer to another's than `apart`, m."""
    way, lines = WALKS * t, [0.1 * k + (apart + 0.1 * (shown - 1)) * person for person in (0, 1) for k in range(shown)]
    if across:
        return [Seen(key, 15.0 + aside, way - 8.0, 0.0, WALKS) for key, aside in enumerate(lines)]
    return [Seen(key, 10.0 + way, aside, WALKS) for key, aside in enumerate(lines)]


def told_of(people: Callable[[float], list[Seen]], until: float, deviation: float = 0.05) -> Obstacles:
    """Return what is told of people at last, each seen in 19 of 20 scans."""
    fed, rng = HandFedVehicles(), np.random.default_rng(3)
    for t in times(1, round(until / 0.05)):
        shown = [one for one in people(t) if rng.random() < 0.95 or t > until - 0.2]
        noise = rng.normal(size=(len(shown), 2)) * deviation
        told = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
    return told


@pytest.mark.parametrize("across", [False, True], ids=["ahead", "across"])
@pytest.mark.parametrize(("apart", "shown"), [(0.7, 1), (1.1, 1), (0.9, 2)])
def test_people_who_walk_side_by_side_are_an_obstacle_each(apart: float, shown: int, across: bool) -> None:
    told = told_of(lambda t: side_by_side(t, apart, shown, across=across), 8.0)
    assert told.state.tolist() == [CONFIRMED, CONFIRMED]
    assert told.kind.tolist() == [PEDESTRIAN, PEDESTRIAN]
    assert np.ptp(told.x if across else told.y) == pytest.approx(apart + 0.1 * (shown - 1), abs=0.25)


@pytest.mark.parametrize("since", [1.9, 2.6, 3.3])
def test_another_reflection_of_one_of_them_is_no_third_person(since: float) -> None:
    """It appears shortly before they are told apart, and has not walked far by then."""

    def people(t: float) -> list[Seen]:
        later = [Seen(2, 10.0 + WALKS * t, 1.3, WALKS)] if t > since else []
        return [*side_by_side(t, 1.1, 1), *later]

    fed, rng, most = HandFedVehicles(), np.random.default_rng(3), 0
    for t in times(1, 160):
        noise = rng.normal(size=(3, 2)) * 0.03
        seen = [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(people(t), noise, strict=False)]
        most = max(most, len(fed.scan(t, seen)))
    assert most == 2


def test_both_sides_of_a_car_that_creeps_are_one_where_it_shows_others_too() -> None:
    """Each of its reflections is another one, elsewhere, after two seconds."""

    def creeping(t: float) -> list[Seen]:
        places = ((0.0, -0.6), (0.9, 1.5))
        return [
            Seen(10 * side + int(t / 2.0), 10.0 + WALKS * t, places[side][int(t / 2.0) % 2], WALKS) for side in (0, 1)
        ]

    assert len(told_of(creeping, 12.0)) == 1


def test_what_drives_off_shows_both_sides_of_one_vehicle() -> None:
    def leaving(t: float) -> list[Seen]:
        speed = min(1.2 * t, 15.0)
        return [Seen(side, 10.0 + 0.6 * t * t, 0.9 * side, speed) for side in (0, 1)]

    assert len(told_of(leaving, 8.0)) == 1


@pytest.mark.parametrize(("rate", "stands"), [(0.1, True), (-2.0, False), (np.nan, True)])
@pytest.mark.parametrize("by_kernels", [True, False])
def test_what_drives_by_its_speed_has_not_stood(
    rate: float, stands: bool, by_kernels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is seen of a vehicle beside us may slide along it as fast as it drives on: its place stands."""
    if by_kernels and not compiled.in_use:
        pytest.skip("no compiled kernels")
    monkeypatch.setattr(compiled, "in_use", by_kernels)
    bodies, settings = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities()), ReflectionSettings()
    modes = bodies.filter.probability.shape[1]
    still, spread = np.zeros((1, modes, 2)), np.tile(np.eye(2) * 0.01, (1, modes, 1, 1))
    place = np.array([[8.0, 3.0]])
    bodies.filter.spawn(place, np.eye(2)[None] * 0.04, still, spread, np.full((1, modes), 1 / modes))
    bodies.add(0, np.array([1.0, 0.0]), 4.5, 1.8)
    bodies.add_reflection(0, 0, 0, 0, np.zeros(2))
    row, none = np.array([0]), np.zeros(2)
    for k in range(20):
        told, variance = (np.array([rate]), np.array([0.01])) if k else (None, None)
        measurement = Measurement(place, np.eye(2)[None] * 0.04, none, none, told, variance)
        note_strays(bodies, row, row, measurement, (k + 1) * 50_000_000, settings)
    assert (bodies.reflections.stood[0] > 0.5) == stands
