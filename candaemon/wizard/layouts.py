"""How a radar's objects lie in its frames: one or several messages, whose objects a number tells apart."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.families import FEWEST, Family, find_families, signal_template
from candaemon.wizard.vocabulary import role_of, words

POSITIONS: Final = ({"x", "y"}, {"range", "azimuth"}, {"x", "azimuth"})
"""Roles that together are a position; some call the distance along the line of sight one ahead."""
_NUMBER: Final = re.compile(r"\d+")
MOST_TRIED: Final = 32
"""Families with a position that are looked at."""
MOST_LISTED: Final = 1000
"""Messages outside families that are looked at as lists."""
_FURTHER: Final = {"range_rate", "vx", "vy", "ax", "valid", "new", "width", "length", "score"}
"""Roles of what a second message of an object holds."""
UNNUMBERED_SLOTS: Final = 64
"""Objects of a list without numbers, where no log says more."""
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
        unnumbered: whether nothing tells them apart but the order in which they come.
        points: what `{point}` stands for, where a message has several objects.
    """

    parts: tuple[Part, ...]
    slots: int
    first: int
    step: int
    why: str
    listed: bool = False
    points: tuple[int, ...] = ()
    unnumbered: bool = False

    @property
    def left_out(self) -> str:
        """What speaks for further objects in each message, of which this layout takes the first only; else empty."""
        if self.points:
            return ""
        for part in self.parts:
            for role in ("x", "range"):
                alike: dict[tuple[int, float], list[str]] = {}
                for name, spec in zip(part.names, part.specs, strict=True):
                    if role_of(name)[0] == role and spec.length >= 6:
                        alike.setdefault((spec.length, spec.scale), []).append(name)
                for names in alike.values():
                    if len(names) > 1:
                        return (
                            f"{part.messages[0].name} seems to hold {len(names)} objects, of which {names[0]} is one; "
                            "say the others by `points`"
                        )
        return ""

    @property
    def name(self) -> str:
        """A name for people: the words of the first message."""
        return "_".join(words(self.parts[0].template)) or "radar"


def find_layouts(messages: Sequence[MessageSpec]) -> list[Layout]:
    """Find what looks like lists of objects among the messages of a DBC file, the likeliest first."""
    families = find_families(messages)
    layouts = [*_numbered(families)]
    taken = {message.name for family in families for message in family.messages}
    rest = [message for message in messages if message.name not in taken]
    several = list(_multiplexed(rest))
    taken |= {layout.parts[0].template for layout in several}
    layouts += [*several, *_listed([message for message in rest if message.name not in taken])]
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
    main = [family for family in families if has_position(family.signals)][:MOST_TRIED]
    for family in main:
        others = [
            other
            for other in families
            if other not in main and other.numbers == family.numbers and _is_companion(family, other, main)
        ]
        parts = [_part(each) for each in (family, *sorted(others, key=lambda each: each.messages[0].can_id))]
        first, last = family.messages[0], family.messages[-1]
        why = f"{family.slots} messages laid out alike, {first.name} to {last.name}"
        pointed = _with_points(parts[0]) if len(parts) == 1 else None
        if pointed is not None:
            part, points = pointed
            why = f"{why}, with {len(points)} objects each"
            yield Layout((part,), family.slots * len(points), family.first, family.step, why, points=points)
            continue
        yield Layout(tuple(parts), family.slots, family.first, family.step, why)


def _is_companion(family: Family, other: Family, main: Sequence[Family]) -> bool:
    """Return whether another family holds more of the same objects: its name is nearest to this one's."""

    def near(one: Family) -> int:
        return len(_common(one.template, other.template))

    rivals = [each for each in main if each.numbers == other.numbers]
    if rivals == [family]:
        return any(role_of(name)[0] in _FURTHER for name in other.signals)
    return near(family) == max(map(near, main)) and near(family) >= min(3, len(family.template) - 6)


def _common(one: str, other: str) -> str:
    """Return what two texts begin with."""
    length = next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    return one[:length]


