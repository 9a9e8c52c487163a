"""The IMM against filterpy and against formulas written out."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.imm import Imm
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.motion_models import CoordinatedTurn, LinearModel, MotionModel
from tests.support.builders import AT_REST, random_covariance, rotation
from tests.support.effort import examples

DT, RATE = 0.1, 0.8
WEAK, STRONG = LinearModel(2, (0.05, 0.02), (20.0, 0.8), (0.001, 0.02)), LinearModel(2, (5.0, 5.0))
MIDDLE = LinearModel(2, (0.5, 0.1))
CV, CT = LinearModel(1, (1e-3, 1e-3)), CoordinatedTurn(0.01, 0.1)
DEFAULT = (CV, STRONG, CT)
SEEDS = st.integers(0, 2**32 - 1)


def imm_of(models: Sequence[MotionModel]) -> Imm:
    return Imm(models, switch_rate=RATE, acceleration=3.0, turn_rate=0.3)


def spawned(models: Sequence[MotionModel], n: int, seed: int = 1) -> Imm:
    """Return a filter with n tracks in motion."""
    rng = np.random.default_rng(seed)
    imm = imm_of(models)
    imm.spawn(
        rng.normal(size=(n, 2)) * 30,
        random_covariance(rng, 2, n),
        rng.normal(size=(n, 2)) * 20,
        random_covariance(rng, 2, n),
    )
    return imm


def directions(n: int, seed: int = 2) -> Floats:
    turned: Floats = rotation(np.random.default_rng(seed).uniform(-pi, pi, n))[:, :, 0]
    return turned


def seen(position: Floats, variance: float = 0.5, **more: Floats | tuple[Projection, ...]) -> Measurement:
    noise = np.tile(np.eye(2) * variance, (len(position), 1, 1))
    return Measurement(position, noise, AT_REST, AT_REST, **more)  # type: ignore[arg-type]  # told by name


def oracles(imm: Imm, models: Sequence[MotionModel], direction: Floats, h: Floats, r: Floats) -> list[KalmanFilter]:
    """Return filterpy's filters in the state of the first track."""
    filters = []
    for j, model in enumerate(models):
        _, f, q = model.transition(imm.mean[:1, j], DT, direction)
        kf = KalmanFilter(dim_x=6, dim_z=len(h))
        kf.x, kf.P, kf.F, kf.Q, kf.H, kf.R = (
            imm.mean[0, j][:, None].copy(),
            imm.covariance[0, j].copy(),
            f[0],
            q[0],
            h,
            r,
        )
        filters.append(kf)
    return filters


