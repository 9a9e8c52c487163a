"""Takes the status snapshot from the counters of the daemon, the pipeline and the service monitor."""

from __future__ import annotations

import os
import time
from collections.abc import Hashable, Mapping
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from candaemon._version import __version__
from candaemon.binding.bound import BoundBus
from candaemon.calibration.report import ego_figures, sensor_figures
from candaemon.daemon.observer import DaemonView
from candaemon.ego.pose import EgoStatus
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.status.losses import EGO_UNUSABLE_CAUSES, LOSS_CAUSES, UNSENT_CAUSES, UNUSABLE_CAUSES, Losses
from candaemon.status.measurements import Measurements
from candaemon.status.snapshot import (
    BusStatus,
    ClockStatus,
    Counts,
    CycleStatus,
    EgoMotionStatus,
    SensorStatus,
    ServiceStatus,
    StatusSnapshot,
)
from candaemon.tracking.obstacles import STATE_NAMES

_PAGE = os.sysconf("SC_PAGE_SIZE")

EGO_STATUS_NAMES = {status: status.name.lower().replace("_", " ") for status in EgoStatus}
"""Words for how far ego motion can be trusted."""

CYCLES = "cycles"
"""Key of the counter of cycles; those of buses and sensors are (kind, name)."""


def take_snapshot(
    daemon: DaemonView,
    measured: Measurements,
    now_s: float,
    losses: Losses,
    recording: Mapping[str, int | float | str | bool] | None,
) -> StatusSnapshot:
    """Return the status snapshot.

    Args:
        daemon: between two iterations of its loop.
        measured: measurements that no counter of the daemon holds.
        now_s: monotonic seconds.
        losses: all there were.
        recording: what the recording counts, None where nothing is recorded.
    """
    pipeline = daemon.pipeline
    rates = measured.rates.of(now_s, rate_counters(daemon))
    tracked = [asdict(tracker.counts) for tracker in pipeline.trackers]
    return StatusSnapshot(
        service=_service(pipeline, measured, now_s),
        own_motion=_own_motion(pipeline, daemon.last),
        tracks=_tracks(daemon.last),
        tracking={key: sum(each[key] for each in tracked) for key in tracked[0]},
        cycles=_cycles(pipeline, rates[CYCLES]),
        cycle_time=measured.cycle_time.spread(),
        latency=measured.latency.spread(),
        clock=ClockStatus(
            backward_steps=daemon.sequence.backward_steps,
            forward_steps=daemon.sequence.forward_steps,
            offset=daemon.sequence.offset_ns * 1e-9,
            late=daemon.sequence.late,
            reordered=daemon.sequence.reordered,
        ),
        buses={bus.name: _bus(daemon, bus, rates["bus", bus.name]) for bus in pipeline.binding.buses},
        sensors=_sensors(pipeline, measured, rates),
        losses=losses,
        recording=recording,
    )


def rate_counters(daemon: DaemonView) -> dict[Hashable, int]:
    """Return the counters whose rates are reported: of cycles, each bus's frames and each sensor's scans."""
    pipeline = daemon.pipeline
    return {
        CYCLES: pipeline.counts.cycles,
        **{("bus", bus.name): daemon.buses[bus.index].counts.received for bus in pipeline.binding.buses},
        **{
            ("sensor", sensor.name): assembler.counts.scans
            for sensor, assembler in zip(pipeline.binding.sensors, pipeline.assemblers, strict=True)
        },
    }


def _service(pipeline: Pipeline, measured: Measurements, now_s: float) -> ServiceStatus:
    loaded = pipeline.binding.loaded
    return ServiceStatus(
        name=loaded.config.name or loaded.path.stem,
        instance=loaded.path.stem,
        config=str(loaded.path),
        version=__version__,
        pid=os.getpid(),
        time=time.time(),
        uptime=now_s - measured.started_s,
        cpu=time.process_time(),
        memory=_memory(),
        reloads=measured.reloads,
        refused=measured.refused,
        reload_error=measured.reload_error,
    )


