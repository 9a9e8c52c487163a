"""DBC files, loaded tolerantly: cantools parses, and every repair and oddity is reported with its line.

Vendors' files overlap signals, carry value tables of signals that are gone, lack the bit of extended identifiers or the
attribute of CAN FD. Such a file loads; what is doubtful in it is in `Database.warnings`.

In this order: `load_database`; the text cut into statements; the statements mended, or left out where cantools would
refuse the whole file for them; cantools' result as `MessageSpec`; what is checked of it (lint).
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Final, Literal

import cantools
from cantools.database.can import Database as ParsedDatabase
from cantools.database.can import Message as ParsedMessage
from cantools.database.can import Signal as ParsedSignal
from cantools.database.errors import UnsupportedDatabaseFormatError

from candaemon.dbc import bits
from candaemon.dbc.types import Database, Diagnostic, MessageSpec, SignalSpec
from candaemon.errors import DatabaseError
from candaemon.frames.frame import EXTENDED

Report = Callable[[int, str], None]
"""Takes a 1-based line and what was found there."""

CLASSIC_LENGTH: Final = 8
"""Payload bytes of a classic CAN frame, at most."""

FD_LENGTH: Final = 64
"""Payload bytes of a CAN FD frame, at most."""


@dataclass(frozen=True, slots=True)
class Statement:
    """One statement of a DBC: from its keyword to the next one.

    Attributes:
        line: 1-based line it begins at.
        keyword: its first word.
        text: all of it, without comments of the `//` kind.
        apart: whether a blank line stands before it.
    """

    line: int
    keyword: str
    text: str
    apart: bool = False


@dataclass(slots=True)
class Outline:
    """Where a file declares its messages and signals, by the identifiers that its statements use.

    Attributes:
        messages: line of each message by identifier; of several with one identifier, the first.
        names: line of each message by name.
        lines: line of each signal by its message's name and its own.
        signals: bits of each signal by its message's identifier and its own name.
    """

    messages: dict[int, int] = field(default_factory=dict)
    names: dict[str, int] = field(default_factory=dict)
    lines: dict[tuple[str, str], int] = field(default_factory=dict)
    signals: dict[tuple[int, str], int] = field(default_factory=dict)


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

    statements = split_statements(close_strings(_read(path), report), report)
    statements, outline = mend(statements, report)
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


KEYWORDS: Final = re.compile(
    r"BA_(DEF_|DEF_DEF_|DEF_DEF_REL_|DEF_REL_|DEF_SGTYPE_|REL_|SGTYPE_)?|BO_(TX_BU_)?|BS_|BU_(BO_REL_|EV_REL_|SG_REL_)?|"
    r"CAT_(DEF_)?|CM_|ENVVAR_DATA_|EV_(DATA_)?|FILTER|NS_(DESC_)?|SG_(MUL_VAL_)?|SGTYPE_(VAL_)?|SIG_GROUP_|"
    r"SIG_TYPE_REF_|SIG_VALTYPE_|SIGTYPE_VALTYPE_|VAL_(TABLE_)?|VERSION"
)
HEAD: Final = re.compile(rf'^[ \t]*(?P<keyword>{KEYWORDS.pattern})(?=[ \t:"])[ \t]*[^ \t\r\n]', re.MULTILINE)
STRING: Final = re.compile(r'"(?:\\"|[^"])*"|//[^\n]*')
OPENING: Final = re.compile(
    r"\s*(BO_\s+\d+\s+\w+\s*:\s*\d|SG_\s+\w[\w\s]*:\s*\d+\s*\||(CM_\s+(BO_|SG_)|VAL_|SIG_VALTYPE_)\s+\d+\s|"
    r'CM_\s+(BU_|EV_|")|BA_(DEF_|DEF_DEF_)?\s+(BO_\s+|SG_\s+|BU_\s+|EV_\s+)?")'
)
"""A line that can hardly be the text of a comment."""


def close_strings(text: str, report: Report) -> str:
    """Comment out every line that opens a string which nothing closes, as it would swallow the statements after it."""
    lines = text.split("\n")
    opened: int | None = None
    at = 0
    while at < len(lines) or opened is not None:
        lost = opened is not None and (at == len(lines) or (at > opened and OPENING.match(lines[at]) is not None))
        if lost and opened is not None:
            report(opened + 1, "a string is opened and never closed: line left out")
            lines[opened] = "//"
            at, opened = opened, None
        code = lines[at] if opened is not None else re.sub(r'^([^"]*?)//.*', r"\1", lines[at])
        if code.replace('\\"', "").count('"') % 2:
            opened = at if opened is None else None
        at += 1
    return "\n".join(lines)


def split_statements(text: str, report: Report) -> list[Statement]:
    """Cut a DBC into its statements, without comments of the `//` kind and what stands before the first."""
    code = STRING.sub(lambda found: found[0] if found[0][0] == '"' else " " * len(found[0]), text)
    masked = mask_strings(code)
    heads = list(HEAD.finditer(masked))
    if not heads:
        return []
    ends = [*(head.start() for head in heads[1:]), len(code)]
    if masked[: heads[0].start()].strip():
        report(1, "text before the first statement: left out")
    statements, line, counted = [], 1, 0
    for head, end in zip(heads, ends, strict=True):
        line += code.count("\n", counted, head.start())
        counted = head.start()
        above = text[text.rfind("\n", 0, max(head.start() - 1, 0)) + 1 : head.start()]
        statements.append(Statement(line, head["keyword"], code[head.start() : end], apart=not above.strip()))
    return statements


def mask_strings(code: str) -> str:
    """Blank out the strings, so that nothing in them is read as a keyword."""
    return STRING.sub(lambda found: '"' + "_" * (len(found[0]) - 2) + '"', code)


LONGEST_ID_RANGE: Final = 1 << 16
"""Ids of one range in `SG_MUL_VAL_`; cantools would list every one of a longer range."""

LONGEST_MESSAGE: Final = 2048
"""Bytes of a message at most; J1939's longest has 1785, and all bits of a signal are listed to find overlaps."""

