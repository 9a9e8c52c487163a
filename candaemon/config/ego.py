"""Ego motion: its signals and their noise."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from candaemon.config.base import Condition, Settings, Signal, Signals, Units
from candaemon.config.gnss import GnssSettings
from candaemon.config.names import DbcName, FilePath, Name
from candaemon.config.protection import InputProtectionSettings, MotionPlausibilitySettings


class LeverArm(Settings):
    """Where the INS measures, in vehicle axes."""

    x: float = Field(0.0, ge=-30, le=30, description="m forward of the rear axle's centre")
    y: float = Field(0.0, ge=-5, le=5, description="m to the left")


class EgoCommon(Settings):
    """What every source of ego motion has."""

    bus: Name = Field(description="name of the bus")
    dbc: FilePath = Field(description="DBC file, relative to this YAML")
    units: Units = Field(default_factory=Units.defaults, description="of signals without a unit of their own")
    age_limit: float = Field(0.5, gt=0, le=10, description="s without an update before ego motion is dead reckoning")
    dead_reckoning: float = Field(
        10.0, gt=0, le=600, description="s without an update before ego motion is lost, dead reckoning too"
    )
    unseen_acceleration: float = Field(
        1.0, gt=0, le=20, description="m/s², how fast the velocity's standard deviation grows in dead reckoning"
    )
    latency: float = Field(0.0, ge=-0.5, le=0.5, description="s from measurement to the frame's time stamp")
    protection: dict[DbcName, InputProtectionSettings] = Field(
        default_factory=dict, description="of messages, by their names; default: none"
    )
    plausibility: MotionPlausibilitySettings = Field(default_factory=MotionPlausibilitySettings.defaults)


class InsSignals(Settings):
    """Signals of a GPS/INS as MESSAGE.SIGNAL. Either the velocity's two components or speed and course."""

    latitude: Signal | None = Field(None, description="geodetic latitude, deg")
    longitude: Signal | None = Field(None, description="geodetic longitude, deg")
    velocity_north: Signal | None = Field(None, description="velocity over ground, north")
    velocity_east: Signal | None = Field(None, description="velocity over ground, east")
    speed: Signal | None = Field(None, description="speed over ground, where there are no velocity components")
    heading: Signal = Field(description="true heading of the vehicle, clockwise from north")
    yaw_rate: Signal | None = Field(None, description="positive to the left")
    curvature: Signal | None = Field(
        None, description="of the path, 1/m, positive to the left; times speed is yaw rate"
    )
    slip: Signal | None = Field(
        None, description="from the heading to the velocity, positive to the left; for a source that gives speed"
    )
    ax: Signal | None = Field(None, description="acceleration over ground, forward")
    ay: Signal | None = Field(None, description="acceleration over ground, to the left")
    valid: DbcName | None = Field(None, description="MESSAGE.SIGNAL that is not 0 while the solution is valid")

    @model_validator(mode="after")
    def _has_velocity(self) -> InsSignals:
        if (self.velocity_north is None) != (self.velocity_east is None):
            raise ValueError("velocity_north and velocity_east go together; give both or neither")
        if self.velocity_north is None and self.speed is None:
            raise ValueError("no velocity; give velocity_north and velocity_east, or speed")
        if (self.latitude is None) != (self.longitude is None):
            raise ValueError("latitude and longitude go together; give both or neither")
        return self


class InsNoise(Settings):
    """One standard deviation of what the INS measures."""

    velocity: float = Field(0.05, gt=0, le=5, description="m/s")
    heading_deg: float = Field(0.15, gt=0, le=10, description="deg")
    yaw_rate_deg: float = Field(0.3, gt=0, le=10, description="deg/s, of the given or derived yaw rate")


class InsSettings(EgoCommon):
    """Ego motion from a GPS/INS."""

    kind: Literal["ins"]
    signals: InsSignals
    lever_arm: LeverArm = Field(
        default_factory=LeverArm.defaults, description="where the INS measures, in vehicle axes"
    )
    noise: InsNoise = Field(default_factory=InsNoise.defaults)
    smoothing: float = Field(0.1, ge=0, le=2, description="s, time constant of yaw rate and acceleration derived here")
    bias_time: float = Field(
        3.0, ge=0, le=600, description="s over which the heading tells the bias of the given yaw rate; 0: it has none"
    )
    gnss: GnssSettings | None = Field(
        None, description="how latitude and longitude place the local frame on earth; default: they do not"
    )


