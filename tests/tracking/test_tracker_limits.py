"""Crowds, clutter, long runs and any detections at all: the tracker stays bounded and sane."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.builders import CYCLE, HandFed, Seen, assert_sane, car, ns, times
from tests.support.effort import examples

POINT = st.one_of(
    st.builds(
        Seen,
        st.integers(0, 7),
        st.floats(-300, 300),
        st.floats(-300, 300),
        st.floats(-80, 80),
        st.floats(-80, 80),
        st.booleans(),
        st.booleans(),
    ),
    st.builds(Seen, st.integers(0, 7), st.sampled_from((0.0, 30.0, 31.0, 33.0)), st.sampled_from((0.0, 0.5, 2.0))),
)
STEPS = st.lists(
    st.tuples(
        st.sampled_from((-0.1, 0.0, 1e-6, 0.05, 0.05, 0.05, 0.3, 5.0)), st.integers(0, 1), st.lists(POINT, max_size=6)
    ),
    max_size=25,
)


def test_clutter_is_not_confirmed() -> None:
    fed, rng = HandFed(), np.random.default_rng(3)
    for t in times(0, 400):
        points = zip(rng.uniform(5, 150, 4), rng.uniform(-15, 15, 4), rng.uniform(-30, 30, 4), strict=True)
        fed.scan(t, [Seen(i, x, y, v) for i, (x, y, v) in enumerate(points)])
    counts = fed.tracker.counts
    assert counts.obstacles > 1000
    assert counts.confirmed <= 1


def test_identities_are_never_used_again() -> None:
    fed, rng, latest, alive = HandFed(), np.random.default_rng(4), 0, set[int]()
    for t in times(0, 300):
        cars = [car(k, t % 3.0, 30.0 + 15 * k, 3.5 * (k % 3 - 1)) for k in range(6) if rng.random() < 0.7]
        now = set(fed.scan(t, cars).id.tolist())
        assert all(identity > latest for identity in now - alive)
        latest, alive = max(now | {latest}), now
    assert latest > 12


def test_what_does_not_fit_is_counted_and_dropped() -> None:
    fed = HandFed(max_tracks=4)
    crowd = [Seen(k, 30.0 + 20 * k, 0.0) for k in range(6)]
    told = fed.scan(0.0, crowd)
    assert len(told) == 4
    assert fed.tracker.counts.crowded == 2
    told = fed.scan(0.05, crowd)
    assert len(told) == 4
    assert (fed.tracker.counts.crowded, fed.tracker.counts.used, fed.tracker.counts.detections) == (4, 8, 12)


@settings(deadline=None, max_examples=examples(80))
@given(steps=STEPS, method=st.sampled_from(("nearest", "id")), merge=st.booleans(), kind=st.sampled_from(("imm", "cs")))
def test_any_detections_leave_it_sane(
    steps: list[tuple[float, int, list[Seen]]], method: str, merge: bool, kind: str
) -> None:
    fed = HandFed(max_tracks=20, association={"method": method}, reflections={"merge": merge}, estimator={"kind": kind})
    t, used = 10.0, 0
    for dt, sensor, seen in steps:
        t += dt
        told = fed.scan(t, seen, sensor=sensor)
        assert_sane(told)
        assert len(told) <= 20
        assert told.time_ns == ns(t)
        assert len(told.used_row) <= len(seen)
        used += len(seen)
    assert fed.tracker.counts.detections == used
    assert fed.tracker.counts.used + fed.tracker.counts.crowded <= used


@pytest.mark.slow
def test_minutes_of_traffic_stay_bounded() -> None:
    """Vehicles come and go at random, slots are handed on: neither tracks nor tables grow."""
    fed, rng = HandFed(), np.random.default_rng(9)
    cars: dict[int, Seen] = {}
    for k, t in enumerate(times(0, 3000)):
        for slot in range(8):
            if slot not in cars or rng.random() < 0.01:
                lane, speed = rng.integers(-1, 2) * 3.5, rng.uniform(-10, 30)
                cars[slot] = Seen(slot, rng.uniform(10, 120), lane, speed, new=True)
        told = fed.scan(t, [each for each in cars.values() if rng.random() < 0.9])
        cars = {
            slot: Seen(slot, each.x + CYCLE * each.vx, each.y, each.vx)
            for slot, each in cars.items()
            if 5 < each.x < 150
        }
        if k % 100 == 0:
            assert_sane(told)
        assert len(told) < 40
    population = fed.tracker._tracks
    assert len(population.row_of) <= len(population.reflections) == len(population.estimator)
    assert all(a < b for a, b in pairwise(told.id.tolist()))
