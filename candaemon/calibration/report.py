"""What a calibrator knows, as figures for the summary, the status and the metrics."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import TypeAlias

from candaemon.calibration.calibrator import Calibrator
from candaemon.calibration.parameters import LATENCY, YAW

Figures: TypeAlias = Mapping[str, float | int | None]
"""Values by their names; None where nothing is known yet."""


def sensor_figures(calibrator: Calibrator | None, sensor: int) -> Figures | None:
    """Return what is known of a sensor: errors of what is configured, one standard deviation each, what is applied.

    ====================  ======================================================================
    `latency`             s, beyond what is configured
    `latency_sd`          one standard deviation of it, s
    `latency_applied`     s, by which scans are put back in time
    `yaw_deg`             deg to the left, beyond what is configured
    `yaw_sd_deg`          one standard deviation of it, deg
    `yaw_applied_deg`     deg, by which the sensor is taken as turned
    `windows`             seconds of standing returns from which that is learnt
    ====================  ======================================================================
    """
    if calibrator is None:
        return None
    state = calibrator.state.sensors[sensor]
    deviation, is_known = state.estimate.deviation, calibrator.is_known(sensor)
    return {
        "latency": _told(state.mean[LATENCY], is_known),
        "latency_sd": _told(deviation[LATENCY], is_known),
        "latency_applied": _told(state.in_force[LATENCY], True),
        "yaw_deg": _told(degrees(state.mean[YAW]), is_known),
        "yaw_sd_deg": _told(degrees(deviation[YAW]), is_known),
        "yaw_applied_deg": _told(degrees(state.in_force[YAW]), True),
        "windows": state.windows.windows,
    }


def ego_figures(calibrator: Calibrator | None) -> Figures | None:
    """Return what is known of the odometry; None where there is none.

    ====================  ======================================================================
    `speed_scale`         speed over ground divided by what is read
    `speed_scale_sd`      one standard deviation of it
    `yaw_rate_bias_deg`   deg/s, what is read of a vehicle that goes straight on
    `yaw_rate_bias_sd_deg`  one standard deviation of it, deg/s
    ====================  ======================================================================
    """
    if calibrator is None or not calibrator.has_odometry:
        return None
    (scale, bias), (scale_sd, bias_sd) = calibrator.ego
    is_known = any(calibrator.is_known(k) for k in range(len(calibrator.state.sensors)))
    return {
        "speed_scale": _told(1.0 + scale, is_known),
        "speed_scale_sd": _told(scale_sd, is_known),
        "yaw_rate_bias_deg": _told(degrees(bias), is_known),
        "yaw_rate_bias_sd_deg": _told(degrees(bias_sd), is_known),
    }


def _told(value: float, is_known: bool) -> float | None:
    return round(float(value), 6) + 0.0 if is_known else None