class OdometrySignals(Settings):
    """Signals of the vehicle's own bus as MESSAGE.SIGNAL."""

    speed: Signals = Field((), description="speedometer, or several signals whose mean is the speed")
    left_wheels: Signals = Field(
        (), description="wheel speeds on the left; with the right ones, their mean is the speed"
    )
    right_wheels: Signals = Field((), description="wheel speeds on the right")
    yaw_rate: Signal | None = Field(
        None, description="positive to the left; default: from the curvature or the wheels of both sides"
    )
    curvature: Signal | None = Field(
        None, description="of the path, 1/m, positive to the left; gives the yaw rate while that does not come"
    )
    reverse: Condition | None = Field(
        None,
        description="on a MESSAGE.SIGNAL, such as that of the gear: while it holds, the vehicle drives backwards, and "
        "speeds sent without a sign count as below 0; default: it never does",
    )

    @model_validator(mode="after")
    def _has_speed_and_turn(self) -> OdometrySignals:
        if len(self.left_wheels) != len(self.right_wheels):
            raise ValueError("as many left_wheels as right_wheels are needed")
        if bool(self.speed) == bool(self.left_wheels):
            raise ValueError("own speed needs one source; give left_wheels and right_wheels, or speed")
        if self.yaw_rate is None and self.curvature is None and not self.left_wheels:
            raise ValueError(
                "no yaw rate; give yaw_rate or curvature, or left_wheels and right_wheels instead of speed"
            )
        return self


class OdometryNoise(Settings):
    """One standard deviation of what the sensors of ego motion measure."""

    speed: float = Field(0.1, gt=0, le=5, description="m/s")
    yaw_rate_deg: float = Field(0.3, gt=0, le=10, description="deg/s")


class BiasSettings(Settings):
    """Estimation of the biases of the ego motion sensors."""

    speed_scale_sd: float = Field(
        0.02, ge=0, le=0.2, description="initial standard deviation of the speed's factor; 0: fixed"
    )
    yaw_rate_bias_sd_deg: float = Field(0.6, ge=0, le=10, description="deg/s, initial standard deviation; 0: fixed")
    learnt: float = Field(
        0.6, gt=0, le=1, description="share of the initial standard deviations, from which on ego motion is initialised"
    )
    learning_time: float = Field(
        5.0, ge=0, le=600, description="s of ego motion after which it counts as initialised, whatever was learnt"
    )
    yaw_rate_drift_deg: float = Field(0.005, ge=0, le=1, description="deg/s per √s, random walk of the yaw rate's bias")
    wheel_noise_deg: float = Field(
        2.0, gt=0, le=20, description="deg/s, of the yaw rate that the wheels' difference gives"
    )
    wheel_mismatch_deg: float = Field(
        0.3, ge=0, le=10, description="deg/s, standard deviation of its bias (unequal tyres)"
    )
    stationary_speed: float = Field(1.0, gt=0, le=10, description="m/s, a return slower than this over ground is used")
    least_own_speed: float = Field(
        3.0, gt=0, le=30, description="m/s, slower, a stationary return hardly shows anything"
    )
    least_distance: float = Field(
        15.0, gt=0, le=200, description="m ahead; nearer, drift across hardly shows the yaw rate"
    )
    least_cosine: float = Field(0.9, gt=0, le=1, description="of the angle between line of sight and travel")
    least_age: float = Field(1.0, ge=0, le=10, description="s, of an obstacle whose returns are used")
    drift_time: float = Field(1.0, gt=0, le=10, description="s over which a stationary return's drift is watched")
    drift_noise: float = Field(
        0.2, gt=0, le=5, description="m, standard deviation of a stationary return's place across"
    )
    stationary_noise: float = Field(
        0.25, gt=0, le=5, description="m/s, standard deviation of a stationary return's range rate"
    )
    shared_returns: float = Field(
        20.0,
        ge=1,
        le=1000,
        description="successive returns of one object that count as one, for they share their error",
    )


class OdometrySettings(EgoCommon):
    """Ego motion from speed and yaw rate, biases estimated on the way."""

    kind: Literal["odometry"]
    signals: OdometrySignals
    track_width: float = Field(1.6, gt=0.5, le=4, description="m between the wheels whose speeds differ in a turn")
    noise: OdometryNoise = Field(default_factory=OdometryNoise.defaults)
    bias: BiasSettings = Field(default_factory=BiasSettings.defaults)
    smoothing: float = Field(0.1, ge=0, le=2, description="s, time constant of the acceleration derived here")
    reverse_age_limit: float = Field(
        3.0,
        gt=0,
        le=86_400,
        description="s without the signal of `reverse`, after which speeds count as ahead; long, where it is sent only "
        "when it changes",
    )


class StaticSettings(Settings):
    """A vehicle that does not move, or a roadside radar: ego motion is zero, always known."""

    kind: Literal["static"]


EgoSettings = Annotated[InsSettings | OdometrySettings | StaticSettings, Field(discriminator="kind")]
