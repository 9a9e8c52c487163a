"""Riders in line are several; a vehicle that shows as much is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from candaemon.tracking.box import TWO_WHEELER
from candaemon.tracking.obstacles import CONFIRMED, Obstacles
from tests.support.builders import HandFedVehicles, Seen, pose, times

SPEED = 6.0  # m/s


def in_line(t: float, apart: float = 4.0, speed: float = SPEED) -> list[Seen]:
    """Return two who drive one behind the other, each seen at one place."""
    return [Seen(key, 25.0 + apart * key + speed * t, -0.3 * key, speed) for key in (0, 1)]


def told_of(seen: Callable[[float], list[Seen]], until: float, **settings: object) -> Obstacles:
    """Return the confirmed obstacles at last of what is followed, each seen in 19 of 20 scans."""
    fed, rng = HandFedVehicles(reflections=settings), np.random.default_rng(3)
    for t in times(1, round(until / 0.05)):
        shown = [one for one in seen(t) if rng.random() < 0.95 or t > until - 0.2]
        noise = rng.normal(size=(len(shown), 2)) * 0.1
        told = fed.scan(
            t, [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(shown, noise, strict=True)]
        )
    assert (told.state == CONFIRMED).all()
    return told


def test_riders_in_line_that_seemed_one_are_two() -> None:
    assert len(told_of(in_line, 2.5)) == 1
    told = told_of(in_line, 8.0)
    assert told.kind.tolist() == [TWO_WHEELER, TWO_WHEELER]
    assert np.ptp(told.x) == pytest.approx(4.0, abs=0.4)


def test_a_car_close_beside_us_shows_its_two_ends_all_the_time() -> None:
    """We drive along with it, by hardly more than its half width beside its axis."""
    fed, rng = HandFedVehicles(), np.random.default_rng(3)
    for t in times(1, 160):
        own = pose(t, east=SPEED * t, ve=SPEED)
        ends = [Seen(key, own.east + along, 1.2, SPEED) for key, along in ((0, -2.0), (1, 2.0))]
        noise = rng.normal(size=(2, 2)) * 0.1
        shown = [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(ends, noise, strict=True)]
        told = fed.scan(t, shown, ego=own)
    assert len(told) == 1


def test_three_in_line_are_three() -> None:
    told = told_of(lambda t: [*in_line(t), Seen(2, 33.2 + SPEED * t, 0.1, SPEED)], 8.0)
    assert np.diff(np.sort(told.x)) == pytest.approx([4.0, 4.2], abs=0.5)


@pytest.mark.parametrize(
    ("apart", "speed", "settings"),
    [(4.0, 12.0, {}), (2.0, SPEED, {}), (4.0, SPEED, {"riders": {"time": 20.0}})],
    ids=["faster", "nearer", "not for long"],
)
def test_what_may_be_a_vehicle_stays_one(apart: float, speed: float, settings: dict[str, object]) -> None:
    assert len(told_of(lambda t: in_line(t, apart, speed), 8.0, **settings)) == 1


def test_a_vehicle_whose_reflections_come_and_go_stays_one() -> None:
    """Each of those ahead of its rear is another one, elsewhere, after two seconds."""

    def shown(t: float) -> list[Seen]:
        places = ((0, 0.0), (1 + int(t / 2.0), 4.0 - 1.1 * (int(t / 2.0) % 3)))
        return [Seen(key, 25.0 + along + SPEED * t, 0.0, SPEED) for key, along in places]

    assert len(told_of(shown, 10.0)) == 1


def test_what_a_sensor_tells_to_be_as_wide_as_a_car_stays_one() -> None:
    fed = HandFedVehicles()
    for t in times(1, 160):
        told = fed.scan(t, in_line(t), width=np.full(2, 1.8))
    assert len(told) == 1


def test_a_vehicle_that_shows_another_reflection_between_stays_one() -> None:
    assert len(told_of(lambda t: [*in_line(t), Seen(2, 27.0 + SPEED * t, -0.1, SPEED)], 8.0)) == 1


@pytest.mark.parametrize(("fastest", "obstacles"), [(9.0, 2), (5.0, 1)])
def test_a_rider_who_comes_up_behind_another_stays_by_itself(fastest: float, obstacles: int) -> None:
    """Each was seen alone for long."""

    def seen(t: float) -> list[Seen]:
        nearing = 1.2 * float(np.clip((10.0 - t) / 2.0, 0.0, 1.0))  # m/s, less and less from 8 s to 10 s
        behind = 2.6 + (1.2 * (9.0 - t) if t < 8.0 else nearing * nearing / 1.2)
        return [Seen(0, 40.0 + SPEED * t, 0.0, SPEED), Seen(1, 40.0 - behind + SPEED * t, -0.2, SPEED + nearing)]

    assert len(told_of(seen, 14.0, riders={"fastest": fastest})) == obstacles


def test_who_appears_behind_a_rider_is_another_one() -> None:
    """Where a car would go on, a bicycle has ended."""

    def seen(t: float) -> list[Seen]:
        behind = [Seen(1, 22.2 + SPEED * t, 0.0, SPEED)] if t > 11.0 else []
        return [Seen(0, 25.0 + SPEED * t, 0.0, SPEED), *behind]

    assert len(told_of(seen, 13.0, alone={"within": 200.0})) == 2


def test_riders_that_part_exist_as_surely_as_the_one_they_seemed_to_be() -> None:
    """Both were seen for so long: neither is left out sooner than the other where both are missed."""
    fed, rng, told = HandFedVehicles(), np.random.default_rng(3), None
    for t in times(1, 200):
        noise = rng.normal(size=(2, 2)) * 0.1
        shown = [replace(one, x=one.x + dx, y=one.y + dy) for one, (dx, dy) in zip(in_line(t), noise, strict=True)]
        told = fed.scan(t, shown)
        if t > 1.0 and len(told) == 2:
            break
    assert told is not None
    assert told.existence.tolist() == pytest.approx([told.existence[0]] * 2)
    assert told.existence[0] > 0.9
