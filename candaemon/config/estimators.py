"""Estimators: filters, their motion models, and the adaptation of the measurement noise."""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import Field

from candaemon.config.base import Settings
from candaemon.config.directions import AlongAcross, Pair, Settling
from candaemon.config.switching import (
    AccelerationLimit,
    Interval,
    LeastChange,
    ManoeuvreFrequency,
    ManoeuvreTime,
    SteadyNoise,
    SteadyTime,
    SwitchingSettings,
    Threshold,
)
from candaemon.config.vehicle import VehicleEstimatorSettings


class _RandomWalk(Settings):
    """What the linear models share."""

    noise: Pair = Field(
        description="power of the white noise on the highest derivative: (m/s²)²/Hz for cv, (m/s³)²/Hz for ca, "
        "(m/s⁴)²/Hz for jerk; or {along, across}"
    )
    wander: Pair = Field(
        default_factory=lambda: AlongAcross.defaults(along=0.0, across=0.0),
        description="m²/s, random walk of the reflection over the vehicle",
    )


class LinearModelSettings(_RandomWalk):
    """Nearly constant velocity (cv) or acceleration (ca)."""

    kind: Literal["cv", "ca"]
    settling: Settling | None = Field(
        None,
        description="s, time constants of at least 0.02: along with which the highest derivative decays, across with "
        "which the velocity does; 0: it keeps; or one number for both",
    )


class JerkModelSettings(_RandomWalk):
    """Nearly constant jerk: four states an axis."""

    kind: Literal["jerk"]


class SingerModelSettings(Settings):
    """Acceleration as coloured noise of zero mean (singer)."""

    kind: Literal["singer"]
    alpha: float = Field(0.5, gt=1e-4, le=60, description="1/s, manoeuvre frequency")
    deviation: float = Field(2.0, gt=0, le=100, description="m/s², standard deviation of the acceleration")


class TurnModelSettings(Settings):
    """Nearly constant speed turn (ct)."""

    kind: Literal["ct"]
    noise: float = Field(0.01, gt=0, le=100, description="(m/s²)²/Hz on velocity")
    turn_noise: float = Field(0.1, gt=0, le=10, description="(rad/s²)²/Hz on the turn rate")
    limit: float = Field(1.5, gt=0, le=10, description="rad/s, largest turn rate")
    wander: float = Field(0.0, ge=0, le=10, description="m²/s, random walk of the reflection over the vehicle")


class StatisticalModelSettings(Settings):
    """The current statistical model (cs) of the adaptive Kalman filter."""

    kind: Literal["cs"]
    alpha: float = Field(0.5, gt=1e-4, le=60, description="1/s, manoeuvre frequency")
    limit: float = Field(10.0, gt=0, le=100, description="m/s², largest acceleration; 1.25 × what is physical")
    floor: float = Field(1.0, ge=0, le=100, description="(m/s²)², smallest variance of the acceleration")
    innovation_memory: float | None = Field(
        None,
        gt=0,
        le=60,
        description="s, time constant of the mean normalised innovation squared that moves the variance between floor "
        "and limit; none: the acceleration alone does",
    )


ModelSettings = Annotated[
    LinearModelSettings | JerkModelSettings | SingerModelSettings | TurnModelSettings | StatisticalModelSettings,
    Field(discriminator="kind"),
]


class FixedNoiseSettings(Settings):
    """The measurement noise is what the sensor's `noise` says."""

    kind: Literal["fixed"] = "fixed"


class _AdaptingNoise(Settings):
    """What the ways to find out the noise share."""

    least: float = Field(0.25, gt=0, le=1, description="smallest factor on the noise's variance")
    most: float = Field(400.0, ge=1, le=1e6, description="largest factor on the noise's variance")
    headroom: float = Field(
        50.0,
        ge=1,
        le=1e6,
        description="times the variance found so far, though not beyond most, within which an id that the sensor keeps "
        "for a confirmed obstacle is accepted, so that a sensor that degrades is noticed; 50 tolerates a variance that "
        "rises to 200 times at once, less is safer where ids jump",
    )


class WindowedNoiseSettings(_AdaptingNoise):
    """The noise of each track's measurements is scaled by its latest innovations (innovation-based estimation)."""

    kind: Literal["window"]
    window: int = Field(30, ge=2, le=500, description="detections of a track that are averaged")


class VariationalNoiseSettings(_AdaptingNoise):
    """The same by variational Bayes, with a memory that fades."""

    kind: Literal["variational"]
    forgetting: float = Field(
        0.97, gt=0.5, lt=1, description="share of what is known of the noise that a detection leaves; near 1: slow"
    )


NoiseSettings = Annotated[
    FixedNoiseSettings | WindowedNoiseSettings | VariationalNoiseSettings, Field(discriminator="kind")
]


class EstimatorCommon(Settings):
    """What every estimator has."""

    measurement_noise: NoiseSettings = Field(
        default_factory=FixedNoiseSettings.defaults,
        description="whether each track finds out how noisy its detections are",
    )


class FirstAcceleration(EstimatorCommon):
    """An estimator with a model that has an acceleration."""

    first_acceleration: float = Field(
        3.0, gt=0, le=20, description="m/s², standard deviation of a track's first acceleration"
    )


class FirstTurnRate(EstimatorCommon):
    """An estimator with a model that has a turn rate."""

    first_turn_rate: float = Field(
        0.3, gt=0, le=3, description="rad/s, standard deviation of a track's first turn rate"
    )


class FirstJerk(EstimatorCommon):
    """An estimator with a model that has a jerk."""

    first_jerk: float = Field(3.0, gt=0, le=100, description="m/s³, standard deviation of a track's first jerk")


