"""Smoothed obstacles, cycle by cycle: chains that last as identities do, through crossing scans, groups and gaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.smoothing import Smoothed
from candaemon.pipeline.cycle import Cycle
from candaemon.playback.cycle_smoothing import CycleSmoother
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import MOTION, Obstacles, concatenated, no_obstacles
from candaemon.tracking.smoother_history import swing_of, with_motion
from candaemon.tracking.tracker import Tracker
from tests.support.builders import CYCLE, HandFed, HandFedVehicles, Seen, assert_sane, ns, pose, times
from tests.support.effort import examples

Pairs = list[tuple[Obstacles, Obstacles]]

SECOND = 1_000_000_000
SPEED, FIRST = 20.0, 30.0
"""m/s and m: a car drives away from us."""
SECOND_GROUP = 1000
"""Identities of the second group are greater."""


def car(rng: np.random.Generator, time: float, y: float = 0.0) -> Seen:
    """See the car; its place is known to 0.3 m, its range rate not at all."""
    noise = rng.normal(size=2) * 0.3
    return Seen(0, FIRST + SPEED * time + noise[0], y + noise[1], SPEED, rated=False)


def hand_fed(identities: Identities | None = None) -> HandFed:
    return HandFed(noise=(0.3, 0.3, 0.1), identities=identities)


def cycle_of(told: Obstacles) -> Cycle:
    return Cycle(told.time_ns, told, [], pose(told.time_ns * 1e-9), None, None)


def smoothed(trackers: Sequence[Tracker], told: Iterator[Obstacles], lag: float = 1.0) -> Pairs:
    """Smooth what trackers tell, step by step; return what they told, if anything, and what became of it."""
    smoother, before, after = CycleSmoother(trackers, lag), list[Obstacles](), list[Obstacles]()
    for obstacles in told:
        if len(obstacles):
            before.append(obstacles)
        after += [cycle.obstacles for cycle in smoother.add(cycle_of(obstacles))]
    after += [cycle.obstacles for cycle in smoother.finish()]
    return list(zip(before, after, strict=True))


def errors(pairs: Pairs) -> Floats:
    """Return RMS errors of the car's place and speed, filtered and smoothed (2, 2), after its first second."""
    late = [pair for pair in pairs if pair[0].time_ns > SECOND]
    truth = FIRST + SPEED * np.array([pair[0].time_ns * 1e-9 for pair in late])
    places, speeds = ([[getattr(each, name)[0] for each in pair] for pair in late] for name in ("x", "vx"))
    return np.sqrt(
        [np.square(np.array(places).T - truth).mean(axis=1), np.square(np.array(speeds).T - SPEED).mean(axis=1)]
    ).T


SCANS = st.lists(
    st.tuples(
        st.sampled_from((-0.1, 0.0, 0.05, 0.05, 0.3, 5.0)),
        st.integers(0, 1),
        st.lists(st.builds(Seen, st.integers(0, 5), st.floats(-200, 200), st.floats(-200, 200)), max_size=5),
    ),
    max_size=20,
)


@settings(deadline=None, max_examples=examples(40))
@given(scans=SCANS, kind=st.sampled_from(("imm", "cs", "information")), lag=st.sampled_from((0.03, 0.5, 10.0)))
def test_any_detections_leave_it_sane(scans: list[tuple[float, int, list[Seen]]], kind: str, lag: float) -> None:
    fed = HandFed(estimator={"kind": kind}, max_tracks=12)
    instants = 10.0 + np.cumsum([dt for dt, _, _ in scans])
    told = (fed.scan(at, seen, sensor=k) for at, (_, k, seen) in zip(instants, scans, strict=True))
    for before, after in smoothed([fed.tracker], told, lag):
        assert_sane(after)
        assert after.id.tolist() == before.id.tolist()


def test_what_nothing_was_learnt_of_is_told_as_before() -> None:
    """A trail's own states, told again in a vehicle that turns, are what the tracker told."""
    fed = hand_fed()
    fed.tracker.keep_smoother_history()
    for t in times(1, 20):
        ego = pose(t, east=5.0 * t, north=-2.0, heading=0.7 + 0.1 * t)
        told = fed.scan(t, [Seen(0, 30.0 + 20 * t, 2 * t, 20.0, 2.0), Seen(1, 5.0, 60.0 - 5 * t, 0.0, -5.0)], ego=ego)
        trail = fed.tracker.smoother_history
        assert trail is not None
        swing = swing_of(trail, told)
        again = with_motion(told, Smoothed(ego.time_ns, trail.id, trail.state, trail.covariance), ego, swing)
        for name in MOTION:
            np.testing.assert_allclose(getattr(again, name), getattr(told, name), atol=1e-9, err_msg=name)


def test_the_trail_of_what_turns_is_told_with_the_velocity_of_its_reference_point() -> None:
    """A car with a known box goes round a bend of 14 m, and stops: what stands does not turn."""
    fed, turn, swung = HandFedVehicles(), 0.5, 0.0
    fed.tracker.keep_smoother_history()
    for t in times(1, 160):
        yaw, speed = turn * min(t, 4.0), 7.0 if t < 4.0 else 0.0
        ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        centre = np.array([25.0, -8.0]) + 14.0 * np.array([np.sin(yaw), 1.0 - np.cos(yaw)])
        rate = turn if t < 4.0 else 0.0
        ends = [Seen(k, *(centre + arm * ahead), *(speed * ahead + arm * rate * left)) for k, arm in enumerate((-2, 2))]
        told = fed.scan(t, ends, length=np.full(2, 4.8), width=np.full(2, 1.9))
        trail = fed.tracker.smoother_history
        assert trail is not None
        swing, ego = swing_of(trail, told), pose(t)
        again = with_motion(told, Smoothed(ego.time_ns, trail.id, trail.state, trail.covariance), ego, swing)
        np.testing.assert_allclose([again.vx, again.vy], [told.vx, told.vy], atol=1e-9)
        if 2.0 < t < 4.0:
            swung = max(swung, float(np.hypot(*swing[0])))
        if t > 5.0:
            assert np.hypot(*swing[0]) < 0.05
    assert swung > 0.5


