"""Noise from the innovations of a window: the formulas, what they learn, and that no burst locks a sensor out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.adaptive_filter import AdaptiveFilter
from candaemon.estimation.discretisation import white_axis
from candaemon.estimation.innovation_noise import (
    CHI_SQUARE,
    InnovationNoise,
    InnovationWindow,
    corrected,
    measurement_noise,
    process_noise,
)
from tests.support.builders import random_covariance
from tests.support.effort import examples

DT = 0.05
CA = white_axis(DT, 0.1, order=2)
BOTH = np.eye(2, 3)
ONE = np.zeros(1, dtype=np.intp)


def followed(tracks: AdaptiveFilter, measured: Floats, observation: Floats) -> Floats:
    """Follow measurements (steps, n, d) from the origin; return the estimates."""
    n = measured.shape[1]
    tracks.spawn(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    estimates = []
    for seen in measured:
        tracks.predict(CA.transition, CA.noise)
        tracks.update(np.arange(n), seen, observation)
        estimates.append(tracks.mean.copy())
    return np.array(estimates)


@settings(deadline=None, max_examples=examples(25))
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 8), steps=st.integers(1, 30))
def test_window_holds_the_latest_of_each_row(seed: int, size: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    plain: list[list[Floats]] = [[], [], []]
    window = InnovationWindow(size, 2)
    window.spawn(2)
    window.spawn(1)
    for _ in range(steps):
        rows = np.flatnonzero(rng.random(3) < 0.7)
        innovation = rng.normal(size=(len(rows), 2))
        window.push(rows, innovation)
        for row, seen in zip(rows.tolist(), innovation, strict=True):
            plain[row] = [*plain[row], seen][-size:]
    rows = np.array([2, 0])
    window.keep(rows)
    for k, row in enumerate(rows.tolist()):
        expected = sum((np.outer(v, v) for v in plain[row]), np.zeros((2, 2))) / size
        np.testing.assert_allclose(window.covariance(np.array([k]))[0], expected, atol=1e-12)
        assert window.full(np.array([k]))[0] == (len(plain[row]) == size)


def test_measurement_noise_is_what_the_prediction_does_not_explain() -> None:
    spread, predicted = np.array([[3.0, 0.5], [0.5, 1.0]]), np.array([[1.0, 0.2], [0.2, 0.999]])
    np.testing.assert_allclose(measurement_noise(spread, predicted, np.full(2, 0.01)), np.diag([2.0, 0.01]))


def test_process_noise_is_the_papers() -> None:
    rng = np.random.default_rng(3)
    f, h = rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    (before, q), (r, excess) = random_covariance(rng, 3, 2), random_covariance(rng, 2, 2)
    prior = f @ before @ f.T + q
    expected = h @ prior @ h.T + r
    gain = prior @ h.T @ np.linalg.inv(expected)
    posterior = prior - gain @ h @ prior
    spread = expected + excess
    printed = gain @ spread @ gain.T + posterior - f @ before @ f.T
    np.testing.assert_allclose(process_noise(q, gain, spread, expected), printed, atol=1e-10)
    np.testing.assert_allclose(process_noise(q, gain, expected, expected), q, atol=1e-12)
    small = process_noise(q, gain, 0.0 * expected, expected)
    assert np.linalg.eigvalsh(small).min() >= -1e-12


def test_an_outlier_is_drawn_towards_zero() -> None:
    spread = np.diag([4.0, 1.0])
    inside, beyond = 2.0 * np.sqrt(CHI_SQUARE), 2.0 * np.sqrt(2.0 * CHI_SQUARE)
    np.testing.assert_allclose(corrected(np.array([inside, -1.0]), spread), [inside, -1.0])
    np.testing.assert_allclose(corrected(np.array([-beyond, 0.5]), spread), [-beyond / np.e, 0.5])
    assert not corrected(np.zeros(2), np.zeros((2, 2))).any()


def test_the_noise_is_found_component_by_component() -> None:
    nominal, true = np.array([0.1, 0.1]), np.array([0.9, 0.02])
    rng = np.random.default_rng(1)
    noise = InnovationNoise(nominal, 60)
    followed(AdaptiveFilter(noise), rng.normal(size=(400, 50, 2)) * np.sqrt(true), BOTH)
    tracks = AdaptiveFilter(InnovationNoise(nominal, 60))
    measured = rng.normal(size=(300, 100, 2)) * np.sqrt(true)
    followed(tracks, measured, BOTH)
    adapted = tracks.update(np.arange(100), measured[-1], BOTH)
    found = np.diagonal(adapted.noise, axis1=1, axis2=2).mean(axis=0)
    np.testing.assert_allclose(found, true, rtol=0.1)


def test_nothing_is_learnt_while_the_window_fills() -> None:
    size = 8
    noise = InnovationNoise(np.array([1.0]), size)
    noise.spawn(1)
    predicted = np.full((1, 1, 1), 0.5)
    for _ in range(size - 1):
        adapted = noise.observe(ONE, np.array([[40.0]]), predicted)
        assert adapted.noise == 1.0
        assert adapted.innovation == 40.0
        assert adapted.spread == 1.5
    assert noise.observe(ONE, np.array([[40.0]]), predicted).noise == pytest.approx(40.0**2 - 0.5)
    noise.spawn(1)
    assert noise.observe(np.array([1]), np.array([[40.0]]), predicted).noise == 1.0


@pytest.mark.parametrize("factor", [4.0, 40.0, 200.0, 1e4])
def test_no_burst_locks_a_sensor_out(factor: float) -> None:
    """R grows to what the burst is, the state stays near, and after it R comes back."""
    rng, n, variance = np.random.default_rng(2), 60, 0.09
    burst = np.ones(500)
    burst[150:300] = factor
    measured = rng.normal(size=(500, n, 1)) * np.sqrt(variance * burst)[:, None, None]
    tracks = AdaptiveFilter(InnovationNoise(np.array([variance])))
    tracks.spawn(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    found = np.empty(500)
    error = np.empty(500)
    for k, seen in enumerate(measured):
        tracks.predict(CA.transition, CA.noise)
        found[k] = tracks.update(np.arange(n), seen, BOTH[:1]).noise.mean()
        error[k] = np.sqrt(np.square(tracks.mean[:, 0]).mean())
    assert found[200:300].mean() == pytest.approx(factor * variance, rel=0.25)
    assert found[380:].mean() == pytest.approx(variance, rel=0.1)
    assert error[200:300].mean() < 0.35 * np.sqrt(factor * variance) + 0.1
    assert error[420:].mean() < 1.5 * error[100:150].mean()


def test_corrected_innovations_in_the_window_would_lock_it_out() -> None:
    window, rng, rows, factor = InnovationWindow(30, 1), np.random.default_rng(0), np.arange(100), 200.0
    window.spawn(len(rows))
    for k in range(600):
        innovation = rng.normal(size=(len(rows), 1)) * (1.0 if k < 100 else np.sqrt(factor))
        window.push(rows, corrected(innovation, window.covariance(rows)) if k >= 30 else innovation)
    assert (window.covariance(rows) < 0.01).mean() > 0.8


def test_process_noise_is_learnt_where_the_told_one_is_too_small() -> None:
    """A target that sways by 3 m/s² under a Q for none: Q̂ halves the error; without the sway it costs as much."""
    rng, n, steps = np.random.default_rng(4), 40, 600
    t = DT * np.arange(1, steps + 1)
    quiet = white_axis(DT, 1e-4, order=2)
    for amplitude, least, most in ((3.0, 2.0, np.inf), (0.0, 0.5, 1.0)):
        truth = amplitude / 0.36 * (1 - np.cos(0.6 * t))
        measured = truth[:, None, None] + 0.3 * rng.normal(size=(steps, n, 1))
        errors = []
        for process in (False, True):
            tracks = AdaptiveFilter(InnovationNoise(np.array([0.09]), learning=False), process=process)
            tracks.spawn(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
            estimates = np.empty((steps, n))
            for k, seen in enumerate(measured):
                tracks.predict(quiet.transition, quiet.noise)
                tracks.update(np.arange(n), seen, BOTH[:1])
                estimates[k] = tracks.mean[:, 0]
            errors.append(np.sqrt(np.square(estimates - truth[:, None])[100:].mean()))
        assert least < errors[0] / errors[1] < most


def test_rows_do_not_touch_each_other() -> None:
    rng, steps = np.random.default_rng(5), 60
    measured = rng.normal(size=(steps, 3, 2)) * (1.0, 3.0)
    together = AdaptiveFilter(InnovationNoise(np.ones(2), 10))
    followed(together, measured, BOTH)
    together.keep(np.array([2, 0]))
    for k, row in enumerate((2, 0)):
        alone = AdaptiveFilter(InnovationNoise(np.ones(2), 10))
        followed(alone, measured[:, row : row + 1], BOTH)
        np.testing.assert_allclose(together.mean[k], alone.mean[0], atol=1e-12)
        np.testing.assert_allclose(together.covariance[k], alone.covariance[0], atol=1e-12)
    assert len(together) == 2


def test_huge_and_certain_inputs_stay_finite() -> None:
    tracks = AdaptiveFilter(InnovationNoise(np.ones(2), 3), process=True)
    tracks.spawn(np.zeros((2, 3)), np.stack([1e60 * np.eye(3), np.zeros((3, 3))]))
    for size in (1e60, 0.0, 1e60, 1.0, 1.0, 0.0):
        tracks.predict(CA.transition, 0.0 * CA.noise)
        adapted = tracks.update(np.arange(2), np.full((2, 2), size), BOTH)
        for array in (tracks.mean, tracks.covariance, adapted.noise, adapted.innovation):
            assert np.isfinite(array).all()
