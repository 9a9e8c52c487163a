"""The Kalman filter of any linear system, and an IMM composed of its steps, against filterpy; what no input breaks."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, IMMEstimator, KalmanFilter
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.discretisation import white_axis
from candaemon.estimation.filter_bank import moments
from candaemon.estimation.imm import mix, posterior
from candaemon.estimation.kalman import predict, update
from tests.support.builders import random_covariance
from tests.support.effort import examples
from tests.support.long_runs import few_and_many_cycles

SEEDS = st.integers(0, 2**32 - 1)
CLOSE = 1e-9


class System:
    """Random matrices of a linear system: n tracks, D states, m measured numbers, and what is measured over steps."""

    def __init__(self, seed: int, n: int, size: int, measured: int, steps: int = 8) -> None:
        rng = np.random.default_rng(seed)
        self.mean, self.covariance = rng.normal(size=(n, size)) * 10, random_covariance(rng, size, n)
        self.f = np.eye(size) + 0.4 * rng.normal(size=(n, size, size))
        self.q, self.r = random_covariance(rng, size, n), random_covariance(rng, measured, n)
        self.h = rng.normal(size=(n, measured, size))
        self.z = rng.normal(size=(steps, n, measured)) * 10

    def innovation(self, mean: Floats, step: int) -> Floats:
        difference: Floats = self.z[step] - np.einsum("nij,nj->ni", self.h, mean)
        return difference

    def oracle(self, row: int) -> KalmanFilter:
        """Return filterpy's filter of one track."""
        kf = KalmanFilter(dim_x=self.mean.shape[1], dim_z=self.z.shape[2])
        kf.x, kf.P = self.mean[row][:, None].copy(), self.covariance[row].copy()
        kf.F, kf.Q, kf.H, kf.R = self.f[row], self.q[row], self.h[row], self.r[row]
        return kf


def assert_close(ours: Floats, theirs: Floats) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=CLOSE, atol=CLOSE * max(float(np.abs(theirs).max()), 1.0))


@settings(deadline=None, max_examples=examples(60))
@given(seed=SEEDS, n=st.integers(1, 4), size=st.integers(1, 8), measured=st.integers(1, 5))
def test_a_linear_system_is_filterpys(seed: int, n: int, size: int, measured: int) -> None:
    system = System(seed, n, size, measured)
    mean, covariance = system.mean.copy(), system.covariance.copy()
    oracles = [system.oracle(row) for row in range(n)]
    for step, z in enumerate(system.z):
        predict(mean, covariance, system.f, system.q)
        fit = update(mean, covariance, system.innovation(mean, step), system.h, system.r)
        np.testing.assert_array_equal(covariance, covariance.swapaxes(1, 2))
        for row, kf in enumerate(oracles):
            kf.predict()
            kf.update(z[row][:, None])
            assert_close(mean[row], kf.x[:, 0])
            assert_close(covariance[row], kf.P)
            assert fit.log_likelihood[row] == pytest.approx(kf.log_likelihood, rel=CLOSE)
            assert fit.nis[row] == pytest.approx(kf.mahalanobis**2, rel=CLOSE)


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS)
def test_a_nonlinear_measurement_is_filterpys(seed: int) -> None:
    """Range and azimuth of a position: the extended filter."""
    rng = np.random.default_rng(seed)
    mean, covariance = np.array([30.0, 5.0, 8.0, 1.0]), random_covariance(rng, 4)[0]
    f, q, r = np.eye(4) + np.diag([0.1, 0.1], 2), 0.01 * random_covariance(rng, 4)[0], np.diag([0.25, 1e-4])

    def polar(x: Floats) -> Floats:
        x = x.reshape(-1)
        return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])]).reshape(-1, 1)

    def jacobian(x: Floats) -> Floats:
        a, b = x.reshape(-1)[:2]
        d = np.hypot(a, b)
        return np.array([[a / d, b / d, 0, 0], [-b / d**2, a / d**2, 0, 0]])

    ekf = ExtendedKalmanFilter(dim_x=4, dim_z=2)
    ekf.x, ekf.P, ekf.F, ekf.Q, ekf.R = mean[:, None].copy(), covariance.copy(), f, q, r
    for k in range(20):
        z = polar(np.array([30 + 0.8 * k, 5 + 0.1 * k])) + rng.normal(size=(2, 1)) * [[0.5], [0.01]]
        predict(mean, covariance, f, q, f @ mean)
        update(mean, covariance, (z - polar(mean))[:, 0], jacobian(mean), r)
        ekf.predict()
        ekf.update(z, jacobian, polar)
        assert_close(mean, ekf.x[:, 0])
        assert_close(covariance, ekf.P)


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, models=st.integers(2, 4), size=st.integers(1, 6), measured=st.integers(1, 3))
def test_the_steps_make_filterpys_imm(seed: int, models: int, size: int, measured: int) -> None:
    """Mixing, each model's own filter, mode probabilities and combination of one track; the rows are its models."""
    system, rng = System(seed, models, size, measured), np.random.default_rng(seed)
    for shared in (system.mean, system.f, system.h, system.r):
        shared[:] = shared[:1]
    system.z = system.z[:, :1] / 5
    switch, probability = rng.uniform(0.1, 1.0, (models, models)), rng.uniform(0.2, 1.0, (1, models))
    switch, probability = switch / switch.sum(axis=1, keepdims=True), probability / probability.sum()
    oracle = IMMEstimator([system.oracle(row) for row in range(models)], probability[0].copy(), switch)
    mean, covariance = system.mean[None], system.covariance[None]
    for step, z in enumerate(system.z):
        mean, covariance, predicted = mix(mean, covariance, probability, switch)
        predict(mean, covariance, system.f, system.q)
        fit = update(mean, covariance, system.innovation(mean[0], step)[None], system.h, system.r)
        probability = posterior(predicted, fit.log_likelihood)
        oracle.predict()
        oracle.update(z[0][:, None])
        assume(oracle.mu.min() >= 1e-3)  # ours never falls below 1e-12, and each step's share of that adds up
        np.testing.assert_allclose(probability[0], oracle.mu, rtol=CLOSE)
        combined, spread = moments(probability, mean, covariance)
        assert_close(combined[0], oracle.x[:, 0])
        assert_close(spread[0], oracle.P)


