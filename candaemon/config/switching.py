"""Switching between constant velocity and the current statistical model (Zhang et al. 2016), for ego and obstacles."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from candaemon.config.base import Settings

SteadyNoise = Annotated[
    float, Field(gt=0, le=100, description="(m/s²)²/Hz, power of the white noise of constant velocity")
]
ManoeuvreFrequency = Annotated[
    float, Field(gt=1e-4, le=60, description="1/s, manoeuvre frequency of the current statistical model")
]
AccelerationLimit = Annotated[
    float, Field(gt=0, le=100, description="m/s², largest acceleration; 1.25 × what is physical")
]
Interval = Annotated[float, Field(gt=0, le=60, description="s between two speeds that are compared")]
Threshold = Annotated[
    float,
    Field(
        gt=0, lt=1, description="Th1, change of speed over an interval, as a share of the speed, that is a manoeuvre …"
    ),
]
LeastChange = Annotated[float, Field(ge=0, le=10, description="m/s, … and never one below this")]
ManoeuvreTime = Annotated[float, Field(ge=0, le=600, description="s, T1, of change until the manoeuvre model is used")]
SteadyTime = Annotated[float, Field(ge=0, le=600, description="s, T2, without change until constant velocity is used")]


class SwitchingSettings(Settings):
    """The two models and when they change; the values suit the vehicle's own track, as in Zhang et al. 2016."""

    kind: Literal["switching"]
    noise: SteadyNoise = 0.5
    alpha: ManoeuvreFrequency = 0.05
    limit: AccelerationLimit = 3.0
    floor: float = Field(1.0, ge=0, le=100, description="(m/s²)², smallest variance of the acceleration")
    interval: Interval = 1.0
    threshold: Threshold = 0.05
    least_change: LeastChange = 0.1
    manoeuvre_time: ManoeuvreTime = 10.0
    steady_time: SteadyTime = 20.0
