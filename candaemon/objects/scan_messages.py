"""Single messages beside the objects: the output's status, a scan's header."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from candaemon.dbc.bits import representable_raw, shift, to_raw
from candaemon.dbc.single_codec import Encoder
from candaemon.dbc.types import MessageSpec, SignalSpec
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
class TimeStampField:
    """The signal that says when a scan was measured; `binding.bind_time_stamp` makes it.

    Attributes:
        message: that has it; of an object's messages, the shortest.
        signal: an integer, in every frame of the message.
        part: index of the objects' layout that has it, None where a single message does.
        own: whether that message is there for it alone: no header, no trigger, no object's.
        unit_ns: ns of one unit of the signal.
        wrap_ns: ns after which a clock begins anew; 0 for an age.
        read: payload → the signal's value, in its unit.

    """

    message: MessageSpec
    signal: SignalSpec
    part: int | None
    own: bool
    unit_ns: float
    wrap_ns: int
    read: Callable[[bytes], tuple[float, ...] | None]

    def stamp_ns(self, data: bytes) -> int | None:
        """Read age or clock, ns, from a payload long enough; None where it has none."""
        values = self.read(data)
        return None if values is None else round(values[0] * self.unit_ns)

    def written(self, data: bytes, stamp_ns: int) -> bytes:
        """Return a payload with an age, brought into the signal's range, or a clock's time, which wraps, in it."""
        signal, low = self.signal, shift(self.message, self.signal)
        stamp_ns = stamp_ns % self.wrap_ns if self.wrap_ns else stamp_ns
        least, most = representable_raw(signal)
        raw = round(min(max(to_raw(signal, stamp_ns / self.unit_ns), least), most))
        mask = (1 << signal.length) - 1
        # A longer message of another slot has further bytes: the signal lies as in the shortest.
        size = self.message.length
        payload = int.from_bytes(data[:size], signal.byte_order) & ~(mask << low) | (raw & mask) << low
        return payload.to_bytes(size, signal.byte_order) + data[size:]


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
        fixed: the value, if any, by which a frame is this header, written behind the others.

    """

    message: MessageSpec
    used_only: bool
    counts: tuple[HeaderCount, ...]
    counter: Callable[[bytes], int] | None
    period: int
    says_look: bool
    encode: Encoder
    protector: FrameProtector | None
    fixed: tuple[float, ...] = ()

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
        values: list[float] = [each.share(count) for each in self.counts]
        if self.counter is not None:
            values.append(counter % self.period)
        if self.says_look:
            values.append(look)
        payload, _ = self.encode([*values, *self.fixed])
        return self.can_id, payload if self.protector is None else self.protector.seal(self.can_id, payload)
