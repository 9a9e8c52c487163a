"""Names of the configuration looked up in the DBC: messages, signals, and the messages that make an object."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.numbered_names import numbered_view, selected_view, valued_view
from candaemon.config.sensors import MOST_SLOTS, ObjectFormat, ObjectMessage
from candaemon.dbc.bits import same_layout, sendable_values
from candaemon.dbc.types import Database, MessageSpec, SignalSpec, near_names
from candaemon.errors import ConfigError
from candaemon.objects.message_layout import MessageLayout, Page


def find_message(database: Database, name: str, location: SettingLocation) -> MessageSpec:
    """Find a message by name.

    Raises:
        ConfigError: the DBC has no such message, or gives its identifier to another one before it.

    """
    message = database.messages.get(name)
    if message is None:
        raise location.error(f"'{database.path.name}' has no message '{name}'; {near_names(name, database.messages)}")
    owner = database.by_id[message.can_id]
    if owner.name != message.name:
        raise location.error(
            f"message '{name}' has the identifier of '{owner.name}', in line {owner.line} of '{database.path.name}', "
            "which all its frames go to; correct one of the two there"
        )
    return message


def find_signal(message: MessageSpec, name: str, location: SettingLocation) -> SignalSpec:
    """Find a signal of a message.

    Raises:
        ConfigError: the message has no such signal.

    """
    signal = message.find(name)
    if signal is None:
        known = [each.name for each in message.signals]
        raise location.error(f"message '{message.name}' has no signal '{name}'; {near_names(name, known)}")
    return signal


def signal_of(message: MessageSpec, name: str) -> SignalSpec | None:
    """Return a signal named as SIGNAL or MESSAGE.SIGNAL if it is one of a message's."""
    of, _, plain = name.rpartition(".")
    return message.find(plain) if of in {"", message.name} else None


def find_qualified(database: Database, name: str, location: SettingLocation) -> tuple[MessageSpec, SignalSpec]:
    """Find a signal named as MESSAGE.SIGNAL.

    Raises:
        ConfigError: not of that form, or the DBC has no such message or signal.

    """
    message_name, dot, signal_name = name.partition(".")
    if not dot:
        owners = [message.name for message in database.messages.values() if message.find(name) is not None]
        hint = f"; did you mean '{owners[0]}.{name}'?" if owners else ""
        raise location.error(f"found '{name}', expected MESSAGE.SIGNAL{hint}")
    message = find_message(database, message_name, location)
    return message, find_signal(message, signal_name, location)


def find_layouts(
    form: ObjectFormat, database: Database, location: SettingLocation, names: Collection[str] = ()
) -> tuple[MessageLayout, ...]:
    """Find the messages of an object format.

    Args:
        form: the format.
        database: the DBC.
        location: place of the format in the configuration.
        names: of signals that hold numbers, as configured.

    Raises:
        ConfigError: naming every message that the DBC lacks.

    """
    errors: list[ConfigError] = []
    layouts: list[MessageLayout] = []
    for index, entry in enumerate(form.messages):
        with collected(errors):
            layouts.append(_layout(index, entry, form, database, location.at("messages", index), names))
    raise_all(errors)
    if all(layout.optional for layout in layouts):
        raise location.at("messages").error("every message is optional; one at least must be there for an object")
    return tuple(layouts)


def _layout(
    index: int,
    entry: ObjectMessage,
    form: ObjectFormat,
    database: Database,
    location: SettingLocation,
    names: Collection[str],
) -> MessageLayout:
    """Find one of an object's messages, for every place."""
    places = range(1 if form.multiplexed else form.places_on_page)
    numbers = [form.first + form.step * place for place in places]
    found = _numbered_messages(database, entry, form, numbers, location)
    id_signal, keys = None, dict[int, int]()
    messages = tuple(numbered_view(message, names, form, place) for place, message in enumerate(found))
    if entry.id_signal is not None and not form.multiplexed:
        raise location.error("id_signal is for a message that all objects share; this one has {slot}")
    if entry.id_signal:
        id_signal = find_signal(found[0], entry.id_signal, location.at("id_signal"))
        if names and id_signal.is_multiplexer:
            try:
                view, keys = selected_view(found[0], id_signal, names, form)
            except ValueError as error:
                raise location.at("id_signal").error(f"message '{entry.message}': {error}") from None
            messages = (view,) if keys else messages
    selector = None
    for name, value in entry.when.items():
        signal = find_signal(messages[0], name, location.at("when", name))
        low, high = sendable_values(signal)
        if not low <= value <= high:
            raise location.at("when", name).error(f"'{name}' cannot be {value}, it holds {low:g} to {high:g}")
        selector = signal, value
        messages = tuple(valued_view(message, name, value) for message in messages)
    for place, message in enumerate(messages):
        lacking = [name for name in names if messages[0].find(name) is not None and message.find(name) is None]
        if lacking:
            raise location.error(
                f"message '{message.name}' has no signal '{lacking[0]}' for slot {numbers[place]}; "
                f"{near_names(lacking[0], [each.name for each in message.signals])}"
            )
    page = None
    if form.pages is not None:
        signal = find_signal(messages[0], form.pages.signal, location.beside("pages").at("signal"))
        page = Page(signal, form.pages.first, form.pages.step, form.pages.count, form.places_on_page)
    layout = MessageLayout(
        index, entry.message, messages, entry.optional, id_signal, keys, form.first, form.step, selector, page
    )
    if page is not None:
        check_alike(layout, [page.signal.name], location)
    return layout


