"""What looks wrong in a message of a DBC, though it can be used: bits, ranges, lengths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

MOST_COMPARISONS: Final = 1 << 22
"""Steps of looking for overlaps, in all messages of a file."""

_Chain = tuple[Gate, ...]


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
        alike: dict[_Chain, list[tuple[int, int]]] = {}  # by conditions: each signal's bits, and its index
        together: dict[_Chain, int] = {}
        told = 0
        for index, (signal, chain) in enumerate(carried):
            own = _bits_of(message, signal)
            met: list[int] = []
            for other, taken in together.items():
                if taken & own and not self._apart(chain, other):
                    self._compared += len(alike[other])
                    met += [earlier for earlier_bits, earlier in alike[other] if earlier_bits & own]
            self._compared += len(together)
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
            alike.setdefault(chain, []).append((own, index))
            together[chain] = together.get(chain, 0) | own

    def _apart(self, a: _Chain, b: _Chain) -> bool:
        """Return whether no frame can pass the conditions of both."""
        others = dict(b)
        common = [(ids, others[multiplexer]) for multiplexer, ids in a if multiplexer in others]
        self._compared += sum(min(len(some), len(more)) for some, more in common if some is not more)
        return any(some is not more and some.isdisjoint(more) for some, more in common)

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
