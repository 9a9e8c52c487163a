"""A sensor, bound: the reader of its objects, what closes its scans, what its frames are checked for."""

from __future__ import annotations

from collections.abc import Callable

from candaemon.binding.bind_protection import bind_frame_monitor, bind_frame_monitors
from candaemon.binding.bind_reader import bind_reader
from candaemon.binding.bind_scan_messages import bind_header
from candaemon.binding.bind_writer import bind_writer
from candaemon.binding.bound import BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.binding.look_up import find_message, find_signal
from candaemon.config.base import SignalRef
from candaemon.config.sensors import CounterScan, HeaderScan, ObjectSignals, SensorSettings, TriggerScan
from candaemon.dbc.single_codec import compile_field_reader
from candaemon.dbc.types import Database, MessageSpec
from candaemon.objects.scan_messages import ScanHeader
from candaemon.objects.writer import ObjectWriter
from candaemon.protection.monitor import FrameMonitorSettings


def bind_sensor(
    settings: SensorSettings, index: int, name: str, bus: int, database: Database, location: SettingLocation
) -> BoundSensor:
    """Bind a sensor to its DBC.

    Args:
        settings: from the configuration.
        index: position in the configuration.
        name: as configured.
        bus: index of the bus.
        database: the DBC.
        location: the sensor's place in the configuration.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """
    reader = bind_reader(settings.objects, _quantities(settings.signals), database, location)
    scan, place = settings.scan, location.at("scan")
    can_ids = set(reader.routes)
    counters: list[Callable[[bytes], int]] = []
    trigger: MessageSpec | None = None
    header: ScanHeader | None = None
    mark_monitor: FrameMonitorSettings | None = None
    if isinstance(scan, CounterScan):
        counters = [
            compile_field_reader(message, find_signal(message, scan.signal, place.at("signal")))
            for message in (layout.shortest for layout in reader.layouts)
        ]
    elif isinstance(scan, TriggerScan):
        trigger = find_message(database, scan.message, place.at("message"))
        can_ids.add(trigger.can_id)
        if trigger.can_id not in reader.routes:
            mark_monitor = bind_frame_monitor(
                [trigger], scan.protection, place.at("protection"), cycle_time=settings.cycle_time
            )
    elif isinstance(scan, HeaderScan):
        header = bind_header(scan, database, place)
        can_ids.add(header.can_id)
        mark_monitor = bind_frame_monitor(
            [header.message], scan.protection, place.at("protection"), cycle_time=settings.cycle_time
        )
    return BoundSensor(
        index,
        name,
        settings,
        bus,
        database,
        reader,
        frozenset(can_ids),
        tuple(counters),
        trigger,
        header,
        bind_frame_monitors(reader, settings, location),
        mark_monitor,
    )


def bind_sensor_writer(sensor: BoundSensor, location: SettingLocation | None = None) -> ObjectWriter:
    """Bind the writer of a sensor's own frames, as the simulation needs it.

    Args:
        sensor: the bound sensor.
        location: its place in the configuration.

    Raises:
        ConfigError: a slot cannot be written as configured.

    """
    settings = sensor.settings
    counters = [settings.scan.signal] if isinstance(settings.scan, CounterScan) else []
    return bind_writer(
        settings.objects,
        _quantities(settings.signals),
        sensor.database,
        settings.protection,
        counters=counters,
        location=location,
    )


def _quantities(signals: ObjectSignals) -> dict[str, SignalRef]:
    """List the quantities that a sensor measures, with their signals."""
    found = {name: getattr(signals, name) for name in type(signals).model_fields}
    return {name: ref for name, ref in found.items() if ref is not None}
