"""Layouts as arrays: payloads as 64-bit windows, and multiplexing by look-up, for all frames of a batch at once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Bytes, Floats, Integers
from candaemon.dbc import bits
from candaemon.dbc.bits import Gate, Place
from candaemon.dbc.types import MessageSpec, SignalSpec

EXACT_BITS: Final = 53
"""Bits of the longest integer that float64 holds exactly."""

TABLE_BITS: Final = 16
"""Bits of the longest multiplexer that is looked up in a table."""

WORD_TYPES: Final = {"little": np.dtype("<i8"), "big": np.dtype(">i8")}


KEPT_FRAMES: Final = 256
"""Frames of the largest batch that `RepeatedColumns` serves; in larger ones broadcasting costs next to nothing."""

KEPT_SIZES: Final = 64
"""Batch sizes that `RepeatedColumns` keeps."""


def fits_window(signal: SignalSpec) -> bool:
    """Return whether a signal can go through 64-bit windows and float64 without loss."""
    return bits.place(signal) is not None and (signal.is_float or signal.length <= EXACT_BITS)


def fits_table(selector: SignalSpec) -> bool:
    """Return whether a multiplexer can be looked up in a table."""
    return selector.length <= TABLE_BITS and not selector.is_float and fits_window(selector)


class Windows:
    """The 64-bit windows of a layout: payloads to one integer a signal and frame, and back.

    Args:
        length: payload bytes.
        signals: one a row; each must fit a window (`fits_window`).
    """

    def __init__(self, length: int, signals: Sequence[SignalSpec]) -> None:
        places = [bits.place(signal) or Place(0, 0) for signal in signals]
        wanted = [(signal.byte_order, place.byte) for signal, place in zip(signals, places, strict=True)]
        self._windows = sorted(set(wanted)) or [("little", 0)]
        self._rows = np.array([self._windows.index(each) for each in wanted], dtype=np.intp)
        self._members = [np.flatnonzero(self._rows == row) for row in range(len(self._windows))]
        self._length = length
        self._width = max(length, 8 + max(byte for _, byte in self._windows))
        self._word = WORD_TYPES[self._windows[0][0]] if len(self._windows) == 1 and length == 8 else None
        self.left = whole_column(place.left for place in places)

    def split(self, payloads: Bytes | bytes) -> Integers:
        """Read the windows of every frame.

        Args:
            payloads: uint8 (n, length), bytes of a row adjacent, or the n payloads joined.

        Returns:
            The window that holds each signal: (1, n) if it is one for all, else (signals, n).
        """
        if self._word is not None:
            words = np.frombuffer(payloads, self._word) if isinstance(payloads, bytes) else payloads.view(self._word)
            return words.astype(np.int64).reshape(1, -1)
        if not isinstance(payloads, np.ndarray):
            payloads = np.frombuffer(payloads, np.uint8).reshape(-1, max(self._length, 1))
        if self._width != self._length:
            padded = np.zeros((len(payloads), self._width), np.uint8)
            padded[:, : self._length] = payloads
            payloads = padded
        words = np.empty((len(self._windows), len(payloads)), np.int64)
        for row, (order, byte) in enumerate(self._windows):
            words[row] = payloads[:, byte : byte + 8].view(WORD_TYPES[order])[:, 0]
        return words if len(words) == 1 else words[self._rows]

    def join(self, bits: Integers) -> Bytes:
        """Or signals into payloads.

        Args:
            bits: (signals, n), each at its place in its window.

        Returns:
            The payloads (n, length).
        """
        if self._word is not None:
            word: Integers = np.bitwise_or.reduce(bits, axis=0)
            return word.astype(self._word, copy=False).view(np.uint8).reshape(-1, 8)
        payloads = np.zeros((bits.shape[1], self._width), np.uint8)
        for row, (order, byte) in enumerate(self._windows):
            word = np.bitwise_or.reduce(bits if len(self._windows) == 1 else bits[self._members[row]], axis=0)
            payloads[:, byte : byte + 8] |= word.astype(WORD_TYPES[order]).view(np.uint8).reshape(-1, 8)
        return payloads[:, : self._length]


class Multiplexing:
    """Which frames of a batch carry which signals, by look-up of the multiplexers' raw values.

    A negative raw value is an index from its table's end, which is where two's complement has it.

    Args:
        message: the layout.
        rows: row of each multiplexer in the raw arrays; each must fit a table (`fits_table`).
        chains: the gates that `present` will be asked for.
    """

    def __init__(self, message: MessageSpec, rows: dict[str, int], chains: Iterable[Sequence[Gate]]) -> None:
        self._rows = rows
        self._known: list[tuple[tuple[Gate, ...], Gate]] = []
        for selector in bits.multiplexers(message):
            if selector.name in rows:
                gate = Gate(selector.name, bits.known_ids(message, selector))
                self._known.append((bits.gates(message, selector) or (), gate))
        gates = {gate for chain in (*chains, *([*chain, gate] for chain, gate in self._known)) for gate in chain}
        self._tables: dict[Gate, Booleans] = {}
        for name in rows.keys() & {gate.multiplexer for gate in gates}:
            self._tables |= _tables(message.signal(name), [gate for gate in gates if gate.multiplexer == name])

    def present(self, chain: Sequence[Gate], raw: Integers) -> Booleans:
        """Return which frames pass all of one or more gates.

        Args:
            chain: the gates.
            raw: raw values (rows, n).

        Returns:
            (n,).
        """
        passed: Booleans = self._tables[chain[0]][raw[self._rows[chain[0].multiplexer]]]
        for gate in chain[1:]:
            passed &= self._tables[gate][raw[self._rows[gate.multiplexer]]]
        return passed

    def known(self, raw: Integers) -> Booleans:
        """Return which frames have only multiplexer values that the DBC knows: (n,) from raw values (rows, n)."""
        known = np.ones(raw.shape[1], np.bool_)
        for chain, gate in self._known:
            right = self.present([gate], raw)
            known &= right | ~self.present(chain, raw) if chain else right
        return known


class RepeatedColumns:
    """Columns (signals, 1) as arrays (signals, n), kept for each n seen.

    In a cycle's few dozen frames numpy spends half of its time on broadcasting; on equal shapes it does not.
    """

    def __init__(self, *columns: npt.NDArray[np.generic]) -> None:
        self._columns = columns
        self._kept: dict[int, tuple[npt.NDArray[Any], ...]] = {}

    def repeated(self, frames: int) -> tuple[npt.NDArray[Any], ...]:
        """Return the columns in the shape for so many frames; they must not be written to."""
        kept = self._kept.get(frames)
        if kept is not None:
            return kept
        if frames > KEPT_FRAMES:
            return self._columns
        if len(self._kept) == KEPT_SIZES:
            self._kept.clear()
        self._kept[frames] = stretched = tuple(np.repeat(each, frames, axis=1) for each in self._columns)
        return stretched


def real_column(values: Iterable[float]) -> Floats:
    """Return numbers as a column (len, 1), to broadcast against arrays (signals, n)."""
    return np.array(list(values), np.float64).reshape(-1, 1)


def whole_column(values: Iterable[int]) -> Integers:
    """Return integers as a column (len, 1), to broadcast against arrays (signals, n)."""
    return np.array(list(values), np.int64).reshape(-1, 1)


def _tables(selector: SignalSpec, gates: Iterable[Gate]) -> dict[Gate, Booleans]:
    """Tabulate for each gate which raw values of its multiplexer pass."""
    size = 1 << selector.length
    raws: dict[int, list[int]] = {}  # by value
    for raw in range(-size // 2, size // 2) if selector.signed else range(size):
        value = raw * selector.scale + selector.offset
        if math.isfinite(value):
            raws.setdefault(int(value), []).append(raw)
    tables = {}
    for gate in gates:
        tables[gate] = table = np.zeros(size, np.bool_)
        table[[raw for value in gate.ids & raws.keys() for raw in raws[value]]] = True
    return tables
