"""Constant velocity or the current statistical model, one at a time: the switching of Zhang et al. 2016.

A vehicle drives steadily for long and manoeuvres in between. The current statistical model (CSM) follows manoeuvres
and is restless without them, constant velocity (CV) is quiet and lags in them; so the change of speed decides which
estimate is reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.axis_filter import AxisFilter, AxisFilterState, WhiteAxis
from candaemon.estimation.estimator_state import SwitchingTracksState
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.manoeuvre_detection import ManoeuvreState, ManoeuvreWatch, SwitchRule
from candaemon.estimation.motion_models import VELOCITY, CurrentStatistical, MotionModel
from candaemon.estimation.sensor_noise import SensorNoise


@dataclass(slots=True)
class CvCsmSwitchState:
    """What a `CvCsmSwitch` remembers: of both filters, and of the decision between them."""

    steady: AxisFilterState
    manoeuvre: AxisFilterState
    watch: ManoeuvreState


class CvCsmSwitch:
    """Batched filter that reports CV or CSM, by the change of the CV filter's speed; rows are tracks.

    State order of an axis [x, ẋ, ẍ]; m, m/s, m/s². Both filters always run: the paper stops CSM while CV is reported,
    and lets it start from nothing when the vehicle manoeuvres, which is when it is needed most.

    The change of speed is that of the velocity vector. On one axis it is |Δẋ| of (7); in the plane a turn at a constant
    speed is then a manoeuvre as well, as it is one that constant velocity cannot follow.

    Args:
        axes: of a track: 1, or 2 in the plane.
        noise: power of the white noise of CV, (m/s²)²/Hz.
        statistical: CSM.
        rule: when to switch.
    """

    def __init__(
        self, axes: int, noise: float, statistical: CurrentStatistical, rule: SwitchRule | None = None
    ) -> None:
        self._axes = axes
        self._steady = AxisFilter(WhiteAxis(1, noise))
        self._manoeuvre = AxisFilter(statistical)
        self._watch = ManoeuvreWatch(axes, rule or SwitchRule())

        self._state = CvCsmSwitchState(self._steady.state, self._manoeuvre.state, self._watch.state)

    def __len__(self) -> int:
        return len(self._watch)

    @property
    def state(self) -> CvCsmSwitchState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: CvCsmSwitchState) -> None:
        self._state = state
        self._steady.state, self._manoeuvre.state, self._watch.state = state.steady, state.manoeuvre, state.watch
        if not len(self._steady) == len(self._manoeuvre) == len(self._watch) * self._axes:
            raise ValueError("the filters have other axes than the tracks")

    @property
    def manoeuvring(self) -> Booleans:
        """Whether CSM is reported, (n,); a track begins with it, as the paper's step (1) does."""
        return self._watch.manoeuvring.copy()

    @property
    def mean(self) -> Floats:
        """States (n, A, 3); of CV the acceleration is zero."""
        reported = np.zeros((len(self), self._axes, 3))
        reported[..., :2] = self._by_track(self._steady.mean)
        reported[self._watch.manoeuvring] = self._by_track(self._manoeuvre.mean)[self._watch.manoeuvring]
        return reported

    @property
    def covariance(self) -> Floats:
        """Covariances (n, A, 3, 3); of CV the acceleration is certain, as its model has none."""
        reported = np.zeros((len(self), self._axes, 3, 3))
        reported[..., :2, :2] = self._by_track(self._steady.covariance)
        reported[self._watch.manoeuvring] = self._by_track(self._manoeuvre.covariance)[self._watch.manoeuvring]
        return reported

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append k tracks, mean (k, A, 3) and covariance (k, A, 3, 3)."""
        self._steady.spawn(mean[..., :2].reshape(-1, 2), covariance[..., :2, :2].reshape(-1, 2, 2))
        self._manoeuvre.spawn(mean.reshape(-1, 3), covariance.reshape(-1, 3, 3))
        self._watch.spawn(mean[..., 1])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        axes = self._rows_of(np.arange(len(self))[rows])
        self._steady.keep(axes)
        self._manoeuvre.keep(axes)
        self._watch.keep(rows)

    def predict(self, dt: float) -> None:
        """Predict all tracks by dt (s) with both models."""
        self._steady.predict(dt)
        self._manoeuvre.predict(dt)
        self._watch.advance(dt)

    def update(self, positions: Floats, variance: Floats | float, rows: Indices | None = None) -> None:
        """Update with measured positions, and switch where it is time.

        Args:
            positions: measured (m, A), m.
            variance: R, of the positions, one or (m, A), m².
            rows: tracks (m,) that were measured, each once; None: all n. The others keep their predicted state.
        """
        measured = np.arange(len(self)) if rows is None else rows
        axes = None if rows is None else self._rows_of(measured)
        flat = np.broadcast_to(variance, positions.shape).ravel()
        self._steady.update(positions.ravel(), flat, axes)
        self._manoeuvre.update(positions.ravel(), flat, axes)
        self._watch.watch(measured, self._by_track(self._steady.mean)[measured, :, 1])

    def _by_track(self, axes: Floats) -> Floats:
        """Turn an array over all axes, (n · A, …), into one over tracks, (n, A, …)."""
        return axes.reshape(-1, self._axes, *axes.shape[1:])

    def _rows_of(self, tracks: Indices) -> Indices:
        """Return the rows of the tracks' axes in the filters."""
        return (tracks[:, None] * self._axes + np.arange(self._axes)).ravel()


_STEADY, _MANOEUVRE = 0, 1


class SwitchingTracks(MomentBank):
    """Both models run, and the one that the latest change of speed asks for is reported unmixed; rows are tracks.

    Args:
        steady: constant velocity.
        statistical: the current statistical model.
        rule: when to switch.
        acceleration: standard deviation of a track's first acceleration, m/s².
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.
    """

    _state: SwitchingTracksState

    def __init__(
        self,
        steady: MotionModel,
        statistical: CurrentStatistical,
        rule: SwitchRule,
        *,
        acceleration: float,
        noise: SensorNoise | None = None,
    ) -> None:
        self._watch = ManoeuvreWatch(2, rule)
        super().__init__([steady, statistical], acceleration=acceleration, turn_rate=1.0, jerk=1.0, noise=noise)

    @property
    def manoeuvring(self) -> Booleans:
        """Whether the current statistical model is reported, (n,)."""
        return self._watch.manoeuvring.copy()

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        super().keep(rows)
        self._watch.keep(rows)

    def _empty(self) -> SwitchingTracksState:
        return SwitchingTracksState(*self._empty_weights(), *self._empty_moments(), self._watch.state)

    def _hand_down(self) -> None:
        super()._hand_down()
        self._watch.state = self._state.watch
        if len(self._watch) != len(self):
            raise ValueError(f"the speeds of {len(self._watch)} tracks are watched, expected {len(self)}")

    def _append(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        certain = np.zeros_like(probability)
        certain[:, _MANOEUVRE] = 1.0
        super()._append(mean, covariance, certain)
        self._watch.spawn(mean[:, _STEADY, VELOCITY])

    def _interact(self, dt: float) -> None:
        """Let the time pass; the two filters run apart."""
        self._watch.advance(dt)

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Give the whole probability to one model, by the steady filter's speed."""
        del log_likelihood  # it is the speed that decides
        self._watch.watch(rows, self.mean[rows, _STEADY, VELOCITY])
        manoeuvring = self._watch.manoeuvring[rows]
        self.probability[rows, _STEADY] = ~manoeuvring
        self.probability[rows, _MANOEUVRE] = manoeuvring
