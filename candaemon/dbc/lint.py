"""What looks wrong in a message of a DBC, though it can be used: bits, ranges, lengths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from candaemon.dbc import bits
from candaemon.dbc.bits import Gate
from candaemon.dbc.types import MessageSpec, SignalSpec

Report = Callable[[int, str], None]
"""Takes a 1-based line and what was found there."""

FD_LENGTH: Final = 64
"""Payload bytes of a CAN FD frame, at most."""

MOST_OVERLAPS: Final = 100
"""Overlaps of signals that are told of one message."""

MOST_COMPARISONS: Final = 1 << 20
"""Steps of looking for overlaps, in all messages of a file."""

_Chain = tuple[Gate, ...]


@dataclass(slots=True)
class _Alike:
    """The signals of a message that have the same conditions.

    Attributes:
        conditions: values of each multiplexer.
        bits: those that any of them takes.
        members: bits and index of each.
    """

    conditions: Mapping[str, frozenset[int]]
    bits: int = 0
    members: list[tuple[int, int]] = field(default_factory=list)


class Lint:
    """Reports what looks wrong in the messages of one file.

    Args:
        report: called for each oddity.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._compared = 0

    def check(self, message: MessageSpec) -> None:
        """Report what looks wrong in a message."""
        carried = self._carried(message)
        if self._compared <= MOST_COMPARISONS:
            self._check_overlaps(message, carried)
        else:
            self._report(message.line, f"overlaps of signals of message '{message.name}' are not looked for: too many")
        for signal in message.signals:
            self._check_values(message, signal)
        if message.length > FD_LENGTH:
            self._report(
                message.line, f"message '{message.name}' has {message.length} bytes, a CAN FD frame {FD_LENGTH} at most"
            )

    def _carried(self, message: MessageSpec) -> list[tuple[SignalSpec, _Chain]]:
        """List the signals that frames carry, with their conditions; report the others."""
        carried = []
        for signal in message.signals:
            chain = bits.gates(message, signal)
            if not bits.readable(message, signal):
                self._report(
                    signal.line,
                    f"signal '{signal.name}' lies outside message '{message.name}' of {message.length} bytes: "
                    "never read",
                )
            elif chain is None:
                parent = message.find(signal.multiplexer_signal or "")
                nested = parent is not None and parent.is_multiplexer and bits.readable(message, parent)
                why = f"within more than {bits.DEEPEST_MULTIPLEXING} others" if nested else "no multiplexer"
                self._report(
                    signal.line,
                    f"signal '{signal.name}' is selected by '{signal.multiplexer_signal}', {why}: never read",
                )
            else:
                carried.append((signal, chain))
        return carried

    def _check_overlaps(self, message: MessageSpec, carried: Sequence[tuple[SignalSpec, _Chain]]) -> None:
        """Report signals that share bits in one frame.

        Signals with the same conditions are compared through the bits they take together, not pair by pair, unless they
        do overlap.
        """
        groups: dict[_Chain, _Alike] = {}
        told = 0
        for index, (signal, chain) in enumerate(carried):
            own = _bits_of(message, signal)
            conditions = dict(chain)
            met: list[int] = []
            self._compared += len(groups)
            for group in groups.values():
                if group.bits & own and not self._apart(conditions, group.conditions):
                    self._compared += len(group.members)
                    met += [earlier for earlier_bits, earlier in group.members if earlier_bits & own]
            for earlier in sorted(met):
                first, second = sorted((carried[earlier][0], signal), key=lambda each: each.line)
                if told == MOST_OVERLAPS or self._compared > MOST_COMPARISONS:
                    self._report(message.line, f"more signals of message '{message.name}' overlap than are told")
                    return
                told += 1
                self._report(
                    second.line,
                    f"signals '{first.name}' and '{second.name}' of message '{message.name}' overlap: both are read",
                )
            group = groups.setdefault(chain, _Alike(conditions))
            group.bits |= own
            group.members.append((own, index))

    def _apart(self, some: Mapping[str, frozenset[int]], others: Mapping[str, frozenset[int]]) -> bool:
        """Return whether no frame can pass the conditions of both."""
        for multiplexer, ids in some.items():
            more = others.get(multiplexer, ids)
            if more is not ids:
                self._compared += min(len(ids), len(more)) >> 4
                if ids.isdisjoint(more):
                    return True
        return False

    def _check_values(self, message: MessageSpec, signal: SignalSpec) -> None:
        """Report a signal whose scale or range cannot be meant."""
        if signal.scale == 0:
            self._report(
                signal.line, f"signal '{signal.name}' of message '{message.name}' has scale 0: constant, cannot be sent"
            )
            return
        given, (low, high) = bits.dbc_raw_range(signal), bits.representable_raw(signal)
        if given is not None and (given[0] > high or given[1] < low):
            self._report(
                signal.line,
                f"range [{signal.minimum}|{signal.maximum}] of signal '{signal.name}' is beyond its bits: not used",
            )


def _bits_of(message: MessageSpec, signal: SignalSpec) -> int:
    """Return the signal's bits as ones in an integer, numbered as those of little-endian signals are."""
    ones = ((1 << signal.length) - 1) << bits.shift(message, signal)
    if signal.byte_order == "little":
        return ones
    return int.from_bytes(ones.to_bytes(message.length, "big"), "little")
