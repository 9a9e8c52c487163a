"""The Kalman filter and the extended one, batched over any leading shape; all in place.

`predict` and `update` are the reference: the joint measurement update in Joseph's form, of any linear system, or of a
nonlinear one linearised, when they are the extended Kalman filter (Bar-Shalom, Li and Kirubarajan 2001).

Where a measured speed needs it there is a second form, with its time beside it; a test holds each to the reference.
Here these are `update_position` and `update_scalar`, for a radar object, which is a position (two dimensions,
correlated) and up to two speeds: sequential scalar updates after a joint one of the position, with the root of the
2 × 2 inverse written out, linearised at the state so far. They reduce P by what the measurement explains, which is fast
but rounds: a variance that falls by more than some 13 digits in one update is kept at that, and none falls by more than
there is of it, so that singular covariances and exact measurements leave all finite. Elsewhere: `axis_filter` and
`plane_filter` on packed covariances, `information` on Y = P⁻¹, and `radial` for three measured components.

Arrays are (…, D) for means and (…, D, D) for covariances.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.estimation.psd import factorise

LOG_2PI = float(np.log(2 * np.pi))

LEAST_VARIANCE = 1e-100
"""Of an innovation, SI units squared: an exact measurement of what is known exactly divides by it, changing nothing."""
LOST = 1e-13
"""Of the variances that add up to an innovation's: what rounding may lose; so much is added, and none falls below 0."""
_FARTHEST = 1e15
"""Innovation, SI units; one that is larger counts as that."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a measurement fits its prediction.

    Attributes:
        nis: normalised innovation squared.
        log_likelihood: of the innovation.
    """

    nis: Floats
    log_likelihood: Floats


def predict(
    mean: Floats, covariance: Floats, transition: Floats, noise: Floats, predicted: Floats | None = None
) -> None:
    """Predict over a step: x⁻ = F x, P⁻ = F P Fᵀ + Q.

    Args:
        mean: states (…, D), changed in place.
        covariance: (…, D, D), changed in place; symmetric to the last bit afterwards.
        transition: F, or the Jacobian of f at the mean, (…, D, D).
        noise: Q (…, D, D).
        predicted: f(x) (…, D) of a nonlinear system; None: F x.
    """
    mean[...] = times(transition, mean) if predicted is None else predicted
    covariance[...] = transition @ covariance @ np.swapaxes(transition, -1, -2) + noise
    symmetrise(covariance)


def update(mean: Floats, covariance: Floats, innovation: Floats, observation: Floats, noise: Floats) -> Fit:
    """Update with a measurement of any size.

    K = P Hᵀ S⁻¹ with S = H P Hᵀ + R, and P by Joseph's form, which stays positive semidefinite whatever K is rounded
    to. S may be singular (R = 0 and a state that is known): then S⁻¹ is a pseudo-inverse, and what was certain stays.
    Variances from 1e-100 to 1e100 keep all finite, an innovation beyond 1e15 counts as that.

    Args:
        mean: states (…, D), changed in place.
        covariance: P (…, D, D), changed in place; symmetric to the last bit afterwards.
        innovation: measured minus predicted (…, m).
        observation: H, or the Jacobian of h at the mean, (…, m, D).
        noise: R (…, m, m), positive semidefinite.

    Returns:
        The fit before the update; as many degrees of freedom as S has rank, m as a rule.
    """
    cross = covariance @ np.swapaxes(observation, -1, -2)
    factor = factorise(observation @ cross + noise)
    root = factor.inverse
    half = cross @ np.swapaxes(root, -1, -2)
    whitened = times(root, bounded(innovation))
    gain = half @ root
    mean += times(half, whitened)
    rest = np.eye(mean.shape[-1]) - gain @ observation
    covariance[...] = rest @ covariance @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(gain, -1, -2)
    symmetrise(covariance)
    nis = np.square(whitened).sum(axis=-1)
    return Fit(nis, -0.5 * (nis + factor.log_determinant + factor.rank * LOG_2PI))


def update_position(mean: Floats, covariance: Floats, position: Floats, noise: Floats) -> Fit:
    """Update with a measured position.

    Args:
        mean: states (…, D), x and y first; changed in place.
        covariance: (…, D, D), changed in place.
        position: measured (…, 2), m, in the axes of the state.
        noise: its covariance (…, 2, 2).

    Returns:
        The fit before the update, two degrees of freedom.
    """
    if compiled.fit_for(mean, covariance) and position.shape[1] == 1:
        nis, root = compiled.kernels.update_position(mean, covariance, position, noise)
        return Fit(nis, -np.log(root) - 0.5 * nis - LOG_2PI)
    # 64 tracks of six states: 0.25 ms, `update` 1.8 ms (7 times as long); compiled 0.02 ms.
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    first = np.sqrt(np.maximum((1.0 + LOST) * (covariance[..., 0, 0] + noise[..., 0, 0]), LEAST_VARIANCE))
    half_x = covariance[..., 0, :] / first[..., None]
    _keep_within(half_x, first, variance)
    slope = half_x[..., 1] + noise[..., 0, 1] / first
    second = _second_root(covariance[..., 1, 1] + noise[..., 1, 1], slope)
    half_y = (covariance[..., 1, :] - slope[..., None] * half_x) / second[..., None]
    _keep_within(half_y, second, variance - half_x * half_x)
    innovation = bounded(position - mean[..., :2])
    x = innovation[..., 0] / first
    y = (innovation[..., 1] - slope * x) / second
    mean += half_x * x[..., None]
    mean += half_y * y[..., None]
    covariance -= half_x[..., :, None] * half_x[..., None, :]
    covariance -= half_y[..., :, None] * half_y[..., None, :]
    nis = x * x + y * y
    return Fit(nis, -np.log(first * second) - 0.5 * nis - LOG_2PI)


