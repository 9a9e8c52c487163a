"""Components that some models of an IMM have and lend to the others for the mixing.

A model that lacks a component takes part in its mixing with the estimate of those that have it; so it biases nobody
(Yuan, Bar-Shalom et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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


def lendings(has: NDArray[np.bool_], blocks: Sequence[slice]) -> list[Lending]:
    """Return the blocks that some models have and others lack, by the table has[model, component]."""
    found = []
    for block in blocks:
        have = has[:, block].any(axis=1)
        if have.any() and not have.all():
            found.append(Lending(block, np.flatnonzero(have).tolist(), np.flatnonzero(~have).tolist()))
    return found
