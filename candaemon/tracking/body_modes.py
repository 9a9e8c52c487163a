"""The modes of motion of the vehicle estimator, from its settings."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from candaemon.config.vehicle import DrivingSettings, VehicleEstimatorSettings
from candaemon.estimation.body_filter import BodyDynamics, BodyMode

CRUISING, MANOEUVRING, TURNING, STANDING, SLIDING, FREE = range(6)
MODE_NAMES = ("cruising", "manoeuvring", "turning", "standing", "sliding", "free")
SETTLED: Final = 2.0
STILL: Final = 0.5
"""s after its first detection, and m/s: what was never faster stands, in whatever mode its filter is."""


def modes_of(settings: VehicleEstimatorSettings) -> tuple[BodyMode, ...]:
    """Return the modes in the order of `CRUISING`, `MANOEUVRING`, `TURNING`, `STANDING`, `SLIDING`, `FREE`."""
    sliding, free = settings.sliding, settings.free
    cruising = _driving(settings.cruising, settings.cruising.turn_time)
    return (
        cruising,
        replace(_driving(settings.manoeuvring, settings.turn_time), acceleration_onset=settings.manoeuvring.onset),
        replace(_driving(settings.turning, settings.turning.turn_time), onset=settings.turning.onset),
        BodyMode(
            moves=False,
            acceleration=0.0,
            lateral_acceleration=0.0,
            velocity_noise=0.0,
            bias_walk=0.0,
            dwell=settings.standing.dwell,
            turn_time=settings.turn_time,
        ),
        replace(cruising, bias_walk=sliding.walk, dwell=sliding.dwell, turn_time=settings.turning.turn_time),
        BodyMode(
            moves=True,
            acceleration=0.0,
            lateral_acceleration=0.0,
            velocity_noise=free.noise,
            bias_walk=0.0,
            dwell=free.dwell,
            turn_time=settings.turn_time,
        ),
    )


def _driving(settings: DrivingSettings, turn_time: float) -> BodyMode:
    return BodyMode(
        moves=True,
        acceleration=settings.acceleration,
        lateral_acceleration=settings.lateral_acceleration,
        velocity_noise=settings.noise,
        bias_walk=0.0,
        dwell=settings.dwell,
        turn_time=turn_time,
        settles=True,
    )


def dynamics_of(settings: VehicleEstimatorSettings) -> BodyDynamics:
    """Return what holds in all modes."""
    places = settings.reflections
    return BodyDynamics(
        first_acceleration=settings.first_acceleration,
        acceleration_time=settings.acceleration_time,
        turn_rate=settings.turn_rate,
        standing=settings.standing.speed,
        first_bias=places.first_bias,
        evidence=settings.evidence,
        settling=places.settling,
        settling_speed=places.settling_speed,
    )
