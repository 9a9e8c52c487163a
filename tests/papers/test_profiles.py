"""Motions of constant accelerations, the bound for who tracks them, and the baseline on filterpy."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from candaemon.estimation.discretisation import white_axis
from candaemon.papers.baselines import linear
from candaemon.papers.profiles import bound, motion
from candaemon.papers.tracking import rmse
from tests.support.builders import random_covariance


def test_a_motion_is_the_closed_form_between_its_changes() -> None:
    truth = motion(0.5, ((2.0, 3.0), (1.0, -1.0)), ((3.0, 0.5),), (4.0, -1.0))
    np.testing.assert_allclose(truth.time, [0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(truth.state[3], [14.0, -1.0, 10.0, 0.0, 3.0, 0.5])  # 4 t + 3/2 t², −t + t²/4 at 2 s
    np.testing.assert_allclose(truth.state[5], [23.5, -0.75, 9.0, 0.5, -1.0, 0.5])
    np.testing.assert_array_equal(truth.opening[:, 0], [False, False, False, False, True, False])
    assert not truth.opening[:, 1].any()


def test_measured_positions_have_the_noise_that_was_asked_for() -> None:
    truth = motion(0.1, ((20.0, 1.0),), ((20.0, 0.0),))
    noise = truth.measured(0.3, 50, np.random.default_rng(1)) - truth.state[:, None, :2]
    assert noise.shape == (200, 50, 2)
    np.testing.assert_allclose(noise.std(axis=(0, 1)), 0.3, rtol=0.03)
    assert abs((noise[..., 0] * noise[..., 1]).mean()) < 0.03 * 0.3**2


def test_the_bound_is_the_best_of_kalman_filters() -> None:
    """Whatever their noise, those that are not told when the acceleration changes do worse, on each axis."""
    truth = motion(0.1, ((8.0, 0.0), (8.0, 2.0), (8.0, -1.0)), ((24.0, 0.0),), (10.0, 0.0))
    measured = truth.measured(1.0, 30, np.random.default_rng(2))
    best = rmse(bound(truth, measured, 1.0, 1.0), truth.state)
    for noise in (0.0, 1e-3, 0.1, 1.0, 10.0):
        axis = white_axis(0.1, noise, order=2)
        first = np.array([0.0, 10.0, 0.0])
        estimates = linear(axis.transition, axis.noise, np.eye(1, 3), np.eye(1), first, np.eye(3), measured[..., :1])
        assert (best[::2] < rmse(estimates, truth.state[:, ::2])).all()
    assert best[5] < 1e-9  # told that y never accelerates


def test_the_bound_of_one_acceleration_is_filterpys_filter_without_noise() -> None:
    truth = motion(0.1, ((5.0, 3.0),), ((5.0, 0.3),), (4.0, -1.0))
    measured = truth.measured(0.5, 3, np.random.default_rng(4))
    estimates, transition = bound(truth, measured, 0.5, 2.0), white_axis(0.1, 0.0, order=2).transition
    for axis, velocity, acceleration in ((0, 4.0, 3.0), (1, -1.0, 0.3)):
        first, known = np.array([0.0, velocity, 0.0]), np.diag([4.0, 4.0, acceleration**2])
        along = measured[..., axis : axis + 1]
        expected = linear(transition, np.zeros((3, 3)), np.eye(1, 3), 0.25 * np.eye(1), first, known, along)
        np.testing.assert_allclose(estimates[..., axis::2], expected, rtol=1e-9, atol=1e-9)


def test_the_bound_forgets_the_acceleration_where_it_changes_and_nothing_else() -> None:
    """Of a sensor without noise it has the new acceleration a step later, of one that is blind it keeps none."""
    truth = motion(0.1, ((2.0, 2.0), (2.0, -1.0)), ((4.0, 0.0),))
    sharp = bound(truth, truth.measured(1e-6, 2, np.random.default_rng(5)), 1e-6, 1.0)
    np.testing.assert_allclose(sharp[2:, 0, 4], truth.state[2:, 4], atol=0.01)
    blind = bound(truth, truth.measured(1.0, 2, np.random.default_rng(6)), 1e9, 1.0)
    np.testing.assert_allclose(blind[..., 4], 0.0, atol=1e-6)


@pytest.mark.parametrize("own_start", [False, True])
def test_the_baseline_is_filterpys_filter_of_each_run(own_start: bool) -> None:
    rng = np.random.default_rng(3)
    transition, observation = np.eye(4) + 0.1 * rng.normal(size=(4, 4)), rng.normal(size=(2, 4))
    noise, spread, covariance = (random_covariance(rng, size)[0] for size in (4, 2, 4))
    mean, measured = rng.normal(size=(3, 4) if own_start else 4), rng.normal(size=(20, 3, 2))
    estimates = linear(transition, noise, observation, spread, mean, covariance, measured)
    for run in range(3):
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.F, kf.Q, kf.H, kf.R, kf.P = transition, noise, observation, spread, covariance
        kf.x = (mean[run] if own_start else mean)[:, None]
        for k in range(20):
            kf.predict()
            kf.update(measured[k, run][:, None])
            np.testing.assert_allclose(estimates[k, run], kf.x[:, 0], rtol=1e-9, atol=1e-12)
