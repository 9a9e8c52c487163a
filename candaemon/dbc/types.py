"""What a DBC says about a message and its signals, as frozen values that the codec and the binding read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from candaemon.errors import ConfigError
from candaemon.similar_names import similar_names


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A repair or an oddity of a DBC file.

    Attributes:
        file: the DBC.
        line: 1-based line.
        text: what was found and how it is treated.
    """

    file: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal: value = raw × scale + offset.

    Attributes:
        name: as in the DBC.
        start: DBC start bit; the least significant bit if little-endian, the most significant if big-endian.
        length: bits.
        byte_order: "little" (Intel, `@1`) or "big" (Motorola, `@0`).
        signed: whether the raw integer is two's complement; of no meaning where `is_float`.
        is_float: whether the raw value is an IEEE 754 number of 16, 32 or 64 bits.
        scale: value of one raw step, in `unit`.
        offset: value of raw zero, in `unit`.
        minimum: least value by the DBC, None where it gives no range.
        maximum: greatest value by the DBC, None where it gives no range.
        unit: as in the DBC, "" where it has none.
        choices: raw value to text, None without a value table.
        initial: raw start value (`GenSigStartValue`), None where the DBC has none.
        is_multiplexer: whether its value selects which other signals a frame carries.
        multiplexer_signal: the multiplexer that selects this signal, None where every frame carries it.
        multiplexer_ids: values of that multiplexer with which this signal is carried.
        comment: from the DBC, "" where it has none.
        line: 1-based line of its `SG_` in the DBC, 0 where unknown.
    """

    name: str
    start: int
    length: int
    byte_order: Literal["little", "big"] = "little"
    signed: bool = False
    is_float: bool = False
    scale: float = 1
    offset: float = 0
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: Mapping[int, str] | None = field(default=None, hash=False)
    initial: float | None = None
    is_multiplexer: bool = False
    multiplexer_signal: str | None = None
    multiplexer_ids: frozenset[int] = frozenset()
    comment: str = ""
    line: int = 0


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message.

    Attributes:
        name: as in the DBC.
        can_id: identifier, with `frame.EXTENDED` set for a 29-bit one.
        length: payload bytes.
        signals: in the order of their bits.
        is_fd: whether it is a CAN FD frame.
        cycle_time: seconds between two, None where the DBC does not give it.
        comment: from the DBC, "" where it has none.
        file: the DBC it is from, None where it is from none.
        line: 1-based line of its `BO_` in the DBC, 0 where unknown.
    """

    name: str
    can_id: int
    length: int
    signals: tuple[SignalSpec, ...]
    is_fd: bool = False
    cycle_time: float | None = None
    comment: str = ""
    file: Path | None = None
    line: int = 0
    _by_name: Mapping[str, SignalSpec] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        by_name = {signal.name: signal for signal in reversed(self.signals)}
        object.__setattr__(self, "_by_name", by_name)

    def find(self, name: str) -> SignalSpec | None:
        """Find a signal by name, None where the message has none of it."""
        return self._by_name.get(name)

    def signal(self, name: str) -> SignalSpec:
        """Find a signal by name.

        Raises:
            ConfigError: the message has no such signal; the text suggests near names.
        """
        signal = self.find(name)
        if signal is None:
            raise ConfigError(
                f"message '{self.name}' has no signal '{name}'; {near_names(name, [s.name for s in self.signals])}",
                file=self.file,
                line=self.line or None,
            )
        return signal

    def select(self, names: Iterable[str] | None) -> tuple[SignalSpec, ...]:
        """Find signals by name, in the order asked for; all of them for None.

        Raises:
            ConfigError: the message has no such signal.
        """
        return self.signals if names is None else tuple(self.signal(name) for name in names)


@dataclass(frozen=True, slots=True)
class Database:
    """A loaded DBC.

    Attributes:
        path: the file.
        messages: by name.
        by_id: by `can_id`; of messages that share one, the first in the file.
        warnings: repairs and oddities, in the order of their lines.
    """

    path: Path
    messages: Mapping[str, MessageSpec] = field(hash=False)
    by_id: Mapping[int, MessageSpec] = field(hash=False)
    warnings: tuple[Diagnostic, ...] = ()

    def message(self, name: str) -> MessageSpec:
        """Find a message by name.

        Raises:
            ConfigError: the DBC has no such message; the text suggests near names.
        """
        try:
            return self.messages[name]
        except KeyError:
            raise ConfigError(f"no message '{name}'; {near_names(name, self.messages)}", file=self.path) from None

    def shifted(self, offset: int) -> Database:
        """Return the same messages with other identifiers, as another device of the same kind has them.

        Args:
            offset: what each identifier is more. Whether CAN has such identifiers is not looked at.
        """
        if not offset:
            return self
        messages = {name: replace(each, can_id=each.can_id + offset) for name, each in self.messages.items()}
        by_id = {each.can_id + offset: messages[each.name] for each in self.by_id.values()}
        return replace(self, messages=messages, by_id=by_id)


def near_names(name: str, known: Iterable[str]) -> str:
    """List which known names are near a mistyped one, or which there are at all."""
    names = list(known)
    plain = name.rpartition(".")[2]
    near = [plain] if plain in names else similar_names(name, names, 3)
    if near:
        return "did you mean " + " or ".join(f"'{each}'" for each in near) + "?"
    some = sorted(names)
    if not some:
        return "it has none at all"
    return "it has " + ", ".join(f"'{each}'" for each in some[:8]) + (", …" if len(some) > 8 else "")
