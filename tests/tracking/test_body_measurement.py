"""One measurement a body from all its detections."""

from __future__ import annotations

import numpy as np

from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_measurement import of_bodies


def test_a_detection_at_the_sensor_itself_is_finite() -> None:
    """Where the range is 0, an angle has no noise across: the covariance is singular."""
    seen = Measurement(np.zeros((1, 2)), np.diag([0.04, 0.0])[None], np.zeros(2), np.zeros(2))
    rows, combined, rates = of_bodies(seen, np.array([3]), np.zeros((1, 2)), np.zeros(1), 1.0)
    assert rows.tolist() == [3]
    assert rates is None
    assert np.isfinite(combined.position).all()
    assert np.linalg.eigvalsh(combined.noise[0]).min() > 0.0


def test_two_detections_of_a_body_are_weighted_by_what_they_know() -> None:
    noise = np.stack([np.eye(2) * 0.01, np.eye(2) * 0.03])
    seen = Measurement(np.array([[1.0, 0.0], [2.0, 0.0]]), noise, np.zeros(2), np.zeros(2))
    _, combined, _ = of_bodies(seen, np.array([0, 0]), np.zeros((2, 2)), np.zeros(2), 1.0)
    assert abs(combined.position[0, 0] - 1.25) < 0.01
    assert combined.noise[0, 0, 0] < 0.01


def test_range_rates_stay_those_of_their_detections() -> None:
    noise = np.tile(np.eye(2) * 0.01, (3, 1, 1))
    place, offset = np.array([[1.0, 0.0], [9.0, 2.0], [2.0, 1.0]]), np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0]])
    seen = Measurement(place, noise, np.ones(2), np.zeros(2), np.array([1.0, 2.0, 3.0]), np.full(3, 0.04))
    rows, combined, rates = of_bodies(seen, np.array([7, 2, 7]), offset, np.zeros(3), 4.0)
    assert rows.tolist() == [2, 7]
    assert combined.range_rate is None
    assert rates is not None
    assert rates.value.tolist() == [1.0, 2.0, 3.0]
    assert rates.body.tolist() == [1, 0, 1]
    assert rates.share == 4.0
    np.testing.assert_array_equal(rates.offset, offset)
