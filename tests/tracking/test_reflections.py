"""Several reflections of one vehicle: who leads, who parts, who joins."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.tracking.obstacles import CONFIRMED
from tests.support.builders import HandFed, Seen, assert_sane, car, place, states, times


def test_several_reflections_are_one_vehicle_and_the_lead_passes_without_a_jump() -> None:
    """A truck's rear, and 3 m further on its axle: at first both, then the axle alone."""
    fed = HandFed()
    identity, xs = None, []
    for k, t in enumerate(times(0, 80)):
        rear, axle = car(1, t, 40.0), car(2, t, 43.0, 0.3)
        told = fed.scan(t, [rear, axle] if k < 40 else [axle])
        assert len(told) == 1
        identity = identity or int(told.id[0])
        assert told.id[0] == identity
        if k < 40:
            assert told.used_row.tolist() == [0, 0]
        xs.append(place(told, identity)[0] - 20.0 * t)
    assert xs[39] == pytest.approx(40.0, abs=0.05)
    steps = np.abs(np.diff(xs))
    assert steps[38:44].max() < 0.1  # from the last scan of both until the axle leads and on
    assert steps.max() < 0.1
    assert 40.5 < xs[-1] < 43.0  # on its way to the reflection that leads
    assert told.state[0] == CONFIRMED


def test_a_reflection_that_drives_off_gets_an_identity_of_its_own() -> None:
    fed = HandFed()
    for t in times(0, 20):
        told = fed.scan(t, [car(1, t, 40.0), car(2, t, 43.0, 0.8)])
    assert len(told) == 1
    first = int(told.id[0])
    for t in times(20, 80):
        moved = 20 * t + 1.5 * (t - 1) ** 2
        told = fed.scan(t, [car(1, t, 40.0), Seen(2, 43.0 + moved, 0.8, 20.0 + 3 * (t - 1))])
        assert first in told.id.tolist()
    assert states(told) == {first: CONFIRMED, first + 1: CONFIRMED}
    assert place(told, first) == pytest.approx((40 + 20 * t, 0.0), abs=0.2)
    assert place(told, first + 1)[0] == pytest.approx(43 + moved, abs=0.3)


def test_two_that_turn_out_to_be_one_keep_the_older_identity() -> None:
    """Two points come together from 4 m apart sideways and then stay: a vehicle seen at an angle."""
    fed = HandFed()
    for k, t in enumerate(times(0, 120)):
        apart = max(4.0 - 0.06 * k, 0.4)
        sideways = -1.2 if apart > 0.4 else 0.0
        told = fed.scan(t, [car(1, t, 40.0), Seen(2, 41.0 + 20 * t, apart, 20.0, sideways)])
        if k == 20:
            assert len(told) == 2
            first = int(told.id.min())
    assert states(told) == {first: CONFIRMED}
    assert fed.tracker.counts.merged == 1
    assert told.used_row.tolist() == [0, 0]


def test_two_lanes_stay_two_vehicles() -> None:
    fed = HandFed()
    for t in times(0, 100):
        told = fed.scan(t, [car(1, t, 40.0), car(2, t, 40.0, 3.5), car(3, t, 52.0)])
    assert len(told) == 3
    assert fed.tracker.counts.merged == 0


def test_three_that_come_together_at_once_become_one() -> None:
    """The second is beside the first and the third beside the second for equally long; the third waits its turn."""
    fed = HandFed()
    for k, t in enumerate(times(0, 140)):
        apart, sideways = (4.0 - 0.06 * k, -1.2) if k < 55 else (0.7, 0.0)
        row = [(40.0 + 3 * i + 20 * t, i * apart, i * sideways) for i in range(3)]
        told = fed.scan(t, [Seen(i, x, y, 20.0, vy) for i, (x, y, vy) in enumerate(row)])
        assert_sane(told)
        if k == 20:
            first = int(told.id.min())
            assert len(told) == 3
    assert states(told) == {first: CONFIRMED}
    assert fed.tracker.counts.merged == 2
    assert told.used_row.tolist() == [0, 0, 0]


def test_no_vehicle_is_longer_than_the_extent() -> None:
    """Eleven points in a row 3 m apart, as a guard rail's, all in one scan: no more than 14 m of them are one."""
    fed = HandFed(reflections={"extent": 14.0})
    told = fed.scan(0.0, [Seen(k, 30.0 + 3.0 * k, 0.0) for k in range(11)])
    assert told.used_row.tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2]
    for t in times(1, 20):
        told = fed.scan(t, [Seen(k, 30.0 + 3.0 * k, 0.0) for k in range(11)])
    assert len(told) == 3
