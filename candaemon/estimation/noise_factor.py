"""Measurement noise as a factor on what the sensor states, learnt from innovations; batched over tracks.

By variational Bayes, as in `candaemon.estimation.variational_noise`, or from a window of innovations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state
from candaemon.estimation.kalman import LEAST_VARIANCE, bounded, inverse_root, times

_MOST_PREDICTED = 3.0
"""H P⁻ Hᵀ, a multiple of the measurement noise, up to which an innovation enters a window."""


@dataclass(slots=True)
class NoiseScaleState:
    """What a `NoiseScale` remembers.

    Attributes:
        scale: factors λ (n,).
    """

    scale: Floats


@dataclass(slots=True)
class WindowedScaleState:
    """What a `WindowedScale` remembers.

    Attributes:
        ring: what the latest N innovations said of the factor, (n, N).
        count: innovations that have entered it, (n,); the next one goes to place `count` modulo N.
        scale: factors (n,).
    """

    ring: Floats
    count: Indices
    scale: Floats


NoiseFactorState: TypeAlias = NoiseScaleState | WindowedScaleState


class NoiseFactor(Protocol):
    """Learns a factor on the stated measurement noise of each of n rows."""

    def __len__(self) -> int: ...

    @property
    def state(self) -> NoiseFactorState:
        """All that it remembers."""
        ...

    @state.setter
    def state(self, state: NoiseFactorState) -> None: ...

    @property
    def scale(self) -> Floats:
        """The factors (n,)."""
        ...

    def spawn(self, count: int) -> None:
        """Append rows whose factor is one."""
        ...

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        ...

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats, noise: Floats) -> Floats:
        """Learn from an innovation of each of the rows before the filter's own update; return their factors (m,).

        Args:
            rows: (m,), each once.
            innovation: (m, d).
            predicted: H P⁻ Hᵀ, (m, d, d).
            noise: as stated, (m, d, d).
        """
        ...


class NoiseScale:
    """A factor λ on the stated measurement noise R₀ of each of n tracks by variational Bayes: R = λ R₀.

    Args:
        forgetting: ρ, share of what is known that a measurement leaves.
        floor: smallest factor on the variance.
        ceiling: largest factor.
        iterations: of the fixed point.
    """

    def __init__(
        self, forgetting: float = 0.97, *, floor: float = 0.25, ceiling: float = 400.0, iterations: int = 3
    ) -> None:
        self._forgetting = forgetting
        self._floor, self._ceiling = floor, ceiling
        self._iterations = iterations
        self._state = NoiseScaleState(np.zeros(0))

    def __len__(self) -> int:
        return len(self._state.scale)

    @property
    def state(self) -> NoiseScaleState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: NoiseFactorState) -> None:
        self._state = checked_state(state, NoiseScaleState(np.zeros(0)))

    @property
    def scale(self) -> Floats:
        """Factors λ (n,); one until something is learnt."""
        return self._state.scale

    def spawn(self, count: int) -> None:
        """Append tracks whose factor is one."""
        self._state.scale = np.concatenate([self._state.scale, np.ones(count)])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self._state.scale = self._state.scale[rows]

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats, noise: Floats) -> Floats:
        """Learn from an innovation of each of the given rows, before the filter's own update.

        Args:
            rows: (m,), each once.
            innovation: (m, d), d 1 or 2.
            predicted: H P⁻ Hᵀ (m, d, d).
            noise: R₀ as stated (m, d, d), positive definite.

        Returns:
            Factors of the rows, (m,).
        """
        share, squared = _spectrum(innovation, predicted, noise)
        known = scale = self.scale[rows]
        for _ in range(self._iterations):
            weight = scale[:, None] / (scale[:, None] + share)
            expected = (weight**2 * squared + weight * share).mean(axis=1)
            scale = np.clip(self._forgetting * known + (1.0 - self._forgetting) * expected, self._floor, self._ceiling)
        self.scale[rows] = scale
        return scale


class WindowedScale:
    """The same factor from a window of innovations: the mean of (vᵀ R₀⁻¹ v − tr(R₀⁻¹ H P⁻ Hᵀ)) / d.

    Source: Gao et al. 2016, eq. (15).

    While the state is far less certain than the detections, as at first and after a gap, their innovations do not enter
    the window: their information would be lost in the difference of two large numbers.

    Args:
        window: N, innovations of a track that are averaged; until there are as many its factor is one.
        floor: smallest factor on the variance.
        ceiling: largest factor.
    """

    def __init__(self, window: int = 30, *, floor: float = 0.25, ceiling: float = 400.0) -> None:
        self._floor, self._ceiling = floor, ceiling
        self._window = window
        self._state = self._empty()

    def __len__(self) -> int:
        return len(self._state.scale)

    @property
    def state(self) -> WindowedScaleState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: NoiseFactorState) -> None:
        self._state = checked_state(state, self._empty())

    @property
    def scale(self) -> Floats:
        """Factors (n,); one until the window has filled."""
        return self._state.scale

    def _empty(self) -> WindowedScaleState:
        return WindowedScaleState(np.zeros((0, self._window)), np.zeros(0, dtype=np.intp), np.zeros(0))

    def spawn(self, count: int) -> None:
        """Append tracks whose factor is one."""
        state = self._state
        state.ring = np.concatenate([state.ring, np.zeros((count, self._window))])
        state.count = np.concatenate([state.count, np.zeros(count, dtype=np.intp)])
        state.scale = np.concatenate([state.scale, np.ones(count)])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        state = self._state
        state.ring, state.count, state.scale = state.ring[rows], state.count[rows], state.scale[rows]

    def observe(self, rows: Indices, innovation: Floats, predicted: Floats, noise: Floats) -> Floats:
        """Learn from an innovation of each of the given rows; see `NoiseScale.observe`."""
        state, window = self._state, self._window
        share, squared = _spectrum(innovation, predicted, noise)
        informative = share.max(axis=1) <= _MOST_PREDICTED * np.maximum(state.scale[rows], 1.0)
        entered = rows[informative]
        state.ring[entered, state.count[entered] % window] = (squared - share).mean(axis=1)[informative]
        state.count[entered] += 1
        learnt = np.clip(state.ring[rows].mean(axis=1), self._floor, self._ceiling)
        state.scale[rows] = np.where(state.count[rows] >= window, learnt, 1.0)
        return state.scale[rows]


def _spectrum(innovation: Floats, predicted: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Rotate to the axes in which R₀ is one and H P⁻ Hᵀ diagonal.

    Returns:
        Eigenvalues of R₀⁻¹ H P⁻ Hᵀ, and the squares of the innovation's components along their axes, (m, d) each.
    """
    innovation = bounded(innovation)
    if innovation.shape[1] == 1:
        variance = np.maximum(noise[:, :, 0], LEAST_VARIANCE)
        return predicted[:, :, 0] / variance, innovation**2 / variance
    root = inverse_root(noise[:, 0, 0], noise[:, 0, 1], noise[:, 1, 1])
    ratio = root @ predicted @ np.swapaxes(root, 1, 2)
    middle, half = (ratio[:, 0, 0] + ratio[:, 1, 1]) / 2, (ratio[:, 0, 0] - ratio[:, 1, 1]) / 2
    apart = np.hypot(half, ratio[:, 0, 1])
    share = np.stack([middle + apart, np.maximum(middle - apart, 0.0)], axis=-1)
    angle = np.arctan2(ratio[:, 0, 1], half) / 2
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = times(root, innovation).T
    return share, np.square(np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1))
