"""A sensor, bound: the reader of its objects, what closes its scans, what its frames are checked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from candaemon.binding.bind_protection import bind_frame_monitor, bind_frame_monitors
from candaemon.binding.bind_reader import bind_reader
from candaemon.binding.bind_scan_messages import bind_headers
from candaemon.binding.bind_time_stamp import bind_time_stamp
from candaemon.binding.bind_writer import bind_writer
from candaemon.binding.bound import BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.binding.look_up import check_alike, find_in_layouts, find_message, find_signal, signal_of
from candaemon.binding.numbered_names import numbered_names, valued_view
from candaemon.config.base import SignalRef
from candaemon.config.sensors import CounterScan, HeaderScan, LookSettings, ObjectSignals, SensorSettings, TriggerScan
from candaemon.dbc.bits import sendable_values
from candaemon.dbc.single_codec import compile_field_reader
from candaemon.dbc.types import Database, MessageSpec
from candaemon.objects.reader import Claim, ObjectReader
from candaemon.objects.scan_messages import LookReader, ScanHeader
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
    reader = bind_reader(
        settings.objects,
        _quantities(settings.signals),
        database,
        location,
        units=settings.units,
        names=numbered_names(settings),
    )
    scan, place = settings.scan, location.at("scan")
    can_ids = set(reader.routes)
    counters: list[Callable[[bytes], int]] = []
    trigger: MessageSpec | None = None
    headers: tuple[ScanHeader, ...] = ()
    mark_monitor: FrameMonitorSettings | None = None
    if isinstance(scan, CounterScan):
        counters = [
            compile_field_reader(message, find_signal(message, scan.signal, place.at("signal")))
            for message in (layout.shortest for layout in reader.layouts)
        ]
    elif isinstance(scan, TriggerScan):
        trigger = find_message(database, scan.message, place.at("message"))
        for name, value in scan.when.items():
            trigger = valued_view(trigger, name, value)
        can_ids.add(trigger.can_id)
        if trigger.can_id in reader.claims and not scan.when:
            raise place.at("message").error(
                f"frames of '{trigger.name}' are of several messages (by 'when'), so none of them ends a scan; "
                "expected another message, or another way to close a scan"
            )
        if trigger.can_id in reader.routes and settings.objects.pages is not None and not scan.when:
            raise place.at("message").error(
                f"'{trigger.name}' comes with each page of a scan, so it ends none; expected a message beside the "
                "objects', or another way to close a scan"
            )
        if trigger.can_id not in reader.routes or scan.when:
            mark_monitor = bind_frame_monitor(
                [trigger], scan.protection, place.at("protection"), cycle_time=settings.cycle_time
            )
    elif isinstance(scan, HeaderScan):
        headers = bind_headers(scan, database, place, None if settings.looks is None else settings.looks.signal)
        can_ids.update(header.can_id for header in headers)
        mark_monitor = bind_frame_monitor(
            [header.message for header in headers],
            scan.protection,
            place.at("protection"),
            cycle_time=settings.cycle_time,
        )
        if mark_monitor is not None and len(headers) > 1:
            raise place.at("protection").error("only a single header can be protected; leave it out for several")
    mark_claims: dict[int, Claim] = {}
    if isinstance(scan, TriggerScan | HeaderScan) and scan.when:
        marks = [header.message for header in headers] + ([] if trigger is None else [trigger])
        mark_claims = {mark.can_id: _mark_claim(mark, scan.when, reader, place) for mark in marks}
    stamp = None
    if settings.time_stamp is not None:
        marks = [header.message for header in headers] + ([] if trigger is None else [trigger])
        stamp = bind_time_stamp(settings.time_stamp, reader, marks, database, location.at("time_stamp"))
        can_ids.add(stamp.message.can_id)
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
        headers,
        bind_frame_monitors(reader, settings, location),
        mark_monitor,
        _bind_look(settings.looks, reader, _marks(headers, trigger, settings.looks), location.at("looks")),
        stamp,
        mark_claims,
    )


def _mark_claim(mark: MessageSpec, when: Mapping[str, int], reader: ObjectReader, location: SettingLocation) -> Claim:
    """Bind the value by which a frame is a header or trigger.

    Raises:
        ConfigError: the message has no such signal, it cannot have the value, or objects' messages of the same
            identifier have that value too, or none.

    """
    ((name, value),) = when.items()
    place = location.at("when", name)
    signal = find_signal(mark, name, place)
    low, high = sendable_values(signal)
    if not low <= value <= high:
        raise place.error(f"'{name}' cannot be {value}, it holds {low:g} to {high:g}")
    claims = reader.claims.get(mark.can_id, ())
    if mark.can_id in reader.routes and (not claims or any(claim.value == value for claim in claims)):
        raise place.error(f"frames of '{mark.name}' are the objects' too; give their messages another value by 'when'")
    return Claim(mark.length, compile_field_reader(mark, signal), value, 0, 0)


def _marks(
    headers: Sequence[ScanHeader], trigger: MessageSpec | None, looks: LookSettings | None
) -> MessageSpec | None:
    """Return the message beside the objects' that may say the look: the header that does, or the trigger."""
    return next((each.message for each in headers if looks is not None and each.says_look), trigger)


def _bind_look(
    looks: LookSettings | None, reader: ObjectReader, mark: MessageSpec | None, location: SettingLocation
) -> LookReader | None:
    """Bind the signal that says which look a scan is: of its header or trigger, or of the objects' messages.

    Raises:
        ConfigError: no such signal, or it cannot have a configured look's value.

    """
    if looks is None:
        return None
    name, place = looks.signal, location.at("signal")
    if mark is not None and mark.can_id in reader.routes:
        mark = None
    signal = None if mark is None else signal_of(mark, name)
    if mark is not None and signal is not None:
        found = LookReader(None, signal.name, compile_field_reader(mark, signal))
    else:
        layout, signal = find_in_layouts(reader.layouts, name, place)[0]
        check_alike(layout, [signal.name], location)
        found = LookReader(layout.index, signal.name, compile_field_reader(layout.shortest, signal))
    low, high = sendable_values(signal)
    for look in looks.fields_of_view:
        if not low <= int(look) <= high:
            raise location.at("fields_of_view", look).error(
                f"look {look} cannot be, signal '{signal.name}' holds {low:g} to {high:g}"
            )
    return found


def bind_sensor_writer(
    sensor: BoundSensor, location: SettingLocation | None = None, look: int | None = None
) -> ObjectWriter:
    """Bind the writer of a sensor's own frames, as the simulation needs it.

    Args:
        sensor: the bound sensor.
        location: its place in the configuration.
        look: which of its looks the objects are written for, where their messages say it; default: the first.

    Raises:
        ConfigError: a slot cannot be written as configured.

    """
    settings, form = sensor.settings, sensor.settings.objects
    if settings.looks is not None and sensor.look is not None and sensor.look.part is not None:
        says = {settings.looks.signal: next(iter(settings.views)) if look is None else look}
        form = form.model_copy(update={"fixed": {**form.fixed, **says}, "empty": {**form.empty, **says}})
    counters = [settings.scan.signal] if isinstance(settings.scan, CounterScan) else []
    return bind_writer(
        form,
        _quantities(settings.signals),
        sensor.database,
        settings.protection,
        counters=counters,
        location=location,
        units=settings.units,
        names=numbered_names(settings),
    )


def _quantities(signals: ObjectSignals) -> dict[str, SignalRef]:
    """List the quantities that a sensor measures, with their signals."""
    found = {name: getattr(signals, name) for name in type(signals).model_fields}
    return {name: ref for name, ref in found.items() if ref is not None}
