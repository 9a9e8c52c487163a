"""The interacting multiple model filter, batched over tracks and models at once.

One filter with M models keeps means (n, M, D) and covariances (n, M, D, D) over the union of its models' components.
A single model is an IMM with M = 1, whose mixing is the identity. The cycle of Blom and Bar-Shalom 1988, which Kim and
Hong 2004 take over in their section 3:

1. mixing (`Imm._interact`, `mix`): μᵢ|ⱼ = πᵢⱼ μᵢ / cⱼ, x̂₀ⱼ = Σ μᵢ|ⱼ x̂ᵢ, P₀ⱼ = Σ μᵢ|ⱼ (Pᵢ + (x̂ᵢ − x̂₀ⱼ)(x̂ᵢ − x̂₀ⱼ)ᵀ);
2. prediction by each model (`FilterBank.predict`): x̂ⱼ⁻ = f(x̂₀ⱼ), Pⱼ⁻ = F P₀ⱼ Fᵀ + Qⱼ;
3. update of each model (`Imm._update_models`): x̂ⱼ, Pⱼ by the Kalman or the information filter, likelihood Λⱼ;
4. mode probabilities (`Imm._update_probabilities`, `posterior`): μⱼ = Λⱼ cⱼ / Σ Λᵢ cᵢ, cⱼ = Σ πᵢⱼ μᵢ;
5. combination (`FilterBank.combined`, `moments`): x̂ = Σ μⱼ x̂ⱼ, P = Σ μⱼ (Pⱼ + (x̂ⱼ − x̂)(x̂ⱼ − x̂)ᵀ).

Steps 1 and 2 are `predict`, 3 and 4 `update`; 5 does not enter the next cycle.

A model that lacks a component (a constant velocity model has no acceleration) takes part in the mixing of that
component with the estimate of those models that have it; so it biases none (Yuan, Bar-Shalom et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1
from typing import Literal, TypeAlias

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.filter_bank import MomentBank, mixture, summed_models
from candaemon.estimation.kalman import LOG_2PI
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.measurement_update import correct, inform
from candaemon.estimation.motion_models import ACCELERATION, JERK, TURN, MotionModel
from candaemon.estimation.sensor_noise import SensorNoise

Form: TypeAlias = Literal["covariance", "information"]
"""How a model's filter takes a measurement: as a Kalman filter, extended where it must, or as an information filter."""

_LEAST_PROBABILITY = 1e-12
_LEAST_LOG_LIKELIHOOD = -1e300
_BLOCKS = (ACCELERATION, slice(TURN, TURN + 1), JERK)


