"""Tracker: which filter, how detections find their tracks, how tracks live."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from candaemon.config.base import Settings


class AlongAcross(Settings):
    """A number for each direction: along and across the direction of travel."""

    along: float = Field(ge=0)
    across: float = Field(ge=0)


def _both_from_number(value: Any) -> Any:
    """Let one number stand for both directions."""
    return {"along": value, "across": value} if isinstance(value, int | float) else value


Pair = Annotated[AlongAcross, BeforeValidator(_both_from_number, json_schema_input_type=float | AlongAcross)]


class LinearModelSettings(Settings):
    """Nearly constant velocity (cv) or acceleration (ca)."""

    kind: Literal["cv", "ca"]
    noise: Pair = Field(
        description="power of the white noise: (m/s²)²/Hz for cv, (m/s³)²/Hz for ca; or {along, across}"
    )
    settling: AlongAcross | None = Field(
        None,
        description="s, time constants: along with which the highest derivative decays, across with which the velocity "
        "does; 0: it keeps",
    )
    wander: Pair = Field(
        default_factory=lambda: AlongAcross(along=0, across=0),
        description="m²/s, random walk of the reflection over the vehicle",
    )


class TurnModelSettings(Settings):
    """Nearly constant speed turn (ct)."""

    kind: Literal["ct"]
    noise: float = Field(0.01, gt=0, le=100, description="(m/s²)²/Hz on velocity")
    turn_noise: float = Field(0.1, gt=0, le=10, description="(rad/s²)²/Hz on the turn rate")
    wander: float = Field(0.0, ge=0, le=10, description="m²/s, random walk of the reflection over the vehicle")


class StatisticalModelSettings(Settings):
    """The current statistical model (cs) of the adaptive Kalman filter."""

    kind: Literal["cs"]
    alpha: float = Field(0.5, gt=1e-4, le=60, description="1/s, manoeuvre frequency")
    limit: float = Field(10.0, gt=0, le=100, description="m/s², largest acceleration")
    floor: float = Field(1.0, ge=0, le=100, description="(m/s²)², smallest variance of the acceleration")


ModelSettings = Annotated[
    LinearModelSettings | TurnModelSettings | StatisticalModelSettings, Field(discriminator="kind")
]


def _default_models() -> tuple[ModelSettings, ...]:
    return (
        LinearModelSettings(kind="cv", noise=AlongAcross(along=1e-3, across=1e-3)),
        LinearModelSettings(kind="ca", noise=AlongAcross(along=5.0, across=5.0)),
        TurnModelSettings(kind="ct"),
    )


class EstimatorCommon(Settings):
    """What every estimator has."""

    first_acceleration: float = Field(
        3.0, gt=0, le=20, description="m/s², standard deviation of a track's first acceleration"
    )


class CsEstimatorSettings(EstimatorCommon):
    """The adaptive Kalman filter on the current statistical model."""

    kind: Literal["cs"]
    alpha: float = Field(0.5, gt=1e-4, le=60, description="1/s, manoeuvre frequency")
    limit: float = Field(10.0, gt=0, le=100, description="m/s², largest acceleration; 1.25 × what is physical")
    floor: float = Field(1.0, ge=0, le=100, description="(m/s²)², smallest variance of the acceleration")


class ImmEstimatorSettings(EstimatorCommon):
    """An interacting multiple model filter; with one model a plain Kalman filter."""

    kind: Literal["imm"] = "imm"
    models: tuple[ModelSettings, ...] = Field(default_factory=_default_models, min_length=1, max_length=8)
    switch_rate: float = Field(0.03, gt=0, le=20, description="1/s, rate at which a target leaves a model")
    first_turn_rate: float = Field(
        0.3, gt=0, le=3, description="rad/s, standard deviation of a track's first turn rate"
    )


EstimatorSettings = Annotated[CsEstimatorSettings | ImmEstimatorSettings, Field(discriminator="kind")]


class TravelSettings(Settings):
    """The direction of travel, which tells along from across."""

    min_speed: float = Field(3.0, gt=0, le=30, description="m/s over ground; slower, the direction is kept")
    time_constant: float = Field(2.0, gt=0, le=60, description="s, with which it follows the course over ground")


class AssociationSettings(Settings):
    """How detections find their tracks."""

    method: Literal["nearest", "id"] = Field(
        "nearest",
        description="nearest: the sensor's id as first guess, global nearest neighbour for the rest; id: the id alone",
    )
    gate: float = Field(16.0, gt=1, le=1000, description="largest normalised innovation squared")
    id_gate: float = Field(
        40.0, gt=1, le=1e6, description="the same where the sensor keeps the id of a confirmed obstacle"
    )


class ReflectionSettings(Settings):
    """When several detections are one vehicle."""

    merge: bool = Field(True, description="false: every object of the sensor is an obstacle")
    along: float = Field(3.5, gt=0, le=30, description="m along the travel from a known reflection")
    across: float = Field(1.2, gt=0, le=5, description="m across it")
    speed: float = Field(1.2, gt=0, le=10, description="m/s difference of speed along the line of sight")
    extent: float = Field(15.0, gt=0, le=50, description="m, longest vehicle")
    merge_time: float = Field(0.5, ge=0, le=10, description="s side by side until two obstacles become one")
    patience: float = Field(0.15, ge=0, le=2, description="s without a detection until another reflection leads")
    return_time: float = Field(
        2.0, gt=0, le=60, description="s, with which the reference point returns to the leading reflection"
    )


class LifecycleSettings(Settings):
    """Birth, confirmation, coasting, deletion."""

    confirm: int = Field(5, ge=1, le=32, description="scans with a detection that confirm a track …")
    window: int = Field(8, ge=1, le=32, description="… among so many")
    coast: float = Field(
        1.0, gt=0, le=30, description="s that a confirmed obstacle lives on undetected; never longer than it was seen"
    )
    tentative_coast: float = Field(0.12, gt=0, le=5, description="s that a tentative one does")
    reflection_coast: float = Field(
        0.4, gt=0, le=30, description="s that a reflection does while its obstacle has others"
    )
    uncertainty: float = Field(
        2.0,
        gt=0,
        le=100,
        description="m, standard deviation of its place with which an undetected obstacle is given up",
    )
    first_speed: Pair = Field(
        default_factory=lambda: AlongAcross(along=25.0, across=5.0),
        description="m/s, standard deviation over ground of an unknown target, along and across our own heading",
    )

    @model_validator(mode="after")
    def _window_holds_the_hits(self) -> LifecycleSettings:
        if self.confirm > self.window:
            raise ValueError(f"confirm {self.confirm} of window {self.window} can never be reached; raise window")
        return self


class TrackerSettings(Settings):
    """How detections become obstacles."""

    estimator: EstimatorSettings = Field(default_factory=ImmEstimatorSettings)
    travel: TravelSettings = Field(default_factory=TravelSettings)
    association: AssociationSettings = Field(default_factory=AssociationSettings)
    reflections: ReflectionSettings = Field(default_factory=ReflectionSettings)
    lifecycle: LifecycleSettings = Field(default_factory=LifecycleSettings)
    max_tracks: int = Field(
        512, ge=1, le=4096, description="reflections kept at once; what comes beyond is counted and dropped"
    )


class GroupSettings(Settings):
    """Sensors that are tracked on their own, apart from the others."""

    sensors: tuple[str, ...] = Field(min_length=1, description="names of the sensors")
    tracker: TrackerSettings = Field(default_factory=TrackerSettings)
