"""Association: the joint innovation against the textbook, the assignment against every permutation."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.tracking.association import nearest_neighbours, nis_in_best_mode, nis_over_modes, pair_nis
from tests.support.builders import random_covariance
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)


def scene(seed: int, tracks: int, detections: int, *, rated: bool) -> tuple[np.ndarray, np.ndarray, Measurement]:
    """Return states, covariances, and detections near some of the states."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(tracks, 6)) * 3 + (40.0, 5.0, 10.0, 0.0, 0.0, 0.0)
    covariance = random_covariance(rng, 6, tracks)
    position = mean[rng.integers(0, tracks, detections), :2] + rng.normal(size=(detections, 2))
    rate = rng.normal(size=detections) * 2 + 5
    rate[::3] = np.nan
    measurement = Measurement(
        position,
        random_covariance(rng, 2, detections),
        rng.normal(size=2),
        rng.normal(size=2),
        rate if rated else None,
        rng.uniform(0.1, 1.0, detections) if rated else None,
    )
    return mean, covariance, measurement


def textbook_nis(mean: np.ndarray, covariance: np.ndarray, measurement: Measurement, k: int) -> float:
    """Return the joint normalised innovation squared of one track and detection k."""
    innovation = measurement.position[k] - mean[:2]
    h = np.eye(2, 6)
    noise = measurement.noise[k]
    rates, variances = measurement.range_rate, measurement.range_rate_variance
    if rates is not None and variances is not None and np.isfinite(rates[k]):
        rate, row = line_of_sight(mean[None], measurement.origin, measurement.velocity)
        innovation = np.append(innovation, rates[k] - rate[0])
        h = np.vstack([h, np.append(row[0], (0.0, 0.0))])
        noise = np.block([[noise, np.zeros((2, 1))], [np.zeros((1, 2)), variances[k]]])
    return float(innovation @ np.linalg.solve(h @ covariance @ h.T + noise, innovation))


@settings(deadline=None)
@given(seed=SEEDS, rated=st.booleans())
def test_the_innovation_of_a_pair_is_the_joint_one(seed: int, rated: bool) -> None:
    mean, covariance, measurement = scene(seed, 5, 5, rated=rated)
    nis = pair_nis(mean, covariance, measurement)
    expected = [textbook_nis(mean[k], covariance[k], measurement, k) for k in range(5)]
    np.testing.assert_allclose(nis, expected, rtol=1e-8)


@settings(deadline=None, max_examples=examples(60))
@given(seed=SEEDS, tracks=st.integers(1, 4), detections=st.integers(1, 4), gate=st.floats(1.0, 30.0))
def test_the_assignment_is_the_best_of_all(seed: int, tracks: int, detections: int, gate: float) -> None:
    """As many pairs inside the gate as can be, and of those the least sum; behind the gate nothing is paired."""
    mean, covariance, measurement = scene(seed, tracks, detections, rated=True)
    nis = np.array(
        [[textbook_nis(mean[t], covariance[t], measurement, d) for d in range(detections)] for t in range(tracks)]
    )
    size = max(tracks, detections)
    cost = np.full((size, size), np.inf)
    cost[:tracks, :detections] = np.where(nis <= gate, nis, np.inf)
    best = max(
        (
            (int(np.isfinite(picked).sum()), -float(picked[np.isfinite(picked)].sum()))
            for order in permutations(range(size))
            for picked in [cost[np.arange(size), list(order)]]
        ),
    )
    t, d = nearest_neighbours(mean, covariance, np.arange(tracks), measurement, np.arange(detections), gate)
    assert len(set(t.tolist())) == len(set(d.tolist())) == len(t) == best[0]
    assert nis[t, d].sum() == pytest.approx(-best[1], rel=1e-9)
    assert (nis[t, d] <= gate).all()


def test_only_what_is_free_is_paired() -> None:
    mean, covariance, measurement = scene(3, 4, 4, rated=False)
    t, d = nearest_neighbours(mean, covariance, np.array([1, 3]), measurement, np.array([0, 2, 3]), 1e6)
    assert set(t.tolist()) == {1, 3}
    assert set(d.tolist()) <= {0, 2, 3}
    none = np.empty(0, dtype=np.intp)
    for free, seen in ((none, np.arange(4)), (np.arange(4), none)):
        assert [len(rows) for rows in nearest_neighbours(mean, covariance, free, measurement, seen, 1e6)] == [0, 0]


def test_modes_that_are_alike_have_the_nis_of_one() -> None:
    spread = np.diag([4.0, 1.0])
    innovation = np.array([[[2.0, 3.0]] * 3])
    modes = np.array([[0.2, 0.5, 0.3]])
    nis = np.array([1.0 + 9.0])
    np.testing.assert_allclose(nis_over_modes(modes, innovation, np.tile(spread, (1, 3, 1, 1)), spread[None]), nis)
    np.testing.assert_allclose(nis_in_best_mode(modes, innovation, np.tile(spread, (1, 3, 1, 1)), 3e-4), nis)


def test_what_an_unlikely_mode_allows_costs_how_unlikely_and_how_wide_that_is() -> None:
    """Six standard deviations of the likely mode, one of another: 2 ln 100 for that, 2 ln 6 for its width."""
    modes, innovation = np.array([[0.99, 0.01]]), np.full((1, 2, 1), 6.0)
    spread = np.array([[[[1.0]], [[36.0]]]])
    nis = nis_over_modes(modes, innovation, spread, np.ones((1, 1, 1)))
    np.testing.assert_allclose(nis, 1.0 + 2.0 * np.log(100.0) + 2.0 * np.log(6.0), atol=1e-4)
    assert nis_in_best_mode(modes, innovation, spread, 3e-4) == [1.0]
    assert nis_in_best_mode(np.array([[1.0 - 1e-4, 1e-4]]), innovation, spread, 3e-4) == [36.0]


def test_covariances_that_cannot_be_inverted_fit_nothing() -> None:
    singular, innovation = np.zeros((1, 2, 2, 2)), np.ones((1, 2, 2))
    modes = np.array([[0.5, 0.5]])
    assert (nis_in_best_mode(modes, innovation, singular, 3e-4) > 1e6).all()
    assert (nis_over_modes(modes, innovation, singular, np.eye(2)[None]) > 100.0).all()
