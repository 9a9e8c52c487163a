"""Which obstacles are one vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from candaemon import compiled
from candaemon.config.tracker import ReflectionSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.tracking.body_merging import inside_others, merge_candidates
from candaemon.tracking.body_sizes import RIDER
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.identities import Identities
from tests.support.builders import HandFedVehicles, Seen, times

NOW_NS = 5 * 10**9


@dataclass(frozen=True)
class Second:
    """What seems 3 m/s faster than the first, which moves at 2 m/s across the line of sight.

    Attributes:
        behind: m, the first.
        deviation: of the velocities of both, m/s.
        age: s.
        unseen: s since it was detected last.
    """

    behind: float = 1.0
    deviation: float = 0.5
    age: float = 0.5
    unseen: float = 0.0


@pytest.mark.parametrize("by_kernels", [True, False])
@pytest.mark.parametrize(
    ("second", "older"),
    [
        (Second(), 0),
        (Second(deviation=0.4), -1),
        (Second(behind=4.5), -1),
        (Second(age=1.5), -1),
        (Second(unseen=0.3), -1),
    ],
    ids=["as far as is known", "too fast", "too far away", "known for long", "lost"],
)
def test_what_is_in_one_place_is_one_vehicle_unless_its_speed_is_known_to_differ(
    second: Second, older: int, by_kernels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what crosses, the speed is known only after some scans."""
    if by_kernels and not compiled.in_use:
        pytest.skip("the kernels are not built")
    monkeypatch.setattr(compiled, "in_use", by_kernels)
    bodies = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = bodies.filter.probability.shape[1]
    velocity = np.tile(np.array([[2.0, 0.0], [5.0, 0.0]])[:, None], (1, modes, 1))
    spread = np.tile(np.eye(2) * second.deviation**2, (2, modes, 1, 1))
    place = np.array([[0.0, 20.0], [-second.behind, 20.0]])
    bodies.filter.spawn(place, np.tile(np.eye(2) * 0.04, (2, 1, 1)), velocity, spread, np.full((2, modes), 1 / modes))
    for row, age in enumerate((3.0, second.age)):
        bodies.add(NOW_NS - round(age * 1e9), np.array([1.0, 0.0]), 4.5, 1.8)
        bodies.add_reflection(row, 0, row, NOW_NS, np.zeros(2))
    bodies.obstacles.confirmed[0] = True
    bodies.obstacles.last_ns[:] = NOW_NS, NOW_NS - round(second.unseen * 1e9)
    found, _ = merge_candidates(bodies, ReflectionSettings(), NOW_NS)
    assert found.tolist() == [-1, older]


@pytest.mark.parametrize(
    ("behind", "speed", "deviation", "age", "inside"),
    [
        (0.6, 1.0, 2.0, 0.4, True),
        (0.6, 12.0, 2.0, 0.4, False),
        (3.0, 1.0, 2.0, 0.4, False),
        (0.6, 1.0, 2.0, 1.5, False),
        (0.6, 1.0, 0.3, 0.4, False),
    ],
    ids=["begun by a detection far off", "moves alike", "behind it", "there for long", "of a velocity that is known"],
)
def test_what_begins_inside_another_and_moves_otherwise_is_no_vehicle(
    behind: float, speed: float, deviation: float, age: float, inside: bool
) -> None:
    """A detection that was far off began it; it follows those of the car, at a velocity of its own."""
    bodies = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = bodies.filter.probability.shape[1]
    velocity = np.tile(np.array([[13.0, 0.0], [speed, 0.0]])[:, None], (1, modes, 1))
    spread = np.tile(np.eye(2) * deviation**2, (2, modes, 1, 1))
    place = np.array([[20.0, 0.0], [20.0 - behind, 0.0]])
    bodies.filter.spawn(place, np.tile(np.eye(2) * 0.09, (2, 1, 1)), velocity, spread, np.full((2, modes), 1 / modes))
    for row, since in enumerate((3.0, age)):
        bodies.add(NOW_NS - round(since * 1e9), np.array([1.0, 0.0]), 4.5, 1.8)
        bodies.add_reflection(row, 0, row, NOW_NS, np.zeros(2))
    bodies.obstacles.confirmed[0] = True
    bodies.obstacles.last_ns[:] = NOW_NS
    bodies.obstacles.facing[:], bodies.obstacles.fastest[:] = [-2.25, 0.0], 13.0
    found = inside_others(bodies, np.array([1]), ReflectionSettings(), NOW_NS)
    assert found.tolist() == [inside]


def test_two_of_which_one_walks_past_the_other_do_not_become_one() -> None:
    """Nearer than reflections of one vehicle lie, and slower than vehicles drive."""
    fed, rng = HandFedVehicles(noise=(0.2, 0.2, 0.1)), np.random.default_rng(3)
    for t in times(1, 120):
        dx, dy, ex, ey = rng.normal(size=4) * 0.2
        told = fed.scan(
            t,
            [Seen(1, 32.0 + dx, -2.0 + dy, 0.0), Seen(2, 29.8 + ex, -5.0 + 1.0 * t + ey, 0.0, 1.0)],
        )
    assert len(told) == 2
    assert fed.tracker.counts.merged == 0


@pytest.mark.parametrize(("apart_for", "obstacles"), [(3.0, 2), (60.0, 1)])
def test_who_has_driven_in_another_lane_for_long_stays_by_itself(apart_for: float, obstacles: int) -> None:
    """In a jam the near side of the car beside is nearer to the middle of the one ahead than a lorry is wide."""
    alone = {"course": {"apart_for": apart_for}, "riders": {"time": 60.0}}  # else riders would be parted again
    fed = HandFedVehicles(noise=(0.2, 0.2, 0.1), reflections=alone)
    for t in times(1, 320):
        told = fed.scan(t, [Seen(1, 20.0 + 5.0 * t, 0.0, 5.0), Seen(2, 31.0 + 4.1 * t, 1.5, 4.1)])
    assert len(told) == obstacles


