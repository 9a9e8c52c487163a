"""Integrated probability of existence: against the equations, and safe at its bounds."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.tracking import existence as ipda


def test_a_missed_obstacle_is_less_probable_by_the_papers_equation() -> None:
    prior, probability = np.array([0.2, 0.9]), np.array([0.9, 0.5])
    expected = prior * (1 - probability) / (1 - probability * prior)
    assert ipda.detected(prior, probability, np.zeros(2)) == pytest.approx(expected)


def test_a_detection_multiplies_the_odds() -> None:
    found = ipda.detected(np.array([0.1]), np.array([0.9]), np.array([50.0]))
    odds = 0.1 / 0.9 * (1 - 0.9 + 0.9 * 50)
    assert found == pytest.approx(odds / (1 + odds))


def test_what_cannot_be_seen_is_not_missed() -> None:
    assert ipda.detected(np.array([0.7]), np.array([0.0]), np.zeros(1)) == pytest.approx(0.7)


def test_an_obstacle_that_nobody_looks_at_decays_with_its_mean_life() -> None:
    assert ipda.predicted(np.array([0.8]), 2.0, 4.0) == pytest.approx(0.8 * np.exp(-0.5))
    assert ipda.predicted(np.array([0.8]), -1.0, 4.0) == pytest.approx(0.8)


@pytest.mark.parametrize("ratio", [0.0, -1.0, 1e-300, 1e300, np.inf, np.nan])
@pytest.mark.parametrize("probability", [0.0, 1.0, np.nan, 7.0])
@pytest.mark.parametrize("prior", [0.0, 1.0, 0.5, np.nan])
def test_existence_stays_within_its_bounds(prior: float, probability: float, ratio: float) -> None:
    found = ipda.detected(np.array([prior]), np.array([probability]), np.array([ratio]))
    assert ipda.LEAST <= found[0] <= 1.0 - ipda.LEAST


def test_evidence_raises_what_was_given_up() -> None:
    found = np.array([0.5])
    for _ in range(1000):
        found = ipda.detected(found, np.array([0.99]), np.zeros(1))
    for _ in range(5):
        found = ipda.detected(found, np.array([0.9]), np.array([100.0]))
    assert found[0] > 0.99
