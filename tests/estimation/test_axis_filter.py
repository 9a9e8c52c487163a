"""The batched filter of axes against filterpy's filter, an axis an object, and what it must survive."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.axis_filter import AxisFilter, AxisModel, WhiteAxis
from candaemon.estimation.discretisation import decaying_axis, white_axis
from candaemon.estimation.motion_models import CurrentStatistical, Singer
from candaemon.papers.profiles import Pieces, motion
from tests.support.builders import random_covariance
from tests.support.effort import examples
from tests.support.long_runs import few_and_many_cycles

SEEDS = st.integers(0, 2**32 - 1)
MODELS = st.one_of(
    st.builds(WhiteAxis, st.sampled_from((1, 2, 3)), st.floats(0.0, 10.0)),
    st.builds(Singer, st.floats(0.01, 3.0), st.floats(0.0, 5.0)),
    st.builds(CurrentStatistical, st.floats(0.01, 3.0), st.floats(1.0, 12.0), st.floats(0.0, 2.0)),
)
EACH_MODEL = (
    WhiteAxis(1, 0.1),
    WhiteAxis(2, 5.0),
    WhiteAxis(3, 5.0),
    Singer(0.5, 3.0),
    CurrentStatistical(0.5, 10.0, 1.0),
    CurrentStatistical(1.0 / 60.0, 10.0, 0.0, innovation_memory=1.0),
)


def states_of(model: AxisModel) -> int:
    return model.order + 1 if isinstance(model, WhiteAxis) else 3


def spawned(model: AxisModel, mean: Floats, covariance: Floats) -> AxisFilter:
    axes = AxisFilter(model)
    axes.spawn(mean, covariance)
    return axes


def vague(model: AxisModel, axes: int, deviation: float = 3.0) -> AxisFilter:
    """Return axes in the origin, of which each state has the same standard deviation."""
    size = states_of(model)
    return spawned(model, np.zeros((axes, size)), np.tile(deviation**2 * np.eye(size), (axes, 1, 1)))


def textbook_predict(kf: KalmanFilter, model: AxisModel, dt: float) -> None:
    """Predict with filterpy's x = F x + B u and P = F P Fᵀ + Q."""
    size = states_of(model)
    if isinstance(model, WhiteAxis):
        axis = white_axis(dt, model.noise, order=model.order)
        kf.predict(F=axis.transition[:size, :size], Q=axis.noise[:size, :size])
    elif isinstance(model, Singer):
        axis = decaying_axis(model.alpha, dt, 2 * model.alpha * model.deviation**2, order=2)
        kf.predict(F=axis.transition, Q=axis.noise)
    else:
        acceleration = kf.x[2:]
        room = max(model.limit - abs(float(acceleration[0, 0])), 0.0)
        variance = max((4 - np.pi) / np.pi * room**2, model.floor)
        axis = decaying_axis(model.alpha, dt, 2 * model.alpha * variance, order=2)
        kf.predict(u=acceleration, B=axis.input[:, None], F=axis.transition, Q=axis.noise)


