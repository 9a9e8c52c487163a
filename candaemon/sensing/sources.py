"""The source of own motion that the configuration names."""

from __future__ import annotations

from candaemon.binding.ego import BoundEgo
from candaemon.config.ego import InsSettings
from candaemon.sensing.ego import EgoMotion
from candaemon.sensing.ins import InsMotion
from candaemon.sensing.odometry import OdometryMotion, StandingStill


def make_ego(bound: BoundEgo | None) -> EgoMotion:
    """Return own motion for a bound configuration; without one, of a vehicle that stands."""
    if bound is None:
        return StandingStill()
    if isinstance(bound.settings, InsSettings):
        return InsMotion(bound.settings)
    return OdometryMotion(bound.settings)
