"""Trust: when a sensor counts as frozen, biased or noisier than it was."""

from __future__ import annotations

from pydantic import Field

from candaemon.config.base import Settings


class TrustSettings(Settings):
    """When what a sensor says is weighted down or cut off.

    Noise and bias are judged by what other sensors of its group say, so only where there are some.
    """

    enabled: bool = Field(True, description="false: every sensor is taken at its word")
    frozen_after: int = Field(
        10, ge=2, le=1000, description="scans with the same objects in succession, while something moves: frozen"
    )
    noise: float = Field(
        3.0,
        ge=1.5,
        le=100,
        description="times the variance of innovations, and of their changes, that the sensor had before: noisy",
    )
    burst: float = Field(
        9.0, ge=2, le=1000, description="times that variance in a single scan, from which on the scan is weighted down"
    )
    bias: float = Field(1.5, ge=0.1, le=50, description="m by which its objects are off along the sight: biased")
    bias_angle_deg: float = Field(
        4.0, ge=0.1, le=90, description="deg by which its objects are off across it, beyond that"
    )
    recovery: float = Field(
        0.5, ge=0, le=60, description="s for which a sensor that was cut off has to be right until it is used again"
    )
