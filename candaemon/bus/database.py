"""DBC files, loaded tolerantly: cantools parses, every repair and oddity is told with its line.

Vendors' files overlap signals, carry value tables of signals that are gone, lack the bit of extended identifiers or the
attribute of CAN FD. Such a file loads; what is doubtful in it is in `Database.warnings`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Literal

import cantools
from cantools.database.can import Database as ParsedDatabase
from cantools.database.can import Message as ParsedMessage
from cantools.database.can import Signal as ParsedSignal
from cantools.database.errors import UnsupportedDatabaseFormatError

from candaemon.bus import layout
from candaemon.bus.dbcmend import Outline, mend
from candaemon.bus.dbctext import Report, Statement, close_strings, split_statements
from candaemon.bus.frame import EXTENDED
from candaemon.bus.spec import Database, Diagnostic, MessageSpec, SignalSpec
from candaemon.errors import DatabaseError

__all__ = ["Database", "Diagnostic", "MessageSpec", "SignalSpec", "load_database"]

CLASSIC_LENGTH = 8
"""Payload bytes of a classic CAN frame, at most."""

FD_LENGTH = 64
"""Payload bytes of a CAN FD frame, at most."""


def load_database(path: Path) -> Database:
    """Load a DBC file, strictly where possible, tolerantly where not.

    Args:
        path: the file, in UTF-8 or Windows-1252.

    Returns:
        Its messages, and each repair and oddity as a warning.

    Raises:
        DatabaseError: the file cannot be read, or no message is left in it.
    """
    warnings: list[Diagnostic] = []

    def report(line: int, text: str) -> None:
        warnings.append(Diagnostic(path, line, text))

    statements, outline = mend(split_statements(close_strings(_read(path), report), report), report)
    parsed = _parse(statements, report) if outline.messages else None
    if parsed is None or not parsed.messages:
        first = warnings[0] if warnings else None
        raise DatabaseError(
            "no message found, expected a DBC file with lines such as 'BO_ 1280 NAME: 8 NODE'"
            + (f"; first trouble: {first.text}" if first else ""),
            file=path,
            line=first.line if first else None,
        )
    messages: dict[str, MessageSpec] = {}
    by_id: dict[int, MessageSpec] = {}
    for each in parsed.messages:
        message = _message(each, path, outline)
        messages.setdefault(message.name, message)
        by_id.setdefault(message.can_id, message)
        for lint in LINTS:
            lint(message, report)
        if CLASSIC_LENGTH < message.length <= FD_LENGTH and not each.is_fd:
            report(
                message.line,
                f"message '{message.name}' has {message.length} bytes but is not marked CAN FD: taken as CAN FD",
            )
    return Database(path, messages, by_id, tuple(sorted(warnings, key=lambda warning: warning.line)))


def _read(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise DatabaseError(f"cannot be read ({error.strerror}); expected a DBC file", file=path) from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("\0", " ")


def _parse(statements: Sequence[Statement], report: Report) -> ParsedDatabase | None:
    """Parse all statements; where cantools refuses them together, as many as it takes."""
    for strict in (True, False):
        try:
            return _load(statements, strict=strict)
        except UnsupportedDatabaseFormatError:
            continue
    kept: list[Statement] = []
    _accept(_units(statements), kept, report)
    return _load(kept) if kept else None


def _load(statements: Sequence[Statement], *, strict: bool = False) -> ParsedDatabase:
    text = "".join(statement.text.rstrip() + "\n" for statement in statements)
    with _quiet():
        parsed = cantools.database.load_string(text, "dbc", strict=strict)
    assert isinstance(parsed, ParsedDatabase)  # noqa: S101 - what cantools gives for a DBC
    return parsed


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence cantools' own log line on messages that share an identifier; the warning with the line says more."""
    logger = logging.getLogger("cantools")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _units(statements: Sequence[Statement]) -> list[list[Statement]]:
    """Group statements into what stands or falls together, definitions before their uses."""
    units: list[list[Statement]] = []
    for statement in statements:
        if statement.keyword == "SG_":
            units[-1].append(statement)
        else:
            units.append([statement])
    order = {"BA_DEF_": 0, "BA_DEF_DEF_": 1, "BO_": 2}
    return sorted(units, key=lambda unit: order.get(unit[0].keyword, 3))