@settings(deadline=None, max_examples=examples(100))
@given(seed=SEEDS, model=MODELS, axes=st.integers(1, 5))
def test_the_batched_filter_equals_filterpys_on_each_axis(seed: int, model: AxisModel, axes: int) -> None:
    """With time steps that vary, noise that does, and some axes measured only."""
    rng, size = np.random.default_rng(seed), states_of(model)
    mean, covariance = rng.normal(size=(axes, size)) * 5, random_covariance(rng, size, axes)
    batch = spawned(model, mean, covariance)
    textbook = []
    for k in range(axes):
        kf = KalmanFilter(dim_x=size, dim_z=1)
        kf.x, kf.P, kf.H = mean[k][:, None].copy(), covariance[k].copy(), np.eye(1, size)
        textbook.append(kf)
    for dt in rng.choice((0.01, 0.05, 0.1, 0.5), 8):
        rows = np.flatnonzero(rng.random(axes) < 0.7)
        z, variance = rng.normal(size=len(rows)) * 5, rng.uniform(0.01, 4.0, len(rows))
        batch.predict(dt)
        batch.update(z, variance, rows)
        for kf in textbook:
            textbook_predict(kf, model, dt)
        for m, row in enumerate(rows):
            textbook[row].update(z[m : m + 1, None], R=variance[m])
            assert batch.fit.log_likelihood[m] == pytest.approx(textbook[row].log_likelihood, rel=1e-9, abs=1e-9)
            assert batch.fit.nis[m] == pytest.approx(textbook[row].mahalanobis ** 2, rel=1e-9, abs=1e-12)
    np.testing.assert_allclose(batch.mean, [kf.x[:, 0] for kf in textbook], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(batch.covariance, [kf.P for kf in textbook], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("model", EACH_MODEL, ids=repr)
@few_and_many_cycles
def test_the_axis_filter_stays_sound_over_many_cycles(model: AxisModel, cycles: int) -> None:
    rng = np.random.default_rng(1)
    axes = vague(model, 4)
    noise = np.array([0.01, 0.1, 1.0, 30.0])
    measured = 20.0 * np.sin(0.01 * np.arange(cycles))[:, None] + noise * rng.normal(size=(cycles, 4))
    scale = 0.05 ** -np.arange(states_of(model))
    for k, z in enumerate(measured):
        axes.predict(0.05)
        axes.update(z, noise**2)
        if k % 1_000 == 999:
            covariance = axes.covariance / np.outer(scale, scale)
            np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
            assert np.linalg.eigvalsh(covariance).min() > 0.0
            assert np.isfinite(axes.mean).all()


@pytest.mark.parametrize("model", EACH_MODEL, ids=repr)
@pytest.mark.parametrize("deviation", [0.0, 1e-30, 1e6, 1e60])
@pytest.mark.parametrize("noise", [0.0, 1e-30, 1e60])
@pytest.mark.parametrize("position", [0.0, 1e60])
def test_singular_and_huge_input_leaves_no_nan(
    model: AxisModel, deviation: float, noise: float, position: float
) -> None:
    axes = vague(model, 2, deviation)
    for dt in (0.0, 0.05, 100.0):
        axes.predict(dt)
        axes.update(np.array([position, -position]), noise)
        assert np.isfinite(axes.mean).all()
        assert np.isfinite(axes.covariance).all()
        assert np.isfinite(axes.fit.nis).all()
        assert np.isfinite(axes.fit.log_likelihood).all()
        assert (np.diagonal(axes.covariance, axis1=1, axis2=2) >= 0.0).all()


@pytest.mark.parametrize("model", EACH_MODEL, ids=repr)
def test_an_update_may_come_before_the_first_prediction(model: AxisModel) -> None:
    axes, size = vague(model, 1), states_of(model)
    axes.update(np.array([2.0]), 1.0)
    np.testing.assert_allclose(axes.mean[0], [1.8] + [0.0] * (size - 1))
    axes.predict(0.1)
    axes.update(np.array([2.0]), 1.0)
    assert np.isfinite(axes.mean).all()
    assert np.isfinite(axes.covariance).all()


def test_an_exact_position_is_taken_over_and_a_vague_one_teaches_nothing() -> None:
    axes = vague(WhiteAxis(2, 5.0), 2)
    axes.predict(0.1)
    before = axes.mean, axes.covariance
    axes.update(np.array([7.0, -3.0]), np.array([0.0, 1e18]))
    np.testing.assert_allclose(axes.mean[0, 0], 7.0, rtol=1e-12)
    np.testing.assert_allclose(axes.covariance[0, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(axes.mean[1], before[0][1], atol=1e-12)
    np.testing.assert_allclose(axes.covariance[1], before[1][1], rtol=1e-12)


@pytest.mark.parametrize("model", EACH_MODEL, ids=repr)
def test_no_time_changes_nothing(model: AxisModel) -> None:
    rng, size = np.random.default_rng(5), states_of(model)
    mean, covariance = rng.normal(size=(3, size)), random_covariance(rng, size, 3)
    axes = spawned(model, mean, covariance)
    axes.predict(0.0)
    np.testing.assert_allclose(axes.mean, mean, rtol=1e-14)
    np.testing.assert_allclose(axes.covariance, covariance, rtol=1e-14)


def test_axes_are_kept_and_appended_without_a_change() -> None:
    rng, model = np.random.default_rng(2), CurrentStatistical(0.5, 8.0, 1.0, innovation_memory=0.5)
    both, alone = vague(model, 3), vague(model, 1)
    for _ in range(30):
        z = rng.normal(size=3)
        both.predict(0.1)
        both.update(z, 0.25)
        alone.predict(0.1)
        alone.update(z[2:], 0.25)
    both.keep(np.array([2, 0]))
    both.spawn(np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    assert len(both) == 4
    np.testing.assert_allclose(both.mean[2:], 1.0)
    both.predict(0.1)
    alone.predict(0.1)
    np.testing.assert_allclose(both.mean[0], alone.mean[0], rtol=1e-12)
    np.testing.assert_allclose(both.covariance[0], alone.covariance[0], rtol=1e-12)
    both.keep(np.zeros(4, dtype=np.bool_))
    both.predict(0.1)
    both.update(np.zeros(0), 0.25)
    assert both.mean.shape == (0, 3)
    assert both.covariance.shape == (0, 3, 3)


def test_what_is_told_stays_as_it_was_told() -> None:
    axes = vague(WhiteAxis(2, 5.0), 2)
    mean, covariance = axes.mean, axes.covariance
    kept = mean.copy(), covariance.copy()
    axes.predict(0.1)
    axes.update(np.ones(2), 1.0)
    np.testing.assert_array_equal(mean, kept[0])
    np.testing.assert_array_equal(covariance, kept[1])


def errors(model: AxisModel, pieces: Pieces, runs: int = 40) -> Floats:
    """Return the RMSE of position, velocity and acceleration after 2 s, T = 0.1 s, noise of 1 m."""
    truth = motion(0.1, pieces, ((40.0, 0.0),), (15.0, 0.0))
    measured = truth.measured(1.0, runs, np.random.default_rng(3))[..., 0]
    axes = spawned(model, np.tile([0.0, 15.0, 0.0], (runs, 1)), np.tile(np.diag([1.0, 25.0, 9.0]), (runs, 1, 1)))
    squares = []
    for z, state in zip(measured, truth.state[:, ::2], strict=True):
        axes.predict(0.1)
        axes.update(z, 1.0)
        squares.append(np.square(axes.mean - state).mean(axis=0))
    rms: Floats = np.sqrt(np.mean(squares[20:], axis=0))
    return rms


def test_a_variance_driven_by_the_innovations_is_quieter_and_no_slower() -> None:
    plain, driven = (CurrentStatistical(0.5, 10.0, 1.0, innovation_memory=memory) for memory in (None, 1.0))
    steady: Pieces = ((40.0, 0.0),)
    assert (errors(driven, steady) < errors(plain, steady) * (0.9, 0.65, 0.5)).all()
    manoeuvres: Pieces = (
        (5.0, 0.0),
        (7.0, 2.0),
        (6.0, 0.0),
        (7.0, -3.0),
        (5.0, 0.0),
        (3.0, 1.5),
        (3.0, -1.5),
        (4.0, 0.0),
    )
    assert (errors(driven, manoeuvres) < errors(plain, manoeuvres)).all()
