"""What the filters of tracks remember: all of it, as plain data.

Two filters of the same settings that are given the same state and the same measurements go on alike to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from candaemon.arrays import Floats
from candaemon.estimation.manoeuvre_detection import ManoeuvreState
from candaemon.estimation.sensor_noise import SensorNoiseState


@dataclass(slots=True)
class FilterBankState:
    """What every filter bank remembers of n tracks beside its estimates.

    Attributes:
        probability: weights of the M models, (n, M).
        mean_nis: normalised innovation squared per degree of freedom, averaged over the latest updates, (n, M).
        dt: s of the latest prediction.
        noise: estimates of the sensors' noise; None where it is as stated.
    """

    probability: Floats
    mean_nis: Floats
    dt: float
    noise: SensorNoiseState | None


@dataclass(slots=True)
class MomentBankState(FilterBankState):
    """State of a bank that keeps a mean and a covariance for each model.

    Attributes:
        mean: (n, M, D).
        covariance: (n, M, D, D).
    """

    mean: Floats
    covariance: Floats


@dataclass(slots=True)
class SwitchingTracksState(MomentBankState):
    """State of `SwitchingTracks`.

    Attributes:
        watch: the decision between the two models.
    """

    watch: ManoeuvreState


@dataclass(slots=True)
class FederatedTracksState(MomentBankState):
    """State of `FederatedTracks`.

    Attributes:
        sensors: numbers of the S sensors in the order of their first scans.
        stated: tr(R) of each sensor's first scan on average, (S,), m².
        trace: tr(R) of each track's latest detection by each sensor, (n, S), m².
    """

    sensors: list[int]
    stated: Floats
    trace: Floats


@dataclass(slots=True)
class RadialTracksState(MomentBankState):
    """State of `RadialTracks`.

    Attributes:
        line: unit vectors of the lines of sight of the latest updates, (n, 2); zero before a track's first.
    """

    line: Floats


@dataclass(slots=True)
class PlaneFilterState(FilterBankState):
    """State of a `PlaneFilter`.

    Attributes:
        columns: one column a track: mean, upper triangle of the covariance row by row, variances that drive x and y;
            (29, n).
    """

    columns: Floats


EstimatorState: TypeAlias = (
    MomentBankState | SwitchingTracksState | FederatedTracksState | RadialTracksState | PlaneFilterState
)
