"""Variational Bayes for the measurement noise: the published recursion, and factors on a stated noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.noise_factor import NoiseScale, WindowedScale
from candaemon.estimation.variational_noise import VariationalNoise
from tests.support.builders import random_covariance
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)
FORGETTING = 0.95


@settings(deadline=None, max_examples=examples(25))
@given(seed=SEEDS, iterations=st.integers(1, 6))
def test_diagonal_noise_is_that_of_sarkka_and_nummenmaa(seed: int, iterations: int) -> None:
    """Their recursion with the state inside the iteration, α at 1 / (2 (1 − ρ))."""
    rng = np.random.default_rng(seed)
    h, nominal = rng.normal(size=(2, 3)), rng.uniform(0.1, 2.0, 2)
    mean, covariance = rng.normal(size=3), random_covariance(rng, 3)[0]
    noise = VariationalNoise(nominal, FORGETTING, floor=1e-6, ceiling=1e6, iterations=iterations)
    noise.spawn(1)
    alpha, beta = 0.5 / (1 - FORGETTING), nominal * 0.5 / (1 - FORGETTING)
    for _ in range(4):
        measured = h @ mean + rng.normal(size=2) * 3.0
        innovation, predicted = measured - h @ mean, h @ covariance @ h.T
        adapted = noise.observe(np.arange(1), innovation[None], predicted[None])
        kept = FORGETTING * beta
        assert FORGETTING * alpha + 0.5 == pytest.approx(alpha)
        for _ in range(iterations):
            gain = covariance @ h.T @ np.linalg.inv(predicted + np.diag(beta / alpha))
            left = innovation - h @ gain @ innovation
            beta = kept + 0.5 * left**2 + 0.5 * np.diag(h @ (covariance - gain @ h @ covariance) @ h.T)
        np.testing.assert_allclose(adapted.noise[0], np.diag(beta / alpha), rtol=1e-8)
        np.testing.assert_allclose(adapted.spread[0], predicted + adapted.noise[0])
        mean, covariance = mean + gain @ innovation, covariance - gain @ h @ covariance + 0.1 * np.eye(3)


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, dimension=st.integers(1, 2), alike=st.booleans())
def test_factor_solves_its_fixed_point(seed: int, dimension: int, alike: bool) -> None:
    """λ = ρ λ⁻ + (1 − ρ) tr(R₀⁻¹ E[(z − H x)(z − H x)ᵀ]) / d, written out with matrices."""
    rng = np.random.default_rng(seed)
    count = 5
    noise = random_covariance(rng, dimension, count)
    predicted = 0.7 * noise if alike else random_covariance(rng, dimension, count)
    innovation = 3.0 * rng.normal(size=(count, dimension))
    scale = NoiseScale(FORGETTING, floor=1e-3, ceiling=1e3, iterations=60)
    scale.spawn(count)
    found = scale.observe(np.arange(count), innovation, predicted, noise)
    for k in range(count):
        r = found[k] * noise[k]
        gain = predicted[k] @ np.linalg.inv(predicted[k] + r)
        left = innovation[k] - gain @ innovation[k]
        square = np.outer(left, left) + predicted[k] - gain @ predicted[k]
        share = np.trace(np.linalg.solve(noise[k], square)) / dimension
        assert found[k] == pytest.approx(FORGETTING + (1 - FORGETTING) * share, rel=1e-6)


def innovations(rng: np.random.Generator, predicted: Floats, noise: Floats, factor: float) -> Floats:
    """Draw an innovation a row of covariance H P⁻ Hᵀ + factor · R."""
    root = np.linalg.cholesky(predicted + factor * noise)
    drawn: Floats = (root @ rng.normal(size=(*noise.shape[:2], 1)))[:, :, 0]
    return drawn


@pytest.mark.parametrize("factor", [0.4, 1.0, 30.0])
@pytest.mark.parametrize("dimension", [1, 2])
def test_factors_are_found(factor: float, dimension: int) -> None:
    rng, count = np.random.default_rng(6), 300
    noise = random_covariance(rng, dimension, count)
    predicted = 0.2 * noise
    for scale in (NoiseScale(0.97), WindowedScale(40)):
        scale.spawn(count)
        found = np.array(
            [
                scale.observe(np.arange(count), innovations(rng, predicted, noise, factor), predicted, noise)
                for _ in range(350)
            ]
        )
        assert found[200:].mean() == pytest.approx(factor, rel=0.12)
        np.testing.assert_array_equal(scale.scale, found[-1])


def test_window_averages_what_the_prediction_does_not_explain() -> None:
    rng, window = np.random.default_rng(7), 5
    scale = WindowedScale(window, floor=0.0)
    scale.spawn(1)
    told = []
    for k in range(12):
        noise, innovation = random_covariance(rng, 2), rng.normal(size=(1, 2)) * 4
        predicted = 0.05 * random_covariance(rng, 2)
        found = scale.observe(np.arange(1), innovation, predicted, noise)
        inverse = np.linalg.inv(noise[0])
        told.append((innovation[0] @ inverse @ innovation[0] - np.trace(inverse @ predicted[0])) / 2)
        expected = 1.0 if k + 1 < window else max(0.0, np.mean(told[-window:]))
        assert found[0] == pytest.approx(expected)


def test_an_uncertain_state_teaches_nothing() -> None:
    """While H P⁻ Hᵀ ≫ R an innovation says where the target is, not how noisy the sensor."""
    scale, noise = NoiseScale(0.9), VariationalNoise(np.ones(2), 0.9)
    scale.spawn(1)
    noise.spawn(1)
    predicted = 1e4 * np.eye(2)[None]
    for _ in range(50):
        innovation = np.array([[100.0, -80.0]])
        factor = scale.observe(np.arange(1), innovation, predicted, np.eye(2)[None])
        adapted = noise.observe(np.arange(1), innovation, predicted)
        assert factor[0] == pytest.approx(1.0, abs=0.01)
        np.testing.assert_allclose(adapted.noise[0], np.eye(2), atol=0.01)


def test_a_window_waits_until_the_state_is_known() -> None:
    """At first H P⁻ Hᵀ is 200 R₀ and falls with each detection, as it does on a track whose velocity nobody knew."""
    rng, count = np.random.default_rng(9), 400
    noise, scale = np.tile(np.eye(2), (count, 1, 1)), WindowedScale(30)
    scale.spawn(count)
    for k in range(40):
        predicted = max(200.0 / (k + 1) ** 3, 0.3) * noise
        found = scale.observe(np.arange(count), innovations(rng, predicted, noise, 1.0), predicted, noise)
        if k < 32:
            np.testing.assert_array_equal(found, 1.0)  # four innovations of the first did not enter
    assert np.median(found) == pytest.approx(1.0, abs=0.1)
    assert (np.percentile(found, (5, 95)) > 0.5).all()
    assert (np.percentile(found, (5, 95)) < 2.0).all()


def test_a_window_sees_a_burst_through_its_own_doubt() -> None:
    """In a burst the state is as uncertain as the noise that was found, far more than the stated one."""
    rng, count = np.random.default_rng(10), 200
    noise, scale = np.tile(np.eye(2), (count, 1, 1)), WindowedScale(30)
    scale.spawn(count)
    for factor, cycles in ((1.0, 60), (200.0, 90), (1.0, 150)):
        for _ in range(cycles):
            predicted = 0.3 * scale.scale[:, None, None] * noise
            found = scale.observe(np.arange(count), innovations(rng, predicted, noise, factor), predicted, noise)
        assert np.median(found) == pytest.approx(factor, rel=0.15)


@pytest.mark.parametrize("make", [lambda: NoiseScale(0.9), lambda: WindowedScale(10)])
def test_factors_keep_their_bounds_and_forget_a_wild_outlier(make: type[NoiseScale]) -> None:
    scale = make()
    scale.spawn(1)
    unit = np.eye(2)[None]
    for size in (1e70, 0.0):
        for _ in range(100):
            found = scale.observe(np.arange(1), np.full((1, 2), size), 1e-3 * unit, unit)
        assert found[0] == {1e70: 400.0, 0.0: 0.25}[size]


def test_singular_and_huge_predictions_stay_finite() -> None:
    together = np.ones((1, 2, 2))
    for size in (0.0, 1.0, 1e10, 1e100):
        noise, scale = VariationalNoise(np.ones(2)), NoiseScale()
        noise.spawn(1)
        scale.spawn(1)
        for _ in range(5):
            innovation = np.full((1, 2), np.sqrt(size))
            adapted = noise.observe(np.arange(1), innovation, size * together)
            factor = scale.observe(np.arange(1), innovation, size * together, np.eye(2)[None])
            assert np.isfinite(adapted.noise).all()
            assert (np.diagonal(adapted.noise[0]) > 0.0).all()
            assert 0.25 <= factor[0] <= 400.0


@pytest.mark.parametrize("noise", [0.0, 1e-170, 1e100])
@pytest.mark.parametrize("size", [0.0, 1e160])
def test_factors_of_singular_and_huge_noise_are_finite(noise: float, size: float) -> None:
    for scale in (NoiseScale(), WindowedScale(1)):
        scale.spawn(1)
        for _ in range(3):
            found = scale.observe(np.arange(1), np.full((1, 2), size), np.eye(2)[None], noise * np.ones((1, 2, 2)))
            assert 0.25 <= found[0] <= 400.0


def test_rows_are_appended_kept_and_do_not_touch_each_other() -> None:
    rng = np.random.default_rng(8)
    unit = np.tile(np.eye(2), (3, 1, 1))
    for scale in (NoiseScale(0.9, ceiling=50.0), WindowedScale(2, ceiling=50.0)):
        scale.spawn(2)
        scale.spawn(1)
        for _ in range(4):
            scale.observe(np.array([2, 0]), 9.0 + rng.normal(size=(2, 2)), 0.1 * unit[:2], unit[:2])
        last = scale.scale.copy()
        assert last[1] == 1.0
        assert (last[[0, 2]] > 5.0).all()
        scale.keep(np.array([False, True, True]))
        assert len(scale) == 2
        np.testing.assert_array_equal(scale.scale, last[1:])
    noise = VariationalNoise(np.ones(1))
    noise.spawn(2)
    noise.observe(np.array([1]), np.array([[9.0]]), np.zeros((1, 1, 1)))
    noise.keep(np.array([1]))
    assert noise.variance.shape == (1, 1)
    assert noise.variance[0, 0] > 2.0
