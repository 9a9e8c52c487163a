"""The filter that the configuration names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from candaemon.config.estimators import (
    EstimatorCommon,
    EstimatorSettings,
    FederatedEstimatorSettings,
    FirstAcceleration,
    FirstJerk,
    FirstTurnRate,
    ImmEstimatorSettings,
    InformationEstimatorSettings,
    IntersectionEstimatorSettings,
    JerkModelSettings,
    LinearModelSettings,
    MlkfEstimatorSettings,
    ModelSettings,
    NoiseSettings,
    SingerModelSettings,
    StatisticalModelSettings,
    SwitchingEstimatorSettings,
    TurnModelSettings,
    VariationalNoiseSettings,
    WindowedNoiseSettings,
)
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.federated import FederatedTracks
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Form, Imm
from candaemon.estimation.intersection import IntersectionTracks
from candaemon.estimation.manoeuvre_detection import SwitchRule
from candaemon.estimation.motion_models import CoordinatedTurn, CurrentStatistical, LinearModel, MotionModel, Singer
from candaemon.estimation.noise_factor import NoiseFactor, NoiseScale, WindowedScale
from candaemon.estimation.plane_filter import PlaneFilter
from candaemon.estimation.radial_tracks import RadialTracks
from candaemon.estimation.sensor_noise import SensorNoise
from candaemon.estimation.switching import SwitchingTracks


def make_estimator(settings: EstimatorSettings | IntersectionEstimatorSettings) -> FilterBank:
    """Return the batched filter of points of the settings, without tracks.

    Raises:
        TypeError: the settings are those of the vehicle estimator, whose filter is one of bodies.
    """
    match settings:
        case VehicleEstimatorSettings():
            raise TypeError("found the vehicle estimator, expected one of points; see BodyFilter")
        case ImmEstimatorSettings() | InformationEstimatorSettings():
            return make_imm(settings)
        case SwitchingEstimatorSettings():
            return SwitchingTracks(
                LinearModel(1, (settings.noise, settings.noise)),
                CurrentStatistical(settings.alpha, settings.limit, settings.floor),
                SwitchRule(
                    threshold=settings.threshold,
                    least_change=settings.least_change,
                    manoeuvre_time=settings.manoeuvre_time,
                    steady_time=settings.steady_time,
                    interval=settings.interval,
                ),
                acceleration=settings.first_acceleration,
                noise=_make_noise(settings.measurement_noise),
            )
        case FederatedEstimatorSettings():
            return FederatedTracks(
                make_model(settings.model),
                acceleration=settings.first_acceleration,
                turn_rate=settings.first_turn_rate,
                jerk=settings.first_jerk,
                outage=settings.outage,
                least=settings.least_share,
                noise=_make_noise(settings.measurement_noise),
            )
        case IntersectionEstimatorSettings():
            return IntersectionTracks(
                make_model(settings.model),
                acceleration=settings.first_acceleration,
                turn_rate=settings.first_turn_rate,
                jerk=settings.first_jerk,
                noise=_make_noise(settings.measurement_noise),
            )
        case MlkfEstimatorSettings():
            return RadialTracks(
                floor=settings.floor,
                noise=settings.noise,
                acceleration=settings.first_acceleration,
                sensor_noise=_make_noise(settings.measurement_noise),
            )
        case StatisticalModelSettings() | SingerModelSettings():
            return PlaneFilter(
                _make_isotropic(settings),
                acceleration=settings.first_acceleration,
                noise=_make_noise(settings.measurement_noise),
            )
        case _:
            return _make_imm(settings, (settings,), switch_rate=1.0)


def make_imm(settings: ImmEstimatorSettings | InformationEstimatorSettings) -> Imm:
    """Return an interacting multiple model filter of Kalman or information filters."""
    form: Form = "information" if isinstance(settings, InformationEstimatorSettings) else "covariance"
    return _make_imm(settings, settings.models, switch_rate=settings.switch_rate, form=form)


def _make_imm(
    settings: EstimatorCommon, models: Sequence[ModelSettings], *, switch_rate: float, form: Form = "covariance"
) -> Imm:
    return Imm(
        [make_model(model) for model in models],
        switch_rate=switch_rate,
        acceleration=settings.first_acceleration if isinstance(settings, FirstAcceleration) else 0.0,
        turn_rate=settings.first_turn_rate if isinstance(settings, FirstTurnRate) else 0.0,
        jerk=settings.first_jerk if isinstance(settings, FirstJerk) else 0.0,
        forms=[form] * len(models),
        noise=_make_noise(settings.measurement_noise),
    )


def _make_noise(settings: NoiseSettings) -> SensorNoise | None:
    """Return what finds out the noise of each track's detections; None where it is what the sensors say."""
    match settings:
        case WindowedNoiseSettings():
            return _sensor_noise(settings, partial(WindowedScale, settings.window))
        case VariationalNoiseSettings():
            return _sensor_noise(settings, partial(NoiseScale, settings.forgetting))
        case _:
            return None


def _sensor_noise(
    settings: WindowedNoiseSettings | VariationalNoiseSettings, factor: Callable[..., NoiseFactor]
) -> SensorNoise:
    make = partial(factor, floor=settings.least, ceiling=settings.most)
    return SensorNoise(make, headroom=settings.headroom, most=settings.most)


def make_model(settings: ModelSettings) -> MotionModel:
    """Return the motion model of the settings."""
    match settings:
        case LinearModelSettings():
            settling = settings.settling
            return LinearModel(
                order=1 if settings.kind == "cv" else 2,
                noise=(settings.noise.along, settings.noise.across),
                decay_time=(None, None) if settling is None else (settling.along or None, settling.across or None),
                position_noise=(settings.wander.along, settings.wander.across),
            )
        case JerkModelSettings():
            noise, wander = settings.noise, settings.wander
            return LinearModel(3, (noise.along, noise.across), position_noise=(wander.along, wander.across))
        case TurnModelSettings():
            return CoordinatedTurn(settings.noise, settings.turn_noise, settings.wander, settings.limit)
        case SingerModelSettings() | StatisticalModelSettings():
            return _make_isotropic(settings)


def _make_isotropic(settings: SingerModelSettings | StatisticalModelSettings) -> Singer | CurrentStatistical:
    """Return one of the models of Han et al. 2015."""
    if isinstance(settings, SingerModelSettings):
        return Singer(settings.alpha, settings.deviation)
    return CurrentStatistical(settings.alpha, settings.limit, settings.floor, settings.innovation_memory)
