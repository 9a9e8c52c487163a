"""The health that the status message shows: sensors lost, frames dropped of late, ego motion unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from candaemon.binding.bound import Binding
from candaemon.ego.pose import EgoStatus
from candaemon.tracking.sensor_trust import Fault


class Health(IntEnum):
    """As on the wire. Degraded: ego motion is dead reckoning, or frames were dropped of late.

    In a fault obstacles are not to be relied on: without ego motion, or without any sensor.
    """

    OK = 0
    DEGRADED = 1
    SENSOR_LOST = 2
    FAULT = 3


@dataclass(slots=True)
class HealthState:
    """What health is judged by.

    Attributes:
        last_scan_ns: when each sensor's last scan was closed.
        drops: frames dropped in all, as of the last cycle.
        dropped_ns: the last cycle in which there were more of them.
    """

    last_scan_ns: list[int]
    drops: int
    dropped_ns: int


class HealthMonitor:
    """Judges the health in each cycle.

    Args:
        binding: the configuration.
    """

    def __init__(self, binding: Binding) -> None:
        self._hold_ns = round(binding.settings.supervision.worry * 1e9)
        self._lost_after_ns = [round(binding.lost_after(sensor) * 1e9) for sensor in binding.sensors]
        self._least_valid = [sensor.settings.protection.least_trust for sensor in binding.sensors]
        self._state = HealthState([0] * len(binding.sensors), 0, -self._hold_ns)

    @property
    def state(self) -> HealthState:
        """What it remembers.

        Raises:
            ValueError: a state that is set is of another number of sensors.
        """
        return self._state

    @state.setter
    def state(self, state: HealthState) -> None:
        if len(state.last_scan_ns) != len(self._lost_after_ns):
            raise ValueError(f"scans of {len(state.last_scan_ns)} sensors, expected {len(self._lost_after_ns)}")
        self._state = state

    def note_scan(self, sensor: int, now_ns: int) -> None:
        """Note that a sensor's scan was closed."""
        self._state.last_scan_ns[sensor] = now_ns

    def health(
        self, ego: EgoStatus, valid_shares: Sequence[float], faults: Sequence[Fault], drops: int, now_ns: int
    ) -> Health:
        """Return the health in a cycle.

        Args:
            ego: how reliable ego motion is.
            valid_shares: of each sensor's frames, those that could be used of late.
            faults: what is wrong with each sensor.
            drops: frames dropped in all.
            now_ns: time of the cycle.
        """
        state = self._state
        if drops > state.drops:
            state.drops, state.dropped_ns = drops, now_ns
        lost = [
            now_ns - last_ns > after_ns or share < least or fault.cuts_off
            for last_ns, after_ns, share, least, fault in zip(
                state.last_scan_ns, self._lost_after_ns, valid_shares, self._least_valid, faults, strict=True
            )
        ]
        if all(lost) or ego is EgoStatus.LOST:
            return Health.FAULT
        if any(lost):
            return Health.SENSOR_LOST
        degraded = ego is EgoStatus.DEAD_RECKONING or now_ns - state.dropped_ns < self._hold_ns
        return Health.DEGRADED if degraded else Health.OK
