"""How alike errors are from scan to scan is learnt from innovations, of what moves as of what stands."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.config.load import load_config
from candaemon.config.sensors import ErrorCorrelation, SensorSettings
from candaemon.config.tracker import TrackerSettings
from candaemon.tracking.innovation_correlation import (
    InnovationCorrelation,
    InnovationCorrelationState,
    InnovationSums,
)
from candaemon.tracking.vehicle_tracker import VehicleTracker
from tests.support.builders import CYCLE, Seen, detections, pose
from tests.support.paths import ROOT

POLAR = load_config(ROOT / "config" / "esr_ins.yaml").config.sensors["front"]
NOISE = (0.25, 0.35, 0.12)


def _with(correlation: ErrorCorrelation | None) -> SensorSettings:
    return POLAR.model_copy(update={"noise": POLAR.noise.model_copy(update={"correlation": correlation})})


def _tracker(share: float, *, seconds: float = 15.0, settings: SensorSettings = POLAR) -> VehicleTracker:
    """Return a tracker that has followed eight cars whose places err by the noise, a share of it for .3 s."""
    told = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}})
    tracker, random, keep = VehicleTracker(told, {0: settings}), np.random.default_rng(5), np.exp(-CYCLE / 0.3)
    slow = random.standard_normal((8, 2))
    for k in range(round(seconds / CYCLE)):
        slow = keep * slow + np.sqrt(1.0 - keep**2) * random.standard_normal(slow.shape)
        error = np.sqrt(share) * slow + np.sqrt(1.0 - share) * random.standard_normal(slow.shape)
        at = pose(k * CYCLE, east=15.0 * k * CYCLE, ve=15.0)
        places = np.stack([20.0 + 12.0 * np.arange(8), np.tile([-3.5, 3.5], 4)], axis=1)
        places = places + [(15.0 + 0.5) * k * CYCLE, 0.0] + error * NOISE[:2]
        seen = [Seen(i, x, y, 15.5) for i, (x, y) in enumerate(places.tolist())]
        tracker.step(detections(at, seen, sensor=0, noise=NOISE), at)
    return tracker


def _learnt(tracker: VehicleTracker, settings: SensorSettings = POLAR) -> tuple[float, float]:
    correlation = InnovationCorrelation({0: settings})
    correlation.state = tracker.state.correlation
    return correlation.share(0)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_which_share_of_the_noise_lasts_is_found(share: float) -> None:
    assert _learnt(_tracker(share))[0] == pytest.approx(share, abs=0.15)


def test_of_errors_that_last_less_is_learnt() -> None:
    white, alike = _tracker(0.0), _tracker(0.6)
    spread = [tracker.state.tracks.estimator.covariance[:, 0, 1, 1].mean() for tracker in (white, alike)]
    assert spread[1] > 1.5 * spread[0]


def test_until_much_is_known_half_of_the_noise_lasts() -> None:
    correlation = InnovationCorrelation({0: POLAR})
    assert correlation.share(0) == pytest.approx((0.5, 0.3))
    assert correlation.share(7)[0] == 0.0  # a sensor without settings
    assert _learnt(_tracker(0.0, seconds=1.0))[0] == pytest.approx(0.5)


def test_a_correlation_that_is_given_stands() -> None:
    settings = _with(ErrorCorrelation(share=0.2, time=0.1))
    assert _learnt(_tracker(0.6, seconds=5.0, settings=settings), settings) == (0.2, 0.1)


def test_what_is_known_follows_a_sensors_number() -> None:
    correlation = InnovationCorrelation({0: POLAR, 1: POLAR})
    correlation.state = InnovationCorrelationState({1: InnovationSums(0.0, 1000.0)})
    learnt = correlation.share(1)
    correlation.renumber_sensors({1: 4})
    assert correlation.share(4) == learnt
    assert correlation.share(1)[0] == 0.0


def test_a_state_that_contradicts_itself_is_refused() -> None:
    correlation = InnovationCorrelation({0: POLAR})
    with pytest.raises(ValueError, match="other sensors"):
        correlation.state = InnovationCorrelationState({3: InnovationSums()})
    for products, squares in ((2.0, 1.0), (0.0, np.inf), (np.nan, 1.0), (-2.0, 1.0)):
        with pytest.raises(ValueError, match="exceed"):
            correlation.state = InnovationCorrelationState({0: InnovationSums(products, squares)})


def test_of_a_sensor_that_looks_elsewhere_in_between_is_learnt() -> None:
    """One of four looks sees the cars, every fourth scan; those between show nothing."""
    looking = load_config(ROOT / "config" / "ford_mrr.yaml").config.sensors["front"]
    looking = looking.model_copy(update={"cycle_time": CYCLE / 4})
    assert looking.revisit_time == CYCLE
    tracker = _tracker(0.6, settings=looking)
    assert _learnt(tracker, looking)[0] == pytest.approx(0.6, abs=0.15)
