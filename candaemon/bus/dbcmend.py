"""A DBC file's statements, mended so far that cantools can parse them.

cantools refuses a whole file for one bad line. Here each statement is looked at by itself: what can be mended is, what
cannot is left out, and either is reported with its line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from candaemon.bus.dbctext import KEYWORDS, Report, Statement, mask_strings
from candaemon.bus.frame import EXTENDED

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


def mend(statements: Sequence[Statement], report: Report) -> tuple[list[Statement], Outline]:
    """Mend or leave out what cantools would refuse the file for.

    Args:
        statements: the file.
        report: told of everything mended or left out.

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
    bits = outline.signals[int(found[1]), found[2]]
    if found[3] in ("1", "2") and bits not in (16, 32, 64):
        report(statement.line, f"signal '{found[2]}' of {bits} bits cannot be a float: taken as integer")
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
"""Tells whether a statement can stay, by keyword."""
