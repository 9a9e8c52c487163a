"""The modes of motion of the vehicle estimator, from its settings."""

from __future__ import annotations

from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.body_filter import BodyDynamics, BodyMode

DRIVING, STANDING, SLIDING, FREE = range(4)


def modes_of(settings: VehicleEstimatorSettings) -> tuple[BodyMode, ...]:
    """Return the modes in the order of `DRIVING`, `STANDING`, `SLIDING`, `FREE`."""
    driving, standing, sliding, free = settings.driving, settings.standing, settings.sliding, settings.free
    return (
        BodyMode(moves=True, steers=True, velocity_noise=driving.noise, bias_walk=0.0, dwell=driving.dwell),
        BodyMode(moves=False, steers=False, velocity_noise=0.0, bias_walk=0.0, dwell=standing.dwell),
        BodyMode(
            moves=True, steers=True, velocity_noise=driving.noise / 4, bias_walk=sliding.walk, dwell=sliding.dwell
        ),
        BodyMode(moves=True, steers=False, velocity_noise=free.noise, bias_walk=0.0, dwell=free.dwell),
    )


def dynamics_of(settings: VehicleEstimatorSettings) -> BodyDynamics:
    """Return what holds in all modes."""
    driving, places = settings.driving, settings.reflections
    return BodyDynamics(
        acceleration=driving.acceleration,
        acceleration_time=driving.acceleration_time,
        lateral_acceleration=driving.lateral_acceleration,
        turn_rate=driving.turn_rate,
        turn_time=driving.turn_time,
        standing=settings.standing.speed,
        bias_time=places.bias_time,
        first_bias=places.first_bias,
    )
