"""Ego motion, bound: which message carries which quantity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from candaemon.binding.bind_protection import bind_frame_monitor
from candaemon.binding.bind_signal import assumes_speed, bind_signal
from candaemon.binding.bound import BoundEgo, EgoMessage
from candaemon.binding.compile_condition import compile_condition
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import find_message, find_qualified
from candaemon.config.base import Condition, SignalRef
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.config.protection import InputProtectionSettings
from candaemon.dbc.single_codec import compile_decoder
from candaemon.dbc.types import Database, MessageSpec
from candaemon.errors import ConfigError
from candaemon.objects.signals import SignalBinding
from candaemon.protection.monitor import FrameMonitorSettings


def bind_ego(
    settings: InsSettings | OdometrySettings, bus: int, database: Database, location: SettingLocation
) -> BoundEgo:
    """Bind the signals of ego motion.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """
    errors: list[ConfigError] = []
    found: dict[int, tuple[MessageSpec, list[SignalBinding]]] = {}
    for quantity, ref, place in _signals(settings, location.at("signals")):
        with collected(errors):
            message, signal = find_qualified(database, ref.signal, place)
            binding = bind_signal(quantity, ref, signal, place, settings.units)
            found.setdefault(message.can_id, (message, []))[1].append(binding)
    monitors: dict[int, FrameMonitorSettings | None] = {}
    for name, protection in settings.protection.items():
        place = location.at("protection", name)
        with collected(errors):
            message = find_message(database, name, place)
            if message.can_id not in found:
                raise place.error(f"nothing is taken from message '{name}'; expected one that signals name")
            monitors[message.can_id] = _monitor(message, protection, place)
    reverse = None
    if isinstance(settings, OdometrySettings) and settings.signals.reverse is not None:
        condition, place = settings.signals.reverse, location.at("signals", "reverse")
        with collected(errors):
            _, signal = find_qualified(database, condition.signal, place)
            reverse = compile_condition(condition, signal, place)
    raise_all(errors)
    messages = {can_id: _ego_message(*entry, monitors.get(can_id)) for can_id, entry in found.items()}
    return BoundEgo(settings, bus, database, messages, reverse)


def assumed_speeds(ego: BoundEgo, location: SettingLocation) -> list[str]:
    """Warn of speeds that are taken as m/s for want of any unit: those of cars are mostly sent in km/h."""
    found = []
    for quantity, ref, place in _signals(ego.settings, location.at("signals")):
        _, signal = find_qualified(ego.database, ref.signal, place)
        if assumes_speed(quantity, ref, signal, ego.settings.units):
            text = f"signal '{signal.name}' has no unit in the DBC, and is taken as m/s"
            found.append(str(place.error(f"{text}; say so, or what it is: {{signal: {ref.signal}, unit: km/h}}")))
    return found


def _monitor(
    message: MessageSpec, protection: InputProtectionSettings, place: SettingLocation
) -> FrameMonitorSettings | None:
    """Work out what the frames of a message must be to be used."""
    cycle_time = message.cycle_time or 0.0
    if protection.max_rate is not None and not (protection.cycle_time or cycle_time):
        raise place.at("max_rate").error(f"the DBC gives no cycle time of '{message.name}'; give cycle_time beside it")
    return bind_frame_monitor([message], protection, place, cycle_time=cycle_time)


def _signals(
    settings: InsSettings | OdometrySettings, location: SettingLocation
) -> Iterator[tuple[str, SignalRef, SettingLocation]]:
    """Yield each signal named, with its quantity and place."""
    signals = settings.signals
    for quantity in type(signals).model_fields:
        value = getattr(signals, quantity)
        if isinstance(value, SignalRef):
            yield quantity, value, location.at(quantity)
        elif isinstance(value, str | Condition):
            name = value if isinstance(value, str) else value.signal
            yield quantity, SignalRef(signal=name, unit=None, scale=1.0, offset=0.0), location.at(quantity)
        elif isinstance(value, tuple):
            for index, ref in enumerate(value):
                yield quantity, ref, location.at(quantity, index)


def _ego_message(
    message: MessageSpec, bindings: list[SignalBinding], monitor: FrameMonitorSettings | None
) -> EgoMessage:
    scaled = _in_si_units(message, bindings)
    return EgoMessage(
        message,
        compile_decoder(scaled, [binding.signal.name for binding in bindings]),
        scaled,
        tuple(binding.quantity for binding in bindings),
        tuple(bindings),
        monitor,
    )


def _in_si_units(message: MessageSpec, bindings: list[SignalBinding]) -> MessageSpec:
    """Return the message with its signals scaled straight to their quantities: decoding needs no second step."""
    scaled = {
        each.signal.name: replace(
            each.signal, scale=each.gain * each.signal.scale, offset=each.gain * each.signal.offset + each.bias
        )
        for each in bindings
    }
    return replace(message, signals=tuple(scaled.get(signal.name, signal) for signal in message.signals))