@pytest.mark.parametrize(("size", "older"), [(0.5, -1), (4.5, 0)])
def test_what_is_small_is_one_with_nothing_that_its_size_leaves_no_room_for(size: float, older: int) -> None:
    bodies = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = bodies.filter.probability.shape[1]
    velocity, spread = np.tile([1.3, 0.0], (2, modes, 1)), np.tile(np.eye(2) * 0.01, (2, modes, 1, 1))
    place = np.array([[0.0, 20.0], [-1.7, 20.5]])
    bodies.filter.spawn(place, np.tile(np.eye(2) * 0.04, (2, 1, 1)), velocity, spread, np.full((2, modes), 1 / modes))
    for row in range(2):
        bodies.add(NOW_NS - 2 * 10**9, np.array([1.0, 0.0]), size, 0.4 * size)
        bodies.add_reflection(row, 0, row, NOW_NS, np.zeros(2))
    bodies.obstacles.confirmed[:], bodies.obstacles.fastest[:], bodies.obstacles.last_ns[:] = True, 1.3, NOW_NS
    found, _ = merge_candidates(bodies, ReflectionSettings(), NOW_NS)
    assert found.tolist() == [-1, older]


def _two(velocity: float, apart: tuple[float, float], ages: tuple[float, float]) -> Bodies:
    """Return two confirmed cars that drive along x, the second so far from the first, of such ages, s."""
    bodies = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = bodies.filter.probability.shape[1]
    velocities, spread = np.tile([velocity, 0.0], (2, modes, 1)), np.tile(np.eye(2) * 0.01, (2, modes, 1, 1))
    place = np.array([[20.0, 0.0], [20.0 + apart[0], apart[1]]])
    noise, even = np.tile(np.eye(2) * 0.04, (2, 1, 1)), np.full((2, modes), 1 / modes)
    bodies.filter.spawn(place, noise, velocities, spread, even)
    for row, age in enumerate(ages):
        bodies.add(NOW_NS - round(age * 1e9), np.array([1.0, 0.0]), 4.5, 1.8)
        bodies.add_reflection(row, 0, row, NOW_NS, np.zeros(2))
    obstacles = bodies.obstacles
    obstacles.confirmed[:], obstacles.directed[:], obstacles.fastest[:] = True, True, velocity
    return bodies


@pytest.mark.parametrize("lost", [0, 1])
@pytest.mark.parametrize(
    ("age", "unseen", "along", "older"),
    [(4.0, 0.3, 2.0, -1), (4.0, 0.0, 2.0, 0), (1.0, 0.3, 2.0, 0), (4.0, 0.3, -5.0, 0)],
    ids=["out of sight", "both seen", "just found", "behind"],
)
def test_who_has_driven_apart_for_long_is_one_with_nothing_that_is_out_of_sight(
    age: float, unseen: float, along: float, older: int, lost: int
) -> None:
    """A lorry's rear and front are one however long they were two; a car beside us in a jam does not drive into us."""
    bodies = _two(15.0, (along, 0.8), (4.5, age))
    bodies.obstacles.last_ns[:] = NOW_NS
    bodies.obstacles.last_ns[lost] -= round(unseen * 1e9)
    found, _ = merge_candidates(bodies, ReflectionSettings(), NOW_NS)
    assert found.tolist() == [-1, older]


@pytest.mark.parametrize(("alone", "age", "older"), [(2.0, 4.0, -1), (2.0, 1.0, 0), (0.0, 4.0, 0)])
def test_who_was_found_to_ride_for_long_becomes_no_part_of_a_car(alone: float, age: float, older: int) -> None:
    bodies = _two(3.0, (0.4, 0.5), (4.5, age))
    obstacles = bodies.obstacles
    obstacles.last_ns[:] = NOW_NS
    obstacles.length[1], obstacles.width[1] = RIDER if alone > 1.0 else (4.5, 1.8)
    obstacles.alone[1] = alone
    found, _ = merge_candidates(bodies, ReflectionSettings(), NOW_NS)
    assert found.tolist() == [-1, older]


@pytest.mark.parametrize(
    ("speed", "told", "needed"), [(1.4, 9.0, 2.5), (1.4, 0.1, 0.5), (4.0, 9.0, 0.5), (0.3, 9.0, 0.5)]
)
def test_what_may_be_people_becomes_one_only_when_it_is_known_to_be_none(
    speed: float, told: float, needed: float
) -> None:
    """They walk alike, a metre apart; what a sensor tells to be as long as a car, was faster, or stands is none."""
    bodies = _two(speed, (1.5, 0.8), (4.5, 1.5))
    bodies.obstacles.last_ns[:], bodies.obstacles.length_variance[:] = NOW_NS, told
    settings = ReflectionSettings()
    found, time = merge_candidates(bodies, settings, NOW_NS)
    assert found.tolist() == [-1, 0]
    assert time[1] == needed
    assert settings.alone.time == 2.5


def test_people_who_seem_to_stop_are_held_for_two_all_the_same() -> None:
    bodies = _two(0.3, (1.5, 0.8), (4.5, 1.5))
    bodies.obstacles.last_ns[:], bodies.obstacles.length_variance[:], bodies.obstacles.fastest[:] = NOW_NS, 9.0, 1.4
    found, time = merge_candidates(bodies, ReflectionSettings(), NOW_NS)
    assert (found.tolist(), time[1]) == ([-1, 0], 2.5)
