"""What is estimated of a sensor and of the ego motion that it is seen with, in which order and from which prior."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import InsSettings, OdometrySettings

LATENCY: Final = 0
"""s, by which a scan was measured before its time stamp less the configured latency says."""
YAW: Final = 1
"""rad, by which the sensor is turned to the left of its configured mounting."""
SCALE: Final = 2
"""Speed over ground divided by what odometry reads, less 1."""
BIAS: Final = 3
"""rad/s, what the yaw rate sensor reads of a vehicle that goes straight on."""
COUNT: Final = 4
OFFSET: Final = 4
"""m/s, by which the ego's speed is read too low within one window: no parameter, but not to be taken for one."""
COLUMNS: Final = 5
"""Of the equations of several windows: the parameters and the offset."""
SIGHT: Final = 5
"""rad, by which the directions that belong to the speeds of one window are off: a radar measures speeds of standing
things by a tenth or two wrongly, more to one side than to the other, so that their yaw is not that of the mounting."""
ALL_COLUMNS: Final = 6
"""Of the equations of one window."""

LONGEST_LATENCY: Final = 0.5
"""s, largest latency that is estimated, before or after what is configured."""
LARGEST_YAW: Final = radians(10.0)
"""rad, largest yaw that is estimated, to either side."""

_LATENCY_SD: Final = 0.15
_YAW_SD: Final = radians(2.5)
_INS_SCALE_SD: Final = 0.002
"""Of an INS, whose speed is Doppler's."""
_INS_DRIFT_SD: Final = radians(0.02)
"""rad/s, by which the heading of an INS drifts over a minute."""
_HEADING_SHARE: Final = 0.4
"""1/s: an INS's heading errs by as much of its noise more after a second, for its error lasts some ten."""
_SLIP_SHARE: Final = 0.2
"""Of the noise of wheel speeds, which is white but for slip and rounding."""
_RATE_SHARE: Final = 0.15
"""Of the noise of the yaw rate, which is white, over the samples of a second."""
_SMALLEST: Final = 1e-6


@dataclass(frozen=True, slots=True)
class EgoNoise:
    """Errors of ego motion that all returns of a window share.

    Attributes:
        speed: standard deviation of what the speed is off for some seconds, m/s.
        turn: of the yaw rate over a window, rad/s.
    """

    speed: float
    turn: float


SIGHT_SD: Final = radians(5.0)
"""rad, standard deviation of `SIGHT`."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Gaussian estimate of the parameters.

    Attributes:
        mean: (4,): latency (s), yaw (rad), scale − 1, bias (rad/s).
        covariance: (4, 4).
    """

    mean: Floats
    covariance: Floats

    @property
    def deviation(self) -> Floats:
        """One standard deviation of each (4,)."""
        return np.sqrt(self.covariance.diagonal())


def ego_noise(ego: object) -> EgoNoise:
    """Return what ego motion may be off by from window to window.

    Args:
        ego: settings of the ego motion.
    """
    if isinstance(ego, InsSettings):
        return EgoNoise(ego.noise.velocity, _HEADING_SHARE * radians(ego.noise.heading_deg))
    if isinstance(ego, OdometrySettings):
        return EgoNoise(_SLIP_SHARE * ego.noise.speed, _RATE_SHARE * radians(ego.noise.yaw_rate_deg))
    return EgoNoise(_SMALLEST, _SMALLEST)


def prior(ego: object) -> Estimate:
    """Return what is known of the parameters before anything is seen.

    Args:
        ego: settings of the ego motion: odometry may read speed and yaw rate wrongly, an INS hardly.
    """
    scale_sd, bias_sd = _INS_SCALE_SD, _INS_DRIFT_SD
    if isinstance(ego, OdometrySettings):
        scale_sd = max(ego.bias.speed_scale_sd, 1e-6)
        bias_sd = max(radians(ego.bias.yaw_rate_bias_sd_deg), 1e-6)
    deviation = np.array([_LATENCY_SD, _YAW_SD, scale_sd, bias_sd])
    return Estimate(np.zeros(COUNT), np.diag(deviation**2))
