"""Detects the events to be archived: chosen obstacles, and faults when they begin."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candaemon.binding.bound import Binding
from candaemon.daemon.observer import CompletedCycle, DaemonView
from candaemon.ego.pose import EgoStatus
from candaemon.recording.event_archive import Event


class EventDetector:
    """Detects when an event begins.

    A fault that goes on is one event, and so is one that comes and goes: only after it has been away for the configured
    time does it begin anew. What has not worked yet since the start does not fail.

    Args:
        binding: the configuration, with the events it asks for.
    """

    def __init__(self, binding: Binding) -> None:
        settings = binding.settings.service.recording.events
        self._asked = frozenset(settings.faults)
        self._chosen = np.array(settings.obstacles, np.int64)
        self._late = settings.late
        self._debounce_ns = round(settings.debounce * 1e9)
        self._least_trust = [sensor.settings.protection.least_trust for sensor in binding.sensors]
        self._sensors = [sensor.name for sensor in binding.sensors]
        self._silent_ns = [round(binding.lost_after(sensor) * 1e9) for sensor in binding.sensors]
        self._last_scan_ns: list[int | None] = [None] * len(binding.sensors)
        self._moved = False
        self._worked: set[str] = set()
        self._lost: dict[str, int] = {}
        self._lasting_ns: dict[tuple[str, str], int] = {}

    def go_on_from(self, former: EventDetector) -> None:
        """Take over what another one has seen: what lasts over a reload does not begin with it."""
        self._worked, self._lost, self._lasting_ns = former._worked, former._lost, former._lasting_ns

    def on_cycle(self, completed: CompletedCycle) -> Iterator[Event]:
        """Look at a cycle; yield what begins with it."""
        cycle = completed.cycle
        now_ns = cycle.time_ns
        if cycle.detections is not None:
            self._last_scan_ns[cycle.detections.sensor] = now_ns
        if len(self._chosen):
            for identity in cycle.obstacles.id[np.isin(cycle.obstacles.id, self._chosen)].tolist():
                yield from self._lasts("obstacle", str(identity), now_ns)
        for name, last_ns, silent_ns in zip(self._sensors, self._last_scan_ns, self._silent_ns, strict=True):
            if last_ns is not None and now_ns - last_ns > silent_ns:
                yield from self._fails("sensor", name, now_ns)
        valid = cycle.pose.status is EgoStatus.VALID
        self._moved |= valid
        if self._moved and not valid:
            yield from self._fails("motion", "", now_ns)
        if completed.seconds > self._late or completed.latency > self._late:
            yield from self._fails("late", "", now_ns)

    def on_iteration(self, daemon: DaemonView, now_ns: int) -> Iterator[Event]:
        """Look at the buses and the trust in the sensors; yield what begins.

        Args:
            daemon: to be looked at a few times a second.
            now_ns: time of the latest item.
        """
        for bus in daemon.buses:
            if bus.counts.lost > self._lost.get(bus.name, 0):
                yield from self._fails("lost", bus.name, now_ns)
            self._lost[bus.name] = bus.counts.lost
            if bus.state.up:
                self._worked.add(bus.name)
            elif bus.name in self._worked:
                yield from self._fails("bus", bus.name, now_ns)
        assemblers = daemon.pipeline.assemblers
        for name, assembler, least in zip(self._sensors, assemblers, self._least_trust, strict=True):
            if assembler.valid_share < least:
                yield from self._fails("trust", name, now_ns)

    def _fails(self, fault: str, about: str, now_ns: int) -> Iterator[Event]:
        """Yield a fault if it begins and is configured."""
        if fault in self._asked:
            yield from self._lasts(fault, about, now_ns)

    def _lasts(self, kind: str, about: str, now_ns: int) -> Iterator[Event]:
        """Yield what is there if it was not for long enough."""
        before_ns = self._lasting_ns.get((kind, about))
        self._lasting_ns[kind, about] = now_ns
        if before_ns is None or now_ns - before_ns > self._debounce_ns:
            yield Event(kind, about, now_ns)
