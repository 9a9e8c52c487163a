"""A Kalman filter of many independent axes at once, each measured by its own position.

Han et al. 2015 estimates x and y apart: F, U, Q and H of (15) to (22) are one axis twice over. So n tracks are 2n
axes, and an axis is what is batched here. Mean and covariance of an axis are one column of one array, the covariance
by its upper
triangle alone: a prediction of everything, the adaptive noise included, is one matrix product, and no covariance can
lose its symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1
from typing import TypeAlias

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.discretisation import decaying_axis, white_axis
from candaemon.estimation.kalman import LEAST_VARIANCE, LOG_2PI, Fit
from candaemon.estimation.motion_models import CurrentStatistical, Singer, driven_variance
from candaemon.estimation.packed_symmetric import PackedSymmetric

_LEAST_LEFT = 1e-14
"""Of a variance after an update: what the rounding of the difference leaves unknown."""


@dataclass(frozen=True, slots=True)
class WhiteAxis:
    """An axis whose highest derivative is driven by white noise.

    Attributes:
        order: 1 constant velocity (CV, Friedland), 2 constant acceleration (CA, Hampton), 3 constant jerk (Hou's four
            states).
        noise: power of the white noise, (m/s²)²/Hz for order 1, (m/s³)²/Hz for order 2, (m/s⁴)²/Hz for order 3.
    """

    order: int
    noise: float


AxisModel: TypeAlias = WhiteAxis | Singer | CurrentStatistical


@dataclass(slots=True)
class AxisFilterState:
    """What an `AxisFilter` remembers of N axes.

    Attributes:
        columns: one column an axis: mean, upper triangle of the covariance row by row, variance of the driving noise;
            (D + D (D + 1) / 2 + 1, N).
        mean_nis: normalised innovation squared, averaged over the latest updates, (N,).
        dt: s of the latest prediction.
    """

    columns: Floats
    mean_nis: Floats
    dt: float


class AxisFilter:
    """Kalman filter of N axes, the rows; two axes a track in the plane, in whatever order the caller keeps.

    State order of an axis [x, ẋ, ẍ, x⃛], cut after the model's order: D = 2 for CV, 3 for CA, Singer and the current
    statistical model, 4 for the constant jerk; m, m/s, m/s², m/s³.

    The cycle is (24) to (29) of Han et al. 2015. For the current statistical model the predicted mean is F x + U ā
    with ā the current acceleration (17), which (28) leaves out, and the noise adapts by (20); with an
    `innovation_memory` it follows the mean NIS of each axis too, `driven_variance`.

    Args:
        model: the same for all axes.
    """

    def __init__(self, model: AxisModel) -> None:
        self._model = model
        self._memory = model.innovation_memory if isinstance(model, CurrentStatistical) else None
        self._size = model.order + 1 if isinstance(model, WhiteAxis) else 3
        self._triangle = PackedSymmetric(self._size)
        self._width = self._size + self._triangle.entries + 1
        self._state = AxisFilterState(np.zeros((self._width, 0)), np.zeros(0), 0.0)
        self._other = self._state.columns.copy()  # what a prediction is written to
        self._prediction_dt, self._prediction = 0.0, self._prediction_over(0.0)
        self._innovation: Floats = np.zeros(0)
        self._innovation_variance: Floats = np.ones(0)

    def __len__(self) -> int:
        return len(self._state.mean_nis)

    @property
    def state(self) -> AxisFilterState:
        """All that it remembers; `fit` is not a part of it.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: AxisFilterState) -> None:
        if state.columns.shape != (self._width, len(state.mean_nis)):
            raise ValueError(f"found {state.columns.shape} columns, expected {self._width} numbers an axis")
        self._state = state
        self._hold(state.columns)

    @property
    def mean(self) -> Floats:
        """States (N, D)."""
        return self._state.columns[: self._size].T.copy()

    @property
    def covariance(self) -> Floats:
        """Covariances (N, D, D), symmetric to the last bit."""
        return self._triangle.unpack(self._state.columns[self._size : -1])

    @property
    def fit(self) -> Fit:
        """How well the last update's positions fitted their predictions, an entry an axis that was updated."""
        nis = self._innovation**2 / self._innovation_variance
        return Fit(nis, -0.5 * (nis + np.log(self._innovation_variance) + LOG_2PI))

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append k axes, mean (k, D) and covariance (k, D, D)."""
        state, columns = self._state, np.ones((self._width, len(mean)))
        columns[: self._size] = mean.T
        columns[self._size : -1] = self._triangle.pack(covariance)
        self._hold(np.concatenate([state.columns, columns], axis=1))
        state.mean_nis = np.concatenate([state.mean_nis, np.ones(len(mean))])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self._hold(self._state.columns[:, rows])
        self._state.mean_nis = self._state.mean_nis[rows]

    def predict(self, dt: float) -> None:
        """Predict all axes by dt (s).

        Source: Han et al. 2015, eqs. (28), (29).
        """
        state = self._state
        state.dt = dt
        if dt != self._prediction_dt:
            self._prediction_dt, self._prediction = dt, self._prediction_over(dt)
        if isinstance(self._model, CurrentStatistical):
            if compiled.in_use and self._memory is None:
                compiled.kernels.drive_axes(state.columns, self._model.limit, self._model.floor)
            else:
                state.columns[-1] = self._adapted_variance(self._model)
        np.matmul(self._prediction, state.columns, out=self._other[:-1])
        state.columns, self._other = self._other, state.columns

    def update(self, positions: Floats, variance: Floats | float, axes: Indices | None = None) -> None:
        """Update with measured positions.

        Source: Han et al. 2015, eqs. (21), (22), (24), (25), (26), (27).

        Args:
            positions: measured (m,), m.
            variance: R, of the positions, one or (m,), m².
            axes: rows (m,) that were measured, each once; None: all N. The others keep their predicted state.
        """
        state = self._state.columns if axes is None else self._state.columns[:, axes]
        if compiled.in_use:
            told = np.asarray(variance, np.float64).reshape(-1)
            found = compiled.kernels.update_axes(state, self._size, positions, told, _LEAST_LEFT)
        else:
            found = _update(state, self._size, positions, variance)
        if axes is not None:
            self._state.columns[:, axes] = state
        self._innovation, self._innovation_variance = found
        self._learn_nis(axes)

    def _hold(self, columns: Floats) -> None:
        """Replace the columns by those of other axes."""
        self._state.columns = np.ascontiguousarray(columns)
        self._other = self._state.columns.copy()

    def _adapted_variance(self, model: CurrentStatistical) -> Floats:
        """Return the acceleration's variance of the axes, (20)."""
        variance = model.variance(self._state.columns[2])
        return variance if self._memory is None else driven_variance(variance, model.floor, self._state.mean_nis)

    def _learn_nis(self, axes: Indices | None) -> None:
        """Follow the NIS where the variance is driven by it."""
        if self._memory is None:
            return
        rows = slice(None) if axes is None else axes
        state = self._state
        state.mean_nis[rows] -= expm1(-state.dt / self._memory) * (self.fit.nis - state.mean_nis[rows])

    def _prediction_over(self, dt: float) -> Floats:
        """Return the matrix that takes [mean, upper triangle of P, noise variance] to the predicted mean and triangle.

        The triangle of F P Fᵀ + σ² Q is linear in P's triangle and in σ².
        """
        mean_transition, transition, noise = axis_matrices(self._model, dt)
        prediction = np.zeros((self._width - 1, self._width))
        prediction[: self._size, : self._size] = mean_transition
        prediction[self._size :, self._size : -1] = self._triangle.propagation(transition)
        prediction[self._size :, -1] = noise[self._triangle.row, self._triangle.column]
        return prediction


