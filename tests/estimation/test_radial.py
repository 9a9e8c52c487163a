"""Ranges and their rates against derivatives, and the MLKF against filterpy's Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from candaemon.arrays import Floats
from candaemon.estimation.radial import ModifiedLinearKalman, radial, radial_jacobian
from tests.support.builders import random_covariance
from tests.support.effort import examples
from tests.support.long_runs import few_and_many_cycles

SEEDS = st.integers(0, 2**32 - 1)
SENSORS = np.array([(3.6, 0.8), (3.6, -0.8), (0.0, 0.9)])
VARIANCES = np.array([0.05, 0.02, 1.0]) ** 2
DT = 0.01


def motions(seed: int, count: int) -> Floats:
    """Return targets a few metres off and farther, (count, 6)."""
    rng = np.random.default_rng(seed)
    place = SENSORS[0] + rng.uniform(2.0, 60.0, (count, 1)) * _unit(rng.uniform(-1.2, 1.2, count))
    return np.concatenate([place, 15.0 * rng.normal(size=(count, 2)), 5.0 * rng.normal(size=(count, 2))], axis=1)


def _unit(angle: Floats) -> Floats:
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def after(state: Floats, time: float) -> Floats:
    """Return states a time later, at constant acceleration."""
    moved = state.copy()
    moved[:, :2] += time * state[:, 2:4] + time**2 / 2 * state[:, 4:]
    moved[:, 2:4] += time * state[:, 4:]
    return moved


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS)
def test_rate_and_acceleration_are_the_derivatives_of_range(seed: int) -> None:
    state, step = motions(seed, 20), 1e-4
    before, here, later = (radial(after(state, time), SENSORS) for time in (-step, 0.0, step))
    np.testing.assert_allclose(here[..., 1:], (later - before)[..., :2] / (2 * step), rtol=1e-4, atol=1e-4)


def test_without_the_centripetal_term_the_acceleration_misses_what_a_crossing_target_has() -> None:
    crossing = np.array([[10.0, 0.0, 0.0, 9.0, 0.0, 0.0]])
    sensor = np.zeros((1, 2))
    np.testing.assert_allclose(radial(crossing, sensor)[0, 0], (10.0, 0.0, 8.1))
    np.testing.assert_allclose(radial(crossing, sensor, centripetal=False)[0, 0], (10.0, 0.0, 0.0))


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS, centripetal=st.booleans())
def test_the_jacobian_is_the_derivative(seed: int, centripetal: bool) -> None:
    state, step = motions(seed, 20), 1e-5
    jacobian = radial_jacobian(state, SENSORS, centripetal=centripetal)
    for c, nudge in enumerate(step * np.eye(6)):
        ahead, behind = (radial(state + sign * nudge, SENSORS, centripetal=centripetal) for sign in (1, -1))
        np.testing.assert_allclose(jacobian[..., c], (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-4)


def test_at_the_sensor_itself_all_is_finite() -> None:
    state = np.array([[*SENSORS[0], 20.0, -5.0, 1.0, 1.0]])
    assert np.isfinite(radial(state, SENSORS)).all()
    assert np.isfinite(radial_jacobian(state, SENSORS)).all()


def oracle(mean: Floats, covariance: Floats) -> KalmanFilter:
    """Return filterpy's filter in a state, with the F of constant acceleration, no process noise, C = I."""
    kf = KalmanFilter(dim_x=3, dim_z=3)
    kf.x, kf.P, kf.H, kf.R = mean[:, None].copy(), covariance.copy(), np.eye(3), np.diag(VARIANCES)
    kf.F = np.array([[1.0, DT, DT**2 / 2], [0.0, 1.0, DT], [0.0, 0.0, 1.0]])
    kf.Q = np.zeros((3, 3))
    return kf


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS, floor=st.sampled_from((0.0, 0.03, 0.3)))
def test_the_mlkf_equals_filterpys_filter_with_a_floor(seed: int, floor: float) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = 10.0 * rng.normal(size=(4, 3)), random_covariance(rng, 3, 4)
    mlkf = ModifiedLinearKalman(floor=floor)
    mlkf.spawn(mean[:3], covariance[:3])
    mlkf.spawn(mean[3:], covariance[3])
    oracles = [oracle(m, p) for m, p in zip(mean, covariance, strict=True)]
    for _ in range(40):
        measured = 10.0 * rng.normal(size=(4, 3))
        mlkf.predict(DT)
        fit = mlkf.update(np.arange(4), measured, VARIANCES)
        for k, kf in enumerate(oracles):
            kf.predict()
            kf.update(measured[k][:, None])
            assert fit.nis[k] == pytest.approx(kf.mahalanobis**2, rel=1e-9)
            spread = multivariate_normal.logpdf(kf.y[:, 0], cov=kf.S)
            assert fit.log_likelihood[k] == pytest.approx(spread, rel=1e-9, abs=1e-9)
            kf.P[2, 2] = max(kf.P[2, 2], floor)
    np.testing.assert_allclose(mlkf.mean, [kf.x[:, 0] for kf in oracles], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(mlkf.covariance, [kf.P for kf in oracles], rtol=1e-9, atol=1e-12)


def test_what_was_not_measured_changes_nothing() -> None:
    mlkf = ModifiedLinearKalman(floor=0.0)
    mlkf.spawn(np.array([[20.0, -3.0, 0.5]] * 3))
    blind = mlkf.mean.copy()
    fit = mlkf.update(np.array([0, 2]), np.array([[21.0, np.nan, np.nan], [np.nan] * 3]), VARIANCES)
    kf = oracle(blind[0], np.eye(3))
    kf.update(21.0, R=VARIANCES[:1, None], H=np.eye(1, 3))
    np.testing.assert_allclose(mlkf.mean[0], kf.x[:, 0], rtol=1e-12)
    np.testing.assert_allclose(mlkf.covariance[0], kf.P, rtol=1e-12, atol=1e-15)
    assert fit.nis[0] == pytest.approx(kf.mahalanobis**2)
    np.testing.assert_array_equal(mlkf.mean[1:], blind[1:])
    assert (fit.nis[1], fit.log_likelihood[1]) == (0.0, 0.0)


def test_the_floor_keeps_it_awake() -> None:
    """A target brakes by 4 m/s² after 4 s of steady motion; a filter without process noise has stopped listening."""

    def error(floor: float) -> float:
        mlkf = ModifiedLinearKalman(floor=floor)
        rng = np.random.default_rng(4)
        time = DT * np.arange(600)
        braking = np.maximum(time - 4.0, 0.0)
        truth = np.stack([50.0 - 2.0 * braking**2, -4.0 * braking, np.where(time >= 4.0, -4.0, 0.0)], axis=1)
        mlkf.spawn(truth[:1])
        for exact in truth[1:]:
            mlkf.predict(DT)
            mlkf.update(np.array([0]), exact[None] + np.sqrt(VARIANCES) * rng.normal(size=3), VARIANCES)
        return float(np.abs(mlkf.mean[0] - truth[-1])[1])

    assert error(0.3) < 0.05
    assert error(0.0) > 1.0


@few_and_many_cycles
def test_many_cycles_leave_it_sound(cycles: int) -> None:
    mlkf = ModifiedLinearKalman()
    mlkf.spawn(np.array([[40.0, -1.0, 0.0]]))
    noise = np.sqrt(VARIANCES) * np.random.default_rng(5).normal(size=(cycles, 1, 3))
    row, exact = np.array([0]), np.array([40.0, 0.0, 0.0])
    for each in noise:
        mlkf.predict(0.05)
        mlkf.update(row, exact + each, VARIANCES)
    assert np.isfinite(mlkf.mean).all()
    np.testing.assert_array_equal(mlkf.covariance, np.swapaxes(mlkf.covariance, 1, 2))
    assert np.linalg.eigvalsh(mlkf.covariance).min() > 0.0
    assert np.abs(mlkf.mean[0, :2] - exact[:2]).max() < 0.1


@pytest.mark.parametrize("variance", [0.0, 1e-20, 1.0, 1e20])
@pytest.mark.parametrize("value", [0.0, 1e120, -1e120])
def test_singular_and_huge_inputs_leave_it_finite(variance: float, value: float) -> None:
    mlkf = ModifiedLinearKalman()
    mlkf.spawn(np.full((2, 3), value), variance * np.eye(3))
    for _ in range(3):
        mlkf.predict(DT)
        fit = mlkf.update(np.arange(2), np.full((2, 3), -value), VARIANCES)
    assert np.isfinite(mlkf.mean).all()
    assert np.isfinite(mlkf.covariance).all()
    assert np.isfinite(fit.nis).all()


def test_rows_that_are_kept_go_on_as_they_were() -> None:
    mlkf = ModifiedLinearKalman()
    mlkf.spawn(np.arange(9.0).reshape(3, 3))
    mlkf.keep(np.array([2, 0]))
    assert len(mlkf) == 2
    np.testing.assert_array_equal(mlkf.mean, [[6.0, 7.0, 8.0], [0.0, 1.0, 2.0]])
