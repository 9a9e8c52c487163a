"""Federated filtering with feedback (FR mode), batched over tracks: paper 004, section 3.3; equations counted as there.

Each sensor has a local filter of the whole state, a global filter fuses them and hands the result back. A local filter
is given only its share β of the information: covariance and process noise divided by β, Σ β = 1. The shares add up to
what there is, so that nothing counts twice: the fused estimate is the centralised filter's, whatever the shares.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.kalman import Fit, predict, symmetrise, update
from candaemon.estimation.psd import factorise


def fused(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return X_g = P_g Σ Pᵢ⁻¹ Xᵢ and P_g = (Σ Pᵢ⁻¹)⁻¹, paper 004 (19) and (20).

    Two at a time, and by the inverse of their sum: P_g = P₁ (P₁ + P₂)⁻¹ P₂. So a component that the model lacks, whose
    variance is zero, does no harm.

    Args:
        mean: independent estimates of one state (…, S, D).
        covariance: (…, S, D, D).

    Returns:
        (…, D) and (…, D, D).
    """
    x, p = mean[..., 0, :], covariance[..., 0, :, :]
    for sensor in range(1, mean.shape[-2]):
        other = covariance[..., sensor, :, :]
        root = factorise(p + other).inverse
        weight = p @ np.swapaxes(root, -1, -2) @ root
        x = x + np.matmul(weight, (mean[..., sensor, :] - x)[..., None])[..., 0]
        p = weight @ other
        symmetrise(p)
    return x, p


def information_shares(trace: Floats, outage: float = 20.0, least: float = 0.01) -> Floats:
    """Return the information factors β, paper 004 (21) and (22), for any number of sensors.

    In proportion to 1/tr(R); but a sensor whose tr(R) is `outage` times that of the best, or more, is left `least`, and
    the others share the rest. The paper has two sensors and watches the lidar alone. None is left more than 1/S, so
    that the others never have less.

    Args:
        trace: tr(R) of each sensor (…, S), positive.
        outage: 20 in the paper.
        least: 0.01 in the paper.

    Returns:
        β (…, S), positive, of sum one.
    """
    least = min(least, 1.0 / trace.shape[-1])
    best = trace.min(axis=-1, keepdims=True)
    failed = trace >= outage * best
    weight = np.where(failed, 0.0, best / trace)
    remaining = 1.0 - least * failed.sum(axis=-1, keepdims=True)
    return np.where(failed, least, remaining * weight / weight.sum(axis=-1, keepdims=True))


class Federated:
    """Local filters of S sensors and the global filter above them, for n tracks.

    Rows are tracks; the state is the caller's, (D,), as are F, Q and every H.

    `fuse` after the updates and before the next `predict`, and the fused estimate equals that of one centralised filter
    with the same F, Q, H and R. It is so for a sensor that measured nothing too: its local filter keeps its prediction.

    Args:
        sensors: S.
        outage: see `information_shares`.
        least: see `information_shares`.

    Attributes:
        mean: of the local filters (n, S, D).
        covariance: of the local filters (n, S, D, D).
        share: β (n, S), of sum one.
    """

    def __init__(self, sensors: int, *, outage: float = 20.0, least: float = 0.01) -> None:
        self._sensors = sensors
        self._outage = outage
        self._least = least
        self.mean: Floats = np.zeros((0, sensors, 0))
        self.covariance: Floats = np.zeros((0, sensors, 0, 0))
        self.share: Floats = np.zeros((0, sensors))

    def __len__(self) -> int:
        return len(self.share)

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append tracks with means (k, D) and covariances (k, D, D), which the sensors share alike."""
        share = np.full((len(mean), self._sensors), 1.0 / self._sensors)
        locals_, spread = self._handed_out(mean, covariance, share)
        if not len(self):
            width = mean.shape[1]
            self.mean, self.covariance = (np.zeros((0, self._sensors, *size)) for size in ((width,), (width, width)))
        self.mean = np.concatenate([self.mean, locals_])
        self.covariance = np.concatenate([self.covariance, spread])
        self.share = np.concatenate([self.share, share])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self.mean, self.covariance, self.share = self.mean[rows], self.covariance[rows], self.share[rows]

    def predict(self, transition: Floats, noise: Floats, predicted: Floats | None = None) -> None:
        """Predict all local filters, (8) and (9) with Qᵢ = Q/βᵢ of (23).

        Args:
            transition: F, or the Jacobian of f, (D, D) or (n, 1, D, D).
            noise: Q, (D, D) or (n, 1, D, D).
            predicted: f(x) of each local mean (n, S, D); None: F x.
        """
        predict(self.mean, self.covariance, transition, noise / self.share[:, :, None, None], predicted)

    def expected(self, sensor: int, rows: Indices, observation: Floats) -> tuple[Floats, Floats]:
        """Return what a sensor should measure of the given rows and the covariance of that, (m, d) and (m, d, d).

        H x⁻ and β H Pᵢ⁻ Hᵀ: the local filter's own covariance is 1/β times that of its error, as long as it has not
        been updated since it was reset; and an estimator of the sensor's noise needs the error's.
        """
        spread = observation @ self.covariance[rows, sensor] @ np.swapaxes(observation, -1, -2)
        return self.mean[rows, sensor] @ observation.T, self.share[rows, sensor, None, None] * spread

    def update(self, sensor: int, rows: Indices, innovation: Floats, observation: Floats, noise: Floats) -> Fit:
        """Update a sensor's local filter of the given rows, (10) to (12).

        Args:
            sensor: index among the sensors.
            rows: (m,), each once.
            innovation: (m, d).
            observation: H, (d, D) or (m, d, D).
            noise: R, (d, d) or (m, d, d).
        """
        mean, covariance = self.mean[rows, sensor], self.covariance[rows, sensor]
        fit = update(mean, covariance, innovation, observation, noise)
        self.mean[rows, sensor], self.covariance[rows, sensor] = mean, covariance
        return fit

    def combined(self) -> tuple[Floats, Floats]:
        """Return the fused mean (n, D) and covariance (n, D, D)."""
        return fused(self.mean, self.covariance)

    def fuse(self, trace: Floats) -> tuple[Floats, Floats]:
        """Fuse the local filters and hand the result back to them by shares, (19) to (25).

        Args:
            trace: tr(R) of each sensor (n, S), positive.

        Returns:
            The fused mean X_g (n, D) and covariance P_g (n, D, D).
        """
        mean, covariance = self.combined()
        self.share = information_shares(trace, self._outage, self._least)
        self.mean, self.covariance = self._handed_out(mean, covariance, self.share)
        return mean, covariance

    def _handed_out(self, mean: Floats, covariance: Floats, share: Floats) -> tuple[Floats, Floats]:
        """Return the local filters' means Xᵢ = X_g and covariances Pᵢ = P_g/βᵢ, (24) and (25)."""
        return (
            np.repeat(mean[:, None], self._sensors, axis=1),
            covariance[:, None] / share[:, :, None, None],
        )
