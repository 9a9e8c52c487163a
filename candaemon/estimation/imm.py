"""The interacting multiple model filter, batched over tracks and models at once.

One filter with M models keeps means (n, M, D) and covariances (n, M, D, D) over the union of its models' components.
A single model is an IMM with M = 1, whose mixing is the identity. The cycle is that of Blom and Bar-Shalom as paper
002 section 3 takes it over; it numbers the Markov chain (3), `mixing.switching`, and the filters' own steps, no others:
mixing (`mixing.lendings`, `mixing.mix`), prediction by each model (`FilterBank.predict`), update
(`measurement_update.correct`, or `measurement_update.inform`, (17)), mode probabilities (`mixing.posterior`),
combination (`FilterBank.combined`, `mixing.moments`).

A model that lacks a component (a constant velocity model has no acceleration) takes part in the mixing of that
component with the estimate of those models that have it; so it biases nobody (Yuan, Bar-Shalom et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.measurement_update import correct, inform
from candaemon.estimation.mixing import lendings, mix, posterior, switching
from candaemon.estimation.motion_models import ACCELERATION, JERK, TURN, MotionModel
from candaemon.estimation.sensor_noise import SensorNoise

Form: TypeAlias = Literal["covariance", "information"]
"""How a model's filter takes a measurement: as a Kalman filter, extended where it must, or as an information filter."""

_BORROWED = (ACCELERATION, slice(TURN, TURN + 1), JERK)


class Imm(MomentBank):
    """Batched IMM over any motion models; rows are tracks.

    State order [x, y, vx, vy, ax, ay, ω, jx, jy], cut after what the models use; level frame, SI units.

    Args:
        models: the motion models.
        switch_rate: rate of leaving a model, 1/s; over a step dt a model is left with probability
            1 − e^(−rate·dt), shared evenly among the others.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
        jerk: standard deviation of a track's first jerk, m/s³.
        forms: of each model's measurement update; none: all are Kalman filters. In information form the measurement's
            parts are linearised at the prediction together, paper 002 (17); else one after another.
        noise: finds out how noisy each track's detections are; None: they are as noisy as they say.

    Attributes:
        mean: (n, M, D).
        covariance: (n, M, D, D).
        probability: of the modes, (n, M).
    """

    def __init__(
        self,
        models: Sequence[MotionModel],
        *,
        switch_rate: float,
        acceleration: float,
        turn_rate: float = 1.0,
        jerk: float = 1.0,
        forms: Sequence[Form] = (),
        noise: SensorNoise | None = None,
    ) -> None:
        super().__init__(models, acceleration=acceleration, turn_rate=turn_rate, jerk=jerk, noise=noise)
        self._switch_rate = switch_rate
        self._forms = tuple(forms) or ("covariance",) * len(self._models)
        if len(self._forms) != len(self._models):
            raise ValueError(f"{len(self._models)} models, {len(self._forms)} forms; give one form a model, or none")
        self._lending = lendings(self._has, _BORROWED)

    def _corrected(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        if "information" not in self._forms:
            return super()._corrected(rows, mean, covariance, measurement)
        nis, log_likelihood = np.empty(mean.shape[:2]), np.empty(mean.shape[:2])
        for form in dict.fromkeys(self._forms):
            chosen = [j for j, each in enumerate(self._forms) if each == form]
            part, spread = mean[:, chosen], covariance[:, chosen]
            nis[:, chosen], log_likelihood[:, chosen] = _CORRECT[form](part, spread, measurement)
            mean[:, chosen], covariance[:, chosen] = part, spread
        return nis, log_likelihood

    def _weigh(self, rows: Indices, log_likelihood: Floats) -> None:
        self.probability[rows] = posterior(self.probability[rows], log_likelihood)

    def _interact(self, dt: float) -> None:
        """Mix the models' estimates with their spread, and predict the mode probabilities by the chain (3)."""
        if len(self._models) == 1:
            return
        for lending in self._lending:
            lending.fill(self.mean, self.covariance, self.probability)
        switch = switching(self._switch_rate, dt, len(self._models))
        mean, covariance, self.probability = mix(self.mean, self.covariance, self.probability, switch)
        covariance *= self._has_both
        mean *= self._has
        self.mean, self.covariance = mean, covariance


_CORRECT = {"covariance": correct, "information": inform}
