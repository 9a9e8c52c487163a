"""The status snapshot as Prometheus's metric families.

Loaded only where the endpoint is configured: the library costs time to load.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import accumulate
from typing import TypeAlias

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from candaemon.calibration.report import Figures
from candaemon.printable import printable
from candaemon.status.collect import EGO_STATUS_NAMES
from candaemon.status.histogram import HistogramSnapshot
from candaemon.status.snapshot import BusStatus, Counts, SensorStatus, StatusSnapshot
from candaemon.tracking.sensor_trust import Fault

Labelled: TypeAlias = tuple[Sequence[str], float]
"""Values of the labels, and the metric's."""


class SnapshotCollector(Collector):
    """Gives a registry the metric families of one snapshot.

    Args:
        snapshot: of the moment.
    """

    def __init__(self, snapshot: StatusSnapshot) -> None:
        self._snapshot = snapshot

    def collect(self) -> Iterator[Metric]:
        """Yield each metric."""
        snapshot = self._snapshot
        yield from _of_process(snapshot)
        yield from _of_buses(snapshot.buses)
        yield from _of_sensors(snapshot.sensors)
        yield from _of_tracking(snapshot)
        yield _counter("candaemon_losses", "What was lost since the start", ("kind",), _by((), asdict(snapshot.losses)))
        yield _histogram(
            "candaemon_cycle_seconds", "From a scan's last frame taken to its obstacles sent", snapshot.cycle_time
        )
        yield _histogram(
            "candaemon_latency_seconds",
            "From that frame's time stamp to the first obstacle frame sent",
            snapshot.latency,
        )


_FAULTS = tuple(fault.name.lower() for fault in Fault)


def _of_process(snapshot: StatusSnapshot) -> Iterator[Metric]:
    service = snapshot.service
    about = {"version": service.version, "instance": service.instance, "name": service.name, "config": service.config}
    yield InfoMetricFamily(
        "candaemon", "Which service this is", {label: printable(text) for label, text in about.items()}
    )
    yield GaugeMetricFamily("process_start_time_seconds", "Start, since 1970", service.time - service.uptime)
    yield CounterMetricFamily("process_cpu_seconds", "Processor time, all threads", service.cpu)
    if service.memory is not None:
        yield GaugeMetricFamily("process_resident_memory_bytes", "Memory resident", service.memory)
    reloads = {"applied": service.reloads, "refused": service.refused}
    yield _counter("candaemon_reloads", "Configurations loaded again", ("result",), _by((), reloads))


def _of_buses(buses: Mapping[str, BusStatus]) -> Iterator[Metric]:
    def each(values: Callable[[BusStatus], Counts]) -> list[Labelled]:
        return [labelled for name, bus in buses.items() for labelled in _by((name,), values(bus))]

    up = [((name,), float(bus.up)) for name, bus in buses.items()]
    yield _gauge("candaemon_bus_up", "Whether the bus is open", ("bus",), up)
    yield _counter(
        "candaemon_frames", "Frames received and sent", ("bus", "direction"),
        each(lambda bus: {"received": bus.received, "sent": bus.sent}),
    )  # fmt: skip
    yield _counter("candaemon_frames_taken", "Frames by who took them", ("bus", "taker"), each(lambda bus: bus.taken))
    yield _counter(
        "candaemon_frames_dropped", "Frames lost or unusable", ("bus", "cause"), each(lambda bus: bus.dropped)
    )
    yield _counter("candaemon_frames_unsent", "Frames not sent", ("bus", "cause"), each(lambda bus: bus.unsent))
    yield _counter("candaemon_bus_events", "What else happened", ("bus", "event"), each(lambda bus: bus.events))


