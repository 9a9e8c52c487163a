"""The assembler that a sensor's configuration asks for."""

from __future__ import annotations

from candaemon.binding.bound import BoundSensor
from candaemon.config.sensors import CounterScan, HeaderScan, TimeoutScan, TriggerScan
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.counter_assembler import CounterAssembler
from candaemon.radar.header_assembler import HeaderAssembler
from candaemon.radar.scan import ScanCounts
from candaemon.radar.timeout_assembler import TimeoutAssembler
from candaemon.radar.trigger_assembler import TriggerAssembler


def make_assembler(sensor: BoundSensor, counts: ScanCounts | None = None) -> ScanAssembler:
    """Return the assembler that a sensor's configuration asks for.

    Args:
        sensor: the bound sensor.
        counts: where frames are counted; default: counts of its own.
    """
    match sensor.settings.scan:
        case CounterScan():
            return CounterAssembler(sensor, counts)
        case TriggerScan():
            return TriggerAssembler(sensor, counts)
        case HeaderScan():
            return HeaderAssembler(sensor, counts)
        case TimeoutScan():
            return TimeoutAssembler(sensor, counts)
