"""What detections count for whose errors are alike from scan to scan."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.estimation.correlated_noise import inflations


@pytest.mark.parametrize("cycle_time", [0.02, 0.05, 0.1])
def test_a_mean_of_so_many_detections_is_as_uncertain_as_it_says(cycle_time: float) -> None:
    share, time, memory = 0.5, 0.3, 0.5
    random, n, keep = np.random.default_rng(3), round(memory / cycle_time), np.exp(-cycle_time / time)
    slow = np.empty((20_000, n))
    slow[:, 0] = random.standard_normal(len(slow))
    for k in range(1, n):
        slow[:, k] = keep * slow[:, k - 1] + np.sqrt(1.0 - keep**2) * random.standard_normal(len(slow))
    errors = np.sqrt(share) * slow + np.sqrt(1.0 - share) * random.standard_normal(slow.shape)
    assert inflations(share, time, cycle_time, memory)[1] == pytest.approx(n * errors.mean(axis=1).var(), rel=0.05)


def test_white_noise_counts_as_it_is() -> None:
    np.testing.assert_allclose(inflations(0.0, 0.3, 0.02, 0.5), 1.0)


def test_what_comes_seldom_is_hardly_alike() -> None:
    factor = inflations(0.8, 0.3, 0.05, 0.5)
    assert factor[0] == factor[1]
    assert (np.diff(factor[1:11]) < 0.0).all()
    assert factor[11] == pytest.approx(1.0)  # beyond the memory there is one at a time
    assert (factor >= 1.0).all()


def test_a_radar_that_measures_twice_as_often_tells_little_more() -> None:
    once, twice = inflations(0.5, 0.3, 0.05, 0.5)[1] * 0.05, inflations(0.5, 0.3, 0.025, 0.5)[1] * 0.025
    assert 0.9 < twice / once < 1.0
