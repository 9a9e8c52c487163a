"""A Kalman filter of many tracks in the plane, by one model that treats x and y alike.

It gives what an `Imm` of that one model gives. As in `AxisFilter`, whose tracks have x and y apart, all that is known
of a track is one column of one array: the covariance by its upper triangle, then the variances that drive x and y. So
tracks lie side by side in memory, and no covariance can lose its symmetry.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.axis_filter import axis_matrices
from candaemon.estimation.discretisation import X, Y, axis_elements, isotropic
from candaemon.estimation.estimator_state import PlaneFilterState
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.kalman import LEAST_VARIANCE, LOST, bounded, triangular_root
from candaemon.estimation.measurement import Measurement, Projection, in_order, line_of_sight
from candaemon.estimation.motion_models import ACCELERATION, VELOCITY, CurrentStatistical, Singer, driven_variance
from candaemon.estimation.output_state import OutputState
from candaemon.estimation.packed_symmetric import PackedSymmetric
from candaemon.estimation.sensor_noise import SensorNoise

_SIZE = 6
_TRIANGLE = PackedSymmetric(_SIZE)
_MEAN, _COVARIANCE, _DRIVE = slice(0, _SIZE), slice(_SIZE, -2), slice(-2, None)
_ROWS = _SIZE + _TRIANGLE.entries + 2
_POSITION, _POSITION_NOISE = np.array([0, 1, _SIZE]), np.array([0, 1, 3])
"""Entries of the position's covariance in the triangle of P, and in a flat matrix (2, 2)."""
_BLOCKS = np.stack([_TRIANGLE.place[X, X], _TRIANGLE.place[X, Y], _TRIANGLE.place[Y, Y]], axis=1)
"""Entries of the covariance of x with x, of x with y and of y with y, rows first: (3, 3 blocks, 3)."""
_UPPER = np.array([np.flatnonzero(_BLOCKS.ravel() == entry)[0] for entry in range(_TRIANGLE.entries)])
"""Where the flat blocks have the entries of the covariance, of those that lie there twice the upper one."""
_FIRST = np.concatenate([np.arange(_SIZE), _TRIANGLE.row])
_SECOND = np.concatenate([np.full(_SIZE, _SIZE), _TRIANGLE.column])
"""Factors of what an update takes from mean and covariance, by their rows in [gain, minus the innovation]."""
_AXIS_PLACE = PackedSymmetric(3).place


