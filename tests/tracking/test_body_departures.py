"""Who drives off from what it stood over keeps its id; who passes close by has another one."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.tracking.obstacles import Obstacles
from tests.support.builders import HandFedVehicles, Seen, car, times

STOP, COVER = 20.0, 21.5  # m ahead, where the near end of the car stands, and the cover below it


def _came(fed: HandFedVehicles) -> int:
    """Let a car come towards us and stop over a cover, which is all that shows in the end; return its id."""
    for t in times(0, 80):
        told = fed.scan(t, [Seen(1, STOP + (4.0 - t) ** 2, 0.0, -2.0 * (4.0 - t))])
    (identity,) = told.id.tolist()
    for t in times(80, 120):
        fed.scan(t, [Seen(1, STOP, 0.0)] if t < 5.0 else [Seen(2, COVER, 0.2)])
    return int(identity)


def _goes(fed: HandFedVehicles, across: float) -> Obstacles:
    """Let something appear there, so far aside, that drives on towards us from the cover, which stays."""
    for t in times(120, 150):
        way = 2.0 * (t - 5.0) ** 2 - 2.0
        told = fed.scan(t, [Seen(2, COVER, 0.2), Seen(3, STOP - way, across, -4.0 * (t - 5.0))])
    return told


@pytest.mark.parametrize(("across", "is_the_car"), [(0.0, True), (2.2, False)])
def test_who_drives_off_from_what_it_stood_over_is_the_car_that_came(across: float, is_the_car: bool) -> None:
    fed = HandFedVehicles(noise=(0.2, 0.2, 0.1))
    came = _came(fed)
    told = _goes(fed, across)
    assert len(told) == 2
    driving = np.hypot(told.vx, told.vy) > 2.0
    assert (told.id[driving] == came).tolist() == [is_the_car]
    assert (told.id[~driving] == came).tolist() == [not is_the_car]
    assert np.abs(told.x[~driving] - COVER) < 0.5


def test_who_takes_up_a_course_keeps_its_reflections_where_they_are() -> None:
    fed = HandFedVehicles()
    for t in times(1, 40):
        fed.scan(t, [car(1, t, 40.0), car(2, t, 43.0), car(9, t, -20.0, 30.0)])
    bodies = fed.tracker._bodies
    assert len(bodies) == 2
    obstacles, before = bodies.obstacles, bodies.offsets().copy()
    obstacles.directed[:], obstacles.axis[1], obstacles.ahead[1] = [False, True], [0.0, 1.0], 5.0
    bodies.take_up(0, 1)
    assert obstacles.axis[0].tolist() == [0.0, 1.0]
    assert bodies.offsets() == pytest.approx(before)


def test_who_takes_up_an_identity_takes_up_the_size_that_reflections_showed() -> None:
    """To a radar that tells no sizes all are known as well: what reflections showed goes with how far they reached."""
    fed = HandFedVehicles()
    for t in times(1, 40):
        fed.scan(t, [car(1, t, 40.0), car(9, t, -20.0, 30.0)])
    obstacles = fed.tracker._bodies.obstacles
    obstacles.length[1], obstacles.width[1], obstacles.extent[1] = 14.0, 2.5, 13.6
    assert obstacles.length_variance[0] == obstacles.length_variance[1]
    fed.tracker._bodies.take_up(0, 1)
    assert (obstacles.length[0], obstacles.width[0], obstacles.extent[0]) == (14.0, 2.5, 13.6)
