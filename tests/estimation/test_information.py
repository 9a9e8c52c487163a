"""Information filters against filterpy, against the Kalman filter, and from knowing nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from filterpy.kalman import InformationFilter as Oracle
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation import information, kalman
from candaemon.estimation.information import InformationFilter, contribution
from tests.support.builders import random_covariance
from tests.support.effort import examples
from tests.support.long_runs import few_and_many_cycles

SEEDS = st.integers(0, 2**32 - 1)
CONSTANT_VELOCITY = np.array([[[1.0, 0.1], [0.0, 1.0]]])
POSITION = np.array([[[1.0, 0.0]]])


def assert_close(ours: Floats, theirs: Floats, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance * max(float(np.abs(theirs).max()), 1.0))


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, size=st.integers(1, 7), measured=st.integers(1, 4))
def test_a_linear_system_is_filterpys(seed: int, size: int, measured: int) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = rng.normal(size=(1, size)), random_covariance(rng, size)
    f, h = np.eye(size) + 0.2 * rng.normal(size=(1, size, size)), rng.normal(size=(1, measured, size))
    assume(np.linalg.cond(f) <= 100)  # filterpy's filter inverts F and loses as many digits
    q, r = random_covariance(rng, size), random_covariance(rng, measured)
    oracle = Oracle(size, measured, compute_log_likelihood=False)
    oracle.x, oracle.P_inv, oracle.F = mean[0][:, None].copy(), np.linalg.inv(covariance[0]), f[0]
    oracle.Q, oracle.H, oracle.R_inv = q[0], h[0], np.linalg.inv(r[0])
    ours = InformationFilter.known(mean, covariance)
    for z in rng.normal(size=(10, 1, measured)) * 3:
        ours.predict(f, q)
        ours.update(z - ours.mean @ h[0].T, h, r)
        oracle.predict()
        oracle.update(z.T)
        assert_close(ours.mean[0], oracle.x[:, 0])
        assert_close(ours.matrix[0], oracle.P_inv)
        np.testing.assert_array_equal(ours.matrix, ours.matrix.swapaxes(1, 2))


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, n=st.integers(1, 4), size=st.integers(1, 7), measured=st.integers(1, 9))
def test_an_update_in_information_form_is_the_kalman_filters(seed: int, n: int, size: int, measured: int) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = rng.normal(size=(n, size)) * 10, random_covariance(rng, size, n)
    covariance[0, -1, :] = covariance[0, :, -1] = 0.0  # of one state a component is certain
    innovation, noise = rng.normal(size=(n, measured)) * 10, random_covariance(rng, measured, n)
    observation = rng.normal(size=(n, measured, size))
    informed, informed_covariance = mean.copy(), covariance.copy()
    expected = kalman.update(mean, covariance, innovation, observation, noise)
    fit = information.update(informed, informed_covariance, innovation, observation, noise)
    assert_close(informed, mean)
    assert_close(informed_covariance, covariance)
    assert_close(fit.nis, expected.nis)
    assert_close(fit.log_likelihood, expected.log_likelihood)


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS, size=st.integers(1, 6), measured=st.integers(1, 3))
def test_prediction_and_update_are_equations_12_to_14(seed: int, size: int, measured: int) -> None:
    rng = np.random.default_rng(seed)
    y, matrix = rng.normal(size=(1, size)), random_covariance(rng, size)
    f, q = np.eye(size) + 0.2 * rng.normal(size=(1, size, size)), random_covariance(rng, size)
    h, r, z = rng.normal(size=(1, measured, size)), random_covariance(rng, measured), rng.normal(size=(1, measured))
    assume(np.linalg.cond(f) <= 100)
    ours = InformationFilter(y, matrix)
    ours.predict(f, q)
    inverse = np.linalg.inv(matrix[0])
    predicted = np.linalg.inv(f[0] @ inverse @ f[0].T + q[0])  # (12)
    carry = predicted @ f[0] @ inverse  # (14)
    assert_close(ours.matrix[0], predicted)
    assert_close(ours.state[0], carry @ y[0])
    ours.update(z - ours.mean @ h[0].T, h, r)
    weight = h[0].T @ np.linalg.inv(r[0])
    assert_close(ours.matrix[0], predicted + weight @ h[0])  # (13)
    assert_close(ours.state[0], carry @ y[0] + weight @ z[0])


def batch_estimate(f: Floats, q: Floats, h: Floats, r: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return the last state and its covariance by weighted least squares over all measurements, knowing nothing else.

    A measurement is H times the last state carried back, less the disturbances carried back that came in between.
    """
    steps, size = len(z), len(f)
    back = np.linalg.inv(f)
    rows = [h @ np.linalg.matrix_power(back, steps - 1 - k) for k in range(steps)]
    effect = np.zeros((steps, len(h), steps, size))
    for k in range(steps):
        for j in range(k + 1, steps):
            effect[k, :, j] = -h @ np.linalg.matrix_power(back, j - k)
    disturbed = effect.reshape(steps * len(h), steps * size)
    weight = np.linalg.inv(disturbed @ np.kron(np.eye(steps), q) @ disturbed.T + np.kron(np.eye(steps), r))
    a = np.concatenate(rows)
    spread = np.linalg.inv(a.T @ weight @ a)
    return spread @ a.T @ weight @ z.reshape(-1), spread


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, size=st.integers(1, 4), disturbed=st.integers(0, 4))
def test_from_knowing_nothing_it_is_least_squares(seed: int, size: int, disturbed: int) -> None:
    """A chain of derivatives whose first is measured; its Q is singular, or nothing at all."""
    rng = np.random.default_rng(seed)
    f, h, r = np.eye(size) + np.diag(np.full(size - 1, 0.5), 1), np.eye(1, size), np.array([[0.3]])
    root = rng.normal(size=(size, min(disturbed, size)))
    q = root @ root.T
    ours = InformationFilter.unknown(1, size)
    z = rng.normal(size=(size + 4, 1)) * 5
    for k, value in enumerate(z):
        assert ours.determined.tolist() == [k >= size]
        assert np.isfinite(ours.mean).all()
        assert np.isfinite(ours.covariance).all()
        if k:
            ours.predict(f[None], q[None])
        ours.update(value[None] - ours.mean @ h.T, h[None], r[None])
        if k + 1 >= size:
            mean, covariance = batch_estimate(f, q, h, r, z[: k + 1])
            assert_close(ours.mean[0], mean, 1e-8)
            assert_close(ours.covariance[0], covariance, 1e-8)


