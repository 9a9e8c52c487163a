"""The vehicle estimator: one filter an obstacle, for a rigid body that moves as vehicles do."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from candaemon.config.base import Settings

Acceleration = Annotated[float, Field(gt=0, le=20, description="m/s², standard deviation along the course")]
LateralAcceleration = Annotated[float, Field(gt=0, le=20, description="m/s², standard deviation of turn rate × speed")]
Slip = Annotated[float, Field(gt=0, le=100, description="(m/s²)²/Hz, white acceleration in any direction: slip")]
Dwell = Annotated[float, Field(gt=0.02, le=1e4, description="s, mean time for which a body drives so")]
TurnTime = Annotated[float, Field(gt=0.02, le=60, description="s, within which the turn rate fades")]


class CruisingSettings(Settings):
    """A body that goes straight, at a speed that hardly changes: what turn rate it had fades at once."""

    acceleration: Acceleration = 0.25
    lateral_acceleration: LateralAcceleration = 0.06
    noise: Slip = 0.001
    dwell: Dwell = 10.0
    turn_time: TurnTime = 0.1


class ManoeuvringSettings(Settings):
    """A body that speeds up or brakes, and may turn meanwhile."""

    acceleration: Acceleration = 3.0
    lateral_acceleration: LateralAcceleration = 1.0
    noise: Slip = 0.05
    dwell: Dwell = 3.0
    onset: float = Field(1.5, ge=0, le=20, description="m/s², standard deviation of an acceleration that begins")


class TurningSettings(Settings):
    """A body that turns at a speed and a turn rate that hardly change, as in a bend or a roundabout.

    While its reflection slides, its turn rate fades within the same time.
    """

    acceleration: Acceleration = 0.08
    lateral_acceleration: LateralAcceleration = 3.0
    noise: Slip = 0.005
    dwell: Dwell = 2.2
    turn_time: TurnTime = 12.0
    onset: float = Field(
        4.0, ge=0, le=20, description="m/s², standard deviation of turn rate × speed of a turn that begins"
    )


DrivingSettings = CruisingSettings | ManoeuvringSettings | TurningSettings
"""A body whose velocity lies along its axis."""


class StandingSettings(Settings):
    """A body that stands."""

    speed: float = Field(0.15, gt=0, le=2, description="m/s, standard deviation of what stands, as own motion errs")
    dwell: float = Field(16.0, gt=0.02, le=1e4, description="s, mean time for which a body stands")


class SlidingSettings(Settings):
    """A body whose reflection slides over it, or whose place the sensor's own filter lets slide: its motion goes on."""

    walk: float = Field(1.0, gt=0, le=100, description="m²/s, random walk of the reflection meanwhile")
    dwell: float = Field(0.3, gt=0.02, le=1e4, description="s, mean time for which it slides")


class FreeSettings(Settings):
    """A body without an axis: a pedestrian, or one of which too little is known."""

    noise: float = Field(2.0, gt=0, le=100, description="(m/s²)²/Hz, white acceleration in any direction")
    dwell: float = Field(1.0, gt=0.02, le=1e4, description="s, mean time for which it moves so")


class ReflectionPlaceSettings(Settings):
    """Where on a body its reflections lie, and how they wander."""

    bias_time: float = Field(0.5, gt=0.05, le=60, description="s, with which the leading reflection's bias fades")
    walk_time: float = Field(
        2.0, gt=0.05, le=60, description="s, likewise where the sensor's reflections are found to walk: a walk lasts"
    )
    first_bias: float = Field(0.2, gt=0, le=5, description="m, standard deviation of a new body's bias")
    passing: float = Field(
        1.0,
        ge=0,
        le=10,
        description="s that a vehicle takes to pass us: so long its reflection may slide along it as fast as the point "
        "that faces us; 0: it does not",
    )
    settling: float = Field(
        1.0,
        gt=0.02,
        le=1e4,
        description="s, with which a speed across the axis settles where the sensor's reflections are found to walk",
    )
    settling_speed: float = Field(
        5.0,
        gt=0.1,
        le=100,
        description="m/s, faster than which it does not: there the course tells the axis; settling would let it lag",
    )
    sure_turn: float = Field(
        2.25,
        ge=0,
        le=10,
        description="standard deviations of a turn rate: with what is beyond them the reference point turns about the "
        "centre of a known box",
    )
    body: float = Field(0.3, ge=0, le=5, description="m, standard deviation of the bias once two are seen")
    beyond: float = Field(
        0.3,
        ge=0,
        le=5,
        description="m beyond an end of a known box, from which on the reference point moves, not the bias",
    )
    return_time: float = Field(
        1.0,
        gt=0.02,
        le=60,
        description="s, with which the reference point returns to the middle of what is seen; of what drives, though "
        "it is one reflection",
    )
    speed_noise: float = Field(
        3.0,
        ge=0.1,
        le=100,
        description="times the stated noise of speeds, of a sensor that filters by itself: successive ones err alike",
    )
    spread: float = Field(0.5, gt=0, le=5, description="m, standard deviation of where further reflections lie")
    spread_time: float = Field(2.0, gt=0.05, le=60, description="s, within which they wander so far")


class BackingSettings(Settings):
    """When a body that moves against its heading backs, and when it must have turned round."""

    speed: float = Field(
        5.0, ge=2, le=30, description="m/s, nothing backs faster; what is slower backs if it was faster ahead before"
    )
    distance: float = Field(
        50.0,
        gt=1,
        le=1e4,
        description="m backwards after which a speed ahead of `speed` is forgotten, so that a wrong heading is healed; "
        "a lower one sooner",
    )


class VehicleEstimatorSettings(Settings):
    """One interacting multiple model filter an obstacle, for the motion of its body; see docs/estimators.md."""

    kind: Literal["vehicle"]
    cruising: CruisingSettings = Field(default_factory=CruisingSettings.defaults)
    manoeuvring: ManoeuvringSettings = Field(default_factory=ManoeuvringSettings.defaults)
    turning: TurningSettings = Field(default_factory=TurningSettings.defaults)
    standing: StandingSettings = Field(default_factory=StandingSettings.defaults)
    sliding: SlidingSettings = Field(default_factory=SlidingSettings.defaults)
    free: FreeSettings = Field(default_factory=FreeSettings.defaults)
    reflections: ReflectionPlaceSettings = Field(default_factory=ReflectionPlaceSettings.defaults)
    backing: BackingSettings = Field(default_factory=BackingSettings.defaults)
    acceleration_time: float = Field(1.5, gt=0.05, le=60, description="s, correlation time of the acceleration")
    turn_time: float = Field(
        1.5,
        gt=0.05,
        le=60,
        description="s, correlation time of the turn rate in modes other than cruising, turning and sliding",
    )
    turn_rate: float = Field(
        0.25, gt=0, le=2, description="rad/s, largest standard deviation of the turn rate, but of a turn that begins"
    )
    first_acceleration: float = Field(1.0, gt=0, le=20, description="m/s², standard deviation of a body's first one")
    evidence: float = Field(
        0.5,
        gt=0,
        le=1,
        description="power of the likelihoods that weigh the modes, of a sensor that filters by itself: below 1, since "
        "its successive errors are alike",
    )
    memory: float = Field(
        0.5, gt=0.02, le=60, description="s over which errors average out: those that last longer count as one"
    )
