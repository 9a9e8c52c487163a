"""How a radar's objects lie in its frames: one or several messages, whose objects a number tells apart."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.families import Family, find_families
from candaemon.wizard.vocabulary import role_of, words

POSITIONS: Final = ({"x", "y"}, {"range", "azimuth"}, {"x", "azimuth"})
"""Roles that together are a position; some call the distance along the line of sight one ahead."""
MOST_LAYOUTS: Final = 8
"""Layouts that are looked at: a car has no more radars on its buses."""


@dataclass(frozen=True, slots=True)
class Part:
    """One message of an object.

    Attributes:
        template: the message's name, with `{slot}` where there is one for each slot.
        messages: of each slot, or the only one.
        names: the signals' names as a configuration writes them.
        specs: of the first slot.
        signal_sets: of each message, the signals' names in the DBC for each object in it.
        id_name: name of the signal that says whose the frame is; None where the message says it.
    """

    template: str
    messages: tuple[MessageSpec, ...]
    names: tuple[str, ...]
    specs: tuple[SignalSpec, ...]
    signal_sets: tuple[tuple[tuple[str, ...], ...], ...]
    id_name: str | None = None


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the objects lie.

    Attributes:
        parts: the messages of an object, the one with the position first.
        slots, first, step: as a configuration has them.
        why: the evidence in the DBC file.
        listed: whether one identifier carries all objects.
    """

    parts: tuple[Part, ...]
    slots: int
    first: int
    step: int
    why: str
    listed: bool = False

    @property
    def name(self) -> str:
        """A name for people: the words of the first message."""
        return "_".join(words(self.parts[0].template)) or "radar"


def find_layouts(messages: Sequence[MessageSpec]) -> list[Layout]:
    """Find what looks like lists of objects among the messages of a DBC file, the likeliest first."""
    families = find_families(messages)
    layouts = [*_numbered(families)]
    taken = {message.name for family in families for message in family.messages}
    layouts += _listed([message for message in messages if message.name not in taken])
    return sorted(layouts, key=_likelihood)[:MOST_LAYOUTS]


def _likelihood(layout: Layout) -> tuple[int, int]:
    """Return what puts the likeliest radar first: roles that radars have, then many slots."""
    roles = {role_of(name)[0] for part in layout.parts for name in part.names}
    return (-len(roles & {"range_rate", "vx", "vy", "range", "azimuth", "x", "y", "valid", "new"}), -layout.slots)


def has_position(names: Iterable[str]) -> bool:
    """Return whether signals are called what the place of an object is called."""
    roles = {role_of(name)[0] for name in names}
    return any(position <= roles for position in POSITIONS)


def _numbered(families: Sequence[Family]) -> Iterator[Layout]:
    """Yield the layouts of families of messages: one with the position, and its companions of the same numbers."""
    main = [family for family in families if has_position(family.signals)]
    for family in main:
        others = [
            other
            for other in families
            if other not in main and other.numbers == family.numbers and _is_companion(family, other, main)
        ]
        parts = [_part(each) for each in (family, *sorted(others, key=lambda each: each.messages[0].can_id))]
        first, last = family.messages[0], family.messages[-1]
        why = f"{family.slots} messages laid out alike, {first.name} to {last.name}"
        yield Layout(tuple(parts), family.slots, family.first, family.step, why)


def _is_companion(family: Family, other: Family, main: Sequence[Family]) -> bool:
    """Return whether another family holds more of the same objects: its name is nearest to this one's."""

    def near(one: Family) -> int:
        return len(_common(one.template, other.template))

    return near(family) == max(map(near, main)) and near(family) >= min(3, len(family.template) - 6)


def _common(one: str, other: str) -> str:
    """Return what two texts begin with."""
    length = next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    return one[:length]


def _part(family: Family) -> Part:
    sets = tuple((tuple(signal.name for signal in message.signals),) for message in family.messages)
    return Part(family.template, family.messages, family.signals, family.messages[0].signals, sets)


def _listed(messages: Sequence[MessageSpec]) -> Iterator[Layout]:
    """Yield the layouts of messages that carry every object in turn and say in a signal which it is."""
    for message in messages:
        names = [signal.name for signal in message.signals]
        identities = [
            signal for signal in message.signals if role_of(signal.name)[0] == "identity" and signal.length >= 4
        ]
        if not has_position(names) or not identities:
            continue
        key = identities[0]
        others = [
            other
            for other in messages
            if other is not message
            and (same := other.find(key.name)) is not None
            and same.length == key.length
            and not has_position(signal.name for signal in other.signals)
        ]
        parts = tuple(
            Part(
                each.name,
                (each,),
                tuple(signal.name for signal in each.signals),
                each.signals,
                ((tuple(signal.name for signal in each.signals),),),
                key.name,
            )
            for each in (message, *others)
        )
        top = key.maximum if key.maximum is not None and key.maximum > 0 else (1 << key.length) - 1
        slots = max(1, min(256, int(top) + 1))
        yield Layout(
            parts, slots, 0, 1, f"{message.name} has a position and the object's number {key.name}", listed=True
        )
