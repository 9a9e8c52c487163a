"""No vehicle is wider than a lorry."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.tracking.body_width import is_wide
from candaemon.tracking.obstacles import CONFIRMED, Obstacles
from tests.support.builders import HandFedVehicles, Seen, pose, times

SPEED, STEADY, WANDERED, NEAR_BY = 8.0, 1.5, 3.0, 8.0


def corners(t: float, left: float, right: float) -> list[Seen]:
    """Return the rear corner of a car ahead and the front corner of one beside it, which reflect elsewhere in time.

    At first they lie as close together as those of one car do.

    Args:
        t: s.
        left: m by which the left one has wandered outwards in the end.
        right: likewise the right one.
    """
    share = min(max((t - STEADY) / (WANDERED - STEADY), 0.0), 1.0)
    places = (20.0, 0.9 - share * right), (18.0, 2.0 + share * left)
    return [Seen(key, x + SPEED * t, y, vx=SPEED) for key, (x, y) in enumerate(places)]


def told(obstacles: Obstacles) -> list[float]:
    """Return how far to the left the confirmed obstacles are, m."""
    return sorted(obstacles.y[obstacles.state == CONFIRMED].tolist())


def test_two_cars_that_seemed_one_are_two_once_they_show_how_wide_they_are() -> None:
    vehicles = HandFedVehicles()
    for t in times(0, 30):
        seemed = vehicles.scan(t, corners(t, 0.9, 1.1))
    (known,) = seemed.id.tolist()
    for t in times(30, 100):
        two = vehicles.scan(t, corners(t, 0.9, 1.1))
    assert told(two) == pytest.approx([-0.2, 2.9], abs=0.3)
    assert known in two.id.tolist()
    assert len(two) == 2


@pytest.mark.parametrize("settings", [{"widest": 4.0}, {}])
def test_a_lorry_stays_one(settings: dict[str, float]) -> None:
    """As wide as lorries are; or as wide as a YAML says that they are."""
    vehicles = HandFedVehicles(reflections=settings)
    for t in times(0, 100):
        lorry = vehicles.scan(t, corners(t, 0.9 if settings else 0.6, 1.1 if settings else 0.7))
        if t > 1.0:
            assert len(told(lorry)) == 1


def test_what_lies_along_a_wrong_axis_seems_to_lie_across() -> None:
    short, long = np.array([[0.0, 0.0], [2.0, 2.8]]), np.array([[0.0, 0.0], [12.0, 2.8]])
    assert is_wide(short, np.zeros(2), 2.5)
    assert not is_wide(long, np.zeros(2), 2.5)
    assert not is_wide(short, np.full(2, 0.1), 2.5)


def side_by_side(t: float, apart: float, between: bool) -> list[Seen]:
    """Return what a queue that stands shows of two lanes: from far away as near to one another as parts of a car.

    Args:
        t: s.
        apart: m from one to the other, as is seen from near by.
        between: whether something shows between the two, as of a car that is parked across.
    """
    share = min(t / NEAR_BY, 1.0)
    right = 3.0 - (1.0 - share) * 1.0 - share * apart
    found = [Seen(1, 40.0, 3.0), Seen(2, 40.5, right)]
    return [*found, Seen(3, 40.2, 0.5 * (3.0 + right))] if between else found


@pytest.mark.parametrize(
    ("apart", "between", "obstacles"),
    [(3.4, False, 2), (3.4, True, 1), (2.3, False, 1)],
    ids=["two lanes", "parked across", "one lane"],
)
def test_two_that_stand_and_seemed_one_from_afar_are_two(apart: float, between: bool, obstacles: int) -> None:
    vehicles = HandFedVehicles()
    for t in times(0, 200):
        told = vehicles.scan(t, side_by_side(t, apart, between))
    assert len(told) == obstacles


@pytest.mark.parametrize(
    "where", [{"heading": np.pi / 2}, {"east": 40.0, "north": -20.0}], ids=["we turned off", "we are beside it"]
)
def test_who_waits_at_a_crossing_and_is_seen_from_beside_shows_how_long_it_is(where: dict[str, float]) -> None:
    """What seems its axis is our own heading as it was seen first, across which it stands."""
    vehicles = HandFedVehicles()
    for t in times(0, 200):
        told = vehicles.scan(t, side_by_side(t, 3.4, False), ego=pose(t, **(where if t > 2.0 else {})))
    assert len(told) == 1