def test_nothing_stays_nothing() -> None:
    ours = InformationFilter.unknown(3, 2)
    ours.predict(CONSTANT_VELOCITY, np.eye(2)[None])
    assert not ours.state.any()
    assert not ours.matrix.any()
    assert not ours.mean.any()
    assert not ours.determined.any()


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS, sensors=st.integers(2, 4))
def test_sensors_add_up_in_any_order(seed: int, sensors: int) -> None:
    """Each sensor's contribution alone, all added, is one update with all of them."""
    rng = np.random.default_rng(seed)
    size, n = 4, 3
    mean, covariance = rng.normal(size=(n, size)), random_covariance(rng, size, n)
    h, z = rng.normal(size=(sensors, n, 2, size)), rng.normal(size=(sensors, n, 2))
    r = random_covariance(rng, 2, sensors * n).reshape(sensors, n, 2, 2)
    fused = InformationFilter.known(mean, covariance)
    for k in rng.permutation(sensors):
        fused.add(*contribution(mean, z[k] - (h[k] @ mean[..., None])[..., 0], h[k], r[k]))
    stacked = np.zeros((n, 2 * sensors, 2 * sensors))
    for k in range(sensors):
        stacked[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = r[k]
    everything = np.concatenate(list(h), axis=1)
    innovation = np.concatenate(list(z), axis=1) - (everything @ mean[..., None])[..., 0]
    kalman.update(mean, covariance, innovation, everything, stacked)
    assert_close(fused.mean, mean)
    assert_close(fused.covariance, covariance)


def test_filters_that_saw_different_components_complete_each_other() -> None:
    first, second = InformationFilter.unknown(1, 2), InformationFilter.unknown(1, 2)
    first.update(np.array([[4.0]]), np.array([[[1.0, 0.0]]]), np.array([[[0.5]]]))
    second.update(np.array([[-3.0]]), np.array([[[0.0, 1.0]]]), np.array([[[0.25]]]))
    assert not first.determined.any()
    first.add(second.state, second.matrix)
    assert first.determined.all()
    np.testing.assert_allclose(first.mean, [[4.0, -3.0]], rtol=1e-12)
    np.testing.assert_allclose(first.covariance[0], np.diag([0.5, 0.25]), rtol=1e-12, atol=1e-15)


def test_states_come_and_go() -> None:
    rng = np.random.default_rng(7)
    ours = InformationFilter.known(rng.normal(size=(3, 2)), random_covariance(rng, 2, 3))
    mean = ours.mean
    ours.spawn(np.zeros((2, 2)), np.zeros((2, 2, 2)))
    assert len(ours) == 5
    assert ours.determined.tolist() == [True, True, True, False, False]
    ours.keep(np.array([4, 2]))
    np.testing.assert_array_equal(ours.mean, np.stack([np.zeros(2), mean[2]]))
    ours.keep(np.zeros(2, dtype=np.bool_))
    ours.predict(CONSTANT_VELOCITY, np.eye(2)[None])
    ours.update(np.zeros((0, 1)), POSITION, np.eye(1)[None])
    assert len(ours) == len(ours.mean) == len(ours.covariance) == 0


@pytest.mark.parametrize(
    "act",
    [
        lambda: InformationFilter.known(np.zeros((1, 2)), np.diag([1.0, 0.0])[None]),
        lambda: InformationFilter.unknown(1, 2).update(np.ones((1, 1)), POSITION, np.zeros((1, 1, 1))),
        lambda: information.update(np.zeros((1, 2)), np.eye(2)[None], np.ones((1, 1)), POSITION, np.zeros((1, 1, 1))),
    ],
    ids=["known", "filter", "update"],
)
def test_infinite_information_is_refused(act: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match="infinite information"):
        act()


@settings(deadline=None, max_examples=examples(200))
@given(
    seed=SEEDS,
    size=st.integers(1, 9),
    measured=st.integers(1, 4),
    rank=st.integers(0, 9),
    powers=st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-100, 100), st.floats(-100, 100)),
)
def test_singular_and_huge_inputs_stay_finite_and_positive_semidefinite(
    seed: int, size: int, measured: int, rank: int, powers: tuple[float, float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    known, disturbance, noise, surprise = (10.0**power for power in powers)
    root = rng.normal(size=(1, size, min(rank, size)))
    matrix = known * (root @ root.swapaxes(1, 2))
    r, h = noise * random_covariance(rng, measured), rng.normal(size=(1, measured, size))
    innovation = surprise * rng.normal(size=(1, measured))
    mean, covariance = rng.normal(size=(1, size)), matrix.copy()
    fit = information.update(mean, covariance, innovation, h, r)
    ours = InformationFilter((matrix @ rng.normal(size=(size, 1)))[..., 0], matrix)
    few = rng.normal(size=(1, size, 1))
    ours.predict(np.eye(size)[None] + np.diag(np.ones(size - 1), 1), disturbance * (few @ few.swapaxes(1, 2)))
    ours.update(innovation, h, r)
    assert np.isfinite([fit.nis, fit.log_likelihood]).all()
    for each in (mean, covariance, ours.state, ours.matrix, ours.mean, ours.covariance):
        assert np.isfinite(each).all()
    for each in (covariance[0], ours.matrix[0]):
        np.testing.assert_array_equal(each, each.T)
        scale = np.sqrt(np.maximum(np.diagonal(each), 1e-300))
        assert np.linalg.eigvalsh(each / scale[:, None] / scale).min() >= -1e-12


@few_and_many_cycles
def test_many_cycles_keep_information_positive_definite(cycles: int) -> None:
    """From knowing nothing; constant velocity at T = 0.05 s in two tracks, position measured to 0.1 m."""
    f = np.array([[[1.0, 0.05], [0.0, 1.0]]])
    q = 0.1 * np.array([[[0.05**3 / 3, 0.05**2 / 2], [0.05**2 / 2, 0.05]]])
    r = np.array([[[0.01]]])
    ours = InformationFilter.unknown(2, 2)
    for noise in np.random.default_rng(8).normal(size=(cycles, 2, 1)) * 0.1:
        ours.predict(f, q)
        ours.update(noise, POSITION, r)
    assert np.isfinite(ours.state).all()
    np.testing.assert_array_equal(ours.matrix, ours.matrix.swapaxes(1, 2))
    assert np.linalg.eigvalsh(ours.matrix).min() > 0.0
    mean, covariance = np.zeros((1, 2)), np.eye(2)[None]
    for _ in range(2000):
        kalman.predict(mean, covariance, f, q)
        kalman.update(mean, covariance, np.zeros((1, 1)), POSITION, r)
    np.testing.assert_allclose(ours.covariance, covariance.repeat(2, axis=0), rtol=1e-9)
