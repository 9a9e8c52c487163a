"""A Kalman filter of many independent axes at once, each measured by its own position.

Paper 000 estimates x and y apart: F, U, Q and H of (15) to (22) are one axis twice over. So n tracks are 2n axes, and
an axis is what is batched here. Mean and covariance of an axis are one column of one array, the covariance by its upper
triangle alone: a prediction of everything, the adaptive noise included, is one matrix product, and no covariance can
lose its symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1
from typing import TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.axis import decaying_axis, white_axis
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


class AxisFilter:
    """Kalman filter of N axes, the rows; two axes a track in the plane, in whatever order the caller keeps.

    State order of an axis [x, ẋ, ẍ, x⃛], cut after the model's order: D = 2 for CV, 3 for CA, Singer and the current
    statistical model, 4 for the constant jerk; m, m/s, m/s², m/s³.

    The cycle is (24) to (29) of paper 000. For the current statistical model the predicted mean is F x + U ā with ā the
    current acceleration (17), which (28) leaves out, and the noise adapts by (20); with an `innovation_memory` it
    follows the mean NIS of each axis too, `driven_variance`.

    Args:
        model: the same for all axes.
    """

    def __init__(self, model: AxisModel) -> None:
        self._model = model
        self._memory = model.innovation_memory if isinstance(model, CurrentStatistical) else None
        self._size = model.order + 1 if isinstance(model, WhiteAxis) else 3
        self._triangle = PackedSymmetric(self._size)
        width = self._size + self._triangle.entries + 1
        self._state: Floats = np.zeros((width, 0))
        self._other = self._state.copy()
        self._dt, self._prediction = 0.0, self._prediction_over(0.0)
        self._innovation: Floats = np.zeros(0)
        self._innovation_variance: Floats = np.ones(0)
        self._mean_nis: Floats = np.zeros(0)

    def __len__(self) -> int:
        return len(self._mean_nis)

    @property
    def mean(self) -> Floats:
        """States (N, D)."""
        return self._state[: self._size].T.copy()

    @property
    def covariance(self) -> Floats:
        """Covariances (N, D, D), symmetric to the last bit."""
        return self._triangle.unpack(self._state[self._size : -1])

    @property
    def fit(self) -> Fit:
        """How well the last update's positions fitted their predictions, an entry an axis that was updated."""
        nis = self._innovation**2 / self._innovation_variance
        return Fit(nis, -0.5 * (nis + np.log(self._innovation_variance) + LOG_2PI))

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append k axes, mean (k, D) and covariance (k, D, D)."""
        state = np.ones((len(self._state), len(mean)))
        state[: self._size] = mean.T
        state[self._size : -1] = self._triangle.pack(covariance)
        self._hold(np.concatenate([self._state, state], axis=1))
        self._mean_nis = np.concatenate([self._mean_nis, np.ones(len(mean))])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self._hold(self._state[:, rows])
        self._mean_nis = self._mean_nis[rows]

    def predict(self, dt: float) -> None:
        """Predict all axes by dt (s): (14) and (29) of paper 000 with Q by (18) to (20)."""
        if dt != self._dt:
            self._dt, self._prediction = dt, self._prediction_over(dt)
        if isinstance(self._model, CurrentStatistical):
            self._state[-1] = self._adapted_variance(self._model)
        np.matmul(self._prediction, self._state, out=self._other[:-1])
        self._state, self._other = self._other, self._state

    def update(self, positions: Floats, variance: Floats | float, axes: Indices | None = None) -> None:
        """Update with measured positions: (25) to (27) of paper 000.

        Args:
            positions: measured (m,), m.
            variance: R, of the positions, one or (m,), m².
            axes: rows (m,) that were measured, each once; None: all N. The others keep their predicted state.
        """
        size = self._size
        state = self._state if axes is None else self._state[:, axes]
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
        if axes is not None:
            self._state[:, axes] = state
        self._innovation, self._innovation_variance = innovation, innovation_variance
        self._learn_nis(axes)

    def _hold(self, state: Floats) -> None:
        """Take over the state of other axes."""
        self._state = np.ascontiguousarray(state)
        self._other = self._state.copy()

    def _adapted_variance(self, model: CurrentStatistical) -> Floats:
        """Return the acceleration's variance of the axes, (20)."""
        variance = model.variance(self._state[2])
        return variance if self._memory is None else driven_variance(variance, model.floor, self._mean_nis)

    def _learn_nis(self, axes: Indices | None) -> None:
        """Follow the NIS where the variance is driven by it."""
        if self._memory is None:
            return
        rows = slice(None) if axes is None else axes
        self._mean_nis[rows] -= expm1(-self._dt / self._memory) * (self.fit.nis - self._mean_nis[rows])

    def _prediction_over(self, dt: float) -> Floats:
        """Return the matrix that takes [mean, upper triangle of P, noise variance] to the predicted mean and triangle.

        The triangle of F P Fᵀ + σ² Q is linear in P's triangle and in σ².
        """
        mean_transition, transition, noise = axis_matrices(self._model, dt)
        prediction = np.zeros((len(self._state) - 1, len(self._state)))
        prediction[: self._size, : self._size] = mean_transition
        prediction[self._size :, self._size : -1] = self._triangle.propagation(transition)
        prediction[self._size :, -1] = noise[self._triangle.row, self._triangle.column]
        return prediction


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
