"""Every second form of the Kalman update agrees with the reference, `kalman.predict` and `kalman.update`."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.config.gnss import DriftFilterSettings
from candaemon.ego.fix_filters import DriftFilter
from candaemon.estimation import information, kalman
from candaemon.estimation.axis_filter import AxisFilter, WhiteAxis, axis_matrices
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import Singer
from candaemon.estimation.plane_filter import PlaneFilter
from candaemon.estimation.radial import ModifiedLinearKalman

TRACKS = 64
RANDOM = np.random.default_rng(5)
agree = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)


def covariances(size: int) -> Floats:
    root = RANDOM.standard_normal((TRACKS, size, size))
    return np.asarray(root @ np.swapaxes(root, 1, 2) + np.eye(size))


MEAN, COVARIANCE = RANDOM.standard_normal((TRACKS, 6)), covariances(6)
POSITION, NOISE = RANDOM.standard_normal((TRACKS, 2)), covariances(2)
OBSERVED = np.eye(6)[:2]


def reference(innovation: Floats, observation: Floats, noise: Floats) -> tuple[Floats, Floats, kalman.Fit]:
    mean, covariance = MEAN.copy(), COVARIANCE.copy()
    return mean, covariance, kalman.update(mean, covariance, innovation, observation, noise)


def assert_same(found: tuple[Floats, Floats, kalman.Fit], expected: tuple[Floats, Floats, kalman.Fit]) -> None:
    agree(found[0], expected[0])
    agree(found[1], expected[1])
    agree(found[2].nis, expected[2].nis)
    agree(found[2].log_likelihood, expected[2].log_likelihood)


def test_position() -> None:
    mean, covariance = MEAN.copy(), COVARIANCE.copy()
    fit = kalman.update_position(mean, covariance, POSITION, NOISE)
    assert_same((mean, covariance, fit), reference(POSITION - MEAN[:, :2], OBSERVED, NOISE))


def test_one_scalar() -> None:
    row, value, variance = RANDOM.standard_normal((TRACKS, 4)), RANDOM.standard_normal(TRACKS), np.full(TRACKS, 0.3)
    mean, covariance = MEAN.copy(), COVARIANCE.copy()
    fit = kalman.update_scalar(mean, covariance, row, value, variance)
    wide = np.concatenate([row, np.zeros((TRACKS, 2))], axis=1)[:, None]
    assert_same((mean, covariance, fit), reference(value[:, None], wide, variance[:, None, None]))


def test_information_form() -> None:
    mean, covariance = MEAN.copy(), COVARIANCE.copy()
    fit = information.update(mean, covariance, POSITION - MEAN[:, :2], OBSERVED, NOISE)
    assert_same((mean, covariance, fit), reference(POSITION - MEAN[:, :2], OBSERVED, NOISE))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_axes(order: int) -> None:
    size, model = order + 1, WhiteAxis(order, 2.0)
    mean, covariance = RANDOM.standard_normal((TRACKS, size)), covariances(size)
    axes, measured = AxisFilter(model), RANDOM.standard_normal(TRACKS)
    axes.spawn(mean, covariance)
    _, transition, noise = axis_matrices(model, 0.1)
    for _ in range(20):
        axes.predict(0.1)
        axes.update(measured, 0.5)
        kalman.predict(mean, covariance, transition, noise)
        innovation = measured[:, None] - mean[:, :1]
        fit = kalman.update(mean, covariance, innovation, np.eye(size)[:1], np.full((1, 1), 0.5))
        assert_same((axes.mean, axes.covariance, axes.fit), (mean, covariance, fit))


def test_packed_plane() -> None:
    model = Singer(0.1, 3.0)
    tracks = PlaneFilter(model, acceleration=3.0)
    tracks.spawn(POSITION, NOISE, MEAN[:, 2:4], NOISE)
    mean, covariance = (each.copy() for each in tracks.combined())
    rows, ahead, at = np.arange(TRACKS), np.tile([1.0, 0.0], (TRACKS, 1)), np.zeros(2)
    for _ in range(20):
        tracks.predict(0.1, ahead)
        nis = tracks.update(rows, Measurement(POSITION, NOISE, at, at))
        predicted, transition, noise = model.transition(mean, 0.1, ahead)
        kalman.predict(mean, covariance, transition, noise, predicted)
        fit = kalman.update(mean, covariance, POSITION - mean[:, :2], OBSERVED, NOISE)
        found = tracks.combined()
        agree(found[0], mean)
        agree(found[1], covariance)
        agree(nis, fit.nis)


def test_mlkf_without_its_floor() -> None:
    mean, covariance, variance = RANDOM.standard_normal((TRACKS, 3)), covariances(3), np.array([0.1, 0.2, 0.3])
    tracks, measured = ModifiedLinearKalman(floor=0.0), RANDOM.standard_normal((TRACKS, 3))
    tracks.spawn(mean, covariance)
    fit = tracks.update(np.arange(TRACKS), measured, variance)
    expected = kalman.update(mean, covariance, measured - mean, np.eye(3), np.diag(variance))
    assert_same((tracks.mean, tracks.covariance, fit), (mean, covariance, expected))


def test_drift_of_the_fixes() -> None:
    drift = DriftFilter(DriftFilterSettings(), 2.0)
    drift.start(np.zeros(2), 3.0 * np.eye(2), np.zeros(2), 1.0)
    mean, covariance, fix = np.zeros((1, 2)), 3.0 * np.eye(2)[None], np.array([1.0, -2.0])
    drift.update(fix)
    kalman.update(mean, covariance, fix - mean, np.eye(2), 4.0 * np.eye(2))
    agree(drift.position, mean[0])
    agree(drift.covariance, covariance[0])
