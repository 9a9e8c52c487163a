"""Counters' companions: checksums of frames, one at a time to verify, a whole cycle at once to fill.

Every checksum covers all of the payload but itself; it fills a byte, honda's half a byte. Kinds:

- `toyota`: sum of the identifier's bytes, the length and the payload, modulo 256.
- `honda`: 8 less the sum of all half bytes of identifier and payload, 3 more with a 29-bit identifier, modulo 16.
- `xor`: exclusive or of the payload.
- `additive`: sum of the payload modulo 256.
- `crc8_sae_j1850`: polynomial 0x1D, start 0xFF, final XOR 0xFF; "123456789" gives 0x4B.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np

from candaemon.arrays import Booleans, Bytes, Integers
from candaemon.dbc.bits import first_bit
from candaemon.dbc.types import MessageSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED
from candaemon.frames.frame_block import FD_LENGTHS

Kind = Literal["toyota", "honda", "xor", "additive", "crc8_sae_j1850"]

POLYNOMIAL: Final = 0x1D


def _crc_table() -> bytes:
    """CRC-8 remainder of every byte."""
    table = bytearray(256)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1) ^ (POLYNOMIAL if crc & 0x80 else 0)
            crc &= 0xFF
        table[byte] = crc
    return bytes(table)


CRC_TABLE: Final = _crc_table()
NIBBLE_SUMS: Final = bytes((byte >> 4) + (byte & 0xF) for byte in range(256))
"""Sum of the half bytes of every byte."""


def crc8_sae_j1850(data: bytes) -> int:
    """CRC-8 SAE J1850 of some bytes."""
    crc, table = 0xFF, CRC_TABLE
    for byte in data:
        crc = table[crc ^ byte]
    return crc ^ 0xFF


def id_sum(kind: Kind, can_id: int) -> int:
    """Return what an identifier adds to a checksum of a kind: its bytes' sum, for honda that of its half bytes."""
    identifier = (can_id & ~EXTENDED).to_bytes(4, "big")
    if kind == "honda":
        return sum(identifier.translate(NIBBLE_SUMS)) - 3 * bool(can_id & EXTENDED)
    return sum(identifier) if kind == "toyota" else 0


class FrameProtector(Protocol):
    """What protects the frames of some messages: checks it in one frame, writes it into one or many."""

    def verify(self, can_id: int, data: bytes) -> bool:
        """Return whether a frame of one of the messages is what was sent; one too short never is."""
        ...

    def seal(self, can_id: int, payload: bytes) -> bytes:
        """Return one frame's payload with its checksum written into it."""
        ...

    def fill(self, can_ids: Integers, payloads: Bytes) -> None:
        """Write the checksums of frames (n, length) laid out alike into them, in place."""
        ...


class _Place(NamedTuple):
    """Where one message keeps its checksum: byte, bits below it there and its mask; and what the identifier adds."""

    position: int
    shift: int
    mask: int
    length: int
    id_sum: int


