"""Own motion's signals: which message carries which quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from candaemon.binding.parts import find_qualified
from candaemon.binding.signals import SignalBinding, bind_signal
from candaemon.binding.where import Where, collected, raise_all
from candaemon.bus.codec import Decoder, compile_decoder
from candaemon.bus.spec import Database, MessageSpec
from candaemon.config.base import SignalRef
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.errors import ConfigError


@dataclass(frozen=True, slots=True)
class EgoMessage:
    """A message that carries own motion.

    Attributes:
        message: what the DBC says of it.
        decode: payload → the quantities, SI units (angles, latitude and longitude too in radians); None for a payload
            that is too short.
        quantities: name of each value's quantity; one that has several signals (wheel speeds) is there for each.
        bindings: quantities with their signals, for writing them.

    """

    message: MessageSpec
    decode: Decoder
    quantities: tuple[str, ...]
    bindings: tuple[SignalBinding, ...]


@dataclass(frozen=True, slots=True)
class BoundEgo:
    """Own motion's settings, bound to a DBC.

    Attributes:
        settings: from the configuration.
        bus: index of the bus.
        database: the DBC.
        messages: by CAN id.

    """

    settings: InsSettings | OdometrySettings
    bus: int
    database: Database
    messages: Mapping[int, EgoMessage]

    def count(self, quantity: str) -> int:
        """Count the signals that give a quantity."""
        return sum(message.quantities.count(quantity) for message in self.messages.values())


def bind_ego(settings: InsSettings | OdometrySettings, bus: int, database: Database, where: Where) -> BoundEgo:
    """Look up own motion's signals.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """
    errors: list[ConfigError] = []
    found: dict[int, tuple[MessageSpec, list[SignalBinding]]] = {}
    for quantity, ref, place in _signals(settings, where.at("signals")):
        with collected(errors):
            message, signal = find_qualified(database, ref.signal, place)
            binding = bind_signal(quantity, ref, signal, place)
            found.setdefault(message.can_id, (message, []))[1].append(binding)
    raise_all(errors)
    return BoundEgo(settings, bus, database, {can_id: _ego_message(*entry) for can_id, entry in found.items()})


def _signals(settings: InsSettings | OdometrySettings, where: Where) -> Iterator[tuple[str, SignalRef, Where]]:
    """Yield each signal named, with its quantity and place."""
    signals = settings.signals
    for quantity in type(signals).model_fields:
        value = getattr(signals, quantity)
        if isinstance(value, SignalRef):
            yield quantity, value, where.at(quantity)
        elif isinstance(value, str):
            yield quantity, SignalRef(signal=value, unit=None, scale=1.0, offset=0.0), where.at(quantity)
        elif isinstance(value, tuple):
            for index, ref in enumerate(value):
                yield quantity, ref, where.at(quantity, index)


def _ego_message(message: MessageSpec, bindings: list[SignalBinding]) -> EgoMessage:
    names = [binding.signal.name for binding in bindings]
    return EgoMessage(
        message,
        compile_decoder(_in_si_units(message, bindings), names),
        tuple(binding.quantity for binding in bindings),
        tuple(bindings),
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
