"""The messages that together make an object, and how they are laid out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from candaemon.dbc.types import MessageSpec, SignalSpec


def is_of_point(name: str) -> bool:
    """Return whether a signal's name, as configured, says which of a message's objects it is of."""
    return "{point" in name or "{object" in name


def point_name(name: str, point: int) -> str:
    """Return the name under which a layout has a signal of one of a message's points; the first has the pattern's."""
    return f"{name}[{point}]" if point and is_of_point(name) else name


def first_point_name(name: str) -> str:
    """Return what `point_name` gives for the first of the points."""
    return name.partition("[")[0]


@dataclass(frozen=True, slots=True)
class Page:
    """Which part of a list longer than its messages a frame is of.

    Attributes:
        signal: says the page.
        first, step: its value on the first page, and the difference on neighbouring ones.
        count: pages.
        places: on each.

    """

    signal: SignalSpec
    first: int
    step: int
    count: int
    places: int

    def offset(self, value: int) -> int:
        """Return how many places are on the pages before the one that a value stands for; −1 where it is none."""
        page, rest = divmod(value - self.first, self.step)
        return -1 if rest or not 0 <= page < self.count else page * self.places

    def values(self, places: int) -> list[int]:
        """Return the signal's value for each of so many places."""
        return [self.first + self.step * (place // self.places) for place in range(places)]


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """One of the messages that together make an object; every place's message of it is laid out alike.

    Attributes:
        index: position among the object's messages.
        pattern: the message's name as configured.
        messages: by place (a slot, or as many slots as a message has points); a single one where all objects share it.
            Signals with numbers in their names have their patterns as names, `point_name` those of further points.
        optional: whether an object is used without it.
        id_signal: signal that gives the place of a frame, where all objects share the message.
        keys: place by the value of that signal; empty where `first` and `step` give it.
        first: value of that signal for the first place.
        step: difference of the values of neighbouring places.
        page: what says on which page of the list a frame is; None: the list has one page, and `messages` are all.
        selector: signal and value that a frame must have to be of this layout; None: every frame of its id is.

    """

    index: int
    pattern: str
    messages: tuple[MessageSpec, ...]
    optional: bool
    id_signal: SignalSpec | None
    keys: Mapping[int, int] = field(default_factory=dict)
    first: int = 0
    step: int = 1
    selector: tuple[SignalSpec, int] | None = None
    page: Page | None = None

    @property
    def shortest(self) -> MessageSpec:
        """The message that stands for those of all places: the first of the shortest ones."""
        return min(self.messages, key=lambda message: message.length)

    @property
    def length(self) -> int:
        """Payload bytes of the shortest message, which hold every signal that is used."""
        return self.shortest.length

    def place(self, key: int) -> int:
        """Return the place that a value of the id signal stands for, −1 where it stands for none."""
        if self.keys:
            return self.keys.get(key, -1)
        place, rest = divmod(key - self.first, self.step)
        return -1 if rest else place

    def key(self, place: int) -> int:
        """Return the value of the id signal for a place."""
        if self.keys:
            return next((key for key, of in self.keys.items() if of == place), -1)
        return self.first + self.step * place