NUMBER: Final = r"([-+]?\d+\.?\d*(?:[eE][+-]?\d+)?)"
NAME: Final = r"([A-Za-z_]\w*)"
TEXT: Final = r'"(?:\\"|[^"])*"'
MESSAGE: Final = re.compile(rf"\s*BO_\s+(\d+)\s+{NAME}\s*:\s*(\d+)[ \t]*{NAME}?", re.ASCII)
SIGNAL: Final = re.compile(
    rf"\s*SG_\s+{NAME}(?:\s+(M|m\d+M?))?\s*:\s*(\d+)\s*\|\s*(\d+)\s*@\s*(\d)\s*([+-])\s*"
    rf"\(\s*{NUMBER}\s*,\s*{NUMBER}\s*\)\s*\[\s*{NUMBER}\s*\|\s*{NUMBER}\s*\]\s*{TEXT}",
    re.ASCII,
)
RECEIVERS: Final = re.compile(r"[ \t]*[A-Za-z_]\w*(?:[ \t]*,\s*[A-Za-z_]\w*)*", re.ASCII)
CHOICES: Final = re.compile(rf"\s*VAL_\s+(\d+)\s+{NAME}\s*(?:-?\d+\s*{TEXT}\s*)*;", re.ASCII)
VALUE_TYPE: Final = re.compile(rf"\s*SIG_VALTYPE_\s+(\d+)\s+{NAME}\s*:?\s*(\d+)\s*;", re.ASCII)
SELECTION: Final = re.compile(rf"\s*SG_MUL_VAL_\s+(\d+)\s+{NAME}\s+{NAME}\s+(\d+-\d+(?:\s*,\s*\d+-\d+)*)\s*;", re.ASCII)
REFERENCE: Final = re.compile(
    rf"(\s*(?:CM_\s+(?:BO_|SG_)|BA_\s+{TEXT}\s*(?:BO_|SG_)|VAL_|SIG_VALTYPE_|SG_MUL_VAL_)\s+)(\d+)",
    re.ASCII,
)

BEARING: Final = frozenset(
    {"BO_", "SG_", "CM_", "VAL_", "SIG_VALTYPE_", "SG_MUL_VAL_", "BA_", "BA_DEF_", "BA_DEF_DEF_"}
)
"""Keywords of the statements that say something of a frame's layout or meaning."""

INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"
"""Name by which tools keep signals of no message; nothing on a bus."""

INDEPENDENT_ID: Final = 0xC000_0000

SIGNAL_FORM: Final = 'SG_ name : start|length@order± (scale,offset) [min|max] "unit" receivers'


def mend(statements: Sequence[Statement], report: Report) -> tuple[list[Statement], Outline]:
    """Mend or leave out what cantools would refuse the file for.

    Args:
        statements: the file.
        report: called for everything mended or left out.

    Returns:
        The statements to parse, and where messages and signals are declared.
    """
    outline = Outline()
    declared = _mend_declarations(statements, outline, report)
    return _mend_references(declared, outline, report), outline


def _mend_declarations(statements: Sequence[Statement], outline: Outline, report: Report) -> list[Statement]:
    """Mend `BO_` and `SG_`; the rest passes."""
    kept: list[Statement] = []
    message: tuple[int, str] | None = None
    within = False
    for statement in statements:
        if statement.keyword == "BO_":
            mended, message = _mend_message(statement, outline, report)
            within = True
        elif statement.keyword == "SG_":
            if not within:
                report(statement.line, "SG_ outside of any message: left out")
            elif message is not None and statement.apart:
                report(statement.line, "SG_ after a blank line: taken into the message above")
            mended = None if message is None else _mend_signal(statement, message, outline, report)
        else:
            mended, message, within = statement, None, False
        if mended is not None:
            kept.append(mended)
    return kept


