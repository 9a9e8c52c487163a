"""What does not fit together across the parts of a configuration."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from itertools import chain

from candaemon.binding.bound import BoundEgo, BoundOutput, BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.dbc.bits import representable_values
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED


def check_identifiers(
    location: SettingLocation,
    ego: BoundEgo | None,
    sensors: Iterable[BoundSensor],
    output: BoundOutput | None,
    on_output_bus: Iterable[Database],
) -> list[ConfigError]:
    """Find identifiers with two owners on a bus, and output identifiers that another message of the bus has.

    Args:
        location: the configuration's root.
        ego: ego motion.
        sensors: the sensors.
        output: the output.
        on_output_bus: the DBC files that the output's bus itself names.

    """
    sensors = list(sensors)
    owners: dict[tuple[int, int], str] = {}
    errors: list[ConfigError] = []
    if ego is not None:
        owners.update(((ego.bus, can_id), "ego") for can_id in ego.messages)
    for sensor in sensors:
        owned = [
            (i, owners[sensor.bus, i])
            for i in sorted(sensor.can_ids)
            if (sensor.bus, i) in owners and not _shares(sensor, i, sensors)
        ]
        if owned:
            bus, alike = sensor.settings.bus, any(_is_alike(sensor, each) for each in sensors)
            cure = "; where it is another device of the same kind, give its id_offset" if alike else ""
            errors.append(location.at("sensors", sensor.name).error(f"on bus '{bus}' {_owned(owned)}{cure}"))
        owners.update(((sensor.bus, can_id), f"sensor '{sensor.name}'") for can_id in sensor.can_ids)
    if output is not None:
        known = {(output.bus, can_id): name for can_id, name in _others(ego, sensors, output, on_output_bus)}
        known.update(owners)
        owned = [(i, known[output.bus, i]) for i in sorted(output.can_ids) if (output.bus, i) in known]
        if owned:
            errors.append(location.at("output").error(f"on bus '{output.settings.bus}' {_owned(owned)}"))
    return errors


def misplaced_identifiers(can_ids: Iterable[int], offset: int) -> list[int]:
    """Return those of a DBC's identifiers, in order, that an `id_offset` leads beyond what identifiers can be."""
    return [can_id for can_id in sorted(can_ids) if not 0 <= (can_id & ~EXTENDED) + offset <= _most(can_id)]


def misplaced_error(message: MessageSpec, offset: int, location: SettingLocation) -> ConfigError:
    """Return the error for a message that an `id_offset` leads beyond what identifiers can be.

    Args:
        message: as the DBC has it.
        offset: the `id_offset`.
        location: its place.
    """
    most = _most(message.can_id)
    identifier = f"0x{message.can_id & ~EXTENDED:X} of '{message.name}'"
    return location.error(
        f"found {offset:#x}, with which {identifier} is no identifier any more; they go up to 0x{most:X}"
    )


def _most(can_id: int) -> int:
    """Return the largest identifier of the same length."""
    return 0x1FFF_FFFF if can_id & EXTENDED else 0x7FF


def _is_alike(sensor: BoundSensor, other: BoundSensor) -> bool:
    """Return whether two sensors on a bus are of one kind, as far as DBC and offset say."""
    return (
        sensor is not other
        and sensor.bus == other.bus
        and sensor.database.path == other.database.path
        and sensor.settings.id_offset == other.settings.id_offset
    )


def _shares(sensor: BoundSensor, can_id: int, sensors: Iterable[BoundSensor]) -> bool:
    """Return whether a value in each frame of an id says which of the sensors on the bus it is of."""
    claims = [each.claimed_values(can_id) for each in sensors if each.bus == sensor.bus and can_id in each.can_ids]
    values = [value for of_sensor in claims for value in of_sensor]
    return all(claims) and len(set(values)) == len(values)


def _owned(owned: list[tuple[int, str]]) -> str:
    (can_id, owner), *others = owned
    more = f" (and {len(others)} more)" if others else ""
    return f"id 0x{can_id & 0x1FFFFFFF:X}{more} belongs to {owner} already; expected ids of its own, or another bus"


def _others(
    ego: BoundEgo | None, sensors: Iterable[BoundSensor], output: BoundOutput, on_output_bus: Iterable[Database]
) -> Iterator[tuple[int, str]]:
    """Yield every message that the DBC files of the output's bus know, bar the output's own.

    A DBC of which both read and send is no stranger, unless the identifiers of those who read are others.
    """
    own = {output.database.by_id[can_id].name for can_id in output.can_ids}
    read = [(sensor.database, sensor.settings.id_offset) for sensor in sensors if sensor.bus == output.bus]
    if ego is not None and ego.bus == output.bus:
        read.append((ego.database, 0))
    for database, offset in read:
        if database.path != output.database.path or offset:
            yield from _messages(database, ())
    for database in on_output_bus:
        if database.path != output.database.path:
            yield from _messages(database, own)  # the file of a whole bus may well list what we send


def _messages(database: Database, bar: Collection[str]) -> Iterator[tuple[int, str]]:
    """Yield the identifiers of a DBC and whose they are, bar the messages of some names."""
    for can_id, message in database.by_id.items():
        if message.name not in bar:
            yield can_id, f"message '{message.name}' of '{database.path.name}'"


def range_warnings(ego: BoundEgo | None, sensors: Iterable[BoundSensor], output: BoundOutput | None) -> list[str]:
    """Warn of bound signals whose range in the DBC their bits cannot reach."""
    bound: list[tuple[MessageSpec, SignalSpec]] = []
    for sensor in sensors:
        bound += [
            (layout.shortest, binding.signal)
            for layout in sensor.reader.layouts
            for binding in sensor.reader.bindings
            if binding.signal in layout.shortest.signals
        ]
    if ego is not None:
        bound += [(each.message, binding.signal) for each in ego.messages.values() for binding in each.bindings]
    if output is not None:
        for layout in output.writer.layouts:
            bound += [(layout.shortest, signal) for signal in layout.shortest.signals]
    return [text for message, signal in dict.fromkeys(bound) for text in _range_warning(message, signal)]


def multiplexed_warnings(sensors: Iterable[BoundSensor]) -> list[str]:
    """Warn of an object's signals that only some of its frames carry: the objects of all others are not used."""
    found = []
    for layout, signal in chain.from_iterable(sensor.reader.required for sensor in sensors):
        selector = None if layout.selector is None else layout.selector[0].name
        if signal.multiplexer_signal not in {None, selector}:
            ids = sorted(signal.multiplexer_ids)
            values = ", ".join(map(str, ids))
            found.append(
                f"{_named(layout.shortest, signal)} is there only where {signal.multiplexer_signal} is {values}; "
                "objects of other frames are not used, and count as not_finite; where such frames are parts of one "
                f"object, give objects.messages an entry for each: when: {{{signal.multiplexer_signal}: {ids[0]}}}"
            )
    return found


def _range_warning(message: MessageSpec, signal: SignalSpec) -> Iterator[str]:
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or low == high or signal.is_float:
        return
    ends = representable_values(signal)
    step = abs(signal.scale)
    if low < ends[0] - step or high > ends[1] + step:
        yield (
            f"{_named(message, signal)} has the range [{low:g}|{high:g}] in the DBC "
            f"but its {signal.length} bits reach from {ends[0]:g} to {ends[1]:g}"
        )


def _named(message: MessageSpec, signal: SignalSpec) -> str:
    """Return what a warning calls a signal, after its place in the DBC."""
    place = "" if message.file is None else f"{message.file}:{signal.line or message.line}: "
    return f"{place}signal '{signal.name}' of '{message.name}'"
