"""Tracks that switch between constant velocity and the current statistical model: paper 003 for a radar's targets."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.estimator_state import SwitchingTracksState
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.manoeuvre import ManoeuvreWatch, SwitchRule
from candaemon.estimation.motion_models import VELOCITY, CurrentStatistical, MotionModel
from candaemon.estimation.sensor_noise import SensorNoise

_STEADY, _MANOEUVRE = 0, 1


class SwitchingTracks(MomentBank):
    """Both models run, and the one that the change of speed of late asks for is told, whole; rows are tracks.

    Args:
        steady: constant velocity.
        statistical: the current statistical model.
        rule: when to switch.
        acceleration: standard deviation of a track's first acceleration, m/s².
        noise: finds out how noisy each track's detections are; None: they are as noisy as they say.
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
        """Whether the current statistical model is told, (n,)."""
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
        told = np.zeros_like(probability)
        told[:, _MANOEUVRE] = 1.0
        super()._append(mean, covariance, told)
        self._watch.spawn(mean[:, _STEADY, VELOCITY])

    def _interact(self, dt: float) -> None:
        """Let the time pass; the two filters run apart."""
        self._watch.advance(dt)

    def _weigh(self, rows: Indices, log_likelihood: Floats) -> None:
        """Tell the one or the other, by the steady filter's speed."""
        del log_likelihood  # it is the speed that decides
        self._watch.watch(rows, self.mean[rows, _STEADY, VELOCITY])
        manoeuvring = self._watch.manoeuvring[rows]
        self.probability[rows, _STEADY] = ~manoeuvring
        self.probability[rows, _MANOEUVRE] = manoeuvring