def update_scalar(mean: Floats, covariance: Floats, row: Floats, innovation: Floats, variance: Floats) -> Fit:
    """Update with one measured number.

    Args:
        mean: states (…, D), changed in place.
        covariance: (…, D, D), changed in place.
        row: the measurement's Jacobian over the first K components, (…, K).
        innovation: measured minus predicted (…).
        variance: of the measurement (…).

    Returns:
        The fit before the update, one degree of freedom.
    """
    if compiled.fit_for(mean, covariance) and row.ndim == 3:
        shape = row.shape[:2]
        every, each = np.broadcast_to(innovation, shape), np.broadcast_to(variance, shape)
        nis, root = compiled.kernels.update_scalar(mean, covariance, row, every, each)
        return Fit(nis, -0.5 * (nis + LOG_2PI) - np.log(root))
    # 64 tracks of six states: 0.3 ms, `update` 1.1 ms (3.6 times as long); compiled 0.02 ms.
    width = range(row.shape[-1])
    cross = _summed(row[..., k, None] * covariance[..., k, :] for k in width)
    s = np.maximum(_summed(row[..., k] * cross[..., k] for k in width), 0.0) + variance
    s += LOST * np.abs(_summed(row[..., k] * row[..., k] * covariance[..., k, k] for k in width))
    root = np.sqrt(np.maximum(s, LEAST_VARIANCE))
    half = cross / root[..., None]
    _keep_within(half, root, np.diagonal(covariance, axis1=-2, axis2=-1))
    whitened = bounded(innovation) / root
    mean += half * whitened[..., None]
    covariance -= half[..., :, None] * half[..., None, :]
    nis = whitened * whitened
    return Fit(nis, -0.5 * (nis + LOG_2PI) - np.log(root))


def inverse_root(a: Floats, b: Floats, d: Floats) -> Floats:
    """Return G (…, 2, 2), lower triangular, with S⁻¹ = Gᵀ G of covariances S = ((a, b), (b, d)); finite if singular."""
    first, slope, second = triangular_root(a, b, d)
    root = np.zeros((*first.shape, 2, 2))
    np.divide(1.0, first, out=root[..., 0, 0])
    np.divide(1.0, second, out=root[..., 1, 1])
    np.divide(slope, -first * second, out=root[..., 1, 0])
    return root


def triangular_root(a: Floats, b: Floats, d: Floats) -> tuple[Floats, Floats, Floats]:
    """Return l, m, n with S = L Lᵀ, L = ((l, 0), (m, n)), of covariances S = ((a, b), (b, d)); l, n > 0 if singular."""
    first = np.sqrt(np.maximum((1.0 + LOST) * a, LEAST_VARIANCE))
    slope = b / first
    return first, slope, _second_root(d, slope)


def _second_root(d: Floats, slope: Floats) -> Floats:
    """Return n of `triangular_root`, told m."""
    return np.asarray(np.sqrt(np.maximum(np.maximum((1.0 + LOST) * d - slope * slope, LOST * d), LEAST_VARIANCE)))


def _keep_within(half: Floats, root: Floats, variance: Floats) -> None:
    """Let no innovation explain more of a component than there is: (P h)² ≤ hᵀ P h · P, as Cauchy and Schwarz have it.

    Where rounding took most of the innovation's variance, it would: that variance is raised until it does not.

    Args:
        half: P h over the root of the innovation's variance (…, D), changed in place.
        root: that root (…), likewise.
        variance: of the components (…, D).
    """
    beyond = half * half > variance
    if not beyond.any():
        return
    half[beyond & (variance <= 0.0)] = 0.0
    excess = np.divide(half * half, variance, out=np.ones(half.shape), where=beyond & (variance > 0.0)).max(axis=-1)
    root *= np.sqrt(excess)
    half /= np.sqrt(excess)[..., None]


def bounded(innovation: Floats) -> Floats:
    """Return innovations no larger than what a double can still square after it was divided by a tiny deviation."""
    return np.minimum(np.maximum(innovation, -_FARTHEST), _FARTHEST)


