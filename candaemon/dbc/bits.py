"""Where a signal's bits lie, when a frame carries it and which raw values it can hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from candaemon.dbc.types import MessageSpec, SignalSpec

LONGEST_NUMBER: Final = 512
"""Bits of the longest signal that is read as a number: a whole CAN FD payload."""

FLOAT_LIMIT: Final = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}
"""Greatest finite IEEE 754 number, by bits."""


NEARLY: Final = 1e-6
"""Share of a signal's step within which a number of the configuration means a value of the signal."""


DEEPEST_MULTIPLEXING: Final = 8
"""Multiplexers that select one another, at most."""


class Gate(NamedTuple):
    """A condition for a signal to be in a frame: the multiplexer's value is one of the ids."""

    multiplexer: str
    ids: frozenset[int]


class Place(NamedTuple):
    """A signal within a 64-bit window of the payload.

    Attributes:
        byte: the window's first byte.
        left: shift to the left that brings the signal's most significant bit to bit 63.
    """

    byte: int
    left: int


def first_bit(signal: SignalSpec) -> int:
    """Count the bits before the signal, in the direction of its byte order.

    Little-endian counts from each byte's least significant bit, big-endian from its most significant: either way the
    signal's bits are then consecutive.
    """
    return signal.start if signal.byte_order == "little" else signal.start ^ 7


def readable(message: MessageSpec, signal: SignalSpec) -> bool:
    """Return whether the signal lies within the message and is short enough to be a number."""
    return first_bit(signal) + signal.length <= 8 * message.length and signal.length <= LONGEST_NUMBER


def shift(message: MessageSpec, signal: SignalSpec) -> int:
    """Bits below the signal when the whole payload is one integer of the signal's byte order."""
    first = first_bit(signal)
    return first if signal.byte_order == "little" else 8 * message.length - first - signal.length