def test_a_trail_has_the_gain_of_the_reflection_that_leads() -> None:
    fed = hand_fed()
    fed.tracker.keep_smoother_history()
    pairs = [Seen(key, 30.0 + 60 * (key // 2) + 2 * (key % 2), 0.0) for key in range(4)]
    for t in times(1, 20):
        fed.scan(t, pairs if t < 0.8 else [pairs[0], *pairs[2:]])
    population, trail = fed.tracker._tracks, fed.tracker.smoother_history
    assert trail is not None
    assert population.estimator.link is not None
    assert len(trail.linked) < len(population.reflections)
    assert population.obstacles.leader.tolist() == [0, 2]
    np.testing.assert_array_equal(trail.link.gain, population.estimator.link.gain[[0, 2]])
    assert (trail.link.gain[1] != population.estimator.link.gain[1]).any()


def test_scans_that_cross_do_not_break_a_chain() -> None:
    """A second sensor's scans come after the first one's and tell of a little earlier."""
    fed, rng = hand_fed(), np.random.default_rng(4)
    instants = [at for t in times(1, 160) for at in (t, t - 0.6 * CYCLE)]
    told = (fed.scan(at, [car(rng, at)], sensor=k % 2) for k, at in enumerate(instants))
    pairs = smoothed([fed.tracker], told)
    assert [after.time_ns for _, after in pairs] == [ns(at) for at in instants]
    assert {tuple(after.id) for _, after in pairs} == {(1,)}
    filtered, better = errors(pairs)
    assert (better < 0.7 * filtered).all()


def test_a_cycle_without_own_motion_does_not_break_a_chain() -> None:
    def drive(gaps: bool) -> Pairs:
        fed, rng = hand_fed(), np.random.default_rng(5)

        def told() -> Iterator[Obstacles]:
            for k, t in enumerate(times(1, 60)):
                yield fed.scan(t, [car(rng, t)])
                if gaps and k % 10 == 0:
                    yield no_obstacles(ns(t) + 1)

        return smoothed([fed.tracker], told())

    for (_, with_gaps), (_, without) in zip(drive(True), drive(False), strict=True):
        for name in MOTION:
            np.testing.assert_array_equal(getattr(with_gaps, name), getattr(without, name))


def test_groups_are_smoothed_as_each_alone() -> None:
    def drive(*wanted: int) -> Pairs:
        identities = Identities(), Identities(SECOND_GROUP)
        groups, rngs = [hand_fed(identities[k]) for k in wanted], [np.random.default_rng(k) for k in wanted]

        def told() -> Iterator[Obstacles]:
            for n, t in enumerate(times(1, 80)):
                # one group's scan a cycle; the other one coasts, and the second group's car comes and goes
                yield concatenated(
                    [
                        fed.scan(t, [car(rng, t, 3.5 * k)] if k == 0 or 10 < n < 50 else [])
                        if n % 2 == k
                        else fed.coast(t)
                        for k, fed, rng in zip(wanted, groups, rngs, strict=True)
                    ]
                )

        return smoothed([fed.tracker for fed in groups], told())

    both = {after.time_ns: after for _, after in drive(0, 1)}
    for which in (0, 1):
        alone = drive(which)
        assert alone
        for _, after in alone:
            rows = np.flatnonzero((both[after.time_ns].id > SECOND_GROUP) == which)
            np.testing.assert_array_equal(both[after.time_ns].id[rows], after.id)
            for name in MOTION:
                np.testing.assert_allclose(getattr(both[after.time_ns], name)[rows], getattr(after, name), atol=1e-9)


@pytest.mark.parametrize("gap", [1.5, 3.0])
def test_a_chain_outlives_the_reflection_that_leads(gap: float) -> None:
    """The nearer of a car's two reflections is lost half way: the reference point stays, and so does the gain."""
    fed, rng = hand_fed(), np.random.default_rng(6)

    def told() -> Iterator[Obstacles]:
        for t in times(1, 160):
            rear = car(rng, t)
            front = replace(car(rng, t), key=1, x=rear.x + gap)
            yield fed.scan(t, [rear, front] if t < 4.0 else [front])

    pairs = smoothed([fed.tracker], told())
    for _, after in pairs:
        assert_sane(after)
    assert {tuple(after.id) for _, after in pairs[20:]} == {(1,)}
    filtered, better = errors(pairs)
    assert better[1] < 0.7 * filtered[1]
    steps = np.abs(np.diff([[each.x[0] for each in pair] for pair in pairs[20:]], axis=0) - SPEED * CYCLE)
    assert steps.max(axis=0)[1] < 0.6 * steps.max(axis=0)[0]
    # the second before the loss learns from the second after it, in which the reference point goes over to the other
    before = [pair for pair in pairs if 3.0 <= pair[0].time_ns * 1e-9 < 4.0]
    place, speed = errors(before)[1]
    assert place < errors(before)[0][0]
    assert place < 2.0 * np.mean([after.sx[0] for _, after in before])
    assert speed < errors(before)[0][1]
