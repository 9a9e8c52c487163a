"""AUTOSAR end-to-end protection of frames: profiles 1, 2, 5 and 11, their CRCs by the library `autosar-e2e`.

The library knows CRC and data id; what a counter may do from one frame to the next is `protect_sequence`'s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any, Final, NamedTuple, TypeAlias

from candaemon.arrays import Bytes, Integers
from candaemon.config.protection import E2eProfile1, E2eProfile2, E2eProfile5, E2eProfile11
from candaemon.dbc.bits import first_bit
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError

Profile: TypeAlias = E2eProfile1 | E2eProfile2 | E2eProfile5 | E2eProfile11


class E2eHeader(NamedTuple):
    """What a profile keeps where: the counter's byte after the offset, its bits and values, and the CRC's bits."""

    counter_byte: int
    counter_bits: int
    counter_values: int
    crc_bits: int


HEADERS: Final = {
    1: E2eHeader(1, 4, 15, 8),
    2: E2eHeader(1, 4, 16, 8),
    5: E2eHeader(2, 8, 256, 16),
    11: E2eHeader(1, 4, 15, 8),
}
"""By profile."""
MODES: Final = {
    1: {"both": "E2E_P01_DATAID_BOTH", "alternating": "E2E_P01_DATAID_ALT", "low": "E2E_P01_DATAID_LOW",
        "nibble": "E2E_P01_DATAID_NIBBLE"},
    11: {"both": "E2E_P11_DATAID_BOTH", "nibble": "E2E_P11_DATAID_NIBBLE"},
}  # fmt: skip
"""Names of the library's data id modes, by profile."""


class _Functions(NamedTuple):
    """The library's functions for one message, all but the payload bound."""

    protect: Callable[[Any], None]
    check: Callable[[Any], bool]
    length: int


class E2eProtector:
    """A profile's CRC over messages, each with a data id of its own.

    Args:
        profile: the profile's settings.
        messages: the messages.
        order: which of the profile's data ids is each message's.

    Attributes:
        profile: as given.
        header: what the profile keeps where.

    Raises:
        ConfigError: the library is not installed, a message is too short, or there are fewer data ids than messages.

    """

    def __init__(self, profile: Profile, messages: Sequence[MessageSpec], order: Sequence[int]) -> None:
        self.profile: Final = profile
        self.header: Final = HEADERS[profile.profile]
        self._counter_at = profile.offset + self.header.counter_byte
        self._mask = (1 << self.header.counter_bits) - 1
        ids = profile.data_ids(max(order) + 1)
        if len(ids) <= max(order):
            lacking = next(message.name for message, index in zip(messages, order, strict=True) if index >= len(ids))
            raise ConfigError(f"found {len(ids)} data ids, expected one for each message; '{lacking}' has none")
        library = _library(profile.profile)
        self._functions = {
            message.can_id: _functions(library, profile, message, ids[index])
            for message, index in zip(messages, order, strict=True)
        }

    def counter(self, data: bytes) -> int:
        """Read the counter from a payload long enough."""
        return data[self._counter_at] & self._mask

    def verify(self, can_id: int, data: bytes) -> bool:
        """Return whether a frame of one of the messages has the right CRC and data id; one too short never has."""
        _, check, length = self._functions[can_id]
        return len(data) >= length and check(bytearray(data[:length]))

    def seal(self, can_id: int, payload: bytes) -> bytes:
        """Return one frame's payload with its CRC written into it; its counter is there already."""
        sealed = bytearray(payload)
        self._functions[can_id].protect(sealed)
        return bytes(sealed)

    def fill(self, can_ids: Integers, payloads: Bytes) -> None:
        """Write the CRCs of a cycle's frames (n, length) into them, in place; their counters are there already."""
        for can_id, row in zip(can_ids.tolist(), payloads, strict=True):
            self._functions[can_id].protect(row)


def check_header(profile: Profile, signal: SignalSpec, role: str) -> str | None:
    """Return what is wrong with a signal that is named as the profile's counter or checksum, None if nothing is.

    A CRC of 16 bits may be named by its whole or by its low byte.
    """
    header = HEADERS[profile.profile]
    if role == "counter":
        start, lengths = 8 * (profile.offset + header.counter_byte), {header.counter_bits}
    else:
        start, lengths = 8 * profile.offset, {header.crc_bits, 8}
    if signal.length in lengths and _lowest_bit(signal) == start:
        return None
    bits = " or ".join(map(str, sorted(lengths)))
    return (
        f"{role} signal '{signal.name}' starts at bit {signal.start} with {signal.length} bits; "
        f"profile {profile.profile} at offset {profile.offset} has it from bit {start} with {bits} bits"
    )


def _lowest_bit(signal: SignalSpec) -> int | None:
    """Return the least significant bit, as the DBC counts; None for a big-endian signal of several bytes."""
    if signal.byte_order == "little":
        return signal.start
    byte, before = divmod(first_bit(signal), 8)
    return 8 * byte + 8 - before - signal.length if before + signal.length <= 8 else None


def _library(profile: int) -> ModuleType:
    """Import the library's module of a profile."""
    try:
        return import_module(f"e2e.p{profile:02d}")
    except ImportError:
        raise ConfigError("end-to-end profiles need autosar-e2e; install it: pip install 'candaemon[e2e]'") from None


def _functions(library: ModuleType, profile: Profile, message: MessageSpec, data_id: int | bytes) -> _Functions:
    """Bind the library's functions to a message."""
    # profiles 1 and 11 take no frame of two bytes
    least = profile.offset + 3
    if message.length < least:
        raise ConfigError(
            f"message '{message.name}' has {message.length} bytes; profile {profile.profile} at offset "
            f"{profile.offset} needs {least}"
        )
    name = f"e2e_p{profile.profile:02d}_"
    bound: dict[str, Any] = {} if profile.profile == 2 else {"offset": profile.offset}
    if isinstance(profile, E2eProfile1 | E2eProfile11):
        bound["data_id_mode"] = getattr(library, MODES[profile.profile][profile.data_id_mode])
    second = "data_id_list" if profile.profile == 2 else "data_id"
    bound[second] = data_id
    protect = partial(getattr(library, f"{name}protect"), increment_counter=False, **bound)
    return _Functions(protect, partial(getattr(library, f"{name}check"), **bound), message.length)