def place(signal: SignalSpec) -> Place | None:
    """Choose the 64-bit window a signal is read from, an aligned one where possible; None if it fits in none."""
    first = first_bit(signal)
    for byte in (first // 64 * 8, first // 8):
        left = first - 8 * byte if signal.byte_order == "big" else 64 - (first - 8 * byte) - signal.length
        if first - 8 * byte + signal.length <= 64:
            return Place(byte, left)
    return None


def known_ids(message: MessageSpec, multiplexer: SignalSpec) -> frozenset[int]:
    """Values of a multiplexer that the DBC knows: those that select a signal, and those its value table names.

    Empty where nothing depends on it, so that any value is known.
    """
    children = {s.multiplexer_ids for s in message.signals if s.multiplexer_signal == multiplexer.name}
    return frozenset().union(*children, multiplexer.choices or ())


def gates(message: MessageSpec, signal: SignalSpec) -> tuple[Gate, ...] | None:
    """List the conditions for a frame to carry the signal, outermost multiplexer first.

    None if no frame can, or where they are more than `DEEPEST_MULTIPLEXING`, as those of multiplexers in a circle are.
    """
    chain: list[Gate] = []
    while signal.multiplexer_signal is not None:
        parent = message.find(signal.multiplexer_signal)
        if parent is None or not parent.is_multiplexer or not readable(message, parent):
            return None
        if not signal.multiplexer_ids or len(chain) == DEEPEST_MULTIPLEXING:
            return None
        chain.append(Gate(parent.name, signal.multiplexer_ids))
        signal = parent
    return tuple(reversed(chain))


def multiplexers(message: MessageSpec) -> tuple[SignalSpec, ...]:
    """List the multiplexers whose value matters, outer before inner."""
    selecting = {signal.multiplexer_signal for signal in message.signals if signal.multiplexer_ids}
    found = [
        (len(chain), signal)
        for signal in message.signals
        if signal.is_multiplexer and readable(message, signal) and (signal.name in selecting or signal.choices)
        for chain in [gates(message, signal)]
        if chain is not None
    ]
    return tuple(signal for _, signal in sorted(found, key=lambda pair: pair[0]))


def is_integral(number: float) -> bool:
    """Return whether a scale or offset is a whole number of sane size, so that integers stay exact."""
    return float(number).is_integer() and abs(number) < 1 << 63


def to_raw(signal: SignalSpec, value: float) -> float:
    """Convert a value to raw, unrounded."""
    return (value - signal.offset) / signal.scale


def representable_raw(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest raw value that the signal's bits can hold."""
    if signal.is_float:
        return -FLOAT_LIMIT[signal.length], FLOAT_LIMIT[signal.length]
    if signal.signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def dbc_raw_range(signal: SignalSpec) -> tuple[float, float] | None:
    """Least and greatest raw value by the DBC's [min|max], rounded as values are; None where it gives no range."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum or signal.scale == 0:
        return None
    ends = sorted((to_raw(signal, signal.minimum), to_raw(signal, signal.maximum)))
    if signal.is_float:
        return ends[0], ends[1]
    low, high = (round(end) if math.isfinite(end) else end for end in ends)
    return low, high


def sendable_raw(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest raw value to send: the tighter of the DBC's range and of what the bits hold.

    A range that the bits cannot reach at all is a mistake in the DBC and is ignored.
    """
    low, high = representable_raw(signal)
    given = dbc_raw_range(signal)
    if given is None or given[0] > high or given[1] < low:
        return low, high
    return max(low, given[0]), min(high, given[1])


def raw_fallback(signal: SignalSpec) -> float:
    """Raw value to send for NaN: the signal's start value, else that of zero, brought into its limits."""
    low, high = sendable_raw(signal)
    wanted = signal.initial if signal.initial is not None else to_raw(signal, 0.0)
    if not signal.is_float and math.isfinite(wanted):
        wanted = round(wanted)
    return min(max(wanted, low), high)


def representable_values(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest value that a signal's bits can hold, whatever range the DBC gives."""
    low, high = (raw * signal.scale + signal.offset for raw in representable_raw(signal))
    return min(low, high), max(low, high)


def sendable_values(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest value that can be sent in a signal."""
    low, high = (raw * signal.scale + signal.offset for raw in sendable_raw(signal))
    return min(low, high), max(low, high)


def value_count(signal: SignalSpec) -> int:
    """Count the values that a counter or identity in this signal can have."""
    return 1 << min(signal.length, 62)


def as_decoded(signal: SignalSpec, value: float) -> float:
    """Return the value that the decoder gives for a number, where it is one of the signal's values, else the number.

    A step of 0.1 decodes three steps as 0.30000000000000004, which `in: [0.3]` should find.
    """
    raw = math.nan if signal.is_float or signal.scale == 0 else to_raw(signal, value)
    if not math.isfinite(raw):
        return value
    nearest = round(raw) * signal.scale + signal.offset
    return nearest if abs(nearest - value) <= NEARLY * abs(signal.scale) else value


def has_value(signal: SignalSpec, value: float) -> bool:
    """Tell whether a number is one of the values that a signal's bits can hold."""
    if signal.is_float or signal.scale == 0:
        return signal.is_float or value == signal.offset
    raw, (low, high) = to_raw(signal, value), representable_raw(signal)
    return low <= round(raw) <= high and abs(raw - round(raw)) <= NEARLY


def same_layout(a: MessageSpec, b: MessageSpec, signals: Iterable[str]) -> bool:
    """Return whether two messages carry the named signals identically, so that one batch codec serves both.

    Lengths, bits, scaling, limits, start values and multiplexing are compared; ids, comments, units and texts are not.
    """
    names = list(signals)
    traits = _traits(a, names)
    return traits is not None and traits == _traits(b, names)


def _traits(message: MessageSpec, names: Sequence[str]) -> tuple[object, ...] | None:
    signals = [signal for name in names if (signal := message.find(name)) is not None]
    if len(signals) != len(names):
        return None
    selectors = multiplexers(message)
    bits = [
        (
            s.name,
            s.start,
            s.length,
            s.byte_order,
            s.signed,
            s.is_float,
            s.scale,
            s.offset,
            s.minimum,
            s.maximum,
            s.initial,
        )
        for s in (*signals, *selectors)
    ]
    chains = [gates(message, signal) for signal in signals]
    return message.length, bits, chains, [known_ids(message, selector) for selector in selectors]