def _mend_message(
    statement: Statement, outline: Outline, report: Report
) -> tuple[Statement | None, tuple[int, str] | None]:
    """Check a `BO_`; give it with its identifier and name, or None twice where it and its signals are left out."""
    line, found = statement.line, MESSAGE.match(statement.text)
    if found is None or KEYWORDS.fullmatch(found[2]):
        report(line, "expected 'BO_ identifier name: length sender': left out with its signals")
        return None, None
    identifier, name, length, sender = int(found[1]), found[2], int(found[3]), found[4] or "Vector__XXX"
    if name == INDEPENDENT:
        return None, None
    if length > LONGEST_MESSAGE:
        report(line, f"message '{name}' of {length} bytes, of {LONGEST_MESSAGE} at most: left out with its signals")
        return None, None
    if name in outline.names:
        report(line, f"message '{name}' is already at line {outline.names[name]}: left out with its signals")
        return None, None
    if 0x7FF < identifier <= 0x1FFF_FFFF:
        report(line, f"identifier {identifier:#x} of message '{name}' is over 0x7ff without bit 31: taken as extended")
        identifier |= EXTENDED
    if not (identifier <= 0x7FF or EXTENDED <= identifier <= EXTENDED + 0x1FFF_FFFF):
        report(line, f"identifier {identifier:#x} of message '{name}' is over 29 bits: left out with its signals")
        return None, None
    if statement.text[0] in " \t":
        report(line, f"BO_ of message '{name}' is indented: read as if it were not")
    if statement.text[found.end() :].strip():
        report(line, f"text after BO_ of message '{name}': left out")
    if identifier in outline.messages:
        report(line, f"message '{name}' has the identifier of line {outline.messages[identifier]}, which frames go to")
    outline.names[name] = line
    outline.messages.setdefault(identifier, line)
    return replace(statement, text=f"BO_ {identifier} {name}: {length} {sender}\n"), (identifier, name)


def _mend_signal(statement: Statement, message: tuple[int, str], outline: Outline, report: Report) -> Statement | None:
    """Check a `SG_` of a message, given by identifier and name; None where it is left out."""
    line, found = statement.line, SIGNAL.match(statement.text)
    if found is None or KEYWORDS.fullmatch(found[1]):
        report(line, f"expected '{SIGNAL_FORM}': left out")
        return None
    name, length = found[1], int(found[4])
    if length == 0 or not all(math.isfinite(float(found[group])) for group in (7, 8)):
        report(line, f"signal '{name}' has no bits or no finite scale and offset: left out")
        return None
    if int(found[3]) + length > 8 * LONGEST_MESSAGE:
        report(line, f"signal '{name}' ends beyond {LONGEST_MESSAGE} bytes: left out")
        return None
    identifier, of = message
    if (of, name) in outline.lines:
        report(line, f"signal '{name}' of message '{of}' is already at line {outline.lines[of, name]}: left out")
        return None
    outline.lines[of, name] = line
    outline.signals.setdefault((identifier, name), length)
    receivers = RECEIVERS.match(statement.text, found.end())
    rest = statement.text[receivers.end() if receivers else found.end() :].strip()
    if receivers is None or rest:
        report(
            line,
            f"signal '{name}' is not followed by receivers 'A,B' alone: "
            + (f"'{rest[:40]}' left out" if rest else "taken as none"),
        )
    listed = receivers[0].strip() if receivers else "Vector__XXX"
    return replace(statement, text=f"{found[0].rstrip()} {listed}\n")


def _mend_references(statements: Sequence[Statement], outline: Outline, report: Report) -> list[Statement]:
    """Mend the statements that speak of messages and signals; what has no bearing on them goes."""
    kept = []
    for statement in statements:
        if statement.keyword not in BEARING:
            continue
        if statement.keyword not in ("BO_", "SG_"):
            statement = _terminated(_renumbered(statement, outline), report)
        check = CHECKS.get(statement.keyword)
        if check is None or check(statement, outline, report):
            kept.append(statement)
    return kept


def _renumbered(statement: Statement, outline: Outline) -> Statement:
    """Let a statement use the message's own identifier where the two differ in bit 31."""
    found = REFERENCE.match(statement.text)
    if found is None or int(found[2]) in outline.messages or int(found[2]) ^ EXTENDED not in outline.messages:
        return statement
    return replace(statement, text=f"{found[1]}{int(found[2]) ^ EXTENDED}{statement.text[found.end() :]}")


