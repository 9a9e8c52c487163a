"""When the switch changes its model, and that it tells the filter in force."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.estimation.axis_filter import AxisFilter, WhiteAxis
from candaemon.estimation.manoeuvre_detection import ManoeuvreWatch, SwitchRule
from candaemon.estimation.motion_models import CurrentStatistical
from candaemon.estimation.switching import CvCsmSwitch
from candaemon.papers.profiles import motion
from tests.support.long_runs import few_and_many_cycles

CV_NOISE, STATISTICAL = 0.1, CurrentStatistical(0.05, 3.0, 0.0)


def switch(tracks: int = 1, speed: float = 20.0, axes: int = 1, rule: SwitchRule | None = None) -> CvCsmSwitch:
    """Return tracks in the origin that travel along the first axis."""
    switch = CvCsmSwitch(axes, CV_NOISE, STATISTICAL, rule)
    mean = np.zeros((tracks, axes, 3))
    mean[:, 0, 1] = speed
    switch.spawn(mean, np.tile(np.eye(3), (tracks, axes, 1, 1)))
    return switch


def drive(switch: CvCsmSwitch, path: Floats, dt: float, deviation: float = 0.1) -> list[bool]:
    """Feed all tracks exact positions (steps, A); return what the first one holds after each step."""
    told = []
    for position in path:
        switch.predict(dt)
        switch.update(np.tile(position, (len(switch), 1)), deviation**2)
        told.append(bool(switch.manoeuvring[0]))
    return told


def along(acceleration: float, dt: float, seconds: float, speed: float = 20.0, start: float = 0.0) -> Floats:
    """Return exact positions (steps, 1) of a constant acceleration."""
    time = np.arange(1, round(seconds / dt) + 1) * dt
    path: Floats = (start + speed * time + acceleration * time**2 / 2)[:, None]
    return path


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.5, 1.0])
def test_a_steady_drive_takes_t2_and_a_manoeuvre_t1(dt: float) -> None:
    """Whatever the rate of the measurements."""
    tracks = switch()
    steady = drive(tracks, along(0.0, dt, 60.0), dt)
    assert steady == [True] * (round(20.0 / dt) - 1) + [False] * (round(40.0 / dt) + 1)
    braking = drive(tracks, along(-2.5, dt, 20.0, speed=20.0, start=1200.0), dt)
    delay = braking.index(True) * dt
    assert 9.0 <= delay <= 12.0  # ten comparisons in a row, the filter's own lag and the second in progress included
    assert all(braking[braking.index(True) :])


@pytest.mark.parametrize(
    ("dt", "jitter"), [(1.0, 0.001), (1.0, 0.2), (0.9, 0.0), (0.7, 0.05), (1.7, 0.1), (0.05, 0.01)]
)
def test_t1_and_t2_are_kept_to_a_sample_at_any_sampling(dt: float, jitter: float) -> None:
    """Real samples are neither even nor a whole number in an interval."""
    steps = dt + jitter * np.random.default_rng(5).uniform(-1.0, 1.0, round(75.0 / dt))
    watch, time = ManoeuvreWatch(1, SwitchRule()), np.cumsum(steps)
    velocity = 20.0 - 1.4 * np.maximum(time - 60.0, 0.0)
    watch.spawn(velocity[:1, None])
    told = []
    for step, speed in zip(steps, velocity, strict=True):
        watch.advance(step)
        watch.watch(np.array([0]), np.array([[speed]]))
        told.append(bool(watch.manoeuvring[0]))
    compared = max(dt, 1.0)  # s between two comparisons
    over = told.index(False)
    assert time[over] == pytest.approx(20.0, abs=0.6 * compared)
    assert time[told.index(True, over)] == pytest.approx(
        70.0, abs=1.6 * compared
    )  # a comparison is in progress at 60 s


def test_two_measurements_of_one_instant_are_one_comparison() -> None:
    watch = ManoeuvreWatch(1, SwitchRule(steady_time=4.0, interval=0.5))
    watch.spawn(np.array([[20.0]]))
    for k in range(1, 6):
        watch.advance(1.2)
        watch.watch(np.array([0]), np.array([[20.0]]))
        watch.watch(np.array([0]), np.array([[20.1]]))
        assert watch.manoeuvring[0] == (k < 4)


def test_a_clone_is_as_far_in_its_decision_as_its_original() -> None:
    watch = ManoeuvreWatch(1, SwitchRule())
    watch.spawn(np.array([[20.0], [5.0]]))
    for k in range(40):
        if k == 12:
            watch.keep(np.array([0, 1, 0, 1]))
        watch.advance(1.0)
        rows = np.arange(len(watch.manoeuvring))
        velocity = np.array([[20.0], [5.0 * 1.1**k]] * (len(rows) // 2))
        watch.watch(rows, velocity)
        if k >= 12:
            np.testing.assert_array_equal(watch.manoeuvring, [k < 19, True] * 2)


def test_what_is_told_of_the_decision_stays_as_it_was() -> None:
    tracks = switch()
    before = tracks.manoeuvring
    drive(tracks, along(0.0, 1.0, 30.0), 1.0)
    assert before.all()
    assert not tracks.manoeuvring.any()


def test_what_is_slower_than_the_threshold_is_no_manoeuvre() -> None:
    """The trap of the paper's test 1: |a| T below 5 % of the speed."""
    tracks = switch()
    drive(tracks, along(0.0, 1.0, 30.0), 1.0)
    assert not any(drive(tracks, along(0.8, 1.0, 60.0, start=600.0), 1.0))


