"""The steps that make an interacting multiple model filter of M filters: pure functions over n tracks.

Blom and Bar-Shalom's cycle, as paper 002 section 3 takes it over: `switching` and `mix` come before each model's own
prediction and update, `posterior` after them, and `moments` is the combination. The paper numbers the chain (3) alone.
Means are (n, M, D), covariances (n, M, D, D), probabilities (n, M).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats

_LEAST_PROBABILITY = 1e-12
_LEAST_LOG_LIKELIHOOD = -1e300


def switching(rate: float, dt: float, models: int) -> Floats:
    """Return the Markov chain of paper 002 (3) over a step: [i, j] is the probability of going from i to j, (M, M).

    Args:
        rate: of leaving a model, 1/s; in dt a model is left with probability 1 − e^(−rate·dt), shared evenly.
        dt: s.
        models: M.
    """
    leave = -np.expm1(-rate * dt)
    switch = np.full((models, models), leave / max(models - 1, 1))
    np.fill_diagonal(switch, 1.0 - leave)
    return switch


def mix(mean: Floats, covariance: Floats, probability: Floats, switch: Floats) -> tuple[Floats, Floats, Floats]:
    """Mix the models' estimates, weighted by the ways that lead to each model.

    Args:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        probability: of the modes, (n, M).
        switch: Markov chain (M, M), rows sum to one.

    Returns:
        Mixed means, mixed covariances with the means' spread, and the predicted mode probabilities.
    """
    n, m, d = mean.shape
    predicted = probability @ switch
    weights = probability[:, None, :] * switch.T[None] / predicted[:, :, None]
    mixed = np.matmul(weights, mean)
    # Spread around each mixed mean, a sum of squares: second moments less the mean's would cancel, even below zero.
    deviation = mean[:, None] - mixed[:, :, None]
    spread = np.matmul(weights, covariance.reshape(n, m, d * d)).reshape(n, m, d, d)
    spread += np.matmul(np.swapaxes(weights[..., None] * deviation, -1, -2), deviation)
    return mixed, spread, predicted


def posterior(prior: Floats, log_likelihood: Floats) -> Floats:
    """Return the mode probabilities after a measurement; none ever becomes zero.

    Args:
        prior: predicted mode probabilities, (n, M).
        log_likelihood: of the measurement under each model, (n, M); −∞ under all of them tells nothing.
    """
    log_likelihood = np.maximum(log_likelihood, _LEAST_LOG_LIKELIHOOD)
    probability = prior * np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    probability = np.maximum(probability, _LEAST_PROBABILITY)
    probability /= probability.sum(axis=1, keepdims=True)
    return np.asarray(probability)


def moments(probability: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return the mean (n, D) and the covariance (n, D, D) of the mixture of the models' estimates.

    Args:
        probability: of the modes, (n, M).
        mean: (n, M, D).
        covariance: (n, M, C, C), of the first C ≤ D components; the others are certain within a model.
    """
    n, m, c = *mean.shape[:2], covariance.shape[-1]
    overall = np.matmul(probability[:, None, :], mean)
    deviation = mean - overall
    combined = np.matmul(np.swapaxes(deviation, 1, 2) * probability[:, None, :], deviation)
    within = np.matmul(probability[:, None, :], covariance.reshape(n, m, c * c))
    combined[:, :c, :c] += within.reshape(n, c, c)
    return overall[:, 0], combined


@dataclass(frozen=True, slots=True)
class Lending:
    """Who has a block of components, and who borrows it.

    Attributes:
        block: the components.
        lenders: models that have them.
        borrowers: models that do not.
    """

    block: slice
    lenders: list[int]
    borrowers: list[int]

    def fill(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        """Give the borrowers what the lenders say, in place.

        Args:
            mean: (n, M, D).
            covariance: (n, M, D, D).
            probability: of the modes, (n, M).
        """
        block = self.block
        lent, spread = self._estimate(mean, covariance, probability)
        for j in self.borrowers:
            mean[:, j, block] = lent
            covariance[:, j, block, block] = spread

    def _estimate(self, mean: Floats, covariance: Floats, probability: Floats) -> tuple[Floats, Floats]:
        """Combine what the lenders say: mean (n, C) and covariance (n, C, C)."""
        block, models = self.block, self.lenders
        if len(models) == 1:
            return mean[:, models[0], block], covariance[:, models[0], block, block]
        share = probability[:, models]
        share = share / np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        lent = np.einsum("nj,njc->nc", share, mean[:, models, block])
        deviation = mean[:, models, block] - lent[:, None]
        spread = np.einsum("nj,njcd->ncd", share, covariance[:, models, block, block])
        spread += np.einsum("nj,njc,njd->ncd", share, deviation, deviation)
        return lent, spread


def lendings(has: Booleans, blocks: Sequence[slice]) -> list[Lending]:
    """Return the blocks that some models have and others lack, by the table has[model, component]."""
    found = []
    for block in blocks:
        have = has[:, block].any(axis=1)
        if have.any() and not have.all():
            found.append(Lending(block, np.flatnonzero(have).tolist(), np.flatnonzero(~have).tolist()))
    return found