class Imm(MomentBank):
    """Batched IMM over any motion models; rows are tracks.

    State order [x, y, vx, vy, ax, ay, ω, jx, jy], cut after what the models use; local frame, SI units.

    Args:
        models: the motion models.
        switch_rate: rate of leaving a model, 1/s; over a step dt a model is left with probability
            1 − e^(−rate·dt), shared evenly among the others.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
        jerk: standard deviation of a track's first jerk, m/s³.
        forms: of each model's measurement update; none: all are Kalman filters. In information form the measurement's
            parts are linearised at the prediction together, Kim and Hong 2004, eq. (17); else one after another.
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.

    Attributes:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        probability: of the modes, (n, M).
    """

    def __init__(
        self,
        models: Sequence[MotionModel],
        *,
        switch_rate: float,
        acceleration: float,
        turn_rate: float = 1.0,
        jerk: float = 1.0,
        forms: Sequence[Form] = (),
        noise: SensorNoise | None = None,
    ) -> None:
        super().__init__(models, acceleration=acceleration, turn_rate=turn_rate, jerk=jerk, noise=noise)
        self._switch_rate = switch_rate
        self._forms = tuple(forms) or ("covariance",) * len(self._models)
        if len(self._forms) != len(self._models):
            raise ValueError(f"{len(self._models)} models, {len(self._forms)} forms; give one form a model, or none")
        self._unequal = unequal_blocks(self._has, _BLOCKS)
        self._source = np.tile(np.arange(len(self._models))[:, None], self._width)
        for unequal in self._unequal:
            if len(unequal.having) == 1:
                self._source[unequal.lacking, unequal.block] = unequal.having[0]

    def predict(self, dt: float, direction: Floats) -> None:
        """Predict all tracks under every model; see `FilterBank.predict`."""
        super().predict(dt, direction)
        state = self._state  # where numpy has mixed, tracks are last in memory; kept and saved, they are first
        state.mean, state.covariance = np.ascontiguousarray(state.mean), np.ascontiguousarray(state.covariance)

    def update(self, rows: Indices, measurement: Measurement) -> Floats:
        """Update the given rows (m,) with a measurement each; return their NIS (m,); see `FilterBank.update`."""
        if not _fitting(self._has) or "information" in self._forms or measurement.projections:
            return super().update(rows, measurement)
        measurement, state = self._adapted(rows, measurement), self._state
        nis, root = compiled.kernels.update_models(
            state.mean,
            state.covariance,
            self._has,
            rows,
            measurement.position,
            measurement.noise,
            None if measurement.range_rate_variance is None else measurement.range_rate,
            measurement.range_rate_variance,
            *measurement.origin.tolist(),
            *measurement.velocity.tolist(),
        )
        nis, log_likelihood = compiled.kernels.fits(nis, np.log(root), LOG_2PI, _LEAST_LOG_LIKELIHOOD)
        self._note_fit(rows, nis, measurement)
        if len(self._models) == 1:
            return nis[:, 0]
        return compiled.kernels.weigh(state.probability, rows, np.exp(log_likelihood), nis, _LEAST_PROBABILITY)

    def _update_models(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        if "information" not in self._forms:
            return super()._update_models(rows, mean, covariance, measurement)
        nis, log_likelihood = np.empty(mean.shape[:2]), np.empty(mean.shape[:2])
        for form in dict.fromkeys(self._forms):
            chosen = [j for j, each in enumerate(self._forms) if each == form]
            chosen_mean, chosen_covariance = mean[:, chosen], covariance[:, chosen]
            nis[:, chosen], log_likelihood[:, chosen] = _CORRECT[form](chosen_mean, chosen_covariance, measurement)
            mean[:, chosen], covariance[:, chosen] = chosen_mean, chosen_covariance
        return nis, log_likelihood

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        self.probability[rows] = posterior(self.probability[rows], log_likelihood)

    def _interact(self, dt: float) -> None:
        """Mix the models' estimates with their spread, and predict the mode probabilities by the chain (3)."""
        if len(self._models) == 1:
            return
        switch = switching(self._switch_rate, dt, len(self._models))
        state, by_kernels = self._state, _fitting(self._has)
        for unequal in self._unequal:
            if not by_kernels or len(unequal.having) > 1:  # else the kernel takes the estimate of the one that has it
                unequal.fill(state.mean, state.covariance, state.probability)
        if by_kernels:
            compiled.kernels.interact(state.mean, state.covariance, state.probability, switch, self._has, self._source)
            if any(len(unequal.having) > 1 for unequal in self._unequal):
                _clear(state.mean, state.covariance, self._has)
        else:
            state.mean, state.covariance, state.probability = mix(
                state.mean, state.covariance, state.probability, switch, self._has
            )
            if compiled.in_use:  # other kernels take what lies in memory track by track
                state.mean, state.covariance = np.ascontiguousarray(state.mean), np.ascontiguousarray(state.covariance)


_CORRECT = {"covariance": correct, "information": inform}


def switching(rate: float, dt: float, models: int) -> Floats:
    """Return the Markov chain over a step: [i, j] is the probability of going from i to j, (M, M).

    Source: Kim and Hong 2004, eq. (3).

    Args:
        rate: of leaving a model, 1/s; in dt a model is left with probability 1 − e^(−rate·dt), shared evenly.
        dt: s.
        models: M.
    """
    leave = -expm1(-rate * dt)
    switch = np.full((models, models), leave / max(models - 1, 1))
    switch.flat[:: models + 1] = 1.0 - leave
    return switch


def mix(
    mean: Floats, covariance: Floats, probability: Floats, switch: Floats, has: Booleans | None = None
) -> tuple[Floats, Floats, Floats]:
    """Mix the models' estimates, weighted by the ways that lead to each model.

    Args:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        probability: of the modes, (n, M).
        switch: Markov chain (M, M), rows sum to one.
        has: components that each model has (M, D); the others become zero. None: all.

    Returns:
        Mixed means, mixed covariances with the means' spread, and the predicted mode probabilities.
    """
    has = np.ones(mean.shape[1:], dtype=np.bool_) if has is None else has
    if _fitting(has):
        source = np.tile(np.arange(len(switch))[:, None], has.shape[1])
        mixed, spread, predicted = (np.array(each, order="C") for each in (mean, covariance, probability))
        compiled.kernels.interact(mixed, spread, predicted, switch, has, source)
        _clear(mixed, spread, has)
        return mixed, spread, predicted
    predicted = probability[:, 0, None] * switch[0]
    for i in range(1, len(switch)):
        predicted += probability[:, i, None] * switch[i]
    weights = probability[:, None, :] * switch.T[None] / predicted[:, :, None]
    mixed, spread = mixture(weights, mean, covariance)
    _clear(mixed, spread, has)
    return mixed, spread, predicted


def _fitting(has: Booleans) -> bool:
    """Return whether the kernels of interacting models have room for models with these components (M, D)."""
    models, size = has.shape
    return compiled.in_use and models <= compiled.MODELS and size <= compiled.COMPONENTS


def _clear(mean: Floats, covariance: Floats, has: Booleans) -> None:
    """Set what models lack, of means (n, M, D) and covariances (n, M, D, D), to zero in place."""
    mean.transpose(1, 2, 0)[~has] = 0.0
    covariance.transpose(1, 2, 3, 0)[~(has[:, :, None] & has[:, None, :])] = 0.0


def posterior(prior: Floats, log_likelihood: Floats) -> Floats:
    """Return the mode probabilities after a measurement; none ever becomes zero.

    Args:
        prior: predicted mode probabilities, (n, M).
        log_likelihood: of the measurement under each model, (n, M); −∞ under all of them changes nothing.
    """
    log_likelihood = np.maximum(log_likelihood, _LEAST_LOG_LIKELIHOOD)
    probability = prior * np.exp(log_likelihood - np.maximum.reduce(log_likelihood, axis=1, keepdims=True))
    probability = np.maximum(probability, _LEAST_PROBABILITY)
    probability /= summed_models(probability)[:, None]
    return np.asarray(probability)


@dataclass(frozen=True, slots=True)
class UnequalBlock:
    """A block of components that some models have and others lack, for mixing models of unequal dimension.

    Attributes:
        block: the components.
        having: models that have them.
        lacking: models that do not.
    """

    block: slice
    having: list[int]
    lacking: list[int]

    def fill(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        """Give the models that lack the block the estimate of those that have it, in place.

        Args:
            mean: (n, M, D).
            covariance: (n, M, D, D).
            probability: of the modes, (n, M).
        """
        block = self.block
        combined, spread = self._estimate(mean, covariance, probability)
        for j in self.lacking:
            mean[:, j, block] = combined
            covariance[:, j, block, block] = spread

    def _estimate(self, mean: Floats, covariance: Floats, probability: Floats) -> tuple[Floats, Floats]:
        """Combine the estimates of the models that have it: mean (n, C) and covariance (n, C, C)."""
        block, models = self.block, self.having
        if len(models) == 1:
            return mean[:, models[0], block], covariance[:, models[0], block, block]
        share = probability[:, models]
        share = share / np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        combined = np.einsum("nj,njc->nc", share, mean[:, models, block])
        deviation = mean[:, models, block] - combined[:, None]
        spread = np.einsum("nj,njcd->ncd", share, covariance[:, models, block, block])
        spread += np.einsum("nj,njc,njd->ncd", share, deviation, deviation)
        return combined, spread


def unequal_blocks(has: Booleans, blocks: Sequence[slice]) -> list[UnequalBlock]:
    """Return the blocks that some models have and others lack, by the table has[model, component]."""
    found = []
    for block in blocks:
        have = has[:, block].any(axis=1)
        if have.any() and not have.all():
            found.append(UnequalBlock(block, np.flatnonzero(have).tolist(), np.flatnonzero(~have).tolist()))
    return found
