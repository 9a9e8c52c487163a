"""Measurement updates against the textbook's joint update and filterpy's filter."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from candaemon.arrays import Floats
from candaemon.estimation.kalman import symmetrise, update_position, update_scalar
from candaemon.estimation.measurement import line_of_sight
from tests.support.builders import random_covariance
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)


def textbook(mean: Floats, covariance: Floats, z: Floats, h: Floats, noise: Floats) -> KalmanFilter:
    """Return filterpy's filter after the update."""
    kf = KalmanFilter(dim_x=len(mean), dim_z=len(z))
    kf.x, kf.P, kf.H, kf.R = mean[:, None].copy(), covariance.copy(), h, noise
    kf.update(z[:, None])
    return kf


@settings(deadline=None, max_examples=examples(100))
@given(seed=SEEDS, size=st.integers(2, 7))
def test_a_position_update_is_filterpys(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = rng.normal(size=size) * 10, random_covariance(rng, size)[0]
    z, noise = rng.normal(size=2) * 10, random_covariance(rng, 2)[0]
    kf = textbook(mean, covariance, z, np.eye(2, size), noise)
    fit = update_position(mean, covariance, z, noise)
    np.testing.assert_allclose(mean, kf.x[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(covariance, kf.P, rtol=1e-9, atol=1e-9)
    assert float(fit.log_likelihood) == pytest.approx(kf.log_likelihood, rel=1e-9)
    assert float(fit.nis) == pytest.approx(kf.mahalanobis**2, rel=1e-9)


@settings(deadline=None, max_examples=examples(100))
@given(seed=SEEDS, size=st.integers(4, 7), batch=st.sampled_from(((), (1,), (3,), (2, 3))))
def test_updates_one_after_another_are_the_joint_one(seed: int, size: int, batch: tuple[int, ...]) -> None:
    """Position, then two scalars; their likelihoods multiply and their NIS add up to the joint ones."""
    rng = np.random.default_rng(seed)
    n = int(np.prod(batch))
    mean = rng.normal(size=(n, size)) * 5
    covariance = random_covariance(rng, size, n)
    z, noise = rng.normal(size=(n, 2)) * 5, random_covariance(rng, 2, n)
    rows, speeds, variances = rng.normal(size=(2, n, 4)), rng.normal(size=(2, n)) * 5, rng.uniform(0.05, 2, (2, n))
    m, p = mean.reshape(*batch, size).copy(), covariance.reshape(*batch, size, size).copy()
    fit = update_position(m, p, z.reshape(*batch, 2), noise.reshape(*batch, 2, 2))
    nis, log_likelihood = fit.nis, fit.log_likelihood
    for row, speed, variance in zip(rows, speeds, variances, strict=True):
        row, speed, variance = row.reshape(*batch, 4), speed.reshape(batch), variance.reshape(batch)
        fit = update_scalar(m, p, row, speed - (row * m[..., :4]).sum(axis=-1), variance)
        nis, log_likelihood = nis + fit.nis, log_likelihood + fit.log_likelihood
    m, p = m.reshape(n, size), p.reshape(n, size, size)
    nis, log_likelihood = np.reshape(nis, n), np.reshape(log_likelihood, n)
    for k in range(n):
        h = np.zeros((4, size))
        h[:2, :2], h[2:, :4] = np.eye(2), rows[:, k]
        r = np.zeros((4, 4))
        r[:2, :2], r[2, 2], r[3, 3] = noise[k], *variances[:, k]
        joint_z = np.concatenate([z[k], speeds[:, k]])
        kf = textbook(mean[k], covariance[k], joint_z, h, r)
        np.testing.assert_allclose(m[k], kf.x[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(p[k], kf.P, rtol=1e-9, atol=1e-9)
        s = h @ covariance[k] @ h.T + r
        innovation = joint_z - h @ mean[k]
        assert log_likelihood[k] == pytest.approx(multivariate_normal.logpdf(innovation, cov=s), rel=1e-9)
        assert nis[k] == pytest.approx(innovation @ np.linalg.solve(s, innovation), rel=1e-9)


def test_updates_write_in_place_and_read_only_what_they_are_given() -> None:
    rng = np.random.default_rng(1)
    mean, covariance = rng.normal(size=(3, 6)), random_covariance(rng, 6, 3)
    z, noise = rng.normal(size=(3, 2)), random_covariance(rng, 2, 3)
    kept = z.copy(), noise.copy(), mean.copy()
    update_position(mean[1:2], covariance[1:2], z[1:2], noise[1:2])
    np.testing.assert_array_equal(z, kept[0])
    np.testing.assert_array_equal(noise, kept[1])
    np.testing.assert_array_equal(mean[[0, 2]], kept[2][[0, 2]])
    assert (mean[1] != kept[2][1]).all()


def test_an_exact_position_leaves_no_doubt_and_a_vague_one_teaches_nothing() -> None:
    covariance = random_covariance(np.random.default_rng(2), 4)
    before = covariance.copy()
    mean = np.zeros((1, 4))
    update_position(mean, covariance, np.array([[3.0, 4.0]]), np.eye(2)[None] * 1e14)
    np.testing.assert_allclose(covariance, before, atol=1e-9)
    np.testing.assert_allclose(mean, 0.0, atol=1e-9)
    update_position(mean, covariance, np.array([[3.0, 4.0]]), np.eye(2)[None] * 1e-14)
    np.testing.assert_allclose(mean[0, :2], (3.0, 4.0), atol=1e-9)
    np.testing.assert_allclose(covariance[0, :2], 0.0, atol=1e-9)


@settings(deadline=None, max_examples=examples(200))
@given(
    x=st.floats(-200, 200),
    y=st.floats(-100, 100),
    velocity=st.tuples(st.floats(-70, 70), st.floats(-70, 70)),
    origin=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    own=st.tuples(st.floats(-60, 60), st.floats(-60, 60)),
)
def test_range_rates_jacobian_is_its_derivative(
    x: float, y: float, velocity: tuple[float, float], origin: tuple[float, float], own: tuple[float, float]
) -> None:
    offset = np.array([x, y]) - origin
    distance = float(np.hypot(*offset))
    assume(distance >= 1.0)  # nearer the Jacobian is bounded on purpose
    mean = np.array([[x, y, *velocity, 0.3, -0.2, 0.1]])
    rate, row = line_of_sight(mean, np.array(origin), np.array(own))
    assert rate[0] == pytest.approx((np.array(velocity) - own) @ offset / distance, abs=1e-9)
    step = 1e-5
    for c in range(4):
        nudge = np.zeros((1, 7))
        nudge[0, c] = step
        ahead, behind = (line_of_sight(mean + sign * nudge, np.array(origin), np.array(own))[0] for sign in (1, -1))
        assert row[0, c] == pytest.approx((ahead - behind)[0] / (2 * step), abs=1e-5)


@pytest.mark.parametrize("distance", [0.0, 1e-12, 1e-4, 0.01, 0.5])
def test_range_rate_is_bounded_at_the_sensor_itself(distance: float) -> None:
    mean = np.array([[3.6 + distance, 0.0, 20.0, 5.0, 0.0, 0.0]])
    rate, row = line_of_sight(mean, np.array([3.6, 0.0]), np.array([10.0, 0.0]))
    assert np.isfinite(rate).all()
    assert abs(rate[0]) <= np.hypot(10, 5)
    assert np.isfinite(row).all()
    assert np.abs(row[0, :2]).max() <= np.hypot(10, 5) + 1e-9


def test_symmetrise_keeps_the_symmetric_part() -> None:
    rng = np.random.default_rng(3)
    matrices = random_covariance(rng, 6, 8).reshape(4, 2, 6, 6) + 0.1 * rng.normal(size=(4, 2, 6, 6))
    expected = (matrices + matrices.transpose(0, 1, 3, 2)) / 2
    symmetrise(matrices)
    np.testing.assert_array_equal(matrices, matrices.transpose(0, 1, 3, 2))
    np.testing.assert_allclose(matrices, expected, rtol=1e-15)


def test_what_rounding_took_below_zero_counts_as_known() -> None:
    covariance = random_covariance(np.random.default_rng(4), 3, 2)
    expected = covariance.copy()
    covariance[1, 2, 2] = -1e-18
    expected[1, 2] = expected[1, :, 2] = 0.0
    symmetrise(covariance)
    np.testing.assert_allclose(covariance, expected, rtol=1e-15)


@pytest.mark.parametrize("known", [0.0, 1e-170, 1e-30])
@pytest.mark.parametrize("noise", [0.0, 1e-170, 1e-30])
def test_what_is_certain_hardly_moves_whatever_is_measured_exactly(known: float, noise: float) -> None:
    mean, covariance = np.ones((1, 4)), np.tile(known * np.eye(4), (1, 1, 1))
    fits = [update_position(mean, covariance, np.full((1, 2), 7.0), np.tile(noise * np.eye(2), (1, 1, 1)))]
    fits.append(update_scalar(mean, covariance, np.ones((1, 4)), np.full(1, 1e160), np.full(1, noise)))
    for fit in fits:
        assert np.isfinite([fit.nis, fit.log_likelihood]).all()
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()
    if known < noise:
        np.testing.assert_allclose(covariance, known * np.eye(4)[None], rtol=1e-9, atol=1e-300)


@settings(deadline=None, max_examples=examples(100))
@given(seed=SEEDS, rank=st.integers(0, 6), powers=st.tuples(st.floats(-8, 8), st.floats(-8, 8)), exact=st.booleans())
@example(seed=5615, rank=1, powers=(0.0, 0.0), exact=True)  # of S, rounding leaves nothing; of P Hᵀ, a thousandth
def test_singular_covariances_stay_positive_semidefinite(
    seed: int, rank: int, powers: tuple[float, float], exact: bool
) -> None:
    """Variances to some 1e-11 of what they were before the update, below which rounding decides."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(1, 6, rank))
    covariance = 10 ** powers[0] * (root @ root.swapaxes(1, 2))
    scale = np.sqrt(np.maximum(np.diagonal(covariance[0]), 1e-300))
    noise = np.zeros((1, 2, 2)) if exact else 10 ** powers[1] * random_covariance(rng, 2)
    mean = np.zeros((1, 6))
    update_position(mean, covariance, rng.normal(size=(1, 2)), noise)
    update_scalar(mean, covariance, rng.normal(size=(1, 4)), rng.normal(size=1), noise[:, 0, 0])
    assert np.isfinite(mean).all()
    assert np.linalg.eigvalsh(covariance[0] / scale[:, None] / scale).min() > -1e-11