@settings(deadline=None, max_examples=examples(20))
@given(seed=SEEDS, model=st.sampled_from((WEAK, STRONG, MIDDLE)), steps=st.integers(1, 60), velocities=st.booleans())
def test_one_model_is_filterpys_kalman_filter(seed: int, model: LinearModel, steps: int, velocities: bool) -> None:
    rng = np.random.default_rng(seed)
    imm, direction = spawned([model], 1, seed), directions(1, seed)
    size = 4 if velocities else 2
    (kf,) = oracles(imm, [model], direction, np.eye(size, 6), np.diag([0.5, 0.5, 0.2, 0.3][:size]))
    for _ in range(steps):
        imm.predict(DT, direction)
        kf.predict()
        if rng.random() < 0.2:
            continue
        z = kf.x[:size, 0] + rng.normal(size=size)
        parts = tuple(
            Projection(np.eye(2)[axis : axis + 1], z[2 + axis : 3 + axis], np.array([variance]))
            for axis, variance in ((0, 0.2), (1, 0.3))
            if velocities
        )
        nis = imm.update(np.arange(1), seen(z[None, :2], projections=parts))
        kf.update(z[:, None])
        assert nis[0] == pytest.approx(kf.mahalanobis**2, rel=1e-8)
    mean, covariance = imm.combined()
    np.testing.assert_allclose(mean[0], kf.x[:, 0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariance[0], kf.P, rtol=1e-10, atol=1e-10)


@settings(deadline=None, max_examples=examples(15))
@given(seed=SEEDS, models=st.sampled_from(((WEAK, STRONG), (STRONG, MIDDLE, WEAK))), steps=st.integers(1, 80))
def test_several_models_are_filterpys_imm(seed: int, models: tuple[LinearModel, ...], steps: int) -> None:
    rng = np.random.default_rng(seed)
    m = len(models)
    imm, direction = spawned(models, 1, seed), directions(1, seed)
    leave = 1 - np.exp(-RATE * DT)
    switch = np.full((m, m), leave / (m - 1)) + (1 - leave - leave / (m - 1)) * np.eye(m)
    filters = oracles(imm, models, direction, np.eye(2, 6), np.eye(2) * 0.5)
    oracle = IMMEstimator(filters, np.full(m, 1 / m), switch)
    acceleration = np.zeros(2)
    position, velocity = imm.mean[0, 0, :2].copy(), imm.mean[0, 0, 2:4].copy()
    for _ in range(steps):
        acceleration = rng.normal(size=2) * 4 if rng.random() < 0.1 else acceleration
        velocity += DT * acceleration
        position += DT * velocity
        z = position + rng.normal(size=2) * 0.7
        imm.predict(DT, direction)
        oracle.predict()
        imm.update(np.arange(1), seen(z[None]))
        oracle.update(z[:, None])
        np.testing.assert_allclose(imm.probability[0], oracle.mu, rtol=1e-8, atol=1e-10)
        mean, covariance = imm.combined()
        np.testing.assert_allclose(mean[0], oracle.x[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariance[0], oracle.P, rtol=1e-9, atol=1e-9)


def test_a_missed_detection_leaves_the_predicted_probabilities_and_a_mixed_covariance() -> None:
    imm = spawned((WEAK, STRONG), 1)
    imm.probability[:] = (0.9, 0.1)
    leave = 1 - np.exp(-RATE * DT)
    expected = np.array([0.9 * (1 - leave) + 0.1 * leave, 0.9 * leave + 0.1 * (1 - leave)])
    before = imm.combined()[1]
    imm.predict(DT, directions(1))
    np.testing.assert_allclose(imm.probability[0], expected, rtol=1e-12)
    assert (np.diagonal(imm.combined()[1][0])[:2] > np.diagonal(before[0])[:2]).all()
    for _ in range(500):
        imm.predict(DT, directions(1))
    np.testing.assert_allclose(imm.probability[0], 0.5, atol=1e-9)


@pytest.mark.parametrize("models", [(STRONG,), (WEAK, STRONG), DEFAULT])
def test_rows_do_not_touch_each_other(models: tuple[MotionModel, ...]) -> None:
    """Updating some rows leaves the rest at the prediction, and gives each what it would get alone."""
    n, chosen = 6, np.array([4, 1, 3])
    imm, direction = spawned(models, n), directions(n)
    imm.predict(DT, direction)
    predicted = imm.mean.copy(), imm.covariance.copy(), imm.probability.copy()
    rng = np.random.default_rng(5)
    z, rates = imm.combined()[0][chosen, :2] + rng.normal(size=(3, 2)), np.array([1.0, np.nan, -2.0])
    measurement = seen(z, range_rate=rates, range_rate_variance=np.full(3, 0.04))
    nis = imm.update(chosen, measurement)
    others = np.setdiff1d(np.arange(n), chosen)
    for now, before in zip((imm.mean, imm.covariance, imm.probability), predicted, strict=True):
        np.testing.assert_array_equal(now[others], before[others])
        if now.shape[-1] > 1:
            assert all((now[row] != before[row]).any() for row in chosen)
    for k, row in enumerate(chosen.tolist()):
        alone = spawned(models, n)
        alone.keep(np.array([row]))
        alone.predict(DT, direction[row : row + 1])
        alone_nis = alone.update(np.arange(1), measurement.take(np.array([k])))
        assert nis[k] == pytest.approx(alone_nis[0], rel=1e-12)
        np.testing.assert_allclose(imm.mean[row], alone.mean[0], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(imm.covariance[row], alone.covariance[0], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(imm.probability[row], alone.probability[0], rtol=1e-11)


@pytest.mark.parametrize("models", [(STRONG,), DEFAULT])
def test_a_range_rate_that_was_not_measured_changes_nothing(models: tuple[MotionModel, ...]) -> None:
    direction = directions(4)
    with_none, with_nan = spawned(models, 4), spawned(models, 4)
    z = with_none.combined()[0][:, :2] + 0.3
    unmeasured = np.full(4, np.nan)
    speeds = (Projection(directions(4), unmeasured, np.full(4, 0.1)),)
    for imm, measurement in (
        (with_none, seen(z)),
        (with_nan, seen(z, range_rate=unmeasured, range_rate_variance=np.full(4, 0.01), projections=speeds)),
    ):
        imm.predict(DT, direction)
        imm.update(np.arange(4), measurement)
    np.testing.assert_array_equal(with_nan.mean, with_none.mean)
    np.testing.assert_array_equal(with_nan.covariance, with_none.covariance)
    np.testing.assert_allclose(with_nan.probability, with_none.probability, rtol=1e-14)


def test_combination_is_the_mixtures_mean_and_covariance() -> None:
    """A coordinated turn's acceleration is ω × v; a constant velocity model's is zero."""
    imm, rng = spawned(DEFAULT, 3), np.random.default_rng(8)
    imm.mean += rng.normal(size=imm.mean.shape) * imm._has
    imm.probability = rng.dirichlet(np.ones(3), 3)
    mean, covariance = imm.combined()
    for k in range(3):
        each = imm.mean[k, :, :6].copy()
        w, vx, vy = imm.mean[k, 2, 6], imm.mean[k, 2, 2], imm.mean[k, 2, 3]
        each[2, 4:6] = -w * vy, w * vx
        assert not each[0, 4:6].any()
        overall = imm.probability[k] @ each
        slope = np.eye(6, 7)
        slope[4], slope[5] = [0, 0, 0, -w, 0, 0, -vy], [0, 0, w, 0, 0, 0, vx]
        own = [imm.covariance[k, 0, :6, :6], imm.covariance[k, 1, :6, :6], slope @ imm.covariance[k, 2] @ slope.T]
        spread = sum(
            p * (own[j] + np.outer(each[j] - overall, each[j] - overall)) for j, p in enumerate(imm.probability[k])
        )
        np.testing.assert_allclose(mean[k], overall, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(covariance[k], spread, rtol=1e-12, atol=1e-12)


def test_models_without_a_component_bias_nobody() -> None:
    """Mixing with a constant velocity model leaves the acceleration and the turn rate of those that have them."""
    imm = spawned(DEFAULT, 1)
    imm.mean[0, 1, 4:6], imm.covariance[0, 1, 4:6, 4:6] = (-5.0, 1.0), np.diag([0.3, 0.2])
    imm.mean[0, 2, 6], imm.covariance[0, 2, 6, 6] = 0.4, 0.01
    imm.probability[:] = (0.9, 0.06, 0.04)
    imm.predict(0.5, directions(1))
    assert imm.probability[0, 0] < 0.7  # much was mixed
    np.testing.assert_allclose(imm.mean[0, 1, 4:6], (-5.0, 1.0), rtol=1e-9)
    np.testing.assert_allclose(imm.covariance[0, 1, 4:6, 4:6], np.diag([0.3, 0.2]) + 5.0 * 0.5 * np.eye(2), atol=1e-9)
    assert imm.mean[0, 2, 6] == pytest.approx(0.4)
    assert imm.covariance[0, 2, 6, 6] == pytest.approx(0.01 + 0.1 * 0.5)
    assert not imm.mean[0, 0, 4:].any()
    assert not imm.covariance[0, 0, 4:].any()


def test_clone_moves_as_its_like_and_stands_elsewhere() -> None:
    imm = spawned(DEFAULT, 3)
    imm.probability[1] = (0.2, 0.7, 0.1)
    place, spread = np.array([[7.0, -1.0]]), np.eye(2)[None] * 0.3
    imm.clone(np.array([1]), place, spread)
    assert len(imm) == 4
    np.testing.assert_array_equal(imm.mean[3, :, 2:], imm.mean[1, :, 2:])
    np.testing.assert_array_equal(imm.covariance[3, :, 2:, 2:], imm.covariance[1, :, 2:, 2:])
    np.testing.assert_array_equal(imm.probability[3], imm.probability[1])
    np.testing.assert_array_equal(imm.mean[3, :, :2], np.tile(place, (3, 1)))
    np.testing.assert_array_equal(imm.covariance[3, :, :2, :2], np.tile(spread, (3, 1, 1)))
    assert not imm.covariance[3, :, :2, 2:].any()


def test_expected_position_is_the_probable_models_prediction() -> None:
    imm, direction = spawned(DEFAULT, 2), directions(2)
    imm.mean[:, 1, 4:6], imm.mean[:, 2, 6] = (2.0, -1.0), 0.5
    imm.probability[:] = np.eye(3)[[1, 2]]
    place = imm.expected_position(np.arange(2), 0.5, direction)
    x, v, a = imm.mean[0, 1, :2], imm.mean[0, 1, 2:4], imm.mean[0, 1, 4:6]
    np.testing.assert_allclose(place[0], x + 0.5 * v + 0.125 * a, rtol=1e-12)
    chord = rotation(0.5 * 0.5 / 2) @ imm.mean[1, 2, 2:4] * 0.5 * np.sinc(0.5 * 0.5 / 2 / pi)
    np.testing.assert_allclose(place[1], imm.mean[1, 2, :2] + chord, rtol=1e-12)


def test_a_filter_without_tracks_does_nothing() -> None:
    imm = imm_of(DEFAULT)
    imm.predict(DT, np.zeros((0, 2)))
    nis = imm.update(np.arange(0), seen(np.zeros((0, 2))))
    mean, covariance = imm.combined()
    assert (len(imm), nis.shape, mean.shape, covariance.shape) == (0, (0,), (0, 6), (0, 6, 6))


def test_probabilities_survive_an_absurd_measurement() -> None:
    imm = spawned(DEFAULT, 2)
    imm.predict(DT, directions(2))
    imm.update(np.arange(2), seen(np.full((2, 2), 1e7), variance=1e-4))
    assert np.isfinite(imm.mean).all()
    np.testing.assert_allclose(imm.probability.sum(axis=1), 1.0, rtol=1e-12)
    assert (imm.probability > 0).all()