def _update(state: Floats, size: int, positions: Floats, variance: Floats | float) -> tuple[Floats, Floats]:
    """Update axes in place, whose columns begin with [mean, triangle of P], with a position each.

    Returns innovations and their variances, (n,).
    """
    # 64 axes of three states: 42 µs, `kalman.update` 1.3 ms (32 times as long).
    cross = state[size : 2 * size]
    innovation = positions - state[0]
    innovation_variance = np.maximum(cross[0] + variance, LEAST_VARIANCE)
    gain = cross / innovation_variance
    state[:size] += gain * innovation
    first = 2 * size
    for i in range(1, size):
        last = first + size - i
        least = state[first] * _LEAST_LEFT
        state[first:last] -= gain[i] * cross[i:]
        np.maximum(state[first], least, out=state[first])
        first = last
    np.multiply(gain, variance, out=cross)  # P − K H P of the measured component, without a difference
    return innovation, innovation_variance


def axis_matrices(model: AxisModel, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return the transition of an axis' mean, F, and Q, at a noise variance of one where that adapts, (D, D) each.

    Args:
        model: of the axis.
        dt: s.
    """
    if isinstance(model, WhiteAxis):
        axis, size = white_axis(dt, model.noise, order=model.order), model.order + 1
        return axis.transition[:size, :size], axis.transition[:size, :size], axis.noise[:size, :size]
    if isinstance(model, Singer):
        axis = decaying_axis(model.alpha, dt, 2 * model.alpha * model.deviation**2, order=2)
        return axis.transition, axis.transition, axis.noise
    axis = decaying_axis(model.alpha, dt, 2 * model.alpha, order=2)
    # F x + U ā with ā the current acceleration: that keeps
    constant = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    return constant, axis.transition, axis.noise