def _accept(units: Sequence[list[Statement]], kept: list[Statement], report: Report) -> None:
    """Add to `kept` every unit that cantools takes, by halving where it does not take all."""
    try:
        chunk = [statement for unit in units for statement in unit]
        _load([*kept, *chunk])
    except UnsupportedDatabaseFormatError as error:
        if len(units) > 1:
            _accept(units[: len(units) // 2], kept, report)
            _accept(units[len(units) // 2 :], kept, report)
        else:
            reason = " ".join(str(error.e_dbc).split())
            report(chunk[0].line, f"{chunk[0].keyword} that cantools does not take ({reason}): left out")
    else:
        kept += chunk


def _message(parsed: ParsedMessage, path: Path, outline: Outline) -> MessageSpec:
    can_id = parsed.frame_id | (EXTENDED if parsed.is_extended_frame else 0)
    line = outline.names.get(parsed.name) or outline.messages.get(can_id, 0)
    return MessageSpec(
        name=parsed.name,
        can_id=can_id,
        length=parsed.length,
        signals=tuple(
            _signal(signal, outline.lines.get((parsed.name, signal.name), line)) for signal in parsed.signals
        ),
        is_fd=parsed.is_fd or parsed.length > CLASSIC_LENGTH,
        cycle_time=_seconds(parsed.cycle_time),
        comment=parsed.comment or "",
        file=path,
        line=line,
    )


def _seconds(cycle: object) -> float | None:
    """Convert `GenMsgCycleTime`, milliseconds, which some files define as text."""
    return cycle / 1000 if isinstance(cycle, int | float) and cycle > 0 else None


def _signal(parsed: ParsedSignal, line: int) -> SignalSpec:
    order: Literal["little", "big"] = "little" if parsed.byte_order == "little_endian" else "big"
    return SignalSpec(
        name=parsed.name,
        start=parsed.start,
        length=parsed.length,
        byte_order=order,
        signed=parsed.is_signed,
        is_float=parsed.is_float,
        scale=parsed.scale,
        offset=parsed.offset,
        minimum=parsed.minimum,
        maximum=parsed.maximum,
        unit=parsed.unit or "",
        choices={raw: str(text) for raw, text in parsed.choices.items()} if parsed.choices else None,
        initial=parsed.raw_initial,
        is_multiplexer=parsed.is_multiplexer,
        multiplexer_signal=parsed.multiplexer_signal,
        multiplexer_ids=frozenset(parsed.multiplexer_ids or ()),
        comment=parsed.comment or "",
        line=line,
    )


def _lint_bits(message: MessageSpec, report: Report) -> None:
    """Tell of signals whose bits lie outside the message, of those no frame carries, and of those that overlap."""
    carried: list[tuple[SignalSpec, set[int], dict[str, frozenset[int]]]] = []
    for signal in message.signals:
        chain = layout.gates(message, signal)
        if not layout.readable(message, signal):
            report(
                signal.line,
                f"signal '{signal.name}' lies outside message '{message.name}' of {message.length} bytes: never read",
            )
        elif chain is None:
            report(
                signal.line,
                f"signal '{signal.name}' is selected by '{signal.multiplexer_signal}', no multiplexer: never read",
            )
        else:
            carried.append((signal, _bits(signal), dict(chain)))
    for (a, a_bits, a_gates), (b, b_bits, b_gates) in combinations(carried, 2):
        apart = any(not a_gates[name] & b_gates[name] for name in a_gates.keys() & b_gates.keys())
        if a_bits & b_bits and not apart:
            first, second = sorted((a, b), key=lambda signal: signal.line)
            report(
                second.line,
                f"signals '{first.name}' and '{second.name}' of message '{message.name}' overlap: both are read",
            )


def _bits(signal: SignalSpec) -> set[int]:
    """List the signal's bits, numbered as those of little-endian signals are."""
    first = layout.first_bit(signal)
    flip = 0 if signal.byte_order == "little" else 7
    return {bit ^ flip for bit in range(first, first + signal.length)}


def _lint_values(message: MessageSpec, report: Report) -> None:
    """Tell of signals whose scale or range cannot be meant."""
    for signal in message.signals:
        if signal.scale == 0:
            report(
                signal.line, f"signal '{signal.name}' of message '{message.name}' has scale 0: constant, cannot be sent"
            )
            continue
        given, (low, high) = layout.raw_range(signal), layout.raw_width(signal)
        if given is not None and (given[0] > high or given[1] < low):
            report(
                signal.line,
                f"range [{signal.minimum}|{signal.maximum}] of signal '{signal.name}' is beyond its bits: not used",
            )


def _lint_length(message: MessageSpec, report: Report) -> None:
    """Tell of messages that fit in no frame."""
    if message.length > FD_LENGTH:
        report(message.line, f"message '{message.name}' has {message.length} bytes, a CAN FD frame {FD_LENGTH} at most")


LINTS: Sequence[Callable[[MessageSpec, Report], None]] = (_lint_bits, _lint_values, _lint_length)