def _of_sensors(sensors: Mapping[str, SensorStatus]) -> Iterator[Metric]:
    def each(value: Callable[[SensorStatus], float | None]) -> list[Labelled]:
        found = [((name,), value(sensor)) for name, sensor in sensors.items()]
        return [(labels, number) for labels, number in found if number is not None]

    def counted(values: Callable[[SensorStatus], Counts]) -> list[Labelled]:
        return [labelled for name, sensor in sensors.items() for labelled in _by((name,), values(sensor))]

    of = ("sensor",)
    yield _counter(
        "candaemon_sensor_frames", "Frames by what became of them", (*of, "fate"), counted(lambda sensor: sensor.frames)
    )
    yield _counter(
        "candaemon_sensor_events", "What else is counted", (*of, "event"), counted(lambda sensor: sensor.counts)
    )
    yield _gauge("candaemon_sensor_lost", "Whether it is silent", of, each(lambda sensor: float(sensor.lost)))
    yield _gauge("candaemon_sensor_age_seconds", "Since its latest scan", of, each(lambda sensor: sensor.age))
    yield _gauge("candaemon_sensor_trust", "Share of late frames that are usable", of, each(lambda s: s.trust))
    faulty = [((name, fault), float(sensor.fault == fault)) for name, sensor in sensors.items() for fault in _FAULTS]
    yield _gauge("candaemon_sensor_fault", "1 at what is wrong with it", (*of, "fault"), faulty)
    yield _gauge("candaemon_sensor_weight", "Share of its stated information used", of, each(lambda s: s.weight))
    yield _counter("candaemon_sensor_noticed", "What was noticed", (*of, "event"), counted(lambda s: s.noticed))
    yield _gauge("candaemon_nis", "NIS of late over its freedom: 1 is expected", of, each(lambda s: s.nis.ratio))
    yield _counter("candaemon_nis_sum", "Sum of NIS", of, each(lambda s: s.nis.sum))
    yield _gauge(
        "candaemon_sensor_calibration", "Errors of what is configured, and what is applied: s, deg", (*of, "figure"),
        [each for name, sensor in sensors.items() for each in _figures((name,), sensor.calibration)],
    )  # fmt: skip
    yield _counter("candaemon_nis_freedom", "Sum of their degrees of freedom", of, each(lambda s: s.nis.freedom))


def _of_tracking(snapshot: StatusSnapshot) -> Iterator[Metric]:
    cycles, clock = snapshot.cycles, snapshot.clock
    yield _gauge("candaemon_tracks", "Obstacles by state", ("state",), _by((), snapshot.tracks))
    yield _counter("candaemon_tracking", "What the trackers did", ("event",), _by((), snapshot.tracking))
    motion = snapshot.own_motion
    status = [((name,), float(name == motion.status)) for name in EGO_STATUS_NAMES.values()]
    yield _gauge("candaemon_own_motion", "1 at how far it can be trusted", ("status",), status)
    yield _counter("candaemon_own_motion_events", "Its frames not used", ("event",), _by((), motion.counts))
    yield _counter("candaemon_own_motion_signals", "How often each came", ("signal",), _by((), motion.signals))
    yield _counter("candaemon_own_motion_samples", "Samples by what was derived", ("kind",), _by((), motion.samples))
    yield _gauge(
        "candaemon_own_motion_calibration", "What odometry reads wrongly", ("figure",), _figures((), motion.calibration)
    )
    yield CounterMetricFamily("candaemon_cycles", "Times that obstacles were told", cycles.told)
    yield CounterMetricFamily("candaemon_coasting_cycles", "Those of them with every sensor silent", cycles.coasting)
    yield CounterMetricFamily("candaemon_scans_without_ego", "Scans dropped for want of own motion", cycles.without_ego)
    yield CounterMetricFamily("candaemon_values_saturated", "Output values beyond their signal", cycles.saturated)
    steps = {"back": clock.backward_steps, "ahead": clock.forward_steps}
    yield _counter("candaemon_clock_steps", "Times that the clock was set", ("direction",), _by((), steps))
    for name, value in (snapshot.recording or {}).items():
        if not isinstance(value, str):
            yield GaugeMetricFamily(f"candaemon_recording_{name}", "What the recording counts", float(value))


def _figures(labels: Sequence[str], figures: Figures | None) -> list[Labelled]:
    """Return what is known of a calibration by its names, the name as the last label."""
    return [((*labels, name), float(value)) for name, value in (figures or {}).items() if value is not None]


def _by(labels: Sequence[str], counts: Counts) -> list[Labelled]:
    """Return counts by their names, the name as the last label."""
    return [((*labels, name), count) for name, count in counts.items()]


def _counter(name: str, about: str, labels: Sequence[str], values: Sequence[Labelled]) -> Metric:
    family = CounterMetricFamily(name, about, labels=labels)
    for given, value in values:
        family.add_metric([printable(each) for each in given], value)
    return family


def _gauge(name: str, about: str, labels: Sequence[str], values: Sequence[Labelled]) -> Metric:
    family = GaugeMetricFamily(name, about, labels=labels)
    for given, value in values:
        family.add_metric([printable(each) for each in given], value)
    return family


def _histogram(name: str, about: str, spread: HistogramSnapshot) -> Metric:
    bounds = [*map(str, spread.bounds), "+Inf"]
    return HistogramMetricFamily(name, about, list(zip(bounds, accumulate(spread.counts), strict=True)), spread.sum)
