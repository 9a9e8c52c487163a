"""Georeference: estimation of the local frame's position on earth from the INS's fixes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from candaemon.config.base import Settings
from candaemon.config.switching import SwitchingSettings


class DriftFilterSettings(Settings):
    """The difference of fix and local frame is a slow random walk: for an INS whose velocity is good."""

    kind: Literal["drift"] = "drift"
    walk: float = Field(0.1, gt=0, le=10, description="m per √s, random walk of the local frame over the earth")
    unseen_acceleration: float = Field(
        1.0, gt=0, le=20, description="m/s², possible acceleration of the vehicle while ego motion was not measured"
    )


class SwitchingFilterSettings(SwitchingSettings):
    """Constant velocity or current statistical model on the fixes alone, switched by change of speed.

    Source: Zhang et al. 2016.
    """

    first_acceleration: float = Field(
        1.0, gt=0, le=20, description="m/s², standard deviation of the first acceleration"
    )


class ImmFilterSettings(Settings):
    """An interacting multiple model filter on the fixes alone: constant velocity and constant acceleration."""

    kind: Literal["imm"]
    steady_noise: float = Field(
        0.01, gt=0, le=100, description="(m/s²)²/Hz, white noise of the constant velocity model"
    )
    manoeuvre_noise: float = Field(
        1.0, gt=0, le=100, description="(m/s³)²/Hz, white noise of the constant acceleration model"
    )
    first_acceleration: float = Field(
        1.0, gt=0, le=20, description="m/s², standard deviation of the first acceleration"
    )
    switch_rate: float = Field(0.05, gt=0, le=20, description="1/s, rate at which the vehicle leaves a model")


FixFilterSettings = Annotated[
    DriftFilterSettings | SwitchingFilterSettings | ImmFilterSettings, Field(discriminator="kind")
]


class GnssSettings(Settings):
    """Fixes of the INS that place the local frame on earth; the frame itself never jumps when a fix does."""

    noise: float = Field(1.0, gt=0, le=100, description="m, standard deviation of a fix, north and east each")
    gate: float = Field(16.0, gt=1, le=1e6, description="largest normalised innovation squared of a fix that is used")
    reacquire: float = Field(
        5.0, gt=0, le=600, description="s of nothing but refused fixes, after which the last of them is accepted"
    )
    hold: float = Field(60.0, gt=0, le=86_400, description="s after the last used fix until the place is unknown")
    filter: FixFilterSettings = Field(
        default_factory=DriftFilterSettings.defaults, description="what smooths the fixes"
    )
