"""The level frame's place on earth: smoothed fixes, refused ones, and what does not move."""

from __future__ import annotations

from math import cos, nan, pi, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.ego.geodesy import TangentPlane
from candaemon.ego.georeference import MOST_WAITING
from tests.support.builders import Circle, known, ns
from tests.support.effort import examples
from tests.support.gnss_drives import HOME, MOTION, PLACE, Drive, Ins, city

FILTERS = ("drift", "switching", "imm")
EAST = np.array([1.0, 0.0])


def told(kind: str, **more: Any) -> dict[str, Any]:
    return {"filter": {"kind": kind}} | more


def errors(ins: Ins, drive: Drive, **how: Any) -> float:
    """Return the RMS distance of own place from the truth at the fixes from 10 s on, m."""
    off = [found - drive.position[k] for k, found in ins.drive(drive, **how) if drive.time[k] >= 10.0]
    return float(np.sqrt(np.mean(np.sum(np.square(off), axis=1))))


@pytest.mark.parametrize("kind", FILTERS)
def test_a_noisy_track_is_smoothed(kind: str) -> None:
    """Fixes of 8 m a second apart, as in paper 003: raw, they are 11.3 m off in the plane."""
    drive = city(150.0)
    reached = [
        errors(Ins(told(kind, noise=8.0)), drive, period=1.0, noise=8.0, speed_noise=0.05, seed=seed)
        for seed in range(4)
    ]
    assert np.mean(reached) < {"drift": 2.3, "switching": 8.6, "imm": 8.2}[kind]
    assert max(reached) < 0.9 * 8.0 * sqrt(2)


