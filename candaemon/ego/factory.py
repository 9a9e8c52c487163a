"""The source of ego motion that the configuration names, and what places its frame on earth."""

from __future__ import annotations

from candaemon.binding.bound import BoundEgo
from candaemon.config.ego import InsSettings
from candaemon.ego.georeference import Georeferencer
from candaemon.ego.ins import InsMotion
from candaemon.ego.motion import EgoMotion
from candaemon.ego.odometry import OdometryMotion, StandingStill


def make_ego(bound: BoundEgo | None) -> EgoMotion:
    """Return the source of ego motion for a bound configuration; without one, of a vehicle that stands."""
    if bound is None:
        return StandingStill()
    if isinstance(bound.settings, InsSettings):
        return InsMotion(bound.settings)
    return OdometryMotion(bound.settings, bound.reverse)


def make_georeferencer(bound: BoundEgo | None, ego: EgoMotion) -> Georeferencer | None:
    """Return what places the local frame of an INS on earth; None where the configuration does not ask for it."""
    if bound is None or not isinstance(bound.settings, InsSettings) or not isinstance(ego, InsMotion):
        return None
    gnss = bound.settings.gnss
    return None if gnss is None else Georeferencer(bound.settings, gnss, ego.history)
