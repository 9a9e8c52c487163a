"""Families of equal messages in a DBC file: the same layout of bits again and again, told apart by a running number."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

from candaemon.dbc.types import MessageSpec, SignalSpec

FEWEST: Final = 3
"""Messages that make a family: two may be alike by chance."""
MOST_NUMBERS: Final = 8
"""Numbers in a name that may be the slot's."""
LONGEST_READ: Final = 256
"""Characters of a name in which they are looked for."""
MOST_SLOTS: Final = 256
"""Slots of a sensor's format."""

_DECIMAL: Final = re.compile(r"\d+")
_HEXADECIMAL: Final = re.compile(r"[0-9A-Fa-f]*\d[0-9A-Fa-f]*")
_SPECS: Final = ("", ":02d", ":03d", ":04d", ":x", ":X", ":02x", ":02X", ":03x", ":03X")


@dataclass(frozen=True, slots=True)
class Family:
    """Messages that are laid out alike and numbered.

    Attributes:
        template: the messages' name with `{slot}` for the number.
        first, step: the numbers.
        messages: in order of their numbers.
        signals: names of the first message's signals as a configuration writes them, in their order: with `{slot}`
            where they hold the number.
    """

    template: str
    first: int
    step: int
    messages: tuple[MessageSpec, ...]
    signals: tuple[str, ...]

    @property
    def slots(self) -> int:
        """Number of messages."""
        return len(self.messages)

    @property
    def numbers(self) -> tuple[int, int, int]:
        """First number, step and how many: families of one object share them."""
        return (self.first, self.step, self.slots)

    def spec(self, row: int) -> SignalSpec:
        """Return what the DBC says of a signal."""
        return self.messages[0].signals[row]


def find_families(messages: Iterable[MessageSpec]) -> list[Family]:
    """Find the families of some messages, those with the most messages first; each message is in one at most."""
    alike: dict[tuple[object, ...], list[MessageSpec]] = defaultdict(list)
    for message in messages:
        if message.signals:
            alike[_layout(message)].append(message)
    found = _joined(family for group in alike.values() if len(group) >= FEWEST for family in _numbered(group))
    return sorted(found, key=lambda family: (-family.slots, family.messages[0].can_id))


def _joined(families: Iterable[Family]) -> list[Family]:
    """Join families whose numbers go on from one to the next and that differ by bits of some signal only."""
    joined: list[Family] = []
    for family in sorted(families, key=lambda each: (each.template, each.signals, each.first)):
        last = joined[-1] if joined else None
        if (
            last is not None
            and (last.template, last.signals, last.step) == (family.template, family.signals, family.step)
            and last.first + last.step * last.slots == family.first
            and last.slots + family.slots <= MOST_SLOTS
        ):
            joined[-1] = replace(last, messages=last.messages + family.messages)
        else:
            joined.append(family)
    return joined


def _layout(message: MessageSpec) -> tuple[object, ...]:
    """Return what messages of a family share: the bits and values of their signals, whatever the names."""
    return (
        message.length,
        *(
            (s.start, s.length, s.byte_order, s.signed, s.is_float, s.scale, s.offset, s.multiplexer_ids)
            for s in message.signals
        ),
    )


def _numbered(group: Sequence[MessageSpec]) -> Iterator[Family]:
    """Yield the families among messages that are laid out alike, by the running numbers in their names."""
    left = {message.name: message for message in group}
    stems: dict[tuple[str, str, int], dict[int, MessageSpec]] = defaultdict(dict)
    for message in group:
        for key, number in _readings(message.name):
            stems[key].setdefault(number, message)
    # decimal before hexadecimal where both explain as many
    for (before, after, base), by_number in sorted(
        stems.items(), key=lambda item: (-len(item[1]), item[0][2], item[0])
    ):
        members = {number: each for number, each in by_number.items() if each.name in left}
        if len(members) < FEWEST:
            continue
        for run in _progressions(sorted(members)):
            family = _family(before, after, base, run, members)
            if family is not None:
                for message in family.messages:
                    del left[message.name]
                yield family


def _readings(name: str) -> Iterator[tuple[tuple[str, str, int], int]]:
    """Yield the ways to read a number out of a name: what is before and behind it and the base, and the number."""
    for form, base in ((_DECIMAL, 10), (_HEXADECIMAL, 16)):
        for found in islice(form.finditer(name[:LONGEST_READ]), MOST_NUMBERS):
            digits = found[0]
            if len(digits) <= 6 and not (base == 16 and digits.lower() != digits and digits.upper() != digits):
                yield (name[: found.start()], name[found.end() :], base), int(digits, base)


def _progressions(numbers: Sequence[int]) -> Iterator[range]:
    """Yield the longest runs of equal steps, one after another."""
    at = 0
    while at + FEWEST <= len(numbers):
        step = numbers[at + 1] - numbers[at]
        end = at + 1
        while end + 1 < len(numbers) and numbers[end + 1] - numbers[end] == step:
            end += 1
        if end - at + 1 >= FEWEST:
            yield range(numbers[at], numbers[end] + 1, step)
            at = end + 1
        else:
            at += 1


def _family(before: str, after: str, base: int, run: range, members: dict[int, MessageSpec]) -> Family | None:
    """Return the family of a run of numbers, None where no template writes its names or signals."""
    messages = tuple(members[number] for number in run)
    spec = _spec([message.name for message in messages], run, before, after, base)
    if spec is None or len(messages) > MOST_SLOTS:
        return None
    names = [
        signal_template([message.signals[row].name for message in messages], run)
        for row in range(len(messages[0].signals))
    ]
    if any(name is None for name in names):
        return None
    return Family(
        f"{before}{{slot{spec}}}{after}",
        run.start,
        run.step,
        messages,
        tuple(name for name in names if name is not None),
    )


def _spec(names: Sequence[str], run: range, before: str, after: str, base: int) -> str | None:
    """Return the format in which names hold their numbers."""
    for spec in _SPECS:
        if (base == 16) == (spec[-1:] in {"x", "X"}) and all(
            name == f"{before}{format(number, spec[1:])}{after}" for name, number in zip(names, run, strict=True)
        ):
            return spec
    return None


def signal_template(names: Sequence[str], run: range) -> str | None:
    """Return what the names of one signal in all messages have in common: itself, or a template with `{slot}`."""
    if len(set(names)) == 1:
        return names[0]
    for spec in _SPECS:
        digits = format(run.start, spec[1:])
        at = names[0].find(digits)
        while at >= 0:
            before, after = names[0][:at], names[0][at + len(digits) :]
            if all(
                name == f"{before}{format(number, spec[1:])}{after}" for name, number in zip(names, run, strict=True)
            ):
                return f"{before}{{slot{spec}}}{after}"
            at = names[0].find(digits, at + 1)
    return None