class Protector:
    """The checksum of messages of one kind; where in the frame it is may differ between them.

    Args:
        kind: how the checksum is made.
        messages: the messages.
        signal: name of the checksum signal in each: 8 bits on a byte of its own; for honda 4 bits, half of one.

    Raises:
        ConfigError: a message has no such signal, or it does not fill its byte or half byte.

    """

    def __init__(self, kind: Kind, messages: Sequence[MessageSpec], signal: str) -> None:
        self.kind: Final = kind
        self._places = {message.can_id: _place(kind, message, signal) for message in messages}
        self._position, self._shift, self._mask, self._length, _ = self._places[messages[0].can_id]
        self._ids = np.array(sorted(self._places), np.int64)
        self._of_ids = np.array([self._places[can_id] for can_id in sorted(self._places)], np.int64).T
        self._padded = any(each.length not in FD_LENGTHS for each in self._places.values())
        self._others = np.array([byte for byte in range(self._length) if byte != self._position], dtype=np.intp)
        if kind == "crc8_sae_j1850":
            self._tables, self._start = self._positional_tables()

    def position(self, can_id: int) -> int:
        """Return the byte of a message's checksum."""
        return self._places[can_id].position

    def checksum(self, can_id: int, data: bytes) -> int:
        """Compute the checksum that a frame should carry, which is at least as long as its message."""
        position, shift, _, _, identifier = self._places[can_id]
        match self.kind:
            case "toyota":
                return (sum(data) - data[position] + identifier + len(data)) & 0xFF
            case "honda":
                own = data[position] >> shift & 0xF
                return (8 - identifier - sum(data.translate(NIBBLE_SUMS)) + own) & 0xF
            case "additive":
                return (sum(data) - data[position]) & 0xFF
            case "xor":
                value = data[position]
                for byte in data:
                    value ^= byte
                return value
            case "crc8_sae_j1850":
                return crc8_sae_j1850(data[:position] + data[position + 1 :])

    def verify(self, can_id: int, data: bytes) -> bool:
        """Return whether a frame of one of the messages carries the checksum it should; one too short never does."""
        position, shift, mask, length, _ = self._places[can_id]
        if self._padded and length not in FD_LENGTHS:
            data = data[:length]  # a controller fills it up to a length that a frame has
        return len(data) >= length and data[position] >> shift & mask == self.checksum(can_id, data)

    def verified(self, can_ids: Integers, lengths: Integers, payloads: Bytes) -> Booleans:
        """Return which of many frames carry the checksum they should: what `verify` tells of each.

        Args:
            can_ids: (n,) identifiers of its messages, with the extended flag where they have it.
            lengths: (n,) bytes of each payload.
            payloads: (n, width), zeros after the length.
        """
        position, shift, mask, least, _ = self._of_ids[:, np.searchsorted(self._ids, can_ids)]
        if self._padded:
            padded = ~np.isin(least, list(FD_LENGTHS))
            lengths = np.where(padded, np.minimum(lengths, least), lengths)
            payloads = np.where(np.arange(payloads.shape[1]) < lengths[:, None], payloads, 0).astype(np.uint8)
        column = np.minimum(position, payloads.shape[1] - 1)  # of a frame that is too short it does not matter
        carried = payloads[np.arange(len(payloads)), column] >> shift & mask
        right: Booleans = (lengths >= least) & (carried == self._checksums(can_ids, lengths, payloads))
        return right

    def _checksums(self, can_ids: Integers, lengths: Integers, payloads: Bytes) -> Integers:
        """Compute the checksums that many frames should carry, (n,): what `checksum` tells of each; see `verified`."""
        position, shift, _, _, identifier = self._of_ids[:, np.searchsorted(self._ids, can_ids)]
        column = np.minimum(position, payloads.shape[1] - 1)
        own = payloads[np.arange(len(payloads)), column].astype(np.int64)
        found: Integers
        match self.kind:
            case "toyota":
                found = payloads.sum(axis=1, dtype=np.int64) - own + identifier + lengths & 0xFF
            case "honda":
                sums = np.frombuffer(NIBBLE_SUMS, np.uint8).take(payloads).sum(axis=1, dtype=np.int64)
                found = 8 - identifier - sums + (own >> shift & 0xF) & 0xF
            case "additive":
                found = payloads.sum(axis=1, dtype=np.int64) - own & 0xFF
            case "xor":
                found = np.bitwise_xor.reduce(payloads, axis=1) ^ own
            case "crc8_sae_j1850":
                found = self._crcs(position, lengths, payloads)
        return found

    def _crcs(self, position: Integers, lengths: Integers, payloads: Bytes) -> Integers:
        """Return the CRC of each of many payloads, but for the byte at its position."""
        table, crc = np.frombuffer(CRC_TABLE, np.uint8), np.full(len(payloads), 0xFF, np.uint8)
        for byte, column in enumerate(payloads.T):
            crc = np.where((byte < lengths) & (byte != position), table[crc ^ column], crc)
        return crc.astype(np.int64) ^ 0xFF

    def seal(self, can_id: int, payload: bytes) -> bytes:
        """Return one frame's payload with its checksum written into it."""
        position, shift, mask, _, _ = self._places[can_id]
        kept = payload[position] & ~(mask << shift)
        sealed = kept | self.checksum(can_id, payload) << shift
        return payload[:position] + bytes((sealed,)) + payload[position + 1 :]

    def fill(self, can_ids: Integers, payloads: Bytes) -> None:
        """Write the checksums of a cycle's frames into them.

        All must be of messages laid out as the first one is.

        Args:
            can_ids: (n,) identifiers, with the extended flag where they have it.
            payloads: (n, length), changed in place.

        """
        if self.kind == "crc8_sae_j1850":  # of our own output: by tables, in a third of the time
            terms = self._tables[np.arange(self._length - 1), payloads[:, self._others]]
            payloads[:, self._position] = np.bitwise_xor.reduce(terms, axis=1) ^ self._start
            return
        checksums = self._checksums(can_ids, np.full(len(payloads), self._length), payloads)
        column = payloads[:, self._position]
        column &= 0xFF ^ (self._mask << self._shift)
        column |= (checksums << self._shift).astype(np.uint8)

    def _positional_tables(self) -> tuple[Bytes, np.uint8]:
        """Tabulate what each value of each byte contributes to the CRC, and return the CRC of all zeros.

        A CRC of a fixed length is affine in its bits, so the bytes' shares are looked up at once and XORed.
        """
        count = self._length - 1
        tables, table = np.empty((count, 256), np.uint8), np.frombuffer(CRC_TABLE, np.uint8)
        share: Bytes = np.arange(256, dtype=np.uint8)
        for byte in reversed(range(count)):
            tables[byte] = share = table[share]  # each further byte after it is one more step of the remainder
        return tables, np.uint8(crc8_sae_j1850(bytes(count)))


def _place(kind: Kind, message: MessageSpec, signal: str) -> _Place:
    """Return where a message keeps its checksum."""
    spec = message.signal(signal)
    first, bits = first_bit(spec), 4 if kind == "honda" else 8
    if spec.length != bits or first % bits or first + bits > 8 * message.length:
        fills = "half a byte" if bits == 4 else "one byte"
        raise ConfigError(
            f"checksum signal '{signal}' of '{message.name}' starts at bit {spec.start} with {spec.length} bits; "
            f"expected {bits} bits that fill {fills} of the message",
            file=message.file,
            line=spec.line or None,
        )
    position, within = divmod(first, 8)
    shift = within if spec.byte_order == "little" else 8 - within - bits
    return _Place(position, shift, (1 << bits) - 1, message.length, id_sum(kind, message.can_id))