def propagated(covariance: Floats, transition: Floats) -> Floats:
    """Return F P Fᵀ of symmetric covariances (n, D, D) for transitions (n or 1, D, D)."""
    if len(transition) > 1:
        each: Floats = np.matmul(np.matmul(transition, covariance), np.swapaxes(transition, -1, -2))
        return each
    # One F for all is two large products instead of 2 n small ones: P Fᵀ, and its transpose times Fᵀ.
    width = covariance.shape[-1]
    half = (covariance.reshape(-1, width) @ transition[0].T).reshape(-1, width, width)
    both: Floats = np.swapaxes(half, 1, 2).reshape(-1, width) @ transition[0].T
    return both.reshape(-1, width, width)


def propagate(covariance: Floats, transition: Floats, noise: Floats) -> None:
    """Replace covariances by F P Fᵀ + Q.

    Args:
        covariance: P (n, D, D), symmetric, changed in place; so it stays to the last bit, and a component whose
            variance has fallen below zero counts as known.
        transition: F (n or 1, D, D).
        noise: Q (n or 1, D, D).
    """
    if compiled.in_use and covariance.shape[-1] <= compiled.COMPONENTS:
        compiled.kernels.propagate(covariance, transition, noise)
        return
    # Tracks last: numpy is quickest along the last axis.
    last, diagonals = covariance.transpose(1, 2, 0), diagonals_of(transition)
    both = diagonals.times(np.swapaxes(diagonals.times(np.ascontiguousarray(last)), 0, 1))
    both += noise.transpose(1, 2, 0)
    row, column = _above(len(both))
    both[row, column] = both[column, row]
    last[...] = both
    _forget_negative(covariance)


class Diagonals:
    """Matrices of many tracks by those of their diagonals that are not zero, which few of a transition are.

    Args:
        matrices: F (n or 1, D, D).
    """

    def __init__(self, matrices: Floats) -> None:
        rows, size = matrices.transpose(1, 2, 0), matrices.shape[-1]
        self._parts = []
        for k, first, end in _spans((matrices != 0.0).any(axis=0).tobytes(), size):
            diagonal = rows.diagonal(k).T[first + min(k, 0) : end + min(k, 0), None]
            self._parts.append((slice(first, end), slice(first + k, end + k), diagonal))

    def times(self, p: Floats) -> Floats:
        """Return F P for P (D, D, n), tracks last.

        The sums run from the first column of F to the last, as the kernels add them up; a matrix product's do not.
        """
        product = np.zeros(p.shape)
        for rows, columns, diagonal in self._parts:
            part = product[rows]
            part += diagonal * p[columns]
        return product


def diagonals_of(matrices: Floats) -> Diagonals:
    """Return the diagonals of matrices (n or 1, D, D); of one that all tracks share, those found before."""
    return Diagonals(matrices) if len(matrices) > 1 else _shared_diagonals(matrices.tobytes(), matrices.shape[-1])


@lru_cache
def _shared_diagonals(matrix: bytes, size: int) -> Diagonals:
    return Diagonals(np.frombuffer(matrix).reshape(1, size, size))


@lru_cache
def _spans(used: bytes, size: int) -> list[tuple[int, int, int]]:
    """Return which diagonals have elements that are used, and from which row to before which, by those (size, size)."""
    rows = dict[int, list[int]]()
    for row, column in np.argwhere(np.frombuffer(used, dtype=np.bool_).reshape(size, size)).tolist():
        rows.setdefault(column - row, []).append(row)
    return [(k, rows[k][0], rows[k][-1] + 1) for k in sorted(rows)]


@lru_cache
def _above(size: int) -> tuple[Indices, Indices]:
    """Return rows and columns of the elements above the diagonal of a matrix."""
    row, column = np.triu_indices(size, 1)
    return row, column


def symmetrise(covariance: Floats) -> None:
    """Undo in place what rounding does to covariances; without it the short update form diverges in some 1,000 cycles.

    They become symmetric, and a component whose variance has fallen below zero counts as known.
    """
    if compiled.in_use and covariance.flags.c_contiguous:
        compiled.kernels.halved(covariance.reshape(-1, *covariance.shape[-2:]))
    else:
        np.multiply(covariance + np.swapaxes(covariance, -1, -2), 0.5, out=covariance)
    _forget_negative(covariance)


def _forget_negative(covariance: Floats) -> None:
    """Count a component as known whose variance has fallen below zero."""
    variance = np.einsum("...ii->...i", covariance)
    if variance.min(initial=0.0) < 0.0:
        known = variance < 0.0
        covariance[known[..., :, None] | known[..., None, :]] = 0.0


def _summed(terms: Iterable[Floats]) -> Floats:
    """Return the sum of terms from the first to the last, as the compiled kernels add them up."""
    first, *further = terms
    for term in further:
        first += term
    return first


def times(matrix: Floats, vector: Floats) -> Floats:
    """Return the product of matrices (…, p, q) and vectors (…, q)."""
    return np.asarray(np.matmul(matrix, vector[..., None])[..., 0])
