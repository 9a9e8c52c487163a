"""What no input breaks: singular and huge ones leave every estimator of the tracker finite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from candaemon.arrays import Floats
from candaemon.config.estimators import EstimatorSettings
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Form, Imm, mix, posterior
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.motion_models import CoordinatedTurn, CurrentStatistical, LinearModel, MotionModel
from candaemon.tracking.estimator_factory import make_estimator
from tests.support.builders import AT_REST, random_covariance
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)
CV, CA, JERK = (LinearModel(order, (noise, noise)) for order, noise in ((1, 1e-3), (2, 5.0), (3, 20.0)))
CT, CS = CoordinatedTurn(0.01, 0.1), CurrentStatistical(0.5, 10.0, 1.0)
MODELS: tuple[tuple[MotionModel, ...], ...] = ((CV,), (CT,), (CS,), (CV, CA, CT), (JERK, CS), (CV, CT, JERK))
KINDS = ("cv", "ca", "jerk", "singer", "ct", "cs", "imm", "information", "switching", "federated", "mlkf")
NOISES = ("stated", "window", "variational")


class Extremes:
    """Draws numbers over many orders of magnitude, zero among them, and covariances of any rank."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def size(self, power: float) -> float:
        """Return a number between 10^−power and 10^power, or zero."""
        return 0.0 if self.rng.random() < 0.15 else float(10.0 ** self.rng.uniform(-power, power))

    def covariance(self, scale: float) -> Floats:
        """Return covariances (2, 2, 2), singular more often than not."""
        root = self.rng.normal(size=(2, 2, self.rng.integers(0, 3)))
        drawn: Floats = scale * (root @ np.swapaxes(root, 1, 2))
        return drawn

    def measurement(self, *, regular: bool) -> Measurement:
        """Return detections of two tracks; `regular` ones have some noise, as information filters need."""
        scale, variance = self.size(170), np.full(2, self.size(170))
        noise = self.covariance(scale)
        if regular:
            noise += max(scale, 1e-100) * np.eye(2)
            variance = np.maximum(variance, 1e-100)
        speed = self.size(160) * self.rng.normal(size=2)
        rated = self.rng.random() < 0.7
        projection = Projection(np.tile([1.0, 0.0], (2, 1)), speed, variance)
        return Measurement(
            self.size(160) * self.rng.normal(size=(2, 2)),
            noise,
            AT_REST,
            AT_REST,
            speed if rated else None,
            variance if rated else None,
            projections=(projection,) * int(self.rng.integers(0, 2)),
        )


def drive(bank: FilterBank, seed: int, *, regular: bool) -> None:
    """Track two targets through extremes, warnings being errors; hold that everything stays finite."""
    extremes = Extremes(seed)
    position, velocity = (extremes.size(10) * extremes.rng.normal(size=(2, 2)) for _ in range(2))
    bank.spawn(position, extremes.covariance(extremes.size(20)), velocity, extremes.covariance(extremes.size(20)))
    for dt in extremes.rng.choice((0.0, 0.05, 0.05, 0.05, 100.0), 6):
        bank.predict(dt, np.tile([0.6, 0.8], (2, 1)))
        nis = bank.update(np.arange(2), extremes.measurement(regular=regular))
        for each in (bank.mean, bank.covariance, bank.probability, nis, *bank.combined()):
            assert np.isfinite(each).all()


@settings(deadline=None, max_examples=examples(300))
@given(seed=SEEDS, models=st.sampled_from(MODELS), information=st.booleans())
def test_an_imm_stays_finite(seed: int, models: Sequence[MotionModel], information: bool) -> None:
    forms: list[Form] = ["information" if information and j != 1 else "covariance" for j in range(len(models))]
    imm = Imm(models, switch_rate=0.5, acceleration=3.0, forms=forms)
    drive(imm, seed, regular=information)


@settings(deadline=None, max_examples=examples(300))
@given(seed=SEEDS, kind=st.sampled_from(KINDS), noise=st.sampled_from(NOISES))
def test_every_kind_stays_finite(seed: int, kind: str, noise: str) -> None:
    process = {"noise": 2.0} if kind in ("cv", "ca", "jerk") else {}
    learnt = {} if noise == "stated" else {"measurement_noise": {"kind": noise}}
    told: EstimatorSettings = TypeAdapter(EstimatorSettings).validate_python({"kind": kind} | process | learnt)
    drive(make_estimator(told), seed, regular=kind == "information")


def test_likelihoods_of_nothing_tell_nothing() -> None:
    prior = np.array([[0.7, 0.2, 0.1], [0.5, 0.3, 0.2]])
    log_likelihood = np.array([[-np.inf, -np.inf, -np.inf], [-np.inf, 0.0, -1.0]])
    found = posterior(prior, log_likelihood)
    np.testing.assert_allclose(found[0], prior[0])
    np.testing.assert_allclose(found[1], np.array([0.0, 0.3, 0.2 / np.e]) / (0.3 + 0.2 / np.e), atol=1e-11)


def test_mixing_far_from_the_origin_cancels_nothing() -> None:
    """Models 1 mm apart at 10¹⁰ m, and models 10⁸ m apart whose variances are 10⁻⁴ m²."""
    rng, switch = np.random.default_rng(1), np.array([[0.9, 0.1], [0.2, 0.8]])
    for far, apart in ((1e10, 1e-3), (0.0, 1e8)):
        mean = far + apart * rng.normal(size=(5, 2, 4))
        covariance = 1e-4 * random_covariance(rng, 4, 10).reshape(5, 2, 4, 4)
        mixed, spread, predicted = mix(mean, covariance, np.full((5, 2), 0.5), switch)
        np.testing.assert_allclose(predicted, [[0.55, 0.45]] * 5)
        np.testing.assert_allclose(mixed[:, 0], (9.0 * mean[:, 0] + 2.0 * mean[:, 1]) / 11.0, rtol=1e-12)
        weights = 0.5 * switch / np.array([0.55, 0.45])  # [i, j]
        for j in range(2):
            difference = mean[:, 0] - mean[:, 1]
            within = np.einsum("i,nicd->ncd", weights[:, j], covariance)
            between = weights[0, j] * weights[1, j] * difference[:, :, None] * difference[:, None, :]
            np.testing.assert_allclose(spread[:, j], within + between, rtol=1e-6, atol=1e-12)
            assert np.linalg.eigvalsh(spread[:, j]).min() >= -1e-15 * apart**2
