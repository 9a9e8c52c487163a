"""Estimators of a sensor's measurement noise from the innovations of a linear filter: what they have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices


@dataclass(frozen=True, slots=True)
class Adapted:
    """What an innovation taught.

    Attributes:
        innovation: to update the state with, (m, d).
        noise: covariance of the measurement, R̂, (m, d, d).
        spread: covariance of the innovation, Ĉ, (m, d, d).
    """

    innovation: Floats
    noise: Floats
    spread: Floats


class NoiseEstimator(Protocol):
    """Learns a sensor's measurement noise from innovations, for each of n tracks."""

    def spawn(self, count: int) -> None:
        """Append tracks whose noise is the nominal one."""
        ...

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        ...

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats) -> Adapted:
        """Learn from an innovation of each of the given rows, before the filter's own update.

        Args:
            rows: (m,), each once.
            innovation: v = z − H x⁻, (m, d).
            predicted: H P⁻ Hᵀ (m, d, d), the prediction's share in its covariance.
        """
        ...


def diagonal(variance: Floats) -> Floats:
    """Return diagonal matrices (…, d, d) of variances (…, d)."""
    matrix: Floats = variance[..., None] * np.eye(variance.shape[-1])
    return matrix