def test_with_a_poor_velocity_the_fixes_alone_do_better_than_the_drift() -> None:
    drive = city(150.0)
    lame = Drive(drive.time, drive.position, drive.velocity * 0.93, drive.heading, drive.yaw_rate)
    by = {kind: errors(Ins(told(kind, noise=8.0)), lame, period=1.0, noise=8.0, seed=3) for kind in FILTERS}
    assert max(by["imm"], by["switching"]) < 8.0 * sqrt(2) < by["drift"]


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("period", [0.01, 0.05, 0.2, 1.0])
def test_fixes_of_any_rate_from_a_lever_arm_place_the_rear_axle(kind: str, period: float) -> None:
    """Exact fixes of an INS ahead of the axle and to its side, on a circle at 1.4 m/s² across."""
    arm, circle = np.array([1.9, -0.6]), Circle(14.0, 0.1, radians(70.0))
    ins = Ins(told(kind), (1.9, -0.6))
    off, step = [], min(period, 0.05)
    for k in range(round(12.0 / step)):
        time, heading = k * step, circle.heading(k * step)
        turned = np.array([[cos(heading), -sin(heading)], [sin(heading), cos(heading)]]) @ arm
        if k % round(period / step) == 0:
            ins.fix(time, circle.position(time) + turned)
        ins.move(time, circle.velocity(time) + 0.1 * np.array([-turned[1], turned[0]]), heading, 0.1)
        off.append(np.hypot(*(ins.place(time) - circle.position(time))))
    assert off[0] < 1e-3
    assert max(off[len(off) // 2 :]) < {"drift": 0.01, "switching": 0.5, "imm": 0.5}[kind]
    assert ins.placer.counts.rejected == 0


def test_a_fix_that_jumps_moves_neither_the_frame_nor_its_place() -> None:
    ins = Ins(told("drift"))
    for k in range(200):
        time = 0.05 * k
        ins.fix(time, 10.0 * time * EAST + (50.0 if 100 <= k < 120 else 0.0))
        ins.move(time, 10.0 * EAST)
        assert known(ins.motion.pose(ns(time))).east == pytest.approx(10.0 * time)
        np.testing.assert_allclose(ins.place(time), 10.0 * time * EAST, atol=1e-3)
    assert ins.placer.counts.rejected == 20
    assert ins.placer.counts.innovation_rms < 1e-3


@pytest.mark.parametrize("kind", FILTERS)
def test_fixes_that_stay_elsewhere_are_believed_in_the_end(kind: str) -> None:
    ins = Ins(told(kind, reacquire=3.0))
    moved = np.array([0.0, 400.0])
    for k in range(600):
        time = 0.05 * k
        there = time > 10.0 and not k % 2  # a good fix between two bad ones starts the time anew
        if k >= 400:
            there = True
        ins.fix(time, 10.0 * time * EAST + (moved if there else 0.0))
        ins.move(time, 10.0 * EAST)
        if not 22.9 < time < 23.1:
            expected = 10.0 * time * EAST + (moved if time > 23.0 else 0.0)
            np.testing.assert_allclose(ins.place(time), expected, atol=0.2)
    assert ins.placer.counts.restarts == 1


@pytest.mark.parametrize("valid_first", [True, False])
def test_fixes_of_an_invalid_solution_are_not_used(valid_first: bool) -> None:
    """Whichever of the burst's frames comes first."""
    ins = Ins(told("drift", gate=1e6), gated=True)
    for k in range(200):
        time, valid = 0.05 * k, not 100 <= k < 150
        if valid_first:
            ins.tell(time, ("valid",), (float(valid),))
        ins.fix(time, 10.0 * time * EAST + (0.0 if valid else 300.0))
        if not valid_first:
            ins.tell(time, ("valid",), (float(valid),))
        ins.move(time, 10.0 * EAST)
        np.testing.assert_allclose(ins.place(time), 10.0 * time * EAST, atol=1e-3)
    # a solution that is good again is known so only after the fix that comes before the word
    assert ins.placer.counts.invalid == (50 if valid_first else 51)
    assert ins.placer.counts.fixes == 200


def test_after_own_motion_was_lost_the_next_fix_is_believed() -> None:
    """Ten seconds without a frame, braked and turned in meanwhile: the level frame has gone on elsewhere."""
    ins = Ins(told("drift"))
    for k in range(200):
        ins.fix(0.05 * k, 20.0 * 0.05 * k * EAST)
        ins.move(0.05 * k, 20.0 * EAST)
    truth = np.array([250.0, 35.0])
    level = known(ins.motion.pose(ns(19.95)))
    for k in range(400, 420):
        ins.fix(0.05 * k, truth)
        ins.move(0.05 * k, np.zeros(2))
        np.testing.assert_allclose(ins.place(0.05 * k), truth, atol=0.1)
    assert ins.placer.counts.rejected == 0
    assert known(ins.motion.pose(ns(20.0))).east == pytest.approx(level.east, abs=2.0)


def test_latitude_and_longitude_of_two_frames_belong_together_or_not_at_all() -> None:
    ins, home = Ins(told("drift", gate=1e6)), TangentPlane(*HOME)
    for k in range(200):
        time = 0.05 * k
        latitude, longitude = home.to_earth(30.0 * time * EAST[:1], 30.0 * time * EAST[:1])
        if k % 10 != 4:
            ins.tell(time, ("latitude",), (float(latitude[0]),))
        if k % 10 != 7:
            ins.tell(time + 0.001, ("longitude",), (float(longitude[0]),))
        ins.move(time + 0.002, np.array([30.0, 30.0]))
        if k:
            np.testing.assert_allclose(ins.place(time), 30.0 * time * np.ones(2), atol=0.1)
    assert ins.placer.counts.fixes == 160


def test_a_pair_that_waited_costs_no_fix_after_it() -> None:
    ins, home = Ins(told("drift", gate=1e6)), TangentPlane(*HOME)
    for k in range(1000):
        time = 0.01 * k + 0.008 * (k == 500)
        latitude, longitude = home.to_earth(30.0 * time * EAST[:1], 30.0 * time * EAST[:1])
        ins.tell(time, ("latitude",), (float(latitude[0]),))
        if k % 100 != 50:
            ins.tell(time + 0.0015, ("longitude",), (float(longitude[0]),))
        ins.move(time + 0.0018, np.array([30.0, 30.0]))
    counts = ins.placer.counts
    assert (counts.fixes, counts.incomplete) == (990, 10)


def test_a_latitude_that_the_multiplexer_left_out_makes_no_fix() -> None:
    ins = Ins()
    ins.move(0.0, EAST)
    ins.tell(0.0, PLACE, (nan, 0.3))
    assert ins.placer.counts.fixes == 0
    assert ins.placer.at(0) is None


def test_a_fix_waits_for_own_motion_of_its_instant() -> None:
    ins = Ins()
    ins.fix(0.0, np.zeros(2))
    assert ins.placer.at(0) is None
    ins.move(0.0, 10.0 * EAST)
    before = ins.placer.at(0)
    assert before is not None
    ins.fix(1.0, np.array([10.3, 0.0]))
    assert ins.placer.at(0) is before
    ins.move(1.0, 10.0 * EAST)
    assert ins.placer.at(0) is not before
    assert ins.placer.counts.compared == 1


def test_fixes_without_own_motion_are_counted_and_bounded() -> None:
    ins = Ins()
    for k in range(3 * MOST_WAITING):
        ins.fix(0.01 * k, np.zeros(2))
    assert len(ins.placer.state.waiting) == MOST_WAITING
    ins.move(100.0, EAST)
    assert ins.placer.at(ns(100.0)) is None
    assert ins.placer.counts.unplaced == ins.placer.counts.fixes


def test_what_is_no_place_on_earth_is_not_used() -> None:
    ins = Ins()
    for k in range(10):
        ins.tell(0.05 * k, PLACE, (radians(-214.7483648), radians(-214.7483648)))
        ins.move(0.05 * k, EAST)
    assert ins.placer.at(ns(0.45)) is None
    assert ins.placer.counts.invalid == 10


def test_an_old_place_is_no_longer_known() -> None:
    ins = Ins({"hold": 7.0})
    ins.fix(0.0, np.zeros(2))
    for k in range(200):
        ins.move(0.05 * k, 10.0 * EAST)
        assert (ins.placer.at(ns(0.05 * k)) is not None) == (k <= 140)


@pytest.mark.parametrize("kind", FILTERS)
def test_far_from_home_the_place_is_as_good(kind: str) -> None:
    """Northeast at 62° for 30 km, along earth's own curves."""
    ins = Ins(told(kind), age_limit=2.0)
    latitude, longitude, speed = radians(62.0), radians(25.0), 30.0
    squared, step = 0.0066943799901413, 0.5
    off = []
    for k in range(1400):
        time = step * k
        ins.tell(time, PLACE, (latitude, longitude))
        ins.tell(time, MOTION, (speed, speed, pi / 4, 0.0))
        here, pose = ins.placer.at(ns(time)), known(ins.motion.pose(ns(time)))
        assert here is not None
        found = here.to_earth(np.array([pose.east]), np.array([pose.north]))
        off.append(np.hypot(*TangentPlane(latitude, longitude).project(float(found[0][0]), float(found[1][0]))))
        for _ in range(10):
            curve = sqrt(1 - squared * sin(latitude) ** 2)
            latitude += speed * step / 10 / (6_378_137.0 * (1 - squared) / curve**3)
            longitude += speed * step / 10 / (6_378_137.0 / curve * cos(latitude))
    assert max(off) < {"drift": 0.01, "switching": 0.3, "imm": 0.3}[kind]
    assert ins.placer.counts.rejected == ins.placer.counts.restarts == 0


@pytest.mark.parametrize("kind", ["switching", "imm"])
def test_far_from_home_the_filter_keeps_what_it_knows(kind: str) -> None:
    """An INS that tells a fifth too little speed, 60 km eastwards: the filter found out on the first of them."""
    ins, equator, step, speed = Ins(told(kind, gate=1e6)), 6_378_137.0, 0.5, 60.0
    off = []
    for k in range(2000):
        time, longitude = step * k, speed * step * k / equator
        ins.tell(time, PLACE, (0.0, longitude))
        ins.move(time, 0.8 * speed * EAST)
        at, pose = ins.placer.at(ns(time)), known(ins.motion.pose(ns(time)))
        assert at is not None
        found = at.to_earth(np.array([pose.east]), np.array([pose.north]))
        off.append(abs(float(found[1][0]) - longitude) * equator)
    assert max(off[:20]) > 0.5
    assert max(off[200:]) < 1e-3


@settings(deadline=None, max_examples=examples(20))
@given(
    kind=st.sampled_from(FILTERS),
    steps=st.lists(st.tuples(st.sampled_from([0.01, 0.05, 0.31, 1.0, 2.5]), st.booleans()), min_size=5, max_size=60),
    seed=st.integers(0, 1000),
)
def test_the_reported_deviation_covers_the_position_error_after_any_outage(
    kind: str, steps: list[tuple[float, bool]], seed: int
) -> None:
    ins, random, time = Ins(told(kind, noise=3.0), age_limit=3.0), np.random.default_rng(seed), 0.0
    # each model knows the place no worse than a fix does, but after an outage the models of an IMM may disagree on it
    most = 6.0 if kind == "imm" else 3.1
    for dt, fixed in steps:
        time += dt
        truth = np.array([12.0, -5.0]) * time
        if fixed:
            ins.fix(time, truth + 3.0 * random.normal(size=2))
        ins.move(time, np.array([12.0, -5.0]))
        at = ins.placer.at(ns(time))
        if at is not None:
            assert 0.0 < at.deviation < most
            assert np.abs(ins.place(time) - truth).max() < 6.0 * at.deviation + 0.1


def test_a_place_there_and_back() -> None:
    ins = Ins()
    ins.fix(0.0, np.array([100.0, -40.0]))
    ins.move(0.0, EAST)
    at = ins.placer.at(0)
    assert at is not None
    east, north = np.array([0.0, 250.0, -3.0]), np.array([0.0, -80.0, 1.0])
    back_east, back_north = at.plane.project(*at.to_earth(east, north))
    np.testing.assert_allclose([back_east + at.east, back_north + at.north], [east, north], atol=1e-6)