def test_a_change_that_does_not_last_is_no_manoeuvre() -> None:
    tracks = switch()
    drive(tracks, along(0.0, 1.0, 30.0), 1.0)
    brief = drive(tracks, along(2.0, 1.0, 6.0, start=600.0), 1.0)
    after = drive(tracks, along(0.0, 1.0, 8.0, speed=32.0, start=756.0), 1.0)
    assert not any(brief + after)


def test_at_rest_the_least_change_decides() -> None:
    """5 % of no speed is no change at all; the paper's threshold alone takes noise at rest for manoeuvring."""
    noise = 0.05 * np.random.default_rng(1).normal(size=(120, 1))
    for least, told in ((0.0, True), (0.25, False)):
        tracks = switch(speed=0.0, rule=SwitchRule(least_change=least))
        assert drive(tracks, noise, 1.0, deviation=0.05)[-1] is told


def test_in_the_plane_a_turn_at_constant_speed_is_a_manoeuvre() -> None:
    tracks = switch(axes=2)
    straight = np.stack([20.0 * np.arange(1.0, 41.0), np.zeros(40)], axis=1)
    assert not drive(tracks, straight, 1.0)[-1]
    angle = 0.15 * np.arange(1.0, 21.0)
    circle = 20.0 / 0.15 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1) + (800.0, 0.0)
    assert drive(tracks, circle, 1.0)[-1]


def test_the_switch_reports_the_filter_in_force() -> None:
    rng, tracks = np.random.default_rng(2), switch()
    steady, manoeuvre = AxisFilter(WhiteAxis(1, CV_NOISE)), AxisFilter(STATISTICAL)
    first = np.array([[0.0, 20.0, 0.0]])
    steady.spawn(first[:, :2], np.eye(2)[None])
    manoeuvre.spawn(first, np.eye(3)[None])
    seen = set()
    for z in along(0.0, 1.0, 40.0) + 0.5 * rng.normal(size=(40, 1)):
        tracks.predict(1.0)
        tracks.update(z[None], 0.25)
        for each in (steady, manoeuvre):
            each.predict(1.0)
            each.update(z, 0.25)
        if tracks.manoeuvring[0]:
            np.testing.assert_array_equal(tracks.mean[:, 0], manoeuvre.mean)
            np.testing.assert_array_equal(tracks.covariance[:, 0], manoeuvre.covariance)
        else:
            np.testing.assert_array_equal(tracks.mean[0, 0], [*steady.mean[0], 0.0])
            np.testing.assert_array_equal(tracks.covariance[0, 0, :2, :2], steady.covariance[0])
            assert not tracks.covariance[0, 0, 2].any()
        seen.add(bool(tracks.manoeuvring[0]))
    assert seen == {True, False}


@pytest.mark.parametrize("axes", [1, 2])
def test_tracks_decide_each_for_itself(axes: int) -> None:
    """A batch in which tracks miss measurements, come and go is as its tracks alone."""
    rng, rule = np.random.default_rng(3), SwitchRule(manoeuvre_time=2.0, steady_time=4.0)
    batch, alone = switch(3, axes=axes, rule=rule), [switch(axes=axes, rule=rule) for _ in range(3)]
    accelerations = np.array([0.0, 3.0, -2.5])
    seen = set()
    for k in range(1, 81):
        time = 0.25 * k
        z = np.zeros((3, axes))
        z[:, 0] = 20.0 * time + accelerations * max(time - 8.0, 0.0) ** 2 / 2
        z += 0.1 * rng.normal(size=z.shape)
        rows = np.flatnonzero(rng.random(3) < 0.8)
        batch.predict(0.25)
        batch.update(z[rows], 0.01, rows)
        for row, each in enumerate(alone):
            each.predict(0.25)
            if row in rows:
                each.update(z[row : row + 1], 0.01)
        np.testing.assert_array_equal(batch.manoeuvring, [each.manoeuvring[0] for each in alone])
        seen.add(tuple(batch.manoeuvring.tolist()))
    np.testing.assert_allclose(batch.mean, np.concatenate([each.mean for each in alone]), rtol=1e-9, atol=1e-9)
    assert (False, False, False) in seen
    assert (False, True, True) in seen
    expected = batch.mean[[2, 0]]
    batch.keep(np.array([2, 0]))
    np.testing.assert_array_equal(batch.mean, expected)
    np.testing.assert_array_equal(batch.manoeuvring, [True, False])
    assert len(batch) == 2


def test_a_gap_is_one_comparison() -> None:
    tracks = switch()
    for _ in range(60):
        tracks.predict(1.0)
    tracks.update(np.array([[1200.0]]), 0.01)
    assert tracks.manoeuvring[0]


@few_and_many_cycles
def test_the_switch_stays_sound_over_many_cycles(cycles: int) -> None:
    rounds = cycles // 1_500
    pieces = ((25.0, 0.0), (12.5, 2.0), (25.0, 0.0), (12.5, -2.0)) * rounds
    truth = motion(0.05, pieces, ((cycles * 0.05, 0.0),), (20.0, 0.0))
    measured = truth.measured(0.5, 1, np.random.default_rng(4))
    tracks = switch(axes=2, rule=SwitchRule(manoeuvre_time=4.0, steady_time=8.0))
    told = []
    for k, z in enumerate(measured):
        tracks.predict(0.05)
        tracks.update(z, 0.25)
        told.append(bool(tracks.manoeuvring[0]))
        if k % 1_000 == 999:
            size = 3 if told[-1] else 2
            covariance = tracks.covariance[0, :, :size, :size]
            np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
            assert np.linalg.eigvalsh(covariance).min() > 0.0
            assert np.isfinite(tracks.mean).all()
    assert len(told) == cycles
    assert np.diff(told).sum() >= 2 * rounds  # to the manoeuvre and back in each