def _with_points(part: Part) -> tuple[Part, tuple[int, ...]] | None:
    """Return a message with the signals of each of its objects told apart by a number, and these; None without any."""
    found: dict[tuple[str, str, str], dict[int, int]] = {}
    for index, name in enumerate(part.names):
        for match in _NUMBER.finditer(name):
            if "{" in name[: match.start()].rpartition("}")[2]:
                continue  # within a slot's braces
            width = len(match[0]) if match[0].startswith("0") or len(match[0]) > 1 else 0
            key = (name[: match.start()], f":0{width}d" if width else "", name[match.end() :])
            found.setdefault(key, {})[int(match[0])] = index
    sets = [tuple(sorted(each)) for each in found.values() if len(each) >= 2]
    if not sets:
        return None
    points = max(sets, key=lambda each: (sets.count(each), len(each)))
    chosen = {key: each for key, each in found.items() if tuple(sorted(each)) == points}
    names = tuple(f"{before}{{point{spec}}}{after}" for before, spec, after in chosen)
    if not has_position(names):
        return None
    columns = [[by_number[point] for by_number in chosen.values()] for point in points]
    signal_sets = tuple(
        tuple(tuple(message.signals[index].name for index in column) for column in columns) for message in part.messages
    )
    specs = tuple(part.specs[index] for index in columns[0])
    return Part(part.template, part.messages, names, specs, signal_sets), points


def _multiplexed(messages: Sequence[MessageSpec]) -> Iterator[Layout]:
    """Yield the layouts of messages in which a multiplexer says the slot, each with signals of its own names."""
    for message in messages:
        selectors = [signal for signal in message.signals if signal.is_multiplexer]
        if len(selectors) != 1:
            continue
        by_id: dict[int, list[SignalSpec]] = {}
        for signal in message.signals:
            for value in signal.multiplexer_ids:
                by_id.setdefault(value, []).append(signal)
        groups = [by_id[value] for value in sorted(by_id)]
        alike = {tuple((s.start, s.length, s.signed, s.scale, s.offset) for s in group) for group in groups}
        if len(groups) < FEWEST or len(alike) != 1:
            continue
        stand_ins = [
            MessageSpec(f"#{number}#", number, message.length, tuple(group)) for number, group in enumerate(groups)
        ]
        template = _common_template(groups)
        if template is None or not has_position(template[0]):
            continue
        names, first = template
        sets = (tuple(tuple(signal.name for signal in group) for group in groups),)
        part = Part(message.name, (message,), names, tuple(groups[0]), sets, selectors[0].name)
        why = f"{len(stand_ins)} groups of signals alike in {message.name}, told apart by {selectors[0].name}"
        yield Layout((part,), len(groups), first, 1, why, listed=True)


def _common_template(groups: Sequence[Sequence[SignalSpec]]) -> tuple[tuple[str, ...], int] | None:
    """Return the names of signals with `{slot}` for a number that counts the groups, and the first number."""
    match = _NUMBER.search(groups[0][0].name)
    if match is None:
        return None
    run = range(int(match[0]), int(match[0]) + len(groups))
    names = [signal_template([group[row].name for group in groups], run) for row in range(len(groups[0]))]
    known = tuple(name for name in names if name is not None)
    return (known, run.start) if len(known) == len(names) else None


def _part(family: Family) -> Part:
    sets = tuple((tuple(signal.name for signal in message.signals),) for message in family.messages)
    return Part(family.template, family.messages, family.signals, family.messages[0].signals, sets)


def _listed(messages: Sequence[MessageSpec]) -> Iterator[Layout]:
    """Yield the layouts of messages that carry every object in turn and say in a signal which it is."""
    for message in messages[:MOST_LISTED]:
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


def find_unnumbered(messages: Sequence[MessageSpec]) -> Iterator[Layout]:
    """Yield the layouts of messages that carry every object in turn, and nothing that says which."""
    for message in messages[:MOST_LISTED]:
        names = tuple(signal.name for signal in message.signals)
        if has_position(names):
            part = Part(message.name, (message,), names, message.signals, ((names,),))
            why = f"{message.name} has a position, and no number"
            yield Layout((part,), UNNUMBERED_SLOTS, 0, 1, why, listed=True, unnumbered=True)
