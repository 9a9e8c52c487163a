"""The federated filter against the centralised one, and how it shares the information."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.estimation.discretisation import white_axis
from candaemon.estimation.federated import Federated, fused, information_shares
from candaemon.estimation.innovation_noise import InnovationNoise
from candaemon.estimation.variational_noise import VariationalNoise
from tests.support.builders import random_covariance
from tests.support.effort import examples
from tests.support.long_runs import few_and_many_cycles

ALONE = np.arange(1)


@settings(deadline=None, max_examples=examples(30))
@given(
    seed=st.integers(0, 2**32 - 1),
    sensors=st.integers(1, 4),
    width=st.integers(2, 6),
    steps=st.integers(1, 40),
)
def test_federated_is_the_centralised_filter(seed: int, sensors: int, width: int, steps: int) -> None:
    """With R known, whatever the shares and whoever is silent; fused and handed back after the updates of each step."""
    rng = np.random.default_rng(seed)
    mean, covariance = rng.normal(size=(1, width)), random_covariance(rng, width)
    sizes = rng.integers(1, width + 1, sensors).tolist()
    seen_by = [(rng.normal(size=(size, width)), random_covariance(rng, size)[0]) for size in sizes]
    f = np.eye(width) + 0.2 * rng.normal(size=(width, width))
    f /= max(1.0, np.abs(np.linalg.eigvals(f)).max())
    q = random_covariance(rng, width)[0]
    federated = Federated(sensors)
    federated.spawn(mean, covariance)
    oracle = KalmanFilter(dim_x=width, dim_z=1)
    oracle.x, oracle.P, oracle.F, oracle.Q = mean[0][:, None].copy(), covariance[0].copy(), f, q
    for _ in range(steps):
        federated.predict(f, q)
        oracle.predict()
        for sensor, (h, r) in enumerate(seen_by):
            if rng.random() < 0.3:
                continue
            measured = rng.normal(size=len(h))
            expected, _ = federated.expected(sensor, ALONE, h)
            federated.update(sensor, ALONE, measured - expected, h, r)
            oracle.update(measured[:, None], R=r, H=h)
        x, p = federated.fuse(rng.uniform(0.1, 30.0, (1, sensors)))
        np.testing.assert_allclose(x[0], oracle.x[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(p[0], oracle.P, rtol=1e-9, atol=1e-9)


def test_the_local_filters_must_be_fused_before_the_next_prediction() -> None:
    """Else each predicts what it alone has learnt, and the result depends on the shares."""
    axis = white_axis(0.1, 1.0, order=2)
    found = []
    for trace in ((1.0, 1.0), (1.0, 9.0)):
        federated = Federated(2)
        federated.spawn(np.zeros((1, 3)), np.eye(3)[None])
        federated.fuse(np.array([trace]))
        for _ in range(5):
            federated.predict(axis.transition, axis.noise)
            federated.update(0, ALONE, np.ones((1, 1)), np.eye(1, 3), 0.1 * np.eye(1))
        found.append(federated.combined()[1])
    assert np.abs(found[0] - found[1]).max() > 1e-4


def test_fusion_adds_information_and_bears_components_that_are_certain() -> None:
    rng = np.random.default_rng(1)
    mean, covariance = rng.normal(size=(7, 3, 4)), random_covariance(rng, 4, 21).reshape(7, 3, 4, 4)
    x, p = fused(mean, covariance)
    information = np.linalg.inv(covariance)
    np.testing.assert_allclose(p, np.linalg.inv(information.sum(axis=1)), rtol=1e-9)
    np.testing.assert_allclose(x, (p @ (information @ mean[..., None]).sum(axis=1))[..., 0], rtol=1e-9, atol=1e-12)
    wider = np.zeros((7, 3, 5, 5))
    wider[..., :4, :4] = covariance
    zero, certain = fused(np.concatenate([mean, np.zeros((7, 3, 1))], axis=2), wider)
    np.testing.assert_allclose(certain[:, :4, :4], p, rtol=1e-9)
    np.testing.assert_allclose(zero[:, :4], x, rtol=1e-9, atol=1e-12)
    assert not certain[:, 4].any()


@pytest.mark.parametrize(
    ("trace", "share"),
    [
        ((0.03, 0.1), (10 / 13, 3 / 13)),
        ((1.999, 0.1), (0.1 / 2.099, 1.999 / 2.099)),
        ((2.0, 0.1), (0.01, 0.99)),
        ((0.1, 7.0), (0.99, 0.01)),
        ((1.0, 3.0, 40.0), (0.99 * 0.75, 0.99 * 0.25, 0.01)),
        ((1.0, 30.0, 40.0), (0.98, 0.01, 0.01)),
        ((5.0,), (1.0,)),
        ((1.0, 1e9, 1e9, 1e9, 1e9), (0.96, 0.01, 0.01, 0.01, 0.01)),
    ],
)
def test_shares_are_the_papers(trace: tuple[float, ...], share: tuple[float, ...]) -> None:
    found = information_shares(np.array([trace, trace]))
    np.testing.assert_allclose(found, [share, share], rtol=1e-12)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("sensors", [1, 2, 4, 9])
def test_no_sensor_is_left_more_than_an_even_share(sensors: int) -> None:
    """All but one have failed, and the least share would be more than there is."""
    trace = np.full(sensors, 1e6)
    trace[0] = 1.0
    np.testing.assert_allclose(information_shares(trace, least=0.49), (0.51, 0.49) if sensors == 2 else 1.0 / sensors)


def test_what_a_sensor_is_expected_to_measure_does_not_depend_on_its_share() -> None:
    rng = np.random.default_rng(2)
    mean, covariance, h = rng.normal(size=(3, 4)), random_covariance(rng, 4, 3), rng.normal(size=(2, 4))
    federated = Federated(2)
    federated.spawn(mean, covariance)
    federated.fuse(np.array([(1.0, 1.0), (9.0, 1.0), (100.0, 1.0)]))
    for sensor in range(2):
        expected, spread = federated.expected(sensor, np.array([2, 0]), h)
        np.testing.assert_allclose(expected, mean[[2, 0]] @ h.T, rtol=1e-9)
        np.testing.assert_allclose(spread, h @ covariance[[2, 0]] @ h.T, rtol=1e-9)


def test_rows_do_not_touch_each_other() -> None:
    rng = np.random.default_rng(3)
    mean, covariance = rng.normal(size=(3, 2)), random_covariance(rng, 2, 3)
    federated = Federated(2)
    federated.spawn(mean[:2], covariance[:2])
    federated.spawn(mean[2:], covariance[2:])
    federated.update(1, np.array([2]), np.ones((1, 1)), np.eye(1, 2), np.eye(1))
    federated.keep(np.array([0, 2]))
    x, p = federated.combined()
    np.testing.assert_allclose(x[0], mean[0], rtol=1e-9)
    np.testing.assert_allclose(p[0], covariance[0], rtol=1e-9)
    gain = covariance[2, :, 0] / (covariance[2, 0, 0] + 1.0)
    np.testing.assert_allclose(p[1], covariance[2] - np.outer(gain, covariance[2, 0]), rtol=1e-9)
    assert len(federated) == 2


@few_and_many_cycles
def test_many_cycles_of_two_sensors_by_turns(cycles: int) -> None:
    """With a window for one sensor's noise and variational Bayes for the other's: finite, symmetric, positive."""
    axis, h = white_axis(0.05, 1.0, order=1), np.eye(1, 2)
    f, q = axis.transition[:2, :2], axis.noise[:2, :2]
    estimators = (InnovationNoise(np.array([0.04])), VariationalNoise(np.array([0.25])))
    federated = Federated(2)
    federated.spawn(np.zeros((1, 2)), np.eye(2)[None])
    for estimator in estimators:
        estimator.spawn(1)
    measured = np.random.default_rng(5).normal(size=cycles) * np.tile([0.2, 0.5], cycles // 2)
    trace = np.array([[0.04, 0.25]])
    for k, seen in enumerate(measured.tolist()):
        sensor = k % 2
        federated.predict(f, q)
        expected, spread = federated.expected(sensor, ALONE, h)
        adapted = estimators[sensor].observe(ALONE, seen - expected, spread)
        federated.update(sensor, ALONE, adapted.innovation, h, adapted.noise)
        trace[0, sensor] = adapted.noise[0, 0, 0]
        x, p = federated.fuse(trace)
        if k % 500 == 0:
            assert np.isfinite(x).all()
            assert (p[0] == p[0].T).all()
            assert np.linalg.eigvalsh(p[0]).min() > 0.0
    assert abs(x[0, 0]) < 1.0
