"""The MLKF of tracks: the radial filter of the papers along the line of sight, and honest in the plane."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from math import radians
from typing import TypeAlias

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.stats import chi2

from candaemon.arrays import Floats
from candaemon.config.estimators import EstimatorSettings
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.radial import ModifiedLinearKalman, radial
from candaemon.estimation.radial_tracks import RadialTracks
from candaemon.estimation.smoothing import Step, smooth
from candaemon.estimation.trilateration import trilaterate
from candaemon.papers.automotive_set import DRIVES
from candaemon.tracking.estimator_factory import make_estimator
from tests.support.builders import AT_REST, polar_measurement, rotation

Noise: TypeAlias = tuple[float, float, float]

DT = 0.05
NOISE: Noise = (0.25, radians(0.5), 0.12)
ANYWHERE = np.array([[1.0, 0.0]])


def estimator(kind: str) -> FilterBank:
    settings: EstimatorSettings = TypeAdapter(EstimatorSettings).validate_python({"kind": kind})
    return make_estimator(settings)


def tracks(floor: float = 1.0) -> RadialTracks:
    return RadialTracks(floor=floor, noise=5.0, acceleration=3.0)


def spawned(bank: RadialTracks, position: Floats) -> RadialTracks:
    spread = np.tile(np.eye(2), (len(position), 1, 1))
    bank.spawn(position, spread, np.zeros((len(position), 2)), 400.0 * spread)
    return bank


def seen(rng: np.random.Generator, offset: Floats, velocity: Floats, noise: Noise = NOISE) -> Measurement:
    """Return what a radar at rest in the origin measures of places (n, 2) that move with velocities (n, 2)."""
    distance = np.hypot(*offset.T)
    exact = distance, np.arctan2(offset[:, 1], offset[:, 0]), (offset * velocity).sum(axis=1) / distance
    drawn = [each + s * rng.normal(size=len(offset)) for each, s in zip(exact, noise, strict=True)]
    return polar_measurement(drawn[0], drawn[1], drawn[2], noise)


def begin(bank: FilterBank, told: Measurement) -> None:
    """Begin tracks of which no speed is known."""
    runs = len(told.position)
    bank.spawn(told.position, told.noise, np.zeros((runs, 2)), np.tile(64.0 * np.eye(2), (runs, 1, 1)))


def squared_in_deviations(bank: FilterBank, truth: Floats) -> Floats:
    """Return the normalised estimation error squared of [x, y, vx, vy] (n,)."""
    mean, covariance = bank.combined()
    error = mean[:, :4] - truth
    return np.asarray((error * np.linalg.solve(covariance[:, :4, :4], error[..., None])[..., 0]).sum(axis=1))


@pytest.mark.parametrize("floor", [0.1, 1.0])
@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
def test_along_a_line_of_sight_it_is_the_mlkf_of_the_papers(angle: float, floor: float) -> None:
    """The sensor drives behind the target on one line; what it measures is relative, sometimes without range rate."""
    rng = np.random.default_rng(2)
    turn, own = rotation(angle), 15.0
    line = turn[:, 0]
    bank, mlkf = tracks(floor), ModifiedLinearKalman(floor=floor)
    bank.spawn((40.0 * line)[None], np.eye(2)[None], (own * line)[None], 4.0 * np.eye(2)[None])
    mlkf.spawn(np.array([[40.0, 0.0, 0.0]]), np.diag([1.0, 4.0, 9.0]))
    variance, row = np.array([NOISE[0] ** 2, NOISE[2] ** 2, 1.0]), np.arange(1)
    noise = turn @ np.diag([NOISE[0] ** 2, 0.3**2]) @ turn.T
    for k in range(200):
        distance, rate = 40.0 + NOISE[0] * rng.normal(), NOISE[2] * rng.normal() if rng.random() < 0.8 else np.nan
        origin = own * k * DT * line
        if k:
            bank.predict(DT, ANYWHERE)
            mlkf.predict(DT)
        told = Measurement(
            (origin + distance * line)[None],
            noise[None],
            origin,
            own * line,
            np.array([rate]),
            variance[1:2],
        )
        nis = bank.update(row, told)
        fit = mlkf.update(row, np.array([[distance, rate, np.nan]]), variance)
        np.testing.assert_allclose(nis, fit.nis, rtol=1e-6, atol=1e-9)
    mean, covariance = (each[0] for each in bank.combined())
    along = mean.reshape(3, 2) @ line - own * np.array([k * DT, 1.0, 0.0])
    axis = np.kron(np.eye(3), line)
    np.testing.assert_allclose(along, mlkf.mean[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(axis @ covariance @ axis.T, mlkf.covariance[0], rtol=1e-9, atol=1e-9)


def test_two_range_rates_determine_the_velocity_as_trilateration_does() -> None:
    sensors = np.array([(3.6, 0.8), (-1.0, -0.8)])
    target = np.array([[12.0, 9.0, -4.0, 6.0, 0.0, 0.0]])
    seen = radial(target, sensors)
    bank = spawned(tracks(), target[:, :2])
    for origin, rate in zip(sensors, seen[0, :, 1], strict=True):
        told = Measurement(target[:, :2], 1e-8 * np.eye(2)[None], origin, AT_REST, rate * np.ones(1), np.full(1, 1e-8))
        bank.update(np.arange(1), told)
    expected = trilaterate(seen, np.diag([1e-4, 1e-4, 1.0]), sensors, np.array([0.0, 1.0]))
    np.testing.assert_allclose(bank.combined()[0][:, 2:4], expected.state[:, 2:4], atol=1e-3)
    np.testing.assert_allclose(bank.combined()[0][:, 2:4], target[:, 2:4], atol=1e-3)


def test_a_second_radar_tells_the_motion_across() -> None:
    """Both radars tell the azimuth to 5° only; the second stands at the side."""
    rng, runs, velocity = np.random.default_rng(3), 40, np.array([-2.0, 1.0])
    off = {}
    for sensors in (np.zeros((1, 2)), np.array([(0.0, 0.0), (10.0, 20.0)])):
        place = np.tile([30.0, 5.0], (runs, 1))
        bank = spawned(tracks(), place + rng.normal(size=(runs, 2)))
        for _ in range(100):
            place = place + DT * velocity
            bank.predict(DT, np.tile(ANYWHERE, (runs, 1)))
            for origin in sensors:
                told = seen(rng, place - origin, velocity, (0.05, radians(5.0), 0.02))
                bank.update(np.arange(runs), replace(told, position=told.position + origin, origin=origin))
        error = bank.combined()[0][:, :4] - np.hstack([place, np.tile(velocity, (runs, 1))])
        off[len(sensors)] = np.sqrt(np.square(error).sum(axis=0) / runs)
    assert np.hypot(*off[2][:2]) < 0.3 * np.hypot(*off[1][:2])
    assert np.hypot(*off[2][2:]) < 0.2 * np.hypot(*off[1][2:])


def test_what_stands_is_standing_as_the_vehicle_passes_it() -> None:
    """Own motion is taken out while the line of sight turns by 100°; the stated covariance is that of the errors."""
    rng, runs, own = np.random.default_rng(4), 60, np.array([15.0, 0.0])
    place = np.tile([45.0, 8.0], (runs, 1))
    truth = np.hstack([place, np.zeros((runs, 2))])
    bank, nees, speeds = tracks(), [], []
    for k in range(100):
        origin = own * k * DT
        told = seen(rng, place - origin, -own)
        told = replace(told, position=told.position + origin, origin=origin, velocity=own)
        if not k:
            begin(bank, told)
            continue
        bank.predict(DT, np.tile(ANYWHERE, (runs, 1)))
        bank.update(np.arange(runs), told)
        if k >= 20:
            nees.append(squared_in_deviations(bank, truth))
            speeds.append(bank.combined()[0][:, 2:4])
    assert 2.5 < np.mean(nees) < 6.0
    assert np.mean(np.array(nees) < chi2.ppf(0.95, 4)) > 0.88
    assert np.sqrt(np.square(speeds).sum(axis=-1).mean()) < 1.0


def test_a_range_rate_that_is_no_number_changes_nothing() -> None:
    told = polar_measurement(np.array([30.0]), np.array([0.2]), np.array([np.nan]), NOISE)
    banks = [spawned(tracks(), np.array([[29.0, 6.5]])) for _ in range(2)]
    nis = [
        bank.update(np.arange(1), each)
        for bank, each in zip(banks, (told, replace(told, range_rate=None)), strict=True)
    ]
    assert nis[0] == nis[1]
    for one, other in zip(*(bank.combined() for bank in banks), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_acceleration_never_falls_asleep() -> None:
    bank = spawned(tracks(floor=0.5), np.array([[30.0, 0.0], [0.0, 30.0]]))
    azimuth = np.array([0.0, np.pi / 2])
    for _ in range(400):
        bank.predict(DT, np.tile(ANYWHERE, (2, 1)))
        bank.update(np.arange(2), polar_measurement(np.full(2, 30.0), azimuth, np.zeros(2), (0.01, 1e-3, 0.01)))
    _, covariance = bank.combined()
    assert covariance[0, 4, 4] == pytest.approx(0.5)
    assert covariance[1, 5, 5] == pytest.approx(0.5)


def test_a_copy_of_a_track_has_its_line_of_sight() -> None:
    bank = spawned(tracks(), np.array([[30.0, 0.0], [0.0, 30.0]]))
    told = polar_measurement(np.full(2, 30.0), np.array([0.0, np.pi / 2]), np.zeros(2), NOISE)
    bank.update(np.arange(2), told)
    bank.clone(np.array([1]), np.array([[1.0, 31.0]]), np.eye(2)[None])
    np.testing.assert_allclose(bank.state.line, [[1, 0], [0, 1], [0, 1]], atol=1e-2)  # type: ignore[union-attr]
    bank.keep(np.array([2]))
    bank.predict(DT, ANYWHERE)
    assert bank.covariance.shape == (1, 1, 6, 6)


def test_what_comes_later_tells_of_the_motion_before() -> None:
    rng, runs, truth = np.random.default_rng(7), 20, DRIVES["cut-in"].states()[:200]
    bank = tracks()
    bank.linking = True
    begin(bank, seen(rng, np.tile(truth[0, :2], (runs, 1)), truth[0, 2:]))
    steps: list[Step] = []
    for k, state in enumerate(truth[1:]):
        bank.predict(DT, np.tile(ANYWHERE, (runs, 1)))
        link = bank.link if steps else None
        bank.update(np.arange(runs), seen(rng, np.tile(state[:2], (runs, 1)), state[2:]))
        mean, covariance = bank.combined()
        steps.append(Step(k * 50_000_000, mean.copy(), covariance.copy(), link))
    smoothed, _ = smooth(steps, 1_000_000_000)
    late = slice(40, 150)
    filtered, smoothed = np.stack([each.mean for each in steps])[late, :, :4], smoothed[late, :, :4]
    before, after = (np.square(each - truth[1:][late, None]).mean(axis=(0, 1)) for each in (filtered, smoothed))
    assert (after < 0.8 * before).all()


@pytest.mark.parametrize("line", [[[1.0, 1.0]], [[np.nan, 0.0]], [[1.0, 0.0], [1.0, 0.0]], [[1.0]]])
def test_a_state_without_a_line_of_sight_a_track_is_refused(line: list[list[float]]) -> None:
    bank = spawned(tracks(), np.array([[30.0, 0.0]]))
    state = deepcopy(bank._state)
    state.line = np.array(line)
    with pytest.raises(ValueError, match=r"\w"):
        tracks().state = state


FACTORS = {"cruise": (2.2, 9.0), "brake": (1.5, 1.8), "cut-in": (1.25, 1.4)}
"""Most times the error of `imm` in position and velocity, which has a model of constant velocity, and so cruises well.
"""


@pytest.mark.parametrize("name", FACTORS)
def test_it_is_not_far_from_the_imm_and_says_how_far_off_it_is(name: str) -> None:
    runs, off, nees = 10, {}, []
    for kind in ("imm", "mlkf"):
        rng, bank, squared = np.random.default_rng(1), estimator(kind), np.zeros(4)
        for k, state in enumerate(DRIVES[name].states()):
            told = seen(rng, np.tile(state[:2], (runs, 1)), state[2:])
            if not k:
                begin(bank, told)
                continue
            bank.predict(DT, np.tile(ANYWHERE, (runs, 1)))
            bank.update(np.arange(runs), told)
            if k >= 20:
                squared += np.square(bank.combined()[0][:, :4] - state).sum(axis=0)
            if k >= 20 and kind == "mlkf":
                nees.append(squared_in_deviations(bank, state))
        off[kind] = np.sqrt([squared[:2].sum(), squared[2:].sum()])
    assert (off["mlkf"] <= np.array(FACTORS[name]) * off["imm"]).all()
    assert 2.5 < np.mean(nees) < 6.0
    assert np.mean(np.array(nees) < chi2.ppf(0.95, 4)) > 0.93
