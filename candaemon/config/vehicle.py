"""The vehicle estimator: one filter an obstacle, for a rigid body that moves as vehicles do."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from candaemon.config.base import Settings


class DrivingSettings(Settings):
    """A body whose velocity lies along its axis: it speeds up, brakes and turns."""

    acceleration: float = Field(1.5, gt=0, le=20, description="m/s², standard deviation along the course")
    acceleration_time: float = Field(1.5, gt=0.05, le=60, description="s, correlation time of it")
    lateral_acceleration: float = Field(1.2, gt=0, le=20, description="m/s², standard deviation of turn rate × speed")
    turn_rate: float = Field(0.3, gt=0, le=2, description="rad/s, largest standard deviation of the turn rate")
    turn_time: float = Field(1.5, gt=0.05, le=60, description="s, correlation time of it")
    noise: float = Field(0.02, gt=0, le=100, description="(m/s²)²/Hz, white acceleration in any direction: slip")
    dwell: float = Field(10.0, gt=0.02, le=1e4, description="s, mean time for which a body drives")


class StandingSettings(Settings):
    """A body that stands."""

    speed: float = Field(0.03, gt=0, le=2, description="m/s, standard deviation of the speed of what stands")
    dwell: float = Field(10.0, gt=0.02, le=1e4, description="s, mean time for which a body stands")


class SlidingSettings(Settings):
    """A body whose reflection slides over it, or whose place the sensor's own filter lets slide: its motion goes on."""

    walk: float = Field(2.0, gt=0, le=100, description="m²/s, random walk of the reflection meanwhile")
    dwell: float = Field(0.3, gt=0.02, le=1e4, description="s, mean time for which it slides")


class FreeSettings(Settings):
    """A body without an axis: a pedestrian, or one of which too little is known."""

    noise: float = Field(2.0, gt=0, le=100, description="(m/s²)²/Hz, white acceleration in any direction")
    dwell: float = Field(1.0, gt=0.02, le=1e4, description="s, mean time for which it moves so")


class ReflectionPlaceSettings(Settings):
    """Where on a body its reflections lie, and how they wander."""

    walk: float = Field(0.005, ge=0, le=10, description="m²/s, random walk of sensors whose walk is not known")
    bias_time: float = Field(2.0, gt=0.05, le=60, description="s, with which the leading reflection's bias fades")
    first_bias: float = Field(0.15, gt=0, le=5, description="m, standard deviation of a new body's bias")
    spread: float = Field(0.5, gt=0, le=5, description="m, standard deviation of where further reflections lie")
    spread_time: float = Field(2.0, gt=0.05, le=60, description="s, within which they wander so far")


class VehicleEstimatorSettings(Settings):
    """One interacting multiple model filter an obstacle, for the motion of its body; see docs/estimators.md."""

    kind: Literal["vehicle"]
    driving: DrivingSettings = Field(default_factory=DrivingSettings)
    standing: StandingSettings = Field(default_factory=StandingSettings)
    sliding: SlidingSettings = Field(default_factory=SlidingSettings)
    free: FreeSettings = Field(default_factory=FreeSettings)
    reflections: ReflectionPlaceSettings = Field(default_factory=ReflectionPlaceSettings)
