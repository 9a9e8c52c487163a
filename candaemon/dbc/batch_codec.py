"""All frames of a cycle decoded or encoded at once, for messages laid out alike.

Every payload is read as 64-bit windows, and each step (shift, mask, scale, offset) is one numpy operation over all
signals and frames. The results are those of `single_codec`, which are cantools': to 1e-9 decoding, byte for byte
encoding. Overlapping signals are all decoded, their common bits read twice; encoding ors them.

What no radar sends in bulk (signals over 53 bits, multiplexers over 16 bits) goes through `single_codec`'s functions
frame by frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Bytes, Floats, Integers
from candaemon.dbc import bits
from candaemon.dbc.bit_windows import (
    Multiplexing,
    RepeatedColumns,
    Windows,
    fits_table,
    fits_window,
    real_column,
    whole_column,
)
from candaemon.dbc.bits import Gate
from candaemon.dbc.single_codec import compile_decoder, compile_encoder, encodable
from candaemon.dbc.types import MessageSpec, SignalSpec

FLOAT_TYPES: Final = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}


class BatchDecoder:
    """Decodes many frames of one layout at once.

    Args:
        message: the layout; messages for which `same_layout` holds share it.
        signals: names of the signals wanted, in the order of the rows; None for all of the message's.

    Raises:
        ConfigError: the message lacks a signal.
    """

    def __init__(self, message: MessageSpec, signals: Iterable[str] | None = None) -> None:
        wanted = message.select(signals)
        selectors = bits.multiplexers(message)
        self._count, self._length = len(wanted), message.length
        self._one = compile_decoder(message, [signal.name for signal in wanted])
        self._by_one = message.length == 0 or not all(map(fits_table, selectors))
        chains = [bits.gates(message, s) if bits.readable(message, s) else None for s in wanted]
        slow = [row for row, s in enumerate(wanted) if chains[row] is not None and not fits_window(s)]
        self._slow = slow, compile_decoder(message, [wanted[row].name for row in slow])
        self._never = [row for row, chain in enumerate(chains) if chain is None]
        self._floats = [(row, s) for row, s in enumerate(wanted) if s.is_float and row not in self._never]
        self._gated = _by_chain(chains)
        rows = [s if row not in (*slow, *self._never) else _NOTHING for row, s in enumerate(wanted)] + list(selectors)
        if self._by_one:
            return
        selector_rows = {s.name: self._count + i for i, s in enumerate(selectors)}
        self._multiplexing = Multiplexing(message, selector_rows, [chain for chain, _ in self._gated])
        self._windows = Windows(message.length, rows)
        right = whole_column(64 - s.length for s in rows)
        mask = whole_column(-1 if s.signed or s.length == 64 else (1 << s.length) - 1 for s in rows)
        self._to_raw = RepeatedColumns(self._windows.left, right, mask)
        self._to_value = RepeatedColumns(real_column(s.scale for s in wanted), real_column(map(_addend, wanted)))
        self._scaled = any(s.scale != 1 for s in wanted)
        self._shifted = any(s.offset != 0 for s in wanted)
        self._special = bool(slow or self._never or self._floats or selectors)
        self._selected = bool(selectors)

    def decode(self, payloads: Bytes | bytes) -> Floats:
        """Decode n frames.

        Args:
            payloads: uint8 (n, length), or the n payloads joined; each cut to `message.length` bytes.

        Returns:
            Values (signals, n), the caller's own. NaN where a frame does not carry the signal; a frame whose
            multiplexer value the DBC does not know is NaN throughout.

        Raises:
            ValueError: the bytes are no whole number of payloads.
        """
        if self._by_one:
            return self._one_by_one(payloads)
        raw = self._raw(payloads)
        scale, offset = self._to_value.repeated(raw.shape[1])
        counts = raw[: self._count]
        values: Floats = counts * scale if self._scaled else counts.astype(np.float64)
        if self._shifted:
            values += offset
        if self._special:
            self._complete(values, raw, payloads)
        return values

    def known(self, payloads: Bytes | bytes) -> Booleans:
        """Return which frames have only multiplexer values that the DBC knows.

        Args:
            payloads: as for `decode`.

        Returns:
            (n,); all True where the message has no multiplexer.
        """
        if self._by_one:
            return np.array([self._one(data) is not None for data in self._split(payloads)], dtype=np.bool_)
        if not self._selected:
            return np.ones(len(payloads) // (1 if isinstance(payloads, np.ndarray) else self._length), np.bool_)
        return self._multiplexing.known(self._raw(payloads))

    def _raw(self, payloads: Bytes | bytes) -> Integers:
        """Return raw integers (signals + multiplexers, n): up to bit 63, down with the sign, unsigned ones masked."""
        words = self._windows.split(payloads)
        left, right, mask = self._to_raw.repeated(words.shape[1])
        raw: Integers = words << left
        raw >>= right
        raw &= mask
        return raw

    def _complete(self, values: Floats, raw: Integers, payloads: Bytes | bytes) -> None:
        """Put in what integers in 64-bit windows cannot give."""
        with np.errstate(invalid="ignore", over="ignore"):  # random bits make signalling NaN
            for row, signal in self._floats:
                bits, real = FLOAT_TYPES[signal.length]
                values[row] = raw[row].astype(bits).view(real).astype(np.float64) * signal.scale + _addend(signal)
        rows, decoder = self._slow
        if rows:
            values[rows] = (
                np.array([decoder(data) or (np.nan,) * len(rows) for data in self._split(payloads)], dtype=np.float64)
                .reshape(-1, len(rows))
                .T
            )
        values[self._never] = np.nan
        for chain, gated in self._gated:
            absent = ~self._multiplexing.present(chain, raw)
            for row in gated:
                values[row, absent] = np.nan
        if self._selected:
            values[:, ~self._multiplexing.known(raw)] = np.nan

    def _split(self, payloads: Bytes | bytes) -> list[bytes]:
        if isinstance(payloads, np.ndarray):
            return [row.tobytes() for row in payloads]
        step = max(self._length, 1)
        return [payloads[at : at + step] for at in range(0, len(payloads), step)]

    def _one_by_one(self, payloads: Bytes | bytes) -> Floats:
        nothing = (np.nan,) * self._count
        rows = [values if (values := self._one(data)) is not None else nothing for data in self._split(payloads)]
        return np.array(rows, dtype=np.float64).reshape(-1, self._count).T


class BatchEncoder:
    """Encodes many frames of one layout at once.

    Args:
        message: the layout.
        signals: names of the signals that will be given, in the order of the rows; None for all of the message's.

    Raises:
        ConfigError: the message lacks a signal, or one cannot be encoded (see `compile_encoder`).
    """

    def __init__(self, message: MessageSpec, signals: Iterable[str] | None = None) -> None:
        given = encodable(message, signals)
        rows = {signal.name: row for row, signal in enumerate(given)}
        selectors = [selector for selector in bits.multiplexers(message) if selector.name in rows]
        self._one = compile_encoder(message, [signal.name for signal in given])
        self._by_one = not all(map(fits_window, given)) or not all(map(fits_table, selectors)) or not given
        self._length = message.length
        if self._by_one:
            return
        self._gated = _by_chain([bits.gates(message, signal) for signal in given])
        selector_rows = {s.name: rows[s.name] for s in selectors}
        self._multiplexing = Multiplexing(message, selector_rows, [chain for chain, _ in self._gated])
        self._floats = [(row, FLOAT_TYPES[s.length]) for row, s in enumerate(given) if s.is_float]
        self._windows = Windows(message.length, given)
        shift = 64 - whole_column(s.length for s in given) - self._windows.left
        mask = whole_column((1 << s.length) - 1 if s.signed and s.length < 64 else -1 for s in given)
        self._to_bits = RepeatedColumns(mask, shift)
        self._signed = any(s.signed for s in given)
        limits = [(*bits.sendable_raw(s), bits.raw_fallback(s)) for s in given]
        low, high, self._fallback = (real_column(each[i] for each in limits) for i in range(3))
        scale, offset = real_column(s.scale for s in given), real_column(s.offset for s in given)
        self._to_raw = RepeatedColumns(offset, scale, low, high)
        self._scaled = any(s.scale != 1 for s in given)
        self._shifted = any(s.offset != 0 for s in given)

    def encode(self, values: Floats) -> tuple[Bytes, int]:
        """Encode n frames.

        Args:
            values: (signals, n).

        Returns:
            Payloads (n, length), and how many values were saturated; rounding, saturation, NaN and multiplexing as with
            `compile_encoder`.
        """
        if self._by_one:
            return self._one_by_one(values)
        offset, scale, low, high = self._to_raw.repeated(values.shape[1])
        raw = self._raw(values, offset, scale)
        kept = np.maximum(raw, low)
        np.minimum(kept, high, out=kept)
        changed = kept != raw
        for row, _ in self._floats:  # of two zeros, maximum and minimum take either; a float's bits tell them apart
            np.copyto(kept[row], raw[row], where=~changed[row])
        saturated = int(np.count_nonzero(changed))
        if saturated:
            np.copyto(kept, self._fallback, where=np.isnan(kept))
        bits = self._bits(kept)
        if self._gated:
            present = self._present(bits)
            saturated = int(np.count_nonzero(changed & present))
            bits *= present
        mask, shift = self._to_bits.repeated(values.shape[1])
        if self._signed:
            bits &= mask
        bits <<= shift
        return self._windows.join(bits), saturated

    def _raw(self, values: Floats, offset: Floats, scale: Floats) -> Floats:
        """Raw values: integers rounded half to even, floats as they are."""
        with np.errstate(over="ignore"):  # an absurd value saturates as infinity does
            raw = values - offset if self._shifted else values
            if self._scaled:
                raw = raw / scale
        rounded = np.rint(raw)
        for row, _ in self._floats:
            rounded[row] = raw[row]
        return rounded

    def _bits(self, kept: Floats) -> Integers:
        """Raw values within their limits as integers; floats as the integer of their bits."""
        patterns = [kept[row].astype(real).view(bits) for row, (bits, real) in self._floats]
        for row, _ in self._floats:
            kept[row] = 0
        whole = kept.astype(np.int64)
        for (row, _), pattern in zip(self._floats, patterns, strict=True):
            whole[row] = pattern.astype(np.int64)
        return whole

    def _present(self, raw: Integers) -> Booleans:
        present = np.ones(raw.shape, np.bool_)
        for chain, rows in self._gated:
            present[rows] = self._multiplexing.present(chain, raw)
        return present

    def _one_by_one(self, values: Floats) -> tuple[Bytes, int]:
        frames = [self._one(column_values) for column_values in np.asarray(values).T.tolist()]
        joined = b"".join(payload for payload, _ in frames)
        payloads = np.frombuffer(joined, np.uint8).reshape(len(frames), self._length)
        return payloads, sum(saturated for _, saturated in frames)


_NOTHING: Final = SignalSpec(name="", start=0, length=1)
"""Stands in a row that is filled in otherwise."""


def _addend(signal: SignalSpec) -> float:
    """Return a signal's offset; minus zero where it has none, for plus zero would make a minus zero plus."""
    return signal.offset or -0.0


def _by_chain(chains: Sequence[tuple[Gate, ...] | None]) -> list[tuple[tuple[Gate, ...], list[int]]]:
    """Group the rows of multiplexed signals by their conditions."""
    return [(chain, [row for row, c in enumerate(chains) if c == chain]) for chain in dict.fromkeys(chains) if chain]
