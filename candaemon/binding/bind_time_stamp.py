"""The signal in which a sensor says when it measured, bound: of its header or trigger, its objects, or a message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from candaemon.binding.bind_signal import UNITS, normalised_unit
from candaemon.binding.location import SettingLocation
from candaemon.binding.look_up import check_alike, find_in_layouts, find_qualified, signal_of
from candaemon.config.sensors import TimeStampSettings
from candaemon.dbc.bits import value_count
from candaemon.dbc.single_codec import compile_decoder
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.objects.reader import ObjectReader
from candaemon.objects.scan_messages import TimeStampField

LONGEST_WRAP: Final = 4.3e9
"""s that a clock counts: 136 years, which ns of 62 bits hold."""


def bind_time_stamp(
    settings: TimeStampSettings,
    reader: ObjectReader,
    marks: Sequence[MessageSpec],
    database: Database,
    location: SettingLocation,
) -> TimeStampField:
    """Bind the time stamp of a sensor.

    Args:
        settings: from the configuration.
        reader: of the sensor's objects.
        marks: its headers, or its trigger.
        database: the DBC.
        location: place of the time stamp in the configuration.

    Raises:
        ConfigError: no message has the signal, it is no integer of every frame, or its unit is none of time.

    """
    place = location.at("signal")
    part, own = None, False
    message, signal = _of_a_mark(settings.signal, marks, reader)
    pattern = settings.signal.rpartition(".")[0]
    if message is None and pattern and pattern not in {layout.pattern for layout in reader.layouts}:
        message, signal = find_qualified(database, settings.signal, place)
        own = True
    if message is None or signal is None:
        layout, signal = find_in_layouts(reader.layouts, settings.signal, place)[0]
        check_alike(layout, [signal.name], location)
        message, part = layout.shortest, layout.index
    if own and message.can_id in reader.routes:
        raise place.error(f"'{message.name}' is one of the objects' messages; expected the signal's name alone")
    if signal.is_float or signal.multiplexer_signal is not None:
        raise place.error(f"signal '{signal.name}' is a float, or not in every frame of '{message.name}'")
    unit, factor = _unit(settings, signal, location)
    unit_ns = factor * 1e9
    wrap_ns = 0
    if settings.kind == "clock":
        wrap = settings.wrap or value_count(signal) * abs(signal.scale) * factor
        wrap_ns = round(min(wrap, LONGEST_WRAP) * 1e9)
        if wrap <= 2 * settings.longest:
            raise location.at("wrap").error(
                f"the clock '{signal.name}' begins anew after {wrap:g} s ({unit}), expected more than twice the "
                f"longest delay, {settings.longest:g} s"
            )
    return TimeStampField(message, signal, part, own, unit_ns, wrap_ns, compile_decoder(message, [signal.name]))


def _of_a_mark(
    name: str, marks: Sequence[MessageSpec], reader: ObjectReader
) -> tuple[MessageSpec | None, SignalSpec | None]:
    """Find a signal in the headers or the trigger, unless that is one of the objects' messages."""
    for mark in marks:
        signal = signal_of(mark, name)
        if signal is not None and mark.can_id not in reader.routes:
            return mark, signal
    return None, None


def _unit(settings: TimeStampSettings, signal: SignalSpec, location: SettingLocation) -> tuple[str, float]:
    """Return the signal's unit, and the s that it is.

    Raises:
        ConfigError: nothing names it, or it is none of time.

    """
    unit = settings.unit or signal.unit
    known = UNITS.get(normalised_unit(unit))
    if known is None or known[0] != "time":
        found = f"the unit '{unit}' in the DBC" if unit.strip() else "no unit in the DBC"
        raise location.at("signal").error(f"signal '{signal.name}' has {found}; give unit: s, ms, us or ns beside it")
    return unit, known[1]