def _terminated(statement: Statement, report: Report) -> Statement:
    """Let a statement end with its semicolon."""
    code, semicolon, rest = mask_strings(statement.text).partition(";")
    if not semicolon:
        report(statement.line, f"{statement.keyword} without the ';' at its end: read as if it were there")
    elif rest.strip():
        report(statement.line, f"text after the ';' of {statement.keyword}: left out")
    return replace(statement, text=f"{statement.text[: len(code)].rstrip()};\n")


def _declared(statement: Statement, identifier: str, name: str, outline: Outline, report: Report) -> bool:
    if (int(identifier), name) in outline.signals:
        return True
    if int(identifier) != INDEPENDENT_ID:
        report(
            statement.line,
            f"{statement.keyword} for signal '{name}' of message {identifier}, which is not there: left out",
        )
    return False


def _check_choices(statement: Statement, outline: Outline, report: Report) -> bool:
    found = CHOICES.fullmatch(statement.text.rstrip())
    if found is not None:
        return _declared(statement, found[1], found[2], outline, report)
    if re.match(r"\s*VAL_\s+[A-Za-z_]", statement.text):
        return True
    report(statement.line, "expected 'VAL_ identifier signal number \"text\" …;': left out")
    return False


def _check_value_type(statement: Statement, outline: Outline, report: Report) -> bool:
    found = VALUE_TYPE.match(statement.text)
    if found is None:
        report(statement.line, "expected 'SIG_VALTYPE_ identifier signal: type;': left out")
        return False
    if not _declared(statement, found[1], found[2], outline, report):
        return False
    length = outline.signals[int(found[1]), found[2]]
    if found[3] in ("1", "2") and length not in (16, 32, 64):
        report(statement.line, f"signal '{found[2]}' of {length} bits cannot be a float: taken as integer")
        return False
    return True


def _check_selection(statement: Statement, outline: Outline, report: Report) -> bool:
    found = SELECTION.match(statement.text)
    ranges = [tuple(map(int, each.split("-"))) for each in found[4].replace(" ", "").split(",")] if found else []
    if found is None or any(high - low >= LONGEST_ID_RANGE for low, high in ranges):
        report(
            statement.line,
            "expected 'SG_MUL_VAL_ identifier signal multiplexer low-high, …;' of 65536 ids at most: left out",
        )
        return False
    return all(_declared(statement, found[1], name, outline, report) for name in (found[2], found[3]))


CHECKS: Final[dict[str, Callable[[Statement, Outline, Report], bool]]] = {
    "VAL_": _check_choices,
    "SIG_VALTYPE_": _check_value_type,
    "SG_MUL_VAL_": _check_selection,
}
"""Returns whether a statement can stay, by keyword."""


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
    """Report signals whose bits lie outside the message, of those no frame carries, and of those that overlap."""
    carried: list[tuple[SignalSpec, set[int], dict[str, frozenset[int]]]] = []
    for signal in message.signals:
        chain = bits.gates(message, signal)
        if not bits.readable(message, signal):
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
            carried.append((signal, _bits_of(signal), dict(chain)))
    for (a, a_bits, a_gates), (b, b_bits, b_gates) in combinations(carried, 2):
        apart = any(not a_gates[name] & b_gates[name] for name in a_gates.keys() & b_gates.keys())
        if a_bits & b_bits and not apart:
            first, second = sorted((a, b), key=lambda signal: signal.line)
            report(
                second.line,
                f"signals '{first.name}' and '{second.name}' of message '{message.name}' overlap: both are read",
            )


def _bits_of(signal: SignalSpec) -> set[int]:
    """Return the signal's bits, numbered as those of little-endian signals are."""
    first = bits.first_bit(signal)
    flip = 0 if signal.byte_order == "little" else 7
    return {bit ^ flip for bit in range(first, first + signal.length)}


def _lint_values(message: MessageSpec, report: Report) -> None:
    """Report signals whose scale or range cannot be meant."""
    for signal in message.signals:
        if signal.scale == 0:
            report(
                signal.line, f"signal '{signal.name}' of message '{message.name}' has scale 0: constant, cannot be sent"
            )
            continue
        given, (low, high) = bits.dbc_raw_range(signal), bits.representable_raw(signal)
        if given is not None and (given[0] > high or given[1] < low):
            report(
                signal.line,
                f"range [{signal.minimum}|{signal.maximum}] of signal '{signal.name}' is beyond its bits: not used",
            )


def _lint_length(message: MessageSpec, report: Report) -> None:
    """Report messages that fit in no frame."""
    if message.length > FD_LENGTH:
        report(message.line, f"message '{message.name}' has {message.length} bytes, a CAN FD frame {FD_LENGTH} at most")


LINTS: Sequence[Callable[[MessageSpec, Report], None]] = (_lint_bits, _lint_values, _lint_length)
