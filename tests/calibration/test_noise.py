"""White part, correlated part and walk of residuals, as far as their differences tell."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.calibration.drives import RANGES, SensorFindings
from candaemon.calibration.noise import NoiseParts, NoiseSamples, noise_parts, residual_pairs
from candaemon.calibration.parameters import Estimate
from candaemon.calibration.proposals import proposals
from tests.support.bound import binding

CYCLE, SCANS, RETURNS = 0.05, 20, 10


def _found(
    white: float,
    slow: float = 0.0,
    time: float = 0.3,
    walk: float = 0.0,
    windows: int = 50,
    like: NoiseParts | None = None,
) -> NoiseParts:
    random, samples = np.random.default_rng(3), NoiseSamples(CYCLE)
    first, count = SCANS * np.arange(RETURNS), np.full(RETURNS, SCANS)
    pairs = residual_pairs(CYCLE, np.tile(np.arange(SCANS), RETURNS), first, count)
    for _ in range(windows):
        residual: Floats = white * random.standard_normal((RETURNS, SCANS))
        residual += np.cumsum(np.sqrt(walk * CYCLE) * random.standard_normal((RETURNS, SCANS)), axis=1)
        state, keep = slow * random.standard_normal(RETURNS), np.exp(-CYCLE / time)
        for k in range(SCANS):
            residual[:, k] += state
            state = keep * state + slow * np.sqrt(1 - keep**2) * random.standard_normal(RETURNS)
        residual[0, 3] += 50.0 * (white + slow)  # a slot that holds another object
        samples.add((residual.ravel()[pairs.later] - residual.ravel()[pairs.earlier]) ** 2, pairs.bounds)
    found = noise_parts(samples, like)
    assert found is not None
    return found


def test_white_noise_is_found() -> None:
    found = _found(0.25)
    assert found.white == pytest.approx(0.25, rel=0.05)
    assert abs(found.white - 0.25) < 3 * found.white_sd + 0.005
    assert (found.slow, found.walk) == (0.0, 0.0)


def test_a_correlated_part_is_told_from_the_white_one() -> None:
    found = _found(0.1, slow=0.2, time=0.2)
    assert found.white == pytest.approx(0.1, rel=0.2)
    assert found.slow == pytest.approx(0.2, rel=0.2)
    assert found.deviation == pytest.approx(0.2236, rel=0.1)
    assert found.walk == 0.0


def test_a_walk_is_told_from_white_noise() -> None:
    found = _found(0.05, walk=0.15)
    assert found.white == pytest.approx(0.05, rel=0.2)
    assert found.walk == pytest.approx(0.15, rel=0.2)
    assert found.slow == 0.0
    assert found.over(0.3) == pytest.approx(np.sqrt(0.05**2 + 0.15 * 0.3), rel=0.15)


def test_too_little_is_not_enough() -> None:
    assert noise_parts(NoiseSamples(CYCLE)) is None
    samples = NoiseSamples(CYCLE)
    pairs = residual_pairs(CYCLE, np.arange(4), np.array([0]), np.array([4]))
    samples.add(np.ones(len(pairs.later)), pairs.bounds)
    assert noise_parts(samples) is None


@pytest.mark.parametrize("walks", [True, False])
def test_what_explains_as_well_is_taken_for_what_the_same_errors_are_elsewhere(walks: bool) -> None:
    """Errors that last for 0.45 s are a walk as well as far as so few windows tell; clear ones are what they are."""
    kind = {"white": 0.0, "slow": 0.0, "time": 0.0, "white_sd": 0.0, "slow_sd": 0.0, "walk_sd": 0.0}
    like = NoiseParts(**kind, walk=float(walks), samples=0)
    assert (_found(0.01, slow=0.16, time=0.45, windows=8, like=like).walk > 0.0) == walks
    assert _found(0.1, slow=0.2, time=0.1, like=like).walk == 0.0
    assert _found(0.02, walk=0.15, windows=400, like=like).walk > 0.0


def test_the_unit_of_a_walk_is_that_of_the_quantity_squared_by_time() -> None:
    of = binding("esr_ins")
    (sensor,) = of.sensors
    parts = NoiseParts(0.1, 0.0, 0.0, 0.04, 0.01, 0.0, 0.01, 1000)
    measured = ("range", "azimuth", "range_rate")
    found = SensorFindings(
        Estimate(np.zeros(4), np.eye(4)),
        30,
        dict.fromkeys(measured, parts),
        dict.fromkeys(measured, [None] * len(RANGES)),
        (None, None),
    )
    told = {row.what.rpartition(".")[2]: row.remark for row in proposals(of, {sensor.name: found})}
    assert told["range"] == "white 0.1, walk 0.04 m²/s"
    assert told["range_rate"] == "white 0.1, walk 0.04 (m/s)²/s"
    assert told["azimuth_deg"].endswith(" deg²/s")
