"""Settings of the service around the pipeline: ticks, log, recording and metrics."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from candaemon.config.base import Settings
from candaemon.config.metrics import MetricsSettings
from candaemon.config.recording import RecordingSettings


class ServiceSettings(Settings):
    """How `candaemon run` serves; a replay does not ask for it."""

    tick: float = Field(
        0.01, ge=0.001, le=1, description="s of silence on all buses after which the pipeline gets a tick with the time"
    )
    coalescing: float = Field(
        0.002,
        ge=0,
        le=0.01,
        description="s at most for which frames wait to be read together, while they cannot complete a scan at the "
        "bitrate of their bus; 0: each frame wakes the service",
    )
    clock_step: float = Field(
        1.0, ge=0.2, le=3600, description="s, a jump ahead of more than this is the clock being set: it is rebased"
    )
    status_interval: float = Field(60.0, ge=0, le=86_400, description="s between two status lines in the log; 0: none")
    log: Literal["text", "json"] = Field("text", description="form of the log's lines")
    recording: RecordingSettings = Field(default_factory=RecordingSettings.defaults)
    metrics: MetricsSettings = Field(default_factory=MetricsSettings.defaults)
