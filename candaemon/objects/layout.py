"""Which messages make an object: the configuration's patterns looked up in the DBC."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.batch_codec import same_layout
from candaemon.dbc.types import Database, MessageSpec, SignalSpec, near_names
from candaemon.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Part:
    """One of the messages that together make an object.

    Attributes:
        index: position among the object's messages.
        pattern: the message's name as configured.
        messages: by slot; a single one where all objects share it.
        optional: whether an object is used without it.
        id_signal: signal that says which object a frame is of, where all objects share the message.

    """

    index: int
    pattern: str
    messages: tuple[MessageSpec, ...]
    optional: bool
    id_signal: SignalSpec | None

    @property
    def layout(self) -> MessageSpec:
        """The message whose layout stands for all slots': the first of the shortest ones."""
        return min(self.messages, key=lambda message: message.length)

    @property
    def length(self) -> int:
        """Payload bytes of the shortest message, which hold every signal that is used."""
        return self.layout.length

    def find(self, name: str) -> SignalSpec | None:
        """Find a signal by name, None where this message has none of it."""
        return next((signal for signal in self.layout.signals if signal.name == name), None)


def find_message(database: Database, name: str, where: SettingLocation) -> MessageSpec:
    """Find a message by name.

    Raises:
        ConfigError: the DBC has no such message.

    """
    message = database.messages.get(name)
    if message is None:
        raise where.error(f"'{database.path.name}' has no message '{name}'; {near_names(name, database.messages)}")
    return message


def find_signal(message: MessageSpec, name: str, where: SettingLocation) -> SignalSpec:
    """Find a signal of a message.

    Raises:
        ConfigError: the message has no such signal.

    """
    for signal in message.signals:
        if signal.name == name:
            return signal
    known = [signal.name for signal in message.signals]
    raise where.error(f"message '{message.name}' has no signal '{name}'; {near_names(name, known)}")


def find_qualified(database: Database, name: str, where: SettingLocation) -> tuple[MessageSpec, SignalSpec]:
    """Find a signal named as MESSAGE.SIGNAL.

    Raises:
        ConfigError: not of that form, or the DBC has no such message or signal.

    """
    message_name, dot, signal_name = name.partition(".")
    if not dot:
        owners = [m.name for m in database.messages.values() if any(s.name == name for s in m.signals)]
        hint = f"; did you mean '{owners[0]}.{name}'?" if owners else ""
        raise where.error(f"found '{name}', expected MESSAGE.SIGNAL{hint}")
    message = find_message(database, message_name, where)
    return message, find_signal(message, signal_name, where)


def resolve_parts(form: ObjectFormat, database: Database, where: SettingLocation) -> tuple[Part, ...]:
    """Look up the messages of an object format.

    Args:
        form: the format.
        database: the DBC.
        where: place of the format in the configuration.

    Raises:
        ConfigError: naming every message that the DBC lacks.

    """
    errors: list[ConfigError] = []
    parts: list[Part] = []
    numbers = [form.first + form.step * slot for slot in range(1 if form.multiplexed else form.slots)]
    for index, entry in enumerate(form.messages):
        place = where.at("messages", index)
        with collected(errors):
            messages = tuple(find_message(database, entry.named(number), place) for number in numbers)
            id_signal = None
            if entry.id_signal is not None:
                if not form.multiplexed:
                    raise place.error("id_signal is for a message that all objects share; this one has {slot}")
                id_signal = find_signal(messages[0], entry.id_signal, place.at("id_signal"))
            parts.append(Part(index, entry.message, messages, entry.optional, id_signal))
    raise_all(errors)
    if all(part.optional for part in parts):
        raise where.at("messages").error("every message is optional; one at least must be there for an object")
    return tuple(parts)


def find_in_parts(parts: Sequence[Part], name: str, where: SettingLocation) -> list[tuple[Part, SignalSpec]]:
    """Find an object's signal: in every part that has it, or in the part named before a dot.

    Args:
        parts: the object's messages.
        name: SIGNAL, or PATTERN.SIGNAL with the pattern as configured (`TRACK_A_{slot}.COUNTER`).
        where: place of the name.

    Raises:
        ConfigError: no part has it.

    """
    pattern, dot, signal_name = name.rpartition(".")
    if dot:
        chosen = [part for part in parts if part.pattern == pattern]
        if not chosen:
            raise where.error(
                f"'{pattern}' is no message of the object; {near_names(pattern, [p.pattern for p in parts])}"
            )
        return [(part, find_signal(part.layout, signal_name, where)) for part in chosen]
    found = [(part, signal) for part in parts if (signal := part.find(name)) is not None]
    if not found:
        known = [signal.name for part in parts for signal in part.layout.signals]
        messages = ", ".join(f"'{part.layout.name}'" for part in parts)
        raise where.error(f"no signal '{name}' in {messages}; {near_names(name, known)}")
    return found


def check_layouts(part: Part, signals: Iterable[str], where: SettingLocation) -> None:
    """Make sure that every slot's message carries the signals alike, so that one codec serves all.

    Messages may be longer than the shortest: Toyota's first eight tracks are.

    Raises:
        ConfigError: a slot's message differs.

    """
    names = list(signals)
    layout = part.layout
    for message in part.messages:
        cut = message if message.length == layout.length else replace(message, length=layout.length)
        if cut is not layout and not same_layout(layout, cut, names):
            raise where.at("messages", part.index).error(
                f"message '{message.name}' lays its signals out otherwise than '{layout.name}' "
                f"(of {', '.join(names)}); all slots of a format must be alike"
            )
