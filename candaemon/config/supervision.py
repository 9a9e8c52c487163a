"""Supervision: time limits after which a source counts as silent or lost, or the service as degraded."""

from __future__ import annotations

from pydantic import Field

from candaemon.config.base import Settings


class SupervisionSettings(Settings):
    """How long things may fail to come until something follows from it."""

    lost_after: float = Field(
        5.0, ge=1, le=1000, description="cycles of a sensor without a scan, after which it is lost: `Health`, events"
    )
    coast_after: float = Field(
        1.5,
        ge=1,
        le=100,
        description="cycles of the fastest sensor without any scan, after which obstacles are reported without one",
    )
    longest_coasting: float = Field(
        10.0, ge=0.1, le=3600, description="s of a pause at most that are reported cycle by cycle once it is over"
    )
    grace: float = Field(
        1.0,
        ge=0,
        le=60,
        description="start-up delay: s from the first frame or tick until the status is sent without a scan",
    )
    worry: float = Field(1.0, ge=0, le=60, description="s for which a lost or refused frame shows as `Health` degraded")
