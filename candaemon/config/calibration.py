"""Self-calibration: what is estimated while driving, and whether it is applied."""

from __future__ import annotations

from pydantic import Field

from candaemon.config.base import Settings


class CalibrationSettings(Settings):
    """Estimation of each sensor's latency and yaw, and of what odometry reads wrongly, from what stands still."""

    enabled: bool = Field(True, description="false: nothing is estimated")
    apply: bool = Field(False, description="correct what is found; default: only report it")
    significance: float = Field(
        3.0, ge=1, le=20, description="standard deviations above which an estimate is applied; below 1 it is given up"
    )
    settling: float = Field(
        1.0, ge=0.1, le=600, description="s, time constant with which a correction comes into force"
    )