def test_rows_may_have_any_shape_and_share_a_measurement_matrix() -> None:
    system = System(3, 6, 4, 2)
    mean, covariance = system.mean.copy(), system.covariance.copy()
    innovation = system.innovation(mean, 0)
    shaped_mean, shaped_covariance = mean.reshape(2, 3, 4).copy(), covariance.reshape(2, 3, 4, 4).copy()
    shared = update(shaped_mean, shaped_covariance, innovation.reshape(2, 3, 2), system.h[0], system.r[0])
    flat = update(mean, covariance, innovation, system.h[:1], system.r[:1])
    np.testing.assert_allclose(shaped_mean.reshape(6, 4), mean, rtol=1e-13)
    np.testing.assert_allclose(shaped_covariance.reshape(6, 4, 4), covariance, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(shared.nis.reshape(6), flat.nis, rtol=1e-13)


def test_what_is_certain_stays_whatever_is_measured_exactly() -> None:
    """P = 0 and R = 0: S is singular, and the pseudo-inverse gives a gain of zero."""
    mean, covariance = np.array([[1.0, 2.0, 3.0]]), np.zeros((1, 3, 3))
    fit = update(mean, covariance, np.array([[5.0, 5.0]]), np.eye(2, 3)[None], np.zeros((1, 2, 2)))
    np.testing.assert_array_equal(mean, [[1.0, 2.0, 3.0]])
    assert not covariance.any()
    assert fit.nis == 0.0
    assert fit.log_likelihood == 0.0


def test_the_same_exact_measurement_twice_counts_once() -> None:
    system = System(4, 3, 4, 1)
    once, twice = system.mean.copy(), system.mean.copy()
    p_once, p_twice = system.covariance.copy(), system.covariance.copy()
    innovation = system.innovation(once, 0)
    update(once, p_once, innovation, system.h, np.zeros((3, 1, 1)))
    update(twice, p_twice, innovation.repeat(2, axis=1), system.h.repeat(2, axis=1), np.zeros((3, 2, 2)))
    np.testing.assert_allclose(twice, once, rtol=1e-9)
    np.testing.assert_allclose(p_twice, p_once, atol=1e-12)
    np.testing.assert_allclose(system.innovation(once, 0), 0.0, atol=1e-12)


@settings(deadline=None, max_examples=examples(200))
@given(
    seed=SEEDS,
    size=st.integers(1, 9),
    measured=st.integers(1, 4),
    rank=st.integers(0, 9),
    powers=st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-100, 100)),
    exact=st.booleans(),
)
def test_singular_and_huge_inputs_stay_finite_and_positive_semidefinite(
    seed: int, size: int, measured: int, rank: int, powers: tuple[float, float, float], exact: bool
) -> None:
    rng = np.random.default_rng(seed)
    p, r, surprise = (10.0**power for power in powers)
    root = rng.normal(size=(1, size, min(rank, size)))
    covariance = p * (root @ root.swapaxes(1, 2))
    scale = np.sqrt(np.maximum(np.diagonal(covariance[0]), 1e-300))
    mean = rng.normal(size=(1, size)) * np.sqrt(p)
    noise = np.zeros((1, measured, measured)) if exact else r * random_covariance(rng, measured)
    fit = update(mean, covariance, rng.normal(size=(1, measured)) * surprise, rng.normal(size=(measured, size)), noise)
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()
    assert np.isfinite([fit.nis, fit.log_likelihood]).all()
    np.testing.assert_array_equal(covariance, covariance.swapaxes(1, 2))
    assert np.linalg.eigvalsh(covariance[0] / scale[:, None] / scale).min() >= -CLOSE


@few_and_many_cycles
def test_many_cycles_keep_covariances_positive_definite(cycles: int) -> None:
    """A radar's hour: constant velocity, acceleration and jerk at T = 0.05 s, positions measured to 0.1 m."""
    dt = 0.05
    axes = [white_axis(dt, 0.1, order=order) for order in (1, 2, 3)]
    f, q = np.zeros((3, 4, 4)), np.zeros((3, 4, 4))
    for row, axis in enumerate(axes):
        size = len(axis.transition)
        f[row, :size, :size], q[row, :size, :size] = axis.transition, axis.noise
        q[row] += np.diag([0.0, 0.0, 1e-6, 1e-6]) * (np.diagonal(q[row]) == 0)
    mean, covariance = np.zeros((3, 4)), np.tile(100.0 * np.eye(4), (3, 1, 1))
    h, r = np.eye(1, 4), np.array([[0.01]])
    innovations = np.random.default_rng(5).normal(size=(cycles, 3, 1)) * 0.1
    for innovation in innovations:
        predict(mean, covariance, f, q)
        update(mean, covariance, innovation, h, r)
    assert np.isfinite(mean).all()
    np.testing.assert_array_equal(covariance, covariance.swapaxes(1, 2))
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    before = covariance.copy()
    predict(mean, covariance, f, q)
    update(mean, covariance, innovations[0], h, r)
    np.testing.assert_allclose(covariance, before, rtol=1e-9, atol=1e-15)
