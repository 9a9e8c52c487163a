"""Status snapshot of a running service: its counts, timings and states at one instant.

`StatusSnapshot.tree` is what `candaemon status --json` prints and the status socket sends. Its keys are the attributes'
names; they are stable: keys may be added, none changes its meaning. What there is none of is null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any, TypeAlias

from candaemon.calibration.report import Figures
from candaemon.status.histogram import HistogramSnapshot
from candaemon.status.losses import Losses

Counts: TypeAlias = Mapping[str, int]

QUANTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99}


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """The process and its configuration.

    Attributes:
        name: of the configuration, or the instance's where it has none.
        instance: stem of the configuration's file: NAME of candaemon@NAME.
        config: the file.
        version: of candaemon.
        pid: of the process.
        time: when the snapshot was taken, s since 1970.
        uptime: s since the buses were opened.
        cpu: s of processor time used so far, all threads.
        memory: bytes resident; None where the system does not say.
        reloads: times that the configuration was loaded again and took its place.
        refused: times that it was refused.
        reload_error: why it was refused last; empty once one took its place.
    """

    name: str
    instance: str
    config: str
    version: str
    pid: int
    time: float
    uptime: float
    cpu: float
    memory: int | None
    reloads: int
    refused: int
    reload_error: str


@dataclass(frozen=True, slots=True)
class BusStatus:
    """A bus.

    Attributes:
        up: whether it is open.
        controller: what its controller says: active, warning, passive, bus-off.
        error: why it is not open; empty where it is.
        rate: frames/s received of late.
        received: frames taken from it.
        sent: frames sent.
        taken: frames by their receiver: `used` by sensors and ego motion, `spare` known but not asked for, `unknown`.
        dropped: frames lost or unusable, by cause.
        unsent: frames not sent, by cause.
        events: what else happened on it: reconnections, error frames, bus-off …
    """

    up: bool
    controller: str
    error: str
    rate: float
    received: int
    sent: int
    taken: Counts
    dropped: Counts
    unsent: Counts
    events: Counts


@dataclass(frozen=True, slots=True)
class EgoMotionStatus:
    """Ego motion.

    Attributes:
        status: how far it can be trusted: lost, dead reckoning, valid …; `unknown` before the first cycle.
        counts: its frames that were not used, and what else is counted of it, by name.
        signals: how often each of its signals came.
        samples: all of them, and in how many of them what was derived.
        calibration: what odometry reads wrongly, as `candaemon.calibration.report.ego_figures`; None without odometry.
    """

    status: str
    counts: Counts
    signals: Counts
    samples: Counts
    calibration: Figures | None = None


@dataclass(frozen=True, slots=True)
class NisStatus:
    """Normalised innovations squared of a sensor: how far its detections lie from where they were expected.

    Attributes:
        samples: detections of tracks that were known already.
        sum: of their NIS.
        freedom: sum of their degrees of freedom, which is what the sum of NIS is expected to be.
        ratio: NIS of late over its degrees of freedom: 1 is expected, more says that noise is set too low or the
            mounting is wrong; None before the first.
    """

    samples: int
    sum: float
    freedom: int
    ratio: float | None


@dataclass(frozen=True, slots=True)
class SensorStatus:
    """A sensor.

    Attributes:
        bus: its bus.
        rate: scans/s of late.
        age: s since its latest scan, in the clock of the frames; None before the first.
        lost: whether it has missed so many cycles that it is reported as lost.
        trust: from 0 to 1, share of its late frames that could be used.
        frames: frames by what became of them.
        counts: what else is counted of it: scans, frames missing, objects rejected …
        nis: how its detections fit the tracks.
        calibration: what is estimated of it, as `candaemon.calibration.report.sensor_figures`; None where nothing is.
        fault: what is wrong with it: none, silent, frozen, biased, noisy.
        weight: from 0 to 1, share of its stated information with which its detections are used.
        noticed: how often it was found silent, frozen, biased, noisy and all right again; its scans `cut_off` and
            `weighted_down`.
    """

    bus: str
    rate: float
    age: float | None
    lost: bool
    trust: float
    frames: Counts
    counts: Counts
    nis: NisStatus
    fault: str
    weight: float
    noticed: Counts
    calibration: Figures | None = None


@dataclass(frozen=True, slots=True)
class CycleStatus:
    """The cycles.

    Attributes:
        told: times that obstacles were reported.
        coasting: those of them without a scan, because every sensor was silent.
        without_ego: scans dropped because ego motion was not known yet.
        rate: cycles/s of late.
        frames: frames made for the output bus.
        saturated: output values that had to be brought into their signal's range.
    """

    told: int
    coasting: int
    without_ego: int
    rate: float
    frames: int
    saturated: int


@dataclass(frozen=True, slots=True)
class ClockStatus:
    """Time.

    Attributes:
        backward_steps: times that the clock was set back.
        forward_steps: times that it was set forward.
        offset: what is added to time stamps for it, s.
        late: frames whose time was raised because they came late.
        reordered: frames sorted into an earlier place.
    """

    backward_steps: int
    forward_steps: int
    offset: float
    late: int
    reordered: int


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """The whole status of a service.

    Attributes:
        service: the process and its configuration.
        own_motion: how far it can be trusted.
        tracks: obstacles at this instant by state.
        tracking: what the trackers did, all groups together.
        cycles: how many.
        cycle_time: from a scan's last frame being taken to its obstacles being handed to the bus.
        latency: from that frame's time stamp to the first obstacle frame being handed to the bus.
        clock: steps.
        buses: by name.
        sensors: by name.
        losses: all that was lost since the start, over all buses and sensors.
        recording: what the recording counts; None where nothing is recorded.
    """

    service: ServiceStatus
    own_motion: EgoMotionStatus
    tracks: Counts
    tracking: Counts
    cycles: CycleStatus
    cycle_time: HistogramSnapshot
    latency: HistogramSnapshot
    clock: ClockStatus
    buses: Mapping[str, BusStatus]
    sensors: Mapping[str, SensorStatus]
    losses: Losses
    recording: Mapping[str, int | float | str | bool] | None

    def tree(self) -> dict[str, Any]:
        """Return all as mappings, lists and plain values, ready for JSON; the spreads with count and quantiles."""
        tree = asdict(self)
        for key, spread in (("cycle_time", self.cycle_time), ("latency", self.latency)):
            tree[key]["count"] = spread.count
            tree[key] |= {name: spread.quantile(share) for name, share in QUANTILES.items()}
        return {key: _finite(value) for key, value in tree.items()}


def _finite(value: Any) -> Any:
    """Return a tree with null for every number that is none: JSON knows no NaN."""
    match value:
        case dict():
            return {key: _finite(each) for key, each in value.items()}
        case float() if not isfinite(value):
            return None
        case _:
            return value
