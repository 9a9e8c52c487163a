"""The filters that the configuration names: switching, federated and noise-adapting tracks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from candaemon.arrays import Floats
from candaemon.config.estimators import EstimatorSettings
from candaemon.estimation.federated import FederatedTracks
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Imm
from candaemon.estimation.kalman import update
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.motion_models import LinearModel
from candaemon.estimation.noise_factor import NoiseScale, WindowedScale
from candaemon.estimation.sensor_noise import SensorNoise
from candaemon.estimation.switching import SwitchingTracks
from candaemon.tracking.estimator_factory import make_estimator
from tests.support.builders import AT_REST, random_covariance

DT = 0.05


class JointTracks(Imm):
    """One Kalman filter that takes all parts of a detection together."""

    def _update_models(
        self, rows: NDArray[np.intp], mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        del rows  # all alike
        fit = update(mean[:, 0], covariance[:, 0], *measurement.linearised(mean[:, 0]))
        return fit.nis[:, None], fit.log_likelihood[:, None]


def made(**settings: Any) -> FilterBank:
    parsed: EstimatorSettings = TypeAdapter(EstimatorSettings).validate_python(settings)
    return make_estimator(parsed)


def spawned(bank: FilterBank, count: int = 1) -> FilterBank:
    """Give a filter tracks at the origin that may have any speed."""
    spread = np.tile(np.eye(2), (count, 1, 1))
    bank.spawn(np.zeros((count, 2)), 0.1 * spread, np.zeros((count, 2)), 400.0 * spread)
    return bank


def seen(position: Floats, deviation: float = 0.2, sensor: int = 0) -> Measurement:
    noise = np.tile(np.eye(2) * deviation**2, (len(position), 1, 1))
    return Measurement(position, noise, AT_REST, AT_REST, sensor=sensor)


def follow(bank: FilterBank, positions: Floats, deviation: float = 0.2) -> None:
    """Let all tracks follow measured positions (steps, n, 2)."""
    rows, direction = np.arange(len(bank)), np.tile([1.0, 0.0], (len(bank), 1))
    for position in positions:
        bank.predict(DT, direction)
        bank.update(rows, seen(position, deviation))


def accelerating(steps: int, acceleration: float, seed: int = 1, speed: float = 10.0, deviation: float = 0.2) -> Floats:
    """Return positions (steps, 1, 2) of a vehicle along x, measured with a standard deviation in m."""
    t = DT * np.arange(1, steps + 1)
    x = speed * t + acceleration * t * t / 2
    noise = np.random.default_rng(seed).normal(size=(steps, 1, 2)) * deviation
    return noise + np.stack([x, np.zeros(steps)], axis=1)[:, None]


def test_switching_tells_constant_velocity_of_what_is_steady_and_the_other_of_what_is_not() -> None:
    bank = spawned(made(kind="switching"))
    assert isinstance(bank, SwitchingTracks)
    assert bank.manoeuvring.all()
    follow(bank, accelerating(120, 0.0))
    assert not bank.manoeuvring.any()
    np.testing.assert_array_equal(bank.probability, [[1.0, 0.0]])
    assert not bank.combined()[0][0, 4:].any()
    bank = spawned(made(kind="switching"))
    follow(bank, accelerating(120, 6.0))
    np.testing.assert_array_equal(bank.probability, [[0.0, 1.0]])
    assert bank.combined()[0][0, 4] == pytest.approx(6.0, abs=1.5)


def test_switching_decides_for_each_track_by_itself_and_forgets_those_that_go() -> None:
    bank = spawned(made(kind="switching"), 3)
    assert isinstance(bank, SwitchingTracks)
    drives = [accelerating(120, a, seed, deviation=0.05) for seed, a in enumerate((0.0, 6.0, 0.0))]
    follow(bank, np.concatenate(drives, axis=1), 0.05)
    assert bank.manoeuvring.tolist() == [False, True, False]
    bank.keep(np.array([1]))
    bank.clone(np.array([0]), np.ones((1, 2)), np.eye(2)[None])
    assert bank.manoeuvring.tolist() == [True, True]
    assert len(bank) == 2


def test_a_clone_is_in_the_state_of_the_one_that_it_is_like() -> None:
    """Which model is told, how noisy its sensor is, how well its innovations fit: all but the position."""
    switching = spawned(made(kind="switching", measurement_noise={"kind": "variational"}), 2)
    driven = spawned(made(kind="cs", innovation_memory=0.3, measurement_noise={"kind": "window", "window": 5}), 2)
    drives = np.concatenate([accelerating(120, 0.0, deviation=2.0), accelerating(120, 6.0, 2)], axis=1)
    for bank in (switching, driven):
        follow(bank, drives)
        bank.clone(np.array([1, 0]), np.ones((2, 2)), np.tile(0.1 * np.eye(2), (2, 1, 1)))
        seen_now, rows = seen(np.zeros((4, 2))), np.arange(4)
        believed = bank.inflated(rows, seen_now).noise
        assert believed[0, 0, 0] > 2 * believed[1, 0, 0]
        np.testing.assert_array_equal(believed[2:], believed[[1, 0]])
        np.testing.assert_array_equal(bank.mean[2:, :, 2:], bank.mean[[1, 0], :, 2:])
        np.testing.assert_array_equal(bank.mean[2:, :, :2], 1.0)
        np.testing.assert_array_equal(bank.covariance[2:, :, 2:, 2:], bank.covariance[[1, 0], :, 2:, 2:])
        assert not bank.covariance[2:, :, :2, 2:].any()
        bank.predict(DT, np.tile([1.0, 0.0], (4, 1)))
        # A prediction shows the process noise, which follows the fit.
        np.testing.assert_allclose(bank.covariance[2:, :, 4:, 4:], bank.covariance[[1, 0], :, 4:, 4:], rtol=1e-12)
    assert isinstance(switching, SwitchingTracks)
    assert switching.manoeuvring.tolist() == [False, True, True, False]
    told = switching.manoeuvring
    told[:] = True
    assert not switching.manoeuvring.all()


def test_what_was_not_measured_weighs_no_model() -> None:
    """A speed that is missing counts nothing in either form, or the two could not be mixed."""
    rng = np.random.default_rng(8)
    models = [LinearModel(1, (0.1, 0.1)), LinearModel(2, (5.0, 5.0))]
    mixed = spawned(Imm(models, switch_rate=0.3, acceleration=3.0, forms=["covariance", "information"]), 3)
    alike = spawned(Imm(models, switch_rate=0.3, acceleration=3.0), 3)
    rows, direction = np.arange(3), np.tile([0.6, 0.8], (3, 1))
    for _ in range(50):
        speed = np.where(rng.random(3) < 0.5, rng.normal(size=3), np.nan)
        measurement = replace(
            seen(rng.normal(size=(3, 2))),
            range_rate=np.full(3, np.nan),
            range_rate_variance=np.full(3, 0.02),
            projections=(Projection(direction, speed, np.full(3, 0.1)),),
        )
        np.testing.assert_array_equal(measurement.measured, 2 + np.isfinite(speed))
        nis = []
        for bank in (mixed, alike):
            bank.predict(DT, direction)
            nis.append(bank.update(rows, measurement))
        np.testing.assert_allclose(nis[0], nis[1], rtol=1e-8)
    np.testing.assert_allclose(mixed.probability, alike.probability, rtol=1e-7)
    np.testing.assert_allclose(mixed.mean, alike.mean, rtol=1e-7, atol=1e-9)


def test_missing_speeds_do_not_make_a_track_look_as_if_it_fitted_better() -> None:
    """The variance that innovations drive is the same whether the sensor has no speed, or told none."""
    drive = accelerating(60, 4.0)
    banks = [spawned(made(kind="cs", innovation_memory=0.3)) for _ in range(2)]
    missing: dict[str, Any] = {"range_rate": np.array([np.nan]), "range_rate_variance": np.array([0.02])}
    for bank, speed in zip(banks, ({}, missing), strict=True):
        for position in drive:
            bank.predict(DT, np.array([[1.0, 0.0]]))
            bank.update(np.arange(1), replace(seen(position), **speed))
    np.testing.assert_allclose(banks[0].covariance, banks[1].covariance, rtol=1e-12)


@pytest.mark.parametrize("rated", [False, True], ids=["", "range rate"])
def test_federated_tracks_are_the_centralised_filter_where_the_noise_is_as_stated(rated: bool) -> None:
    """With a range rate the one that takes each detection as one measurement, linearised at its prediction."""
    rng = np.random.default_rng(3)
    model = LinearModel(2, (5.0, 2.0), (None, 0.8))
    federated = FederatedTracks(model, acceleration=3.0, turn_rate=1.0, jerk=1.0, outage=20.0, least=0.01)
    central = (JointTracks if rated else Imm)([model], switch_rate=1.0, acceleration=3.0)
    position, velocity = rng.normal(size=(4, 2)) * 30, rng.normal(size=(4, 2)) * 10
    spread, speed_spread = random_covariance(rng, 2, 4), random_covariance(rng, 2, 4)
    for bank in (federated, central):
        bank.spawn(position, spread, velocity, speed_spread)
    direction = np.tile([0.6, 0.8], (4, 1))
    for step in range(60):
        rows = np.flatnonzero(rng.random(4) < 0.8)
        measurement = Measurement(
            position[rows] + rng.normal(size=(len(rows), 2)),
            random_covariance(rng, 2, len(rows)) * (1.0, 40.0, 5.0)[step % 3],
            AT_REST,
            AT_REST,
            projections=(Projection(direction[rows], rng.normal(size=len(rows)), np.full(len(rows), 0.1)),),
            sensor=step % 3,
        )
        if rated:
            rate = np.where(rng.random(len(rows)) < 0.8, rng.normal(size=len(rows)), np.nan)
            measurement = replace(measurement, range_rate=rate, range_rate_variance=np.full(len(rows), 0.02))
        nis = []
        for bank in (federated, central):
            bank.predict(DT, direction)
            nis.append(bank.update(rows, measurement))
        np.testing.assert_allclose(nis[0], nis[1], rtol=1e-8)
    np.testing.assert_allclose(federated.mean, central.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(federated.covariance, central.covariance, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(federated.share.sum(axis=1), 1.0)
    federated.keep(np.array([2]))
    assert federated.share.shape == (1, 3)


def test_what_sensors_state_outlives_the_tracks() -> None:
    bank = spawned(made(kind="federated"), 2)
    assert isinstance(bank, FederatedTracks)
    for sensor, deviation in enumerate((0.1, 0.2)):
        bank.predict(DT, np.tile([1.0, 0.0], (2, 1)))
        bank.update(np.arange(2), seen(np.zeros((2, 2)), deviation, sensor))
    bank.keep(np.zeros(2, dtype=np.bool_))
    assert len(bank.update(np.arange(0), seen(np.zeros((0, 2)), sensor=1))) == 0
    spawned(bank)
    np.testing.assert_allclose(bank.share, [[0.8, 0.2]])


def test_a_federated_filters_variance_follows_its_innovations_too() -> None:
    variances = {}
    for memory in (None, 0.3):
        model = {"kind": "cs", "innovation_memory": memory}
        bank = spawned(made(kind="federated", model=model))
        follow(bank, accelerating(60, 8.0))
        variances[memory] = bank.covariance[0, 0, 5, 5]
    alone = spawned(made(kind="cs", innovation_memory=0.3))
    follow(alone, accelerating(60, 8.0))
    assert variances[0.3] == pytest.approx(alone.covariance[0, 0, 5, 5], rel=1e-9)
    assert variances[0.3] != pytest.approx(variances[None], rel=0.05)


@pytest.mark.parametrize("kind", ["window", "variational"])
@pytest.mark.parametrize("estimator", ["imm", pytest.param("federated", marks=pytest.mark.slow)])
def test_a_sensor_that_goes_bad_loses_its_weight_and_gets_it_back(estimator: str, kind: str) -> None:
    """Two sensors; the noise of the first bursts to 200 times its variance for 10 s."""
    rng = np.random.default_rng(5)
    steps, burst = 900, slice(300, 500)
    scale = np.ones(steps)
    scale[burst] = np.sqrt(200.0)
    noise = rng.normal(size=(steps, 2, 20, 2)) * 0.2
    errors = {}
    for adapting in (True, False):
        bank = spawned(made(kind=estimator, **({"measurement_noise": {"kind": kind}} if adapting else {})), 20)
        rows, direction, off = np.arange(20), np.tile([1.0, 0.0], (20, 1)), np.empty((steps, 20))
        for k in range(steps):
            truth = np.array([10.0 * DT * (k + 1), 0.0])
            bank.predict(DT, direction)
            bank.update(rows, seen(truth + scale[k] * noise[k, 0], sensor=0))
            bank.update(rows, seen(truth + noise[k, 1], sensor=1))
            off[k] = np.linalg.norm(bank.combined()[0][:, :2] - truth, axis=1)
        errors[adapting] = off
    hurt = slice(burst.start + 60, burst.stop)
    assert errors[True][hurt].mean() < 0.4 * errors[False][hurt].mean()
    # once it is well again it counts as much as ever: the adapting filter is as good as the one that never doubted
    assert errors[True][700:].mean() < 1.1 * errors[False][700:].mean()


@pytest.mark.parametrize("make", [NoiseScale, lambda: WindowedScale(10)], ids=["variational", "window"])
def test_noise_is_found_out_for_each_track_and_sensor(make: Any) -> None:
    rng = np.random.default_rng(6)
    noise = SensorNoise(make)
    noise.spawn(2)
    rows, position, covariance = np.arange(2), np.zeros((2, 2)), np.tile(np.eye(2) * 1e-4, (2, 1, 1))
    for _ in range(200):
        bad = rng.normal(size=(2, 2)) * np.array([[0.2], [2.0]])
        first = noise.adapted(rows, seen(bad, sensor=0), position, covariance)
        other = noise.adapted(rows, seen(rng.normal(size=(2, 2)) * 0.2, sensor=1), position, covariance)
    assert first.noise[0, 0, 0] < 3 * 0.04
    assert first.noise[1, 0, 0] > 20 * 0.04
    assert other.noise[:, 0, 0].max() < 3 * 0.04
    noise.keep(np.array([False, True]))
    noise.spawn(1)
    kept = noise.adapted(rows, seen(np.zeros((2, 2)), sensor=0), position, covariance)
    assert kept.noise[0, 0, 0] > 10 * 0.04
    assert kept.noise[1, 0, 0] < 2 * 0.04


def test_variance_driven_by_innovations_is_quieter_and_as_quick() -> None:
    """The current statistical model with a variance that its innovations drive, beside the plain one."""
    drives = np.concatenate([accelerating(300, 0.0, seed) for seed in range(30)], axis=1)
    brakes = np.concatenate([accelerating(40, -6.0, seed, speed=20.0) for seed in range(30)], axis=1)
    speeds: dict[float | None, tuple[float, float]] = {}
    for memory in (None, 0.3):
        quiet = spawned(made(kind="cs", innovation_memory=memory), 30)
        follow(quiet, drives)
        rms = float(np.sqrt(np.square(quiet.combined()[0][:, 2] - 10.0).mean()))
        rows = spawned(made(kind="cs", innovation_memory=memory), 30)
        follow(rows, brakes)
        speeds[memory] = rms, float(np.abs(rows.combined()[0][:, 2] - (20.0 - 6.0 * 40 * DT)).mean())
    assert speeds[0.3][0] < 0.75 * speeds[None][0]
    assert speeds[0.3][1] < 1.1 * speeds[None][1]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "jerk", "noise": 5, "settling": {"along": 1, "across": 1}},
        {"kind": "cv"},
        {"kind": "singer", "deviation": 0},
        {"kind": "imm", "measurement_noise": {"kind": "variational", "forgetting": 1}},
        {"kind": "nothing"},
    ],
)
def test_what_makes_no_sense_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        made(**wrong)