def _memory() -> int | None:
    """Return the bytes that the process has resident; None where /proc is not there or hidden."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except OSError:
        return None


def _own_motion(pipeline: Pipeline, last: Cycle | None) -> EgoMotionStatus:
    counts = {"short": pipeline.counts.ego_motion_short} | asdict(pipeline.counts.ego_motion)
    status = "unknown" if last is None else EGO_STATUS_NAMES[last.pose.status]
    calibration = ego_figures(pipeline.calibrator)
    return EgoMotionStatus(status, counts, pipeline.ego_signals, asdict(pipeline.ego.counts), calibration)


def _tracks(last: Cycle | None) -> Counts:
    """Count the latest cycle's obstacles by state."""
    if last is None:
        return dict.fromkeys(STATE_NAMES, 0)
    counted = np.bincount(last.obstacles.state, minlength=len(STATE_NAMES))
    return dict(zip(STATE_NAMES, counted.tolist(), strict=True))


def _cycles(pipeline: Pipeline, rate: float) -> CycleStatus:
    counts = pipeline.counts
    return CycleStatus(
        told=counts.cycles,
        coasting=counts.coasting_cycles,
        without_ego=counts.without_ego,
        rate=rate,
        frames=counts.sent,
        saturated=pipeline.saturated,
    )


def _bus(daemon: DaemonView, bus: BoundBus, rate: float) -> BusStatus:
    pipeline, live = daemon.pipeline, daemon.buses[bus.index]
    counts, taken = asdict(live.counts), pipeline.counts.buses[bus.index]
    return BusStatus(
        up=live.state.up,
        controller=live.state.controller,
        error=live.state.error,
        rate=rate,
        received=live.counts.received,
        sent=live.counts.sent,
        taken={"used": taken.used, "spare": taken.spare, "unknown": taken.unknown},
        dropped={cause: counts[cause] for cause in LOSS_CAUSES} | _unusable(pipeline, bus.index),
        unsent={cause: counts[cause] for cause in UNSENT_CAUSES},
        events={
            name: count
            for name, count in counts.items()
            if name not in {"received", "sent", *LOSS_CAUSES, *UNSENT_CAUSES}
        },
    )


def _unusable(pipeline: Pipeline, bus: int) -> dict[str, int]:
    """Return the frames of a bus that sensors and ego motion could not use, each under one cause."""
    binding, counts = pipeline.binding, pipeline.counts
    found = dict.fromkeys((*UNUSABLE_CAUSES, *EGO_UNUSABLE_CAUSES), 0)
    found["short"] += counts.buses[bus].short
    for sensor, assembler in zip(binding.sensors, pipeline.assemblers, strict=True):
        if sensor.bus == bus:
            for cause in UNUSABLE_CAUSES:
                found[cause] += getattr(assembler.counts, cause)
    if binding.ego is not None and binding.ego.bus == bus:
        for cause in EGO_UNUSABLE_CAUSES:
            found[cause] += getattr(counts.ego_motion, cause)
    return found


def _sensors(pipeline: Pipeline, measured: Measurements, rates: Mapping[Hashable, float]) -> dict[str, SensorStatus]:
    binding = pipeline.binding
    statuses = {}
    for sensor, assembler in zip(binding.sensors, pipeline.assemblers, strict=True):
        watch = measured.sensors[sensor.name]
        age = None if watch.last_ns is None else (measured.now_ns - watch.last_ns) * 1e-9
        statuses[sensor.name] = SensorStatus(
            bus=binding.buses[sensor.bus].name,
            rate=rates["sensor", sensor.name],
            age=age,
            lost=age is None or age > binding.lost_after(sensor),
            trust=assembler.valid_share,
            frames={name: getattr(assembler.counts, name) for name in ("used", *UNUSABLE_CAUSES)},
            counts={
                each.name: getattr(assembler.counts, each.name)
                for each in fields(assembler.counts)
                if each.name not in {"used", *UNUSABLE_CAUSES}
            },
            nis=watch.nis.status(),
            calibration=sensor_figures(pipeline.calibrator, sensor.index),
            fault=pipeline.trust.fault(sensor.index).name.lower(),
            weight=pipeline.trust.weight(sensor.index),
            noticed=asdict(pipeline.trust.counts(sensor.index)),
        )
    return statuses
