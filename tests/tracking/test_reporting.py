"""What a tracker reports of a body: heading, yaw rate, size, centre, class and the whole covariance."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

from candaemon.tracking.obstacles import UNKNOWN, Obstacles, concatenated, no_obstacles
from tests.support.builders import Circle, HandFed, Seen, assert_sane, pose, rotation, times

EGO_HEADING = 0.7
SETTINGS: dict[str, Any] = {"lifecycle": {"confirm": 1, "window": 2}, "association": {"method": "id"}}


def driven(seen: list[Seen], seconds: float = 2.0, **settings: Any) -> Obstacles:
    """Return what is told at the end of a drive of steady objects, seen from a vehicle that stands askew."""
    fed = HandFed(**{**SETTINGS, **settings})
    for time in times(0, int(seconds * 20)):
        moved = [Seen(each.key, each.x + each.vx * time, each.y + each.vy * time, each.vx, each.vy) for each in seen]
        told = fed.scan(time, moved, ego=pose(time, heading=EGO_HEADING))
    return told


@pytest.mark.parametrize("merge", [True, False])
@pytest.mark.parametrize("course", [0.5, 2.0, -3.0])
def test_heading_is_where_it_drives_to(course: float, merge: bool) -> None:
    told = driven([Seen(1, 40.0, 10.0, 15 * cos(course), 15 * sin(course))], 9.0, reflections={"merge": merge})
    expected = (course - EGO_HEADING + pi) % (2 * pi) - pi
    assert told.heading[0] == pytest.approx(expected, abs=0.02)
    assert abs(told.yaw_rate[0]) < 0.02


def test_heading_is_unknown_of_what_never_drove_and_kept_by_what_stops() -> None:
    fed = HandFed(**SETTINGS)
    x = 30.0
    for time in times(0, 200):
        speed = float(np.clip(12.0 - 2.0 * time, 0.0, 12.0))
        x += speed * 0.05
        told = fed.scan(time, [Seen(1, x, 0.0, speed), Seen(2, 30.0, 10.0)], ego=pose(time, heading=EGO_HEADING))
    assert_sane(told)
    assert np.isnan(told.heading[1])
    assert told.heading[0] == pytest.approx(-EGO_HEADING, abs=0.1)
    assert np.isnan(told.yaw_rate).all()  # neither moves


def test_yaw_rate_is_that_of_the_curve_it_drives() -> None:
    circle, fed = Circle(12.0, 0.3, 0.2), HandFed(**SETTINGS)
    rates = []
    for time in times(0, 120):
        (x, y), (vx, vy) = circle.position(time), circle.velocity(time)
        told = fed.scan(time, [Seen(1, 60.0 + float(x), float(y), float(vx), float(vy))])
        rates.append(float(told.yaw_rate[0]))
    assert np.mean(rates[60:]) == pytest.approx(0.3, abs=0.05)


def test_what_a_point_tracker_does_not_know_is_not_told() -> None:
    told = driven([Seen(1, 40.0, 10.0, 15.0, 0.0), Seen(2, 20.0, -10.0)])
    for name in ("length", "width", "kind_likelihood"):
        assert np.isnan(getattr(told, name)).all(), name
    assert told.kind.tolist() == [UNKNOWN, UNKNOWN]
    np.testing.assert_array_equal(told.center_x, told.x)
    np.testing.assert_array_equal(told.center_y, told.y)


def test_the_covariance_is_turned_to_vehicle_axes() -> None:
    seen = [Seen(1, 40.0, 10.0, 15.0, 2.0), Seen(2, 20.0, -10.0, 3.0, 9.0)]
    fed = HandFed(noise=(0.1, 0.8, 0.06), **SETTINGS)
    for time in times(0, 40):
        told = fed.scan(time, seen, ego=pose(time, heading=EGO_HEADING))
    _, local = fed.tracker._tracks.states()
    turn = np.kron(np.eye(2), rotation(-EGO_HEADING))
    np.testing.assert_allclose(told.covariance, turn @ local[:, :4, :4] @ turn.T, atol=1e-12)
    assert abs(told.covariance[:, 0, 1]).max() > 1e-3  # or the angle of turning showed nowhere
    assert_sane(told)


def test_bodies_of_several_trackers_are_told_as_one() -> None:
    parts = [driven([Seen(1, 40.0, 10.0, 15.0, 0.0)]), driven([Seen(2, 20.0, -10.0, 9.0, 0.0), Seen(3, 50.0, 5.0)])]
    both = concatenated([*parts, no_obstacles(parts[0].time_ns)])
    assert both.covariance.shape == (3, 4, 4)
    assert both.kind.dtype == np.int8
    np.testing.assert_array_equal(both.heading, np.concatenate([part.heading for part in parts]))