def _numbered_messages(
    database: Database, entry: ObjectMessage, form: ObjectFormat, numbers: Sequence[int], location: SettingLocation
) -> list[MessageSpec]:
    """Find the message of each number.

    Raises:
        ConfigError: the DBC has not all of them; the text says which numbers it has, where that is a row without gaps.
    """
    absent = next((number for number in numbers if entry.named(number) not in database.messages), None)
    if absent is not None and not form.multiplexed and form.step == 1 and form.pages is None:
        row = _row(database, entry)
        if row and all(number in row for number in numbers if entry.named(number) in database.messages):
            raise location.error(
                f"'{database.path.name}' has no message '{entry.named(absent)}'; it has '{entry.named(row[0])}' to "
                f"'{entry.named(row[-1])}': set first: {row[0]} and slots: {len(row) * len(form.points)}"
            )
    return [find_message(database, entry.named(number), location) for number in numbers]


def _row(database: Database, entry: ObjectMessage) -> range:
    """Return the first numbers without a gap that the DBC has messages of; empty where it has none up to MOST_SLOTS."""
    there = (number for number in range(MOST_SLOTS + 1) if entry.named(number) in database.messages)
    first = end = next(there, 0)
    while end - first < MOST_SLOTS and entry.named(end) in database.messages:
        end += 1
    return range(first, end)


def find_in_layouts(
    layouts: Sequence[MessageLayout], name: str, location: SettingLocation
) -> list[tuple[MessageLayout, SignalSpec]]:
    """Find an object's signal: in every layout that has it, or in the one named before a dot.

    Args:
        layouts: the object's messages.
        name: SIGNAL, or PATTERN.SIGNAL with the pattern as configured (`TRACK_A_{slot}.COUNTER`).
        location: place of the name.

    Raises:
        ConfigError: no layout has it.

    """
    pattern, dot, signal_name = name.rpartition(".")
    if dot:
        chosen = [layout for layout in layouts if layout.pattern == pattern]
        if not chosen:
            patterns = [layout.pattern for layout in layouts]
            raise location.error(f"'{pattern}' is no message of the object; {near_names(pattern, patterns)}")
        return [(layout, find_signal(layout.shortest, signal_name, location)) for layout in chosen]
    found = [(layout, signal) for layout in layouts if (signal := layout.shortest.find(name)) is not None]
    if not found:
        known = [signal.name for layout in layouts for signal in layout.shortest.signals]
        messages = ", ".join(f"'{layout.shortest.name}'" for layout in layouts)
        raise location.error(f"no signal '{name}' in {messages}; {near_names(name, known)}")
    return found


def check_alike(layout: MessageLayout, signals: Iterable[str], location: SettingLocation) -> None:
    """Check that every slot's message carries the signals alike, so that one codec serves all.

    Messages may be longer than the shortest: Toyota's first eight tracks are.

    Raises:
        ConfigError: a slot's message differs.

    """
    names = list(signals)
    shortest = layout.shortest
    for message in layout.messages:
        cut = message if message.length == shortest.length else replace(message, length=shortest.length)
        if cut is not shortest and not same_layout(shortest, cut, names):
            raise location.at("messages", layout.index).error(
                f"message '{message.name}' lays its signals out otherwise than '{shortest.name}' "
                f"(of {', '.join(names)}); all slots of a format must be alike"
            )
