"""The filter that the configuration names."""

from __future__ import annotations

from candaemon.config.tracker import (
    CsEstimatorSettings,
    EstimatorSettings,
    LinearModelSettings,
    ModelSettings,
    TurnModelSettings,
)
from candaemon.estimation.imm import Imm
from candaemon.estimation.models import CoordinatedTurn, CurrentStatistical, LinearModel, MotionModel


def make_estimator(settings: EstimatorSettings) -> Imm:
    """Return the batched filter of the settings, without tracks."""
    if isinstance(settings, CsEstimatorSettings):
        model = CurrentStatistical(settings.alpha, settings.limit, settings.floor)
        return Imm([model], switch_rate=1.0, acceleration=settings.first_acceleration, turn_rate=1.0)
    return Imm(
        [make_model(model) for model in settings.models],
        switch_rate=settings.switch_rate,
        acceleration=settings.first_acceleration,
        turn_rate=settings.first_turn_rate,
    )


def make_model(settings: ModelSettings) -> MotionModel:
    """Return the motion model of the settings."""
    if isinstance(settings, LinearModelSettings):
        settling = settings.settling
        return LinearModel(
            order=1 if settings.kind == "cv" else 2,
            noise=(settings.noise.along, settings.noise.across),
            settling=(None, None) if settling is None else (settling.along or None, settling.across or None),
            wander=(settings.wander.along, settings.wander.across),
        )
    if isinstance(settings, TurnModelSettings):
        return CoordinatedTurn(settings.noise, settings.turn_noise, settings.wander)
    return CurrentStatistical(settings.alpha, settings.limit, settings.floor)
