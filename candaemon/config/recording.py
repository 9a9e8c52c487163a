"""Recording: the ring buffer of recent frames, and the event archive."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from candaemon.config.base import Settings
from candaemon.config.numbers import Identity

Fault = Literal["bus", "lost", "sensor", "trust", "motion", "late"]


class EventSettings(Settings):
    """What makes the recording keep a part of the ring; SIGUSR1 always does."""

    obstacles: tuple[Identity, ...] = Field((), description="identities of obstacles whose appearance is an event")
    faults: tuple[Fault, ...] = Field(
        ("bus", "lost", "sensor", "trust", "motion", "late"),
        description="faults that are events: a bus down or bus-off, frames lost live, a sensor silent, "
        "a sensor below its least_trust, ego motion silent, a cycle that took too long",
    )
    late: float = Field(0.25, gt=0, le=60, description="s from a scan's last frame to its obstacles that are too long")
    before: float = Field(60.0, ge=0, le=86_400, description="s kept before an event, as far as the ring reaches")
    after: float = Field(20.0, ge=0, le=3600, description="s kept after an event")
    debounce: float = Field(
        60.0, ge=0, le=86_400, description="s without a fault after which the same fault is an event again"
    )
    kept: int = Field(20, ge=0, le=1000, description="events kept; the oldest go")
    disk: float = Field(512.0, gt=0, le=1e6, description="MB that the kept events may take; the oldest go")


class RecordingSettings(Settings):
    """The ring that `run` keeps with `--record DIR`, or as a service where it is enabled."""

    enabled: bool = Field(
        False, description="record without --record, into the state directory that systemd gives the service"
    )
    minutes: float = Field(5.0, gt=0, le=1440, description="min of input that the ring holds")
    file_seconds: float = Field(30.0, ge=0.1, le=3600, description="s of input in one file of the ring")
    disk: float = Field(256.0, ge=1, le=1e6, description="MB that the ring may take, whatever comes; the oldest go")
    flush: float = Field(0.5, ge=0.01, le=1, description="s after which what came is written: the most a kill loses")
    sync: bool = Field(False, description="force what is written onto the disk each time: the most a power cut loses")
    buffer: float = Field(8.0, ge=0.1, le=1024, description="MB that may wait for a slow disk before input is left out")
    retry: float = Field(5.0, ge=0.1, le=3600, description="s after which a disk that refused is tried again")
    events: EventSettings = Field(default_factory=EventSettings.defaults)