class PlaneFilter(FilterBank):
    """Batched Kalman filter of one model; rows are tracks.

    State order [x, y, vx, vy, ax, ay], local frame, SI units. A position is taken jointly, then speed by speed, each
    linearised at the state so far, as `measurement_update.correct` does.

    Args:
        model: of Han et al. 2015.
        acceleration: standard deviation of a track's first acceleration, m/s².
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.
    """

    _state: PlaneFilterState

    def __init__(
        self, model: Singer | CurrentStatistical, *, acceleration: float, noise: SensorNoise | None = None
    ) -> None:
        self._model = model
        self._axis_dt, self._axis = 0.0, _axis_elements(model, 0.0)
        super().__init__([model], acceleration=acceleration, turn_rate=0.0, jerk=0.0, noise=noise)

    @property
    def mean(self) -> Floats:
        """(n, 1, 6), the filter's own."""
        return self._state.columns[_MEAN].T[:, None]

    @mean.setter
    def mean(self, mean: Floats) -> None:
        self._state.columns[_MEAN] = mean[:, 0].T

    @property
    def covariance(self) -> Floats:
        """(n, 1, 6, 6)."""
        return _TRIANGLE.unpack(self._state.columns[_COVARIANCE])[:, None]

    @covariance.setter
    def covariance(self, covariance: Floats) -> None:
        self._state.columns[_COVARIANCE] = _TRIANGLE.pack(covariance[:, 0])

    def combined(self) -> tuple[Floats, Floats]:
        """Return the mean (n, 6) and the covariance (n, 6, 6)."""
        columns = self._state.columns
        if compiled.in_use:
            return compiled.kernels.plane_moments(columns)
        return columns[_MEAN].T, _TRIANGLE.unpack(columns[_COVARIANCE])

    def predict(self, dt: float, direction: Floats) -> None:
        """Predict all tracks.

        Source: Han et al. 2015, eqs. (14), (18), (29).
        """
        del direction  # the model is the same in every direction
        if not len(self):
            self.link = None
            return
        state, model = self._state, self._model
        state.dt = dt
        if dt != self._axis_dt:
            self._axis_dt, self._axis = dt, _axis_elements(model, dt)
        before = OutputState(self.mean.copy(), self.covariance, self._turning) if self.linking else None
        adapts, limit, floor = False, 0.0, 0.0
        if isinstance(model, CurrentStatistical):
            adapts, limit, floor = compiled.in_use and model.innovation_memory is None, model.limit, model.floor
            if not adapts:
                state.columns[_DRIVE] = self._adapted_variance(model)
        if compiled.in_use:
            compiled.kernels.predict_plane(state.columns, self._axis, adapts, limit, floor)
        else:
            _predict(state.columns, self._axis)
        if before is not None:
            _, transition, _ = axis_matrices(model, dt)
            self.link = self._link(before, [isotropic(transition, _SIZE)[None]])

    def update(self, rows: Indices, measurement: Measurement) -> Floats:
        """Update the given rows (m,) with a measurement each; return their NIS (m,)."""
        measurement = self._adapted(rows, measurement)
        update = _update_by_kernel if compiled.in_use else _update
        nis = update(self._state.columns, rows, measurement)
        self._note_fit(rows, nis[:, None], measurement)
        return nis

    def _adapted_variance(self, model: CurrentStatistical) -> Floats:
        """Return the variances of the acceleration along x and y, (2, n), (20)."""
        state = self._state
        variance = model.variance(state.columns[ACCELERATION])
        return variance if model.innovation_memory is None else driven_variance(variance, model.floor, state.mean_nis.T)

    def _empty(self) -> PlaneFilterState:
        return PlaneFilterState(*self._empty_weights(), np.ones((_ROWS, 0)))

    def _hand_down(self) -> None:
        super()._hand_down()
        if self._state.columns.shape != (_ROWS, len(self)):
            raise ValueError(f"found {self._state.columns.shape} columns, expected {(_ROWS, len(self))}")
        self._state.columns = _apart(self._state.columns)

    def _keep_estimates(self, rows: Indices | Booleans) -> None:
        self._state.columns = _apart(self._state.columns[:, rows])

    def _append_estimates(self, mean: Floats, covariance: Floats) -> None:
        columns = np.ones((_ROWS, len(mean)))
        columns[_MEAN], columns[_COVARIANCE] = mean[:, 0].T, _TRIANGLE.pack(covariance[:, 0])
        self._state.columns = _apart(np.concatenate([self._state.columns, columns], axis=1))

    def _interact(self, dt: float) -> None:
        """Do nothing: there is one model."""

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Do nothing: there is one model."""


def _apart(columns: Floats) -> Floats:
    """Return columns whose rows are an odd number of cache lines apart.

    The rows of some hundred tracks would else fall into the same sets of the cache: 1,024 tracks cost a third more.
    """
    rows, n = columns.shape
    held = np.empty((rows, 8 * ((n + 7) // 8 | 1)))[:, :n]
    held[...] = columns
    return held


def _axis_elements(model: Singer | CurrentStatistical, dt: float) -> Floats:
    """Return what tells a prediction of an axis over dt, s, by `axis_elements` (14,), Q at a variance of one for CS."""
    if isinstance(model, Singer):
        return axis_elements(model.alpha, dt, 2 * model.alpha * model.deviation**2, mean_decays=True)
    return axis_elements(model.alpha, dt, 2 * model.alpha, mean_decays=False)


def _predict(columns: Floats, axis: Floats) -> None:
    """Predict columns [mean, triangle of P, variances that drive x and y] (29, n) in place.

    A component whose variance has fallen below zero counts as known.

    Args:
        columns: changed.
        axis: by `_axis_elements`.
    """
    # Views are changed in place: `array[i] += …` would copy the result once more.
    covariance, every = columns[_COVARIANCE], columns[_DRIVE, None, None]
    blocks = covariance.take(_BLOCKS, axis=0)
    _transform(columns[_MEAN].reshape(3, 2, -1), axis[4:8])
    _transform(blocks, axis[:4])
    _transform(blocks.transpose(2, 0, 1, 3), axis[:4])
    own = blocks[:, ::2]
    own += axis[8:].take(_AXIS_PLACE)[:, None, :, None] * every.transpose(1, 0, 2, 3)
    blocks.reshape(_BLOCKS.size, -1).take(_UPPER, axis=0, out=covariance, mode="clip")  # without a copy between
    known = covariance.take(_TRIANGLE.diagonal, axis=0) < 0.0
    if np.count_nonzero(known):
        covariance[known[_TRIANGLE.row] | known[_TRIANGLE.column]] = 0.0


def _transform(rows: Floats, f: Floats) -> None:
    """Replace three rows (3, …, n) by F times these; see `_axis_elements`."""
    first, upper, last = rows[0], rows[:2], rows[2]
    first += f[0] * rows[1]
    upper += f[1:3].reshape(2, *(1,) * last.ndim) * last
    last *= f[3]


def _update_by_kernel(columns: Floats, rows: Indices, measurement: Measurement) -> Floats:
    """Do what `_update` does."""
    nis: Floats = compiled.kernels.update_plane(
        columns,
        rows,
        measurement.position,
        measurement.noise,
        None if measurement.range_rate_variance is None else measurement.range_rate,
        measurement.range_rate_variance,
        *measurement.origin.tolist(),
        *measurement.velocity.tolist(),
    )
    for part in measurement.projections:
        row, innovation = _along(part, columns[VELOCITY].take(rows, axis=1))
        nis += compiled.kernels.take_speed(columns, rows, row, innovation, part.variance)
    return nis


def _update(columns: Floats, rows: Indices, measurement: Measurement) -> Floats:
    """Update columns (29, n) in place with a measurement of each of some rows (m,); return the NIS (m,)."""
    # 64 tracks with range rate: 0.4 ms, the sequential updates of `kalman` 1.2 ms, `kalman.update` 2.4 ms.
    every = len(rows) == columns.shape[1] and in_order(rows)
    state = columns if every else columns.take(rows, axis=1)
    nis = _take_position(state, measurement.position, measurement.noise)
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        rate, row = line_of_sight(state[_MEAN].T, measurement.origin, measurement.velocity)
        nis += _take_speed(state, row.T, measurement.range_rate - rate, measurement.range_rate_variance)
    for part in measurement.projections:
        nis += _take_speed(state, *_along(part, state[VELOCITY]), part.variance)
    if not every:
        columns[:, rows] = state
    return nis


def _along(part: Projection, velocity: Floats) -> tuple[Floats, Floats]:
    """Return the Jacobian (4, m) and the innovation (m,) of a speed, for velocities (2, m)."""
    row = np.zeros((4, velocity.shape[1]))
    row[2:] = part.direction.T
    return row, part.value - (row[2:] * velocity).sum(axis=0)


def _take_position(state: Floats, position: Floats, noise: Floats) -> Floats:
    """Update columns with measured positions (n, 2), as `kalman.update_position` does; return the NIS (n,)."""
    covariance = state[_COVARIANCE]
    spread = noise.reshape(-1, 4).T.take(_POSITION_NOISE, axis=0)
    spread += covariance.take(_POSITION, axis=0)
    first, slope, second = triangular_root(*spread)
    x, y = innovation = bounded(position.T - state[:2])
    x /= first
    y -= slope * x
    y /= second
    half = np.empty((2, _SIZE + 1, len(position)))
    gain_x, gain_y = half[:, :_SIZE]
    np.divide(covariance[:_SIZE], first, out=gain_x)
    np.subtract(covariance.take(_TRIANGLE.place[1], axis=0), slope * gain_x, out=gain_y)
    gain_y /= second
    np.negative(innovation, out=half[:, _SIZE])
    _subtract_explained(state, half[0])
    _subtract_explained(state, half[1])
    return np.asarray(x * x + y * y)


def _take_speed(state: Floats, row: Floats, innovation: Floats, variance: Floats) -> Floats:
    """Update columns with one speed of Jacobian (4, n) each, as `kalman.update_scalar` does; return the NIS (n,).

    Where it was not measured (NaN), nothing changes and it fits perfectly.
    """
    known = np.isfinite(innovation)
    if not known.all():
        row, innovation = np.where(known, row, 0.0), np.where(known, innovation, 0.0)
    covariance = state[_COVARIANCE]
    cross = np.add.reduce(covariance.take(_TRIANGLE.place[:4], axis=0) * row[:, None])
    spread = np.maximum(np.add.reduce(row * cross[:4]), 0.0) + variance
    spread += LOST * np.abs(np.add.reduce(row * row * covariance.take(_TRIANGLE.diagonal[:4], axis=0)))
    root = np.sqrt(np.maximum(spread, LEAST_VARIANCE))
    whitened = bounded(innovation) / root
    half = np.empty((_SIZE + 1, len(root)))
    np.divide(cross, root, out=half[:_SIZE])
    np.negative(whitened, out=half[_SIZE])
    _subtract_explained(state, half)
    return np.asarray(whitened * whitened)


def _subtract_explained(state: Floats, half: Floats) -> None:
    """Take from columns [mean, triangle of P, …] what a whitened innovation explains.

    Args:
        state: changed in place.
        half: the gain for it (6, n), and minus the innovation, (7, n).
    """
    explained = half.take(_FIRST, axis=0)
    explained *= half.take(_SECOND, axis=0)
    state = state[:-2]
    state -= explained
