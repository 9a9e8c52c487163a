"""The messages that together make an object, and how they are laid out."""

from __future__ import annotations

from dataclasses import dataclass

from candaemon.dbc.types import MessageSpec, SignalSpec


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """One of the messages that together make an object; every slot's message of it is laid out alike.

    Attributes:
        index: position among the object's messages.
        pattern: the message's name as configured.
        messages: by slot; a single one where all objects share it.
        optional: whether an object is used without it.
        id_signal: signal that gives the object of a frame, where all objects share the message.

    """

    index: int
    pattern: str
    messages: tuple[MessageSpec, ...]
    optional: bool
    id_signal: SignalSpec | None

    @property
    def shortest(self) -> MessageSpec:
        """The message that stands for those of all slots: the first of the shortest ones."""
        return min(self.messages, key=lambda message: message.length)

    @property
    def length(self) -> int:
        """Payload bytes of the shortest message, which hold every signal that is used."""
        return self.shortest.length
