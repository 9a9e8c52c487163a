"""Joint association: probabilities over all joint events, and what is made of them where gates overlap."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.radar.detections import Detections
from candaemon.tracking.body_association import Association
from candaemon.tracking.joint_association import EXACT, doubts, joint_probabilities, likelihood_ratios
from tests.support.builders import HandFedVehicles, car, detections, pose, times
from tests.support.effort import examples
from tests.support.paths import ROOT


def enumerated(ratio: Floats) -> Floats:
    """Return the probabilities by a walk through all joint events."""
    n, m = ratio.shape
    total, found = 0.0, np.zeros((n, m))
    for event in product(range(-1, m), repeat=n):
        taken = [d for d in event if d >= 0]
        if len(set(taken)) == len(taken):
            pairs = [(i, d) for i, d in enumerate(event) if d >= 0]
            weight = float(np.prod([ratio[pair] for pair in pairs]))
            total += weight
            for pair in pairs:
                found[pair] += weight
    return found / total


@settings(max_examples=examples(200))
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_the_probabilities_are_those_of_all_joint_events(n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    ratio = random.exponential(10.0 ** random.uniform(-3, 6), (n, m)) * (random.random((n, m)) < 0.8)
    np.testing.assert_allclose(joint_probabilities(ratio), enumerated(ratio), rtol=1e-9, atol=1e-12)


def test_many_pairs_have_probabilities_that_are_possible() -> None:
    """Beyond what is counted exactly each pair stands beside those that it excludes; the limit changes little."""
    random = np.random.default_rng(4)
    n = EXACT + 1
    ratio = np.where(random.random((n, n)) < 0.3, random.exponential(20.0, (n, n)), 0.0)
    found = joint_probabilities(ratio)
    assert (found >= 0.0).all()
    assert (found.sum(axis=0) <= 1.0).all()
    assert (found.sum(axis=1) <= 1.0).all()
    alone = np.zeros((n, n))
    alone[0, 0] = 3.0
    assert joint_probabilities(alone)[0, 0] == joint_probabilities(alone[:1, :1])[0, 0] == 0.75


def test_reflections_of_one_body_do_not_compete() -> None:
    track, detection, ratio = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]), np.full(4, 1e6)
    chosen = np.array([0, 3])
    assert doubts(track, detection, np.array([5, 5, 5, 5]), ratio, chosen).tolist() == [1.0, 1.0]
    doubted = doubts(track, detection, np.array([5, 5, 6, 6]), ratio, chosen)
    assert doubted == pytest.approx([2.0, 2.0], rel=1e-5)  # both ways of assigning are as likely


def test_what_is_likely_is_in_no_doubt() -> None:
    """Without a competitor nothing is in doubt, however unlikely; with one far off hardly anything."""
    one = np.array([0])
    assert doubts(one, one, one, np.array([1e-3]), one).tolist() == [1.0]
    ratio = np.array([1e6, 1.0, 1e6])
    doubted = doubts(np.array([0, 0, 1]), np.array([0, 1, 1]), np.array([0, 0, 1]), ratio, np.array([0, 2]))
    assert doubted == pytest.approx([1.0, 1.0], abs=1e-5)


def test_the_ratio_is_that_of_the_densities() -> None:
    """A detection where it is expected, of a reflection known to 1 m: N(0) over clutter, for 3 measured numbers."""
    at = pose(1.0)
    scan = detections(at, [car(1, 0.0, 50.0)], sensor=0, noise=(1.0, 1.0, 0.5))
    mean = np.array([[*scan.measurement.position[0], 0.0, 0.0]])
    rate = scan.measurement.range_rate
    assert rate is not None
    mean[0, 2:] = (rate[0] + scan.measurement.velocity[0]), 0.0
    covariance = np.diag([1.0, 1.0, 0.0, 0.0])[None]
    (ratio,) = likelihood_ratios(mean, covariance, scan.measurement, 0.9, 1e-4)
    density = 1.0 / (2 * np.pi * 2.0) / np.sqrt(2 * np.pi * 0.25)
    assert ratio == pytest.approx(9.0 * density / (1e-4 / 80.0), rel=1e-3)


def associations(monkeypatch: pytest.MonkeyPatch, apart: float, *, joint: bool) -> list[Association]:
    """Return those of two walkers side by side, seen by a radar that tells no identity."""
    front = bind(load_config(ROOT / "config" / "esr_ins.yaml")).sensors[0].settings
    fed = HandFedVehicles(sensors={0: front}, noise=(0.6, 0.6, 0.1), association={"joint": joint})
    found: list[Association] = []
    associate = fed.tracker._associate

    def noting(scan: Detections) -> Association:
        found.append(associate(scan))
        return found[-1]

    monkeypatch.setattr(fed.tracker, "_associate", noting)
    for t in times(1, 30):
        fed.scan(t, [car(0, t, 30.0, 0.0, 1.4), car(1, t, 30.0, apart, 1.4)], identified=False)
    return found


@pytest.mark.parametrize(("apart", "in_doubt"), [(2.0, True), (12.0, False)])
def test_neighbours_without_identity_are_in_doubt(
    apart: float, in_doubt: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where gates overlap alone, and not where `association.joint` is false."""
    doubted = [each.doubt for each in associations(monkeypatch, apart, joint=True) if each.doubt is not None]
    assert any((each > 1.0).any() for each in doubted) == in_doubt
    assert all(each.doubt is None for each in associations(monkeypatch, apart, joint=False))