class CvEstimatorSettings(EstimatorCommon, LinearModelSettings):
    """A Kalman filter on the constant velocity model."""

    kind: Literal["cv"]


class CaEstimatorSettings(FirstAcceleration, LinearModelSettings):
    """A Kalman filter on the constant acceleration model."""

    kind: Literal["ca"]


class JerkEstimatorSettings(FirstAcceleration, FirstJerk, JerkModelSettings):
    """A Kalman filter on the constant jerk model."""


class SingerEstimatorSettings(FirstAcceleration, SingerModelSettings):
    """A Kalman filter on Singer's model."""


class TurnEstimatorSettings(FirstTurnRate, TurnModelSettings):
    """An extended Kalman filter on the turn model, whose noise has to cover changes of speed too."""

    noise: float = Field(2.0, gt=0, le=100, description="(m/s²)²/Hz on velocity")


class CsEstimatorSettings(FirstAcceleration, StatisticalModelSettings):
    """The adaptive Kalman filter on the current statistical model."""


def _default_models() -> tuple[ModelSettings, ...]:
    return (
        LinearModelSettings.defaults(kind="cv", noise=AlongAcross.defaults(along=1e-3, across=1e-3)),
        LinearModelSettings.defaults(kind="ca", noise=AlongAcross.defaults(along=5.0, across=5.0)),
        TurnModelSettings.defaults(kind="ct"),
    )


class _InteractingSettings(FirstAcceleration, FirstTurnRate, FirstJerk):
    """What the interacting multiple model filters share."""

    models: tuple[ModelSettings, ...] = Field(default_factory=_default_models, min_length=1, max_length=8)
    switch_rate: float = Field(0.03, gt=0, le=20, description="1/s, rate at which a target leaves a model")


class ImmEstimatorSettings(_InteractingSettings):
    """An interacting multiple model filter; with one model a plain Kalman filter."""

    kind: Literal["imm"] = "imm"


class InformationEstimatorSettings(_InteractingSettings):
    """The same with a nonlinear information filter for each model; with one model a plain information filter."""

    kind: Literal["information"]


class SwitchingEstimatorSettings(FirstAcceleration, SwitchingSettings):
    """Constant velocity or current statistical model, as the recent change of speed demands: one at a time, no weights.

    Zhang et al. 2016 follow a vehicle's own track of one fix a second, with T1 = 10 s and T2 = 20 s. An obstacle that
    brakes has to be followed within a second, and a radar's range rate shows it so soon: so interval and times are
    shorter, and the threshold, which is a change over the interval, is lower with them.
    """

    noise: SteadyNoise = 0.1
    alpha: ManoeuvreFrequency = 0.5
    limit: AccelerationLimit = 10.0
    interval: Interval = 0.5
    threshold: Threshold = 0.02
    least_change: LeastChange = 0.4
    manoeuvre_time: ManoeuvreTime = 0.5
    steady_time: SteadyTime = 1.0


class FederatedEstimatorSettings(FirstAcceleration, FirstTurnRate, FirstJerk):
    """A local filter for each sensor, fused after every scan and reset from the fused estimate.

    The result is that of one filter, whatever the shares of the information that the local filters start from; what
    weighs a sensor is its noise.
    """

    kind: Literal["federated"]
    model: ModelSettings = Field(
        default_factory=lambda: LinearModelSettings.defaults(
            kind="ca", noise=AlongAcross.defaults(along=5.0, across=5.0)
        ),
        description="of every local filter",
    )
    outage: float = Field(
        20.0,
        gt=1,
        le=1e4,
        description="times the variance of the best sensor from which on a sensor's local filter is left least_share",
    )
    least_share: float = Field(
        0.01, gt=0, lt=0.5, description="share of the information it then starts from; never more than an even one"
    )


class IntersectionEstimatorSettings(FirstAcceleration, FirstTurnRate, FirstJerk):
    """A filter that takes each detection by covariance intersection; a group with `fusion: tracks` has it."""

    kind: Literal["intersection"] = "intersection"
    model: ModelSettings = Field(description="of the filter")


class MlkfEstimatorSettings(FirstAcceleration):
    """The modified linear Kalman filter along the line of sight, a plain one of constant acceleration across it."""

    kind: Literal["mlkf"]
    floor: float = Field(
        1.0,
        gt=0,
        le=100,
        description="(m/s²)², smallest variance of the acceleration along the line of sight after an update",
    )
    noise: float = Field(
        5.0,
        gt=0,
        le=100,
        description="(m/s³)²/Hz, power of the white noise on the acceleration across the line of sight",
    )


EstimatorSettings = Annotated[
    CsEstimatorSettings
    | CvEstimatorSettings
    | CaEstimatorSettings
    | JerkEstimatorSettings
    | SingerEstimatorSettings
    | TurnEstimatorSettings
    | ImmEstimatorSettings
    | InformationEstimatorSettings
    | SwitchingEstimatorSettings
    | FederatedEstimatorSettings
    | MlkfEstimatorSettings
    | VehicleEstimatorSettings,
    Field(discriminator="kind"),
]

SingleModelEstimatorSettings: TypeAlias = (
    CvEstimatorSettings
    | CaEstimatorSettings
    | JerkEstimatorSettings
    | SingerEstimatorSettings
    | TurnEstimatorSettings
    | CsEstimatorSettings
)
"""Estimators of one motion model."""
SINGLE_MODEL: Final = (
    CvEstimatorSettings,
    CaEstimatorSettings,
    JerkEstimatorSettings,
    SingerEstimatorSettings,
    TurnEstimatorSettings,
    CsEstimatorSettings,
)
"""The same, to be asked for by `isinstance`."""
