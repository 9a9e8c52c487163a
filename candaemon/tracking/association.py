"""Which detection belongs to which track."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.estimation.measurement import Measurement, line_of_sight

Solver: TypeAlias = Callable[[Floats], tuple[Indices, Indices]]


def assign(cost: Floats) -> tuple[Indices, Indices]:
    """Pair each row with a column of its own, or each column with a row where there are fewer, at the least sum.

    Args:
        cost: of each pair, (n, m), finite.

    Returns:
        Rows, ascending, and their columns.
    """
    return _solver()(cost)


@cache
def _solver() -> Solver:
    """Return scipy's solver, which is one file of C++.

    The package around it takes half a second to import: too long in a running service, and more than all the rest of
    its start. Where the file is not where it used to be, the package is imported all the same.
    """
    scipy = find_spec("scipy")
    folders = [] if scipy is None else scipy.submodule_search_locations or []
    for path in (Path(folder, "optimize", f"_lsap{suffix}") for folder in folders for suffix in EXTENSION_SUFFIXES):
        spec = spec_from_file_location("scipy.optimize._lsap", path)
        if path.is_file() and spec is not None and spec.loader is not None:
            module = module_from_spec(spec)
            spec.loader.exec_module(module)
            return cast("Solver", module.linear_sum_assignment)
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - see above

    return cast("Solver", linear_sum_assignment)


_OUT_OF_GATE = 1e9
_LEAST, _MOST = 1e-12, 1e3  # of a probability, and of a NIS, that a logarithm is taken of
_REACH = 30.0  # m; a pair farther apart passes no gate and is not worth the arithmetic


def pair_nis(mean: Floats, covariance: Floats, measurement: Measurement) -> Floats:
    """Return the normalised innovation squared of m aligned pairs.

    Position and range rate are taken jointly, through the Schur complement of the position's 2 × 2 block.

    Args:
        mean: predicted states (m, 6).
        covariance: (m, 6, 6).
        measurement: m detections.
    """
    if measurement.projections:
        return _joint_nis(mean, covariance, measurement)
    speed = variance = predicted = np.full(len(mean), np.nan)  # of a sensor that measures none
    row = np.zeros((len(mean), 4))
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        speed, variance = measurement.range_rate, measurement.range_rate_variance
        predicted, row = line_of_sight(mean, measurement.origin, measurement.velocity)
    if compiled.in_use:
        return compiled.kernels.pair_nis(
            mean, covariance, measurement.position, measurement.noise, predicted, row, speed, variance
        )
    innovation = measurement.position - mean[:, :2]
    s = covariance[:, :2, :2] + measurement.noise
    a, b, d = s[:, 0, 0], s[:, 0, 1], s[:, 1, 1]
    determinant = a * d - b * b
    ix, iy = innovation[:, 0], innovation[:, 1]
    nis = (d * ix * ix - 2 * b * ix * iy + a * iy * iy) / determinant
    cross = covariance[:, :4, 0] * row[:, 0, None]
    for k in range(1, 4):
        cross += covariance[:, :4, k] * row[:, k, None]
    cx, cy = cross[:, 0], cross[:, 1]
    gain_x, gain_y = (d * cx - b * cy) / determinant, (a * cy - b * cx) / determinant
    residual = speed - predicted - gain_x * ix - gain_y * iy
    spread = row[:, 0] * cross[:, 0]
    for k in range(1, 4):
        spread += row[:, k] * cross[:, k]
    spread += variance
    spread -= gain_x * cx
    spread -= gain_y * cy
    with np.errstate(over="ignore"):  # infinitely far off is out of every gate
        return nis + np.where(np.isfinite(residual), residual * residual / spread, 0.0)


def _joint_nis(mean: Floats, covariance: Floats, measurement: Measurement) -> Floats:
    """Return the same where the sensor gives velocity components: all measured numbers in one system of equations."""
    innovation, jacobian, noise = measurement.linearised(mean[:, :4])
    return _nis(innovation, jacobian @ covariance[:, :4, :4] @ np.swapaxes(jacobian, 1, 2) + noise)


def nis_in_best_mode(probability: Floats, innovation: Floats, spread: Floats, least: float) -> Floats:
    """Return the normalised innovation squared of pairs (…) in the mode that fits each best, of those not improbable.

    Args:
        probability: of the modes (…, M).
        innovation: in each mode (…, M, f).
        spread: covariance of it (…, M, f, f).
        least: probability of a mode below which it is improbable.
    """
    nis = _nis(innovation, spread)
    return np.asarray(np.where(probability >= least, nis, np.inf).min(axis=-1))


def nis_over_modes(probability: Floats, innovation: Floats, spread: Floats, overall: Floats) -> Floats:
    """Return how unlikely pairs (…) are over all modes: −2 ln of the likelihood by its peak, were it one Gaussian.

    So it is the normalised innovation squared where the modes are alike (Alspach and Sorenson 1972). One Gaussian would
    hide what an unlikely mode allows: of a car that cruised and was not detected for half a second, one in two hundred
    has braked.

    Args:
        probability: of the modes (…, M).
        innovation: in each mode (…, M, f).
        spread: covariance of it (…, M, f, f).
        overall: covariance of the innovation over all modes (…, f, f).
    """
    volume, whole = (np.maximum(np.linalg.slogdet(each)[1], -_MOST) for each in (spread, overall))
    cost = np.clip(_nis(innovation, spread) + volume - whole[..., None], -_MOST, _MOST)
    return np.asarray(-2.0 * np.log((np.maximum(probability, _LEAST) * np.exp(-0.5 * cost)).sum(axis=-1)))


def _nis(innovation: Floats, spread: Floats) -> Floats:
    """Return the normalised innovation squared (…) of innovations (…, f) with covariances (…, f, f)."""
    try:
        solved = np.linalg.solve(spread, innovation[..., None])[..., 0]
    except np.linalg.LinAlgError:  # numbers so far apart that 64 bits do not hold the small ones: no pair passes a gate
        return np.full(innovation.shape[:-1], np.inf)
    with np.errstate(over="ignore"):  # as in `pair_nis`
        return np.asarray((innovation * solved).sum(axis=-1))


def nearest_neighbours(
    mean: Floats, covariance: Floats, tracks: Indices, measurement: Measurement, detections: Indices, gate: float
) -> tuple[Indices, Indices]:
    """Assign detections to tracks by global nearest neighbour behind a gate.

    Args:
        mean: predicted states of all tracks (n, 6).
        covariance: (n, 6, 6).
        tracks: rows of the tracks that are free.
        measurement: all detections.
        detections: rows of the detections that are free.
        gate: largest normalised innovation squared.

    Returns:
        Rows of tracks and rows of detections, aligned.
    """
    track, detection, nis = gated_pairs(mean, covariance, tracks, measurement, detections, gate)
    chosen = best_pairs(track, detection, nis)
    return track[chosen], detection[chosen]


def gated_pairs(
    mean: Floats,
    covariance: Floats,
    tracks: Indices,
    measurement: Measurement,
    detections: Indices,
    gate: float | Floats,
) -> tuple[Indices, Indices, Floats]:
    """Return the pairs within the gate: rows of tracks (p,), of detections (p,), and their NIS (p,).

    Args:
        mean: as in `nearest_neighbours`, like all others.
        covariance: likewise.
        tracks: likewise.
        measurement: likewise.
        detections: likewise.
        gate: likewise, or one for each of all detections.
    """
    track, detection = near_pairs(mean, tracks, measurement, detections)
    if not len(track):
        return track, detection, np.empty(0)
    nis = pair_nis(mean[track], covariance[track], measurement.take(detection))
    inside = nis <= (gate.take(detection) if isinstance(gate, np.ndarray) else gate)
    return track[inside], detection[inside], nis[inside]


def near_pairs(mean: Floats, tracks: Indices, measurement: Measurement, detections: Indices) -> tuple[Indices, Indices]:
    """Return the pairs that are near enough to pass a gate: rows of tracks (p,) and of detections (p,).

    Args:
        mean: as in `nearest_neighbours`, like all others.
        tracks: likewise.
        measurement: likewise.
        detections: likewise.
    """
    if not len(tracks) or not len(detections):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    apart = np.abs(mean[tracks, None, :2] - measurement.position[None, detections]).max(axis=2)
    t, d = np.nonzero(apart < _REACH)
    return tracks[t], detections[d]


def best_pairs(track: Indices, detection: Indices, cost: Floats) -> Indices:
    """Return which pairs (p,) assign most detections at the least cost, each track and detection in one at most.

    Args:
        track: of each pair, ascending, and within a track detections ascending.
        detection: likewise.
        cost: of each pair.
    """
    if len(track) < 2:
        return np.arange(len(track))
    tracks, t = np.unique(track, return_inverse=True)
    detections, d = np.unique(detection, return_inverse=True)
    table = np.full((len(tracks), len(detections)), _OUT_OF_GATE)
    table[t, d] = cost
    number = np.zeros(table.shape, dtype=np.intp)
    number[t, d] = np.arange(len(track))
    chosen_t, chosen_d = assign(table)
    real = table[chosen_t, chosen_d] < _OUT_OF_GATE
    return number[chosen_t[real], chosen_d[real]]
