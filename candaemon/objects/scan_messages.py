"""Single messages beside the objects: the output's status, a scan's header."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from candaemon.dbc.single_codec import Encoder
from candaemon.dbc.types import MessageSpec
from candaemon.protection.checksums import FrameProtector


@dataclass(frozen=True, slots=True)
class StatusField:
    """One signal of the status message.

    Attributes:
        quantity: what it shows, None for a fixed value.
        fixed: that value.
        wrap: number of values after which the quantity starts again, 0 where it saturates.

    """

    quantity: str | None
    fixed: float = 0.0
    wrap: int = 0


@dataclass(frozen=True, slots=True)
class StatusWriter:
    """Writes the message that is sent once a cycle; `binding.bind_status` makes it.

    Attributes:
        message: its layout.
        fields: one a signal that is written.
        encode: of the fields' values.
        protector: counter and checksum, None where there are none.

    """

    message: MessageSpec
    fields: tuple[StatusField, ...]
    encode: Encoder
    protector: FrameProtector | None

    def write(self, values: Mapping[str, float], *, counter: int) -> tuple[int, bytes]:
        """Write the message.

        Args:
            values: quantity → value; one left out is written as 0.
            counter: what the counter shows, modulo its width.

        Returns:
            CAN id and payload.

        """
        given = []
        for field in self.fields:
            quantity, wrap = field.quantity, field.wrap
            value = field.fixed if quantity is None else counter if quantity == "counter" else values.get(quantity, 0.0)
            given.append(value % wrap if wrap else value)
        payload, _ = self.encode(given)
        if self.protector is not None:
            payload = self.protector.seal(self.message.can_id, payload)
        return self.message.can_id, payload


@dataclass(frozen=True, slots=True)
class LookReader:
    """Reads which look a scan is; `binding.bind_sensor` makes it.

    Attributes:
        part: index of the objects' layout that says it, None where the header or trigger does.
        signal: its name.
        read: payload → look, −1 where it does not carry the signal.

    """

    part: int | None
    signal: str
    read: Callable[[bytes], int]


@dataclass(frozen=True, slots=True)
class HeaderCount:
    """A signal with the number of a scan's objects, or of some of them.

    Attributes:
        read: payload → number.
        greatest: greatest number that the signal holds.
        index: which it is of the signals that add up to the number of objects.
        of: how many these are.

    """

    read: Callable[[bytes], int]
    greatest: int
    index: int
    of: int

    def share(self, count: int) -> int:
        """Return how many of so many objects it shows."""
        return min(count // self.of + (self.index < count % self.of), self.greatest)


@dataclass(frozen=True, slots=True)
class ScanHeader:
    """Reads and writes a scan's header message; `binding.bind_headers` makes it.

    Attributes:
        message: its layout.
        used_only: whether only the objects counted are sent.
        counts: its signals with numbers of objects that follow.
        counter: payload → measurement counter, None where there is none.
        period: number of values of the measurement counter, 0 where there is none.
        says_look: whether it says which look the scan is.
        encode: of the numbers of objects and, where there are such, the measurement counter and the look.
        protector: counter and checksum, None where there are none.

    """

    message: MessageSpec
    used_only: bool
    counts: tuple[HeaderCount, ...]
    counter: Callable[[bytes], int] | None
    period: int
    says_look: bool
    encode: Encoder
    protector: FrameProtector | None

    @property
    def can_id(self) -> int:
        """The message's identifier."""
        return self.message.can_id

    def read(self, data: bytes) -> tuple[int, int]:
        """Read the number of objects that follow and the measurement counter (−1 where there is none)."""
        return sum(max(count.read(data), 0) for count in self.counts), -1 if self.counter is None else self.counter(
            data
        )

    def write(self, count: int, counter: int, look: int = 0) -> tuple[int, bytes]:
        """Write a header: CAN id and payload; a count over the greatest is clipped to it."""
        values = [each.share(count) for each in self.counts]
        if self.counter is not None:
            values.append(counter % self.period)
        if self.says_look:
            values.append(look)
        payload, _ = self.encode(values)
        return self.can_id, payload if self.protector is None else self.protector.seal(self.can_id, payload)
