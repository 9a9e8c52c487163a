"""Metrics: what a running service exposes to a Prometheus server."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, field_validator

from candaemon.config.base import Settings

_BUCKETS = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.25, 1.0)


class MetricsSettings(Settings):
    """What is measured of a running service, and the endpoint for Prometheus, on the loopback interface alone."""

    port: int | None = Field(None, ge=1, le=65_535, description="TCP port of the endpoint; default: there is none")
    buckets: tuple[Annotated[float, Field(gt=0, le=86_400)], ...] = Field(
        _BUCKETS,
        min_length=1,
        max_length=64,
        description="s, upper bounds of the histograms of cycle time and latency, ascending; one without bound follows",
    )
    nis_scans: int = Field(
        200, ge=1, le=100_000, description="scans that a sensor's NIS of late looks back on, older ones fading"
    )

    @field_validator("buckets")
    @classmethod
    def _buckets_ascend(cls, bounds: tuple[float, ...]) -> tuple[float, ...]:
        if any(upper <= lower for lower, upper in pairwise(bounds)):
            raise ValueError(f"found {list(bounds)}, expected bounds in ascending order, each once")
        return bounds
