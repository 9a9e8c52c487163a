"""DBC files, loaded tolerantly: cantools parses, and every repair and oddity is reported with its line.

Vendors' files overlap signals, carry value tables of signals that are gone, lack the bit of extended identifiers or the
attribute of CAN FD. Such a file loads; what is doubtful in it is in `Database.warnings`.

In this order: `load_database`; the text cut into statements; the statements checked, and mended or left out one by one;
cantools' reading of what is left, as `MessageSpec`.

A file comes from outside: loading it takes time and memory in proportion to its bytes, and those are limited, as are
its messages, its signals and the digits of its numbers. Each statement is looked at once, and cantools gets only what
it takes, a piece of the file at a time. What would cost cantools too much is read here: comments, units and value
tables (130 bytes of memory for each character of a string), and multiplexing (a codec for each combination of the
values of multiplexers within multiplexers).
"""

from __future__ import annotations

import codecs
import logging
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from candaemon.dbc import bits
from candaemon.dbc.database_bytes import read_database
from candaemon.dbc.lint import FD_LENGTH, Lint, Report
from candaemon.dbc.types import Database, Diagnostic, MessageSpec, SignalSpec
from candaemon.errors import DatabaseError
from candaemon.files.bounded import FileReader, read_bounded
from candaemon.frames.frame import EXTENDED

if TYPE_CHECKING:
    from cantools.database.can import Message as ParsedMessage
    from cantools.database.can import Signal as ParsedSignal

CLASSIC_LENGTH: Final = 8
"""Payload bytes of a classic CAN frame, at most."""

LONGEST_STATEMENT: Final = 1 << 20
"""Characters of a statement, at most."""

LONGEST_NAME: Final = 256
"""Characters of a name, at most."""

LONGEST_NUMBER: Final = 400
"""Digits of a number before its point, and as many behind it; the largest of 64 bits in full has 309."""

LONGEST_MESSAGE: Final = 2048
"""Bytes of a message, at most; J1939's longest has 1785."""

MOST_STATEMENTS: Final = 250_000
"""Statements of a file."""

MOST_MESSAGES: Final = 8192
"""Messages of a file."""

MOST_SIGNALS: Final = 16_384
"""Signals of a file, in all its messages."""

MOST_SIGNALS_A_MESSAGE: Final = 2048
"""Signals of a message; a CAN FD frame has 512 bits, which multiplexed signals share."""

MOST_MULTIPLEXERS: Final = 64
"""Multiplexers of a message."""

MOST_IDS_A_SIGNAL: Final = 1 << 16
"""Multiplexer values that select one signal."""

MOST_IDS: Final = 1 << 18
"""Multiplexer values in all selections of a file that differ."""

MOST_CHOICES: Final = 1 << 17
"""Entries of all value tables of a file."""

MOST_WARNINGS: Final = 1000
"""Repairs of a file that are told, and as many oddities; of further ones, the number."""

PIECE: Final = 500
"""Messages and signals that cantools gets at a time."""


def load_database(path: Path, read: FileReader = read_bounded) -> Database:
    """Load a DBC file, tolerantly.

    Args:
        path: the file, in UTF-8, Windows-1252, or UTF-16 with its byte order mark.
        read: reads it.

    Returns:
        Its messages, and each repair and oddity as a warning.

    Raises:
        DatabaseError: the file cannot be read, or no message is left in it.
    """
    return parse_database(read_database(path, read), path)


def parse_database(content: bytes, path: Path) -> Database:
    """Parse a DBC file's bytes, tolerantly.

    Args:
        content: in UTF-8, Windows-1252, or UTF-16 with its byte order mark.
        path: the file, for what is said of it.

    Returns:
        Its messages, and each repair and oddity as a warning.

    Raises:
        DatabaseError: no message is left in it.
    """
    repairs, oddities = Findings(path), Findings(path)
    contents = mend(split_statements(close_strings(_decode(content), repairs.add), repairs.add), repairs.add)
    messages: dict[str, MessageSpec] = {}
    by_id: dict[int, MessageSpec] = {}
    lint = Lint(oddities.add)
    for message in sorted(_parse(contents, path, repairs.add), key=lambda message: message.line):
        if message.name in messages:
            first_line = messages[message.name].line
            repairs.add(message.line, f"message '{message.name}' is already at line {first_line}: found by id alone")
        messages.setdefault(message.name, message)
        by_id.setdefault(message.can_id, message)
        lint.check(message)
    if not messages:
        first = repairs.told[0] if repairs.told else None
        raise DatabaseError(
            "no message found, expected a DBC file with lines such as 'BO_ 1280 NAME: 8 NODE'"
            + (f"; first trouble: {first.text}" if first else ""),
            file=path,
            line=first.line if first else None,
        )
    warnings = sorted([*repairs.told, *oddities.told], key=lambda warning: warning.line)
    if untold := repairs.untold + oddities.untold:
        warnings.append(Diagnostic(path, warnings[-1].line, f"and {untold:,} more warnings of this file"))
    return Database(path, messages, by_id, tuple(warnings))


@dataclass(slots=True)
class Findings:
    """What is found in a file; beyond a limit, how much more.

    Attributes:
        path: the file.
        told: the first `MOST_WARNINGS`.
        untold: number of the others.
    """

    path: Path
    told: list[Diagnostic] = field(default_factory=list)
    untold: int = 0

    def add(self, line: int, text: str) -> None:
        """Add a finding at a 1-based line."""
        if len(self.told) < MOST_WARNINGS:
            self.told.append(Diagnostic(self.path, line, text))
        else:
            self.untold += 1


@dataclass(slots=True)
class Quota:
    """How much of something is read; what is beyond is left out, and told at the end.

    Attributes:
        most: the limit.
        what: what is counted.
        used: taken so far.
        refused: left out so far.
        line: 1-based line of the first left out.
    """

    most: int
    what: str
    used: int = 0
    refused: int = 0
    line: int = 0

    def take(self, line: int, count: int = 1) -> bool:
        """Return whether so many more are read."""
        if self.used + count <= self.most:
            self.used += count
            return True
        self.line = self.line or line
        self.refused += count
        return False

    def full(self, line: int) -> bool:
        """Return whether no more is read, in which case one more is left out."""
        return self.used == self.most and not self.take(line)

    def tell(self, report: Report) -> None:
        """Report what was left out."""
        if self.refused:
            report(self.line, f"{self.refused:,} {self.what} beyond the {self.most:,} that are read: left out")


def _decode(raw: bytes) -> str:
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = raw.decode("utf-16", errors="replace")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("\0", " ")


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


KEYWORDS: Final = re.compile(
    r"BA_(DEF_|DEF_DEF_|DEF_DEF_REL_|DEF_REL_|DEF_SGTYPE_|REL_|SGTYPE_)?|BO_(TX_BU_)?|BS_|BU_(BO_REL_|EV_REL_|SG_REL_)?|"
    r"CAT_(DEF_)?|CM_|ENVVAR_DATA_|EV_(DATA_)?|FILTER|NS_(DESC_)?|SG_(MUL_VAL_)?|SGTYPE_(VAL_)?|SIG_GROUP_|"
    r"SIG_TYPE_REF_|SIG_VALTYPE_|SIGTYPE_VALTYPE_|VAL_(TABLE_)?|VERSION"
)
HEAD: Final = re.compile(rf'^[ \t]*(?P<keyword>{KEYWORDS.pattern})(?=[ \t:"])[ \t]*[^ \t\r\n]', re.MULTILINE)
TEXT: Final = r'"(?:[^"\\]+|\\"?)*+"'
"""A string. It is matched without going back: a quote after a backslash never ends it."""
STRING: Final = re.compile(rf"{TEXT}?|//[^\n]*")
"""A string, of which the end of the file may be the end, or a comment of the `//` kind."""
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
        code = lines[at]
        if '"' in code:
            before, slashes, _ = code.partition("//")
            if opened is None and slashes and '"' not in before:
                code = before
            if code.replace('\\"', "").count('"') % 2:
                opened = at if opened is None else None
        at += 1
    return "\n".join(lines)


def split_statements(text: str, report: Report) -> Iterator[Statement]:
    """Cut a DBC into its statements, without comments of the `//` kind and what stands before the first."""
    code = text
    if "//" in text:
        code = STRING.sub(lambda found: found[0] if found[0][0] == '"' else " " * len(found[0]), text)
    masked = mask_strings(code)
    quota = Quota(MOST_STATEMENTS, "statements")
    head = HEAD.search(masked)
    if head is not None and masked[: head.start()].strip():
        report(1, "text before the first statement: left out")
    line, counted = 1, 0
    while head is not None:
        begin, following = head.start(), HEAD.search(masked, head.end())
        line += code.count("\n", counted, begin)
        counted = begin
        if quota.take(line):
            above = text[text.rfind("\n", 0, max(begin - 1, 0)) + 1 : begin]
            end = following.start() if following is not None else len(code)
            yield Statement(line, head["keyword"], code[begin:end], apart=not above.strip())
        head = following
    quota.tell(report)


def mask_strings(code: str) -> str:
    """Blank out the strings, so that nothing in them is read as a keyword."""
    return STRING.sub(lambda found: '"' + "_" * (len(found[0]) - 2) + '"', code)


NUMBER: Final = rf"[-+]?\d{{1,{LONGEST_NUMBER}}}(?:\.\d{{0,{LONGEST_NUMBER}}})?(?:[eE][+-]?\d{{1,9}})?"
WHOLE: Final = r"\d{1,20}"
NAME: Final = rf"([A-Za-z_]\w{{0,{LONGEST_NAME - 1}}})(?!\w)"
UNTIL_SEMICOLON: Final = re.compile(rf'(?:{TEXT}|[^";]+)*+')
MESSAGE: Final = re.compile(rf"\s*BO_\s+({WHOLE})\s+{NAME}\s*:\s*({WHOLE})(?!\d)[ \t]*(?:{NAME})?", re.ASCII)
SIGNAL: Final = re.compile(
    rf"\s*SG_\s+{NAME}(?:\s+(M|m{WHOLE}M?))?\s*:\s*({WHOLE})\s*\|\s*({WHOLE})\s*@\s*(\d)\s*([+-])\s*"
    rf"\(\s*({NUMBER})\s*,\s*({NUMBER})\s*\)\s*\[\s*({NUMBER})\s*\|\s*({NUMBER})\s*\]\s*({TEXT})",
    re.ASCII,
)
RECEIVERS: Final = re.compile(r"[ \t]*[A-Za-z_]\w*(?:[ \t]*,\s*[A-Za-z_]\w*)*+", re.ASCII)
REFERENCE: Final = rf"(?:BO_\s*({WHOLE}+)|SG_\s*({WHOLE}+)\s+{NAME})"
COMMENT: Final = re.compile(rf"\s*CM_\s+{REFERENCE}\s*({TEXT})\s*;", re.ASCII)
CHOICES: Final = re.compile(
    rf"\s*VAL_\s+({WHOLE})\s+{NAME}\s*((?:-?\d{{1,{LONGEST_NUMBER}}}\s*{TEXT}\s*)*+);", re.ASCII
)
CHOICE: Final = re.compile(rf"(-?\d+)\s*({TEXT})", re.ASCII)
VALUE_TYPE: Final = re.compile(rf"\s*SIG_VALTYPE_\s+({WHOLE})\s+{NAME}\s*:?\s*({WHOLE})\s*;", re.ASCII)
SELECTION: Final = re.compile(
    rf"\s*SG_MUL_VAL_\s+({WHOLE})\s+{NAME}\s+{NAME}\s+({WHOLE}-{WHOLE}(?:\s*,\s*{WHOLE}-{WHOLE})*+)\s*;", re.ASCII
)
DEFINITION: Final = re.compile(
    rf'\s*BA_DEF_\s+(?:(?:BO_|SG_|BU_|EV_)\s*)?({TEXT})\s*(\w+)((?:{TEXT}|[^;"]+)*+);', re.ASCII
)
DEFAULT: Final = re.compile(rf"\s*BA_DEF_DEF_\s+({TEXT})\s*({NUMBER}|{TEXT})\s*;", re.ASCII)
ATTRIBUTE: Final = re.compile(
    rf"\s*BA_\s+({TEXT})\s*(?:{REFERENCE}|(?:BU_|EV_)\s*\w++)?\s*({NUMBER}|{TEXT})\s*;", re.ASCII
)

BEARING: Final = frozenset({"CM_", "VAL_", "SIG_VALTYPE_", "SG_MUL_VAL_", "BA_", "BA_DEF_", "BA_DEF_DEF_"})
"""Keywords of the statements that say something of a message's or signal's layout or meaning."""

INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"
"""Name by which tools keep signals of no message; nothing on a bus."""

INDEPENDENT_ID: Final = 0xC000_0000

NOBODY: Final = "Vector__XXX"
"""The node that stands for none; who sends and who receives is not read."""

SIGNAL_FORM: Final = 'SG_ name : start|length@order± (scale,offset) [min|max] "unit" receivers'


@dataclass(slots=True)
class DeclaredSignal:
    """A `SG_`.

    Attributes:
        line: 1-based line.
        text: what cantools is to read.
        length: bits.
        mark: "M" of a multiplexer, "m3" of a signal that its value 3 selects, "m3M" of one that is both, else "".
        unit: as in the file.
    """

    line: int
    text: str
    length: int
    mark: str
    unit: str


@dataclass(slots=True)
class DeclaredMessage:
    """A `BO_` and its `SG_`.

    Attributes:
        line: 1-based line.
        name: as in the file; an attribute may give another.
        text: what cantools is to read, without the signals.
        signals: by name.
    """

    line: int
    name: str
    text: str
    signals: dict[str, DeclaredSignal] = field(default_factory=dict)


@dataclass(slots=True)
class Identified:
    """What a file says of one identifier: its message, seldom more than one, and the statements that refer to it.

    Attributes:
        messages: in the order of the file.
        signals: by name; where several messages have one, the first.
        comments: by signal; those of messages by "".
        choices: value tables by signal.
        selections: by multiplexer, then by signal: the multiplexer's values that select it.
        attributes: what cantools is to read of value types and attributes, by signal or "", and what is said.
    """

    messages: list[DeclaredMessage] = field(default_factory=list)
    signals: dict[str, DeclaredSignal] = field(default_factory=dict)
    comments: dict[str, str] = field(default_factory=dict)
    choices: dict[str, dict[int, str]] = field(default_factory=dict)
    selections: dict[str, dict[str, frozenset[int]]] = field(default_factory=dict)
    attributes: dict[tuple[str, str], str] = field(default_factory=dict)


@dataclass(slots=True)
class Definition:
    """A `BA_DEF_`.

    Attributes:
        kind: INT, HEX, FLOAT, ENUM or STRING.
        text: what cantools is to read of it.
        values: number of its values where they are few.
        default: what cantools is to read of its `BA_DEF_DEF_`.
    """

    kind: str
    text: str
    values: int | None = None
    default: str = ""


@dataclass(slots=True)
class Contents:
    """What is left of a file's statements.

    Attributes:
        identified: by the identifier as its statements give it.
        definitions: of the attributes in `ATTRIBUTES`, by name.
    """

    identified: dict[int, Identified] = field(default_factory=dict)
    definitions: dict[str, Definition] = field(default_factory=dict)


def mend(statements: Iterable[Statement], report: Report) -> Contents:
    """Mend or leave out what is not as it should be, or too much.

    Args:
        statements: the file.
        report: called for everything mended or left out.
    """
    contents = Contents()
    declarations = Declarations(contents.identified, report)
    waiting = [
        statement for statement in statements if not declarations.take(statement) and statement.keyword in BEARING
    ]
    declarations.finish()
    references = References(contents, report)
    for statement in sorted(waiting, key=lambda each: _DEFINITIONS_FIRST.get(each.keyword, 2)):
        references.take(statement)
    references.finish()
    return contents


_DEFINITIONS_FIRST: Final = {"BA_DEF_": 0, "BA_DEF_DEF_": 1}


class Declarations:
    """Messages and signals: `BO_` and `SG_`.

    Args:
        identified: filled with them.
        report: called for everything mended or left out.
    """

    def __init__(self, identified: dict[int, Identified], report: Report) -> None:
        self._identified = identified
        self._report = report
        self._names: dict[str, int] = {}
        self._messages = Quota(MOST_MESSAGES, "messages")
        self._signals = Quota(MOST_SIGNALS, "signals")
        self._signals_here = Quota(MOST_SIGNALS_A_MESSAGE, "signals of a message")
        self._multiplexers_here = Quota(MOST_MULTIPLEXERS, "multiplexers of a message")
        self._within = False
        self._group: Identified | None = None

    def finish(self) -> None:
        """Report what was beyond the limits."""
        for quota in (self._signals_here, self._multiplexers_here, self._signals, self._messages):
            quota.tell(self._report)

    def take(self, statement: Statement) -> bool:
        """Take a statement of the file in its order; return whether it declares something."""
        line = statement.line
        if statement.keyword == "BO_":
            self._group, self._within = self._message(statement), True
        elif statement.keyword != "SG_":
            self._group, self._within = None, False
            return False
        elif not self._within:
            self._report(line, "SG_ outside of any message: left out")
        elif self._group is not None:
            if statement.apart:
                self._report(line, "SG_ after a blank line: taken into the message above")
            self._signal(statement, self._group, self._group.messages[-1])
        return True

    def _message(self, statement: Statement) -> Identified | None:
        """Take a `BO_`; None where it is left out with its signals."""
        line, found = statement.line, MESSAGE.match(statement.text)
        if found is None or KEYWORDS.fullmatch(found[2]):
            self._report(line, "expected 'BO_ identifier name: length sender': left out with its signals")
            return None
        identifier, name, length = int(found[1]), found[2], int(found[3])
        if name == INDEPENDENT:
            return None
        if length > LONGEST_MESSAGE:
            self._report(
                line, f"message '{name}' of {length} bytes, of {LONGEST_MESSAGE} at most: left out with its signals"
            )
            return None
        if name in self._names:
            self._report(line, f"message '{name}' is already at line {self._names[name]}: left out with its signals")
            return None
        if 0x7FF < identifier <= 0x1FFF_FFFF:
            self._report(
                line, f"identifier {identifier:#x} of message '{name}' is over 0x7ff without bit 31: taken as extended"
            )
            identifier |= EXTENDED
        if not (identifier <= 0x7FF or EXTENDED <= identifier <= EXTENDED + 0x1FFF_FFFF):
            self._report(
                line, f"identifier {identifier:#x} of message '{name}' is over 29 bits: left out with its signals"
            )
            return None
        if not self._messages.take(line):
            return None
        if statement.text[0] in " \t":
            self._report(line, f"BO_ of message '{name}' is indented: read as if it were not")
        if statement.text[found.end() :].strip():
            self._report(line, f"text after BO_ of message '{name}': left out")
        group = self._identified.setdefault(identifier, Identified())
        if group.messages:
            first = group.messages[0].line
            self._report(line, f"message '{name}' has the identifier of line {first}, which frames go to")
        self._names[name] = line
        group.messages.append(DeclaredMessage(line, name, f"BO_ {identifier} {name}: {length} {NOBODY}\n"))
        self._signals_here.tell(self._report)
        self._signals_here = Quota(MOST_SIGNALS_A_MESSAGE, f"signals of message '{name}'")
        self._multiplexers_here.tell(self._report)
        self._multiplexers_here = Quota(MOST_MULTIPLEXERS, f"multiplexers of message '{name}'")
        return group

    def _signal(self, statement: Statement, group: Identified, message: DeclaredMessage) -> None:
        """Take a `SG_` of a message."""
        line = statement.line
        if self._signals_here.full(line) or self._signals.full(line):
            return
        found = SIGNAL.match(statement.text)
        if found is None or KEYWORDS.fullmatch(found[1]):
            self._report(line, f"expected '{SIGNAL_FORM}': left out")
            return
        name, mark, start, length, order, sign, scale, offset, low, high, unit = found.groups()
        if int(length) == 0 or not _finite(scale, offset):
            self._report(line, f"signal '{name}' has no bits or no finite scale and offset: left out")
        elif int(length) > bits.LONGEST_NUMBER:
            self._report(line, f"signal '{name}' has {length} bits, {bits.LONGEST_NUMBER} at most: left out")
        elif int(start) + int(length) > 8 * LONGEST_MESSAGE:
            self._report(line, f"signal '{name}' ends beyond {LONGEST_MESSAGE} bytes: left out")
        elif name in message.signals:
            first = message.signals[name].line
            self._report(line, f"signal '{name}' of message '{message.name}' is already at line {first}: left out")
        elif mark is None or mark[-1] != "M" or self._multiplexers_here.take(line):
            self._signals_here.take(line)
            self._signals.take(line)
            if not _finite(low, high):
                self._report(line, f"range [{_cut(low)}|{_cut(high)}] of signal '{name}' is not finite: not used")
                low = high = "0"
            text = f' SG_ {name} : {start}|{length}@{order}{sign} ({scale},{offset}) [{low}|{high}] "" {NOBODY}\n'
            message.signals[name] = DeclaredSignal(line, text, int(length), mark or "", _unquoted(unit))
            group.signals.setdefault(name, message.signals[name])
            self._check_receivers(name, statement, found.end())

    def _check_receivers(self, name: str, statement: Statement, begin: int) -> None:
        receivers = RECEIVERS.match(statement.text, begin)
        rest = statement.text[receivers.end() if receivers else begin :].strip()
        if receivers is None or rest:
            self._report(
                statement.line,
                f"signal '{name}' is not followed by receivers 'A,B' alone: "
                + (f"'{_cut(rest)}' left out" if rest else "taken as none"),
            )


def _finite(*numbers: str) -> bool:
    return all(math.isfinite(float(number)) for number in numbers)


def _cut(text: str) -> str:
    return text[:40]


def _unquoted(text: str) -> str:
    return text[1:-1].replace('\\"', '"')


ATTRIBUTES: Final[Mapping[str, str]] = {
    "GenMsgCycleTime": "BO_",
    "VFrameFormat": "BO_",
    "SystemMessageLongSymbol": "BO_",
    "GenSigStartValue": "SG_",
    "SystemSignalLongSymbol": "SG_",
}
"""Attributes that are read, and whether of messages or of signals."""

LONG_NAMES: Final = frozenset({"SystemMessageLongSymbol", "SystemSignalLongSymbol"})

FRAME_FORMATS: Final = 16
"""Values of `VFrameFormat` where its definition does not list them."""

ATTRIBUTE_LIMIT: Final = 1 << 63
"""Numbers in attributes are less; cantools would write out every digit of 1e999999999."""


class References:
    """What statements say of messages and signals by identifier and name.

    Args:
        contents: the messages and signals; filled with what is said of them.
        report: called for everything mended or left out.
    """

    def __init__(self, contents: Contents, report: Report) -> None:
        self._contents = contents
        self._report = report
        self._defined: set[str] = set()
        self._long_names: dict[int, dict[str, str]] = {}
        self._selections: dict[tuple[tuple[int, ...], ...], frozenset[int]] = {}
        self._ids = Quota(MOST_IDS, "multiplexer values in SG_MUL_VAL_")
        self._choices = Quota(MOST_CHOICES, "entries of value tables")

    def finish(self) -> None:
        """Report what was beyond the limits."""
        for quota in (self._ids, self._choices):
            quota.tell(self._report)

    def take(self, statement: Statement) -> None:
        """Take a statement; definitions before their uses."""
        if len(statement.text) > LONGEST_STATEMENT:
            self._leave_out(statement, f"is longer than {LONGEST_STATEMENT:,} characters")
            return
        text = self._terminated(statement)
        match statement.keyword:
            case "CM_":
                self._comment(statement, text)
            case "VAL_":
                self._value_table(statement, text)
            case "SIG_VALTYPE_":
                self._value_type(statement, text)
            case "SG_MUL_VAL_":
                self._selection(statement, text)
            case "BA_DEF_":
                self._definition(statement, text)
            case "BA_DEF_DEF_":
                self._default(statement, text)
            case "BA_":
                self._attribute(statement, text)

    def _leave_out(self, statement: Statement, why: str) -> None:
        self._report(statement.line, f"{statement.keyword} {why}: left out")

    def _expected(self, statement: Statement, form: str) -> None:
        self._report(statement.line, f"expected '{statement.keyword} {form};': left out")

    def _terminated(self, statement: Statement) -> str:
        """Let a statement end with its semicolon."""
        found = UNTIL_SEMICOLON.match(statement.text)
        end = found.end() if found is not None else 0
        if statement.text[end : end + 1] != ";":
            self._report(statement.line, f"{statement.keyword} without the ';' at its end: read as if it were there")
        elif statement.text[end + 1 :].strip():
            self._report(statement.line, f"text after the ';' of {statement.keyword}: left out")
        return f"{statement.text[:end].rstrip()};"

    def _find(self, identifier: str) -> tuple[int, Identified] | None:
        """Find what has an identifier; where bit 31 alone differs, the message's own counts."""
        for own in (int(identifier), int(identifier) ^ EXTENDED):
            if own in self._contents.identified:
                return own, self._contents.identified[own]
        return None

    def _find_signal(self, statement: Statement, identifier: str, name: str) -> tuple[int, Identified] | None:
        """Find what has an identifier and a signal; report where nothing has both."""
        found = self._find(identifier)
        if found is not None and name in found[1].signals:
            return found
        if int(identifier) != INDEPENDENT_ID:
            self._leave_out(statement, f"for signal '{name}' of message {identifier}, which is not there")
        return None

    def _comment(self, statement: Statement, text: str) -> None:
        found = COMMENT.fullmatch(text)
        if found is None:
            if re.match(r'\s*CM_\s+(BU_|EV_|")', text) is None:
                self._expected(statement, 'SG_ identifier signal "text"')
            return
        of = self._find(found[1] or found[2])
        if of is not None:
            of[1].comments[found[3] or ""] = _unquoted(found[4])

    def _value_table(self, statement: Statement, text: str) -> None:
        found = CHOICES.fullmatch(text)
        if found is None:
            if re.match(r"\s*VAL_\s+[A-Za-z_]", text) is None:
                self._expected(statement, 'identifier signal number "text" …')
            return
        of = self._find_signal(statement, found[1], found[2])
        entries = CHOICE.findall(found[3])
        if of is not None and entries and self._choices.take(statement.line, len(entries)):
            of[1].choices[found[2]] = {int(raw): _unquoted(meaning) for raw, meaning in entries}

    def _value_type(self, statement: Statement, text: str) -> None:
        found = VALUE_TYPE.fullmatch(text)
        if found is None:
            self._expected(statement, "identifier signal: type")
            return
        of = self._find_signal(statement, found[1], found[2])
        if of is None:
            return
        length = of[1].signals[found[2]].length
        if found[3] in ("1", "2") and length not in (16, 32, 64):
            self._report(statement.line, f"signal '{found[2]}' of {length} bits cannot be a float: taken as integer")
            return
        of[1].attributes[found[2], statement.keyword] = f"SIG_VALTYPE_ {of[0]} {found[2]} : {found[3]};\n"

    def _selection(self, statement: Statement, text: str) -> None:
        found = SELECTION.fullmatch(text)
        ranges = [] if found is None else [tuple(map(int, each.split("-"))) for each in found[4].split(",")]
        count = sum(max(high - low + 1, 0) for low, high in ranges)
        if found is None or count > MOST_IDS_A_SIGNAL:
            self._report(
                statement.line,
                "expected 'SG_MUL_VAL_ identifier signal multiplexer low-high, …;' "
                f"of {MOST_IDS_A_SIGNAL} ids at most: left out",
            )
            return
        of = self._find_signal(statement, found[1], found[2])
        if of is None or self._find_signal(statement, found[1], found[3]) is None:
            return
        key = tuple(ranges)
        if key not in self._selections:
            if not self._ids.take(statement.line, count):
                return
            self._selections[key] = frozenset(each for low, high in ranges for each in range(low, high + 1))
        of[1].selections.setdefault(found[3], {})[found[2]] = self._selections[key]

    def _definition(self, statement: Statement, text: str) -> None:
        found = DEFINITION.fullmatch(text)
        if found is None:
            self._expected(statement, 'BO_ "attribute" type …')
            return
        name, kind = found[1][1:-1], found[2]
        self._defined.add(name)
        if name in ATTRIBUTES:
            self._contents.definitions.pop(name, None)
            definition = _define(name, kind, found[3])
            if definition is None:
                self._leave_out(statement, f"of attribute '{name}' with values that it does not have")
            else:
                self._contents.definitions[name] = definition

    def _default(self, statement: Statement, text: str) -> None:
        found = DEFAULT.fullmatch(text)
        if found is None:
            self._expected(statement, '"attribute" value')
            return
        name = found[1][1:-1]
        definition = self._contents.definitions.get(name)
        if definition is None or name in LONG_NAMES:
            return
        # that of an ENUM is one of its texts, not their number
        value = _string(found[2]) if definition.kind == "ENUM" else _value(definition, found[2])
        if value is None:
            self._leave_out(statement, f"of attribute '{name}' with a value that it does not have")
        else:
            definition.default = f'BA_DEF_DEF_ "{name}" {value};\n'

    def _attribute(self, statement: Statement, text: str) -> None:
        found = ATTRIBUTE.fullmatch(text)
        if found is None:
            self._expected(statement, '"attribute" BO_ identifier value')
            return
        name, signal = found[1][1:-1], found[4] or ""
        if name not in self._defined:
            self._leave_out(statement, f"of attribute '{_cut(name)}', which nothing defines")
            return
        definition = self._contents.definitions.get(name)
        of = self._find(found[2] or found[3] or "0") if definition is not None else None
        if definition is None or of is None or ATTRIBUTES[name] != ("SG_" if signal else "BO_" if found[2] else ""):
            return
        identifier, identified = of
        if signal and signal not in identified.signals:
            return
        value = _value(definition, found[5])
        if value is None or (name in LONG_NAMES and not self._unused(identifier, identified, signal, value[1:-1])):
            self._leave_out(statement, f"of attribute '{name}' with a value that it does not have")
            return
        owner = f"SG_ {identifier} {signal}" if signal else f"BO_ {identifier}"
        identified.attributes[signal, name] = f'BA_ "{name}" {owner} {value};\n'

    def _unused(self, identifier: int, identified: Identified, signal: str, name: str) -> bool:
        """Return whether a message's or signal's long name is a name, and a signal's not another signal's."""
        if re.fullmatch(NAME, name, re.ASCII) is None:
            return False
        others = self._long_names.setdefault(identifier, {})
        if not signal or name == signal:
            return True
        return name not in identified.signals and others.setdefault(name, signal) == signal


def _define(name: str, kind: str, arguments: str) -> Definition | None:
    """Define an attribute; None where it can have no such values."""
    head = f'BA_DEF_ {ATTRIBUTES[name]} "{name}" {kind}'
    if name == "VFrameFormat":
        formats = re.findall(TEXT, arguments)
        if kind == "ENUM" and formats and all(_string(each) for each in formats):
            return Definition(kind, f"{head} {','.join(formats)};\n", len(formats))
        if kind == "INT":  # cantools needs its default
            return Definition(kind, f"{head};\n", FRAME_FORMATS, f'BA_DEF_DEF_ "{name}" 0;\n')
        return None
    text = kind == "STRING"
    possible = text if name in LONG_NAMES else not text if name == "GenSigStartValue" else True
    return Definition(kind, f"{head};\n") if possible and kind in ("INT", "HEX", "FLOAT", "ENUM", "STRING") else None


def _value(definition: Definition, text: str) -> str | None:
    """Return an attribute's value as cantools is to read it; None where it can have no such value."""
    if definition.kind == "STRING":
        return _string(text)
    number = text.strip('"').strip()
    if re.fullmatch(NUMBER, number, re.ASCII) is None or not abs(float(number)) < ATTRIBUTE_LIMIT:
        return None
    return number if definition.values is None or 0 <= float(number) < definition.values else None


def _string(text: str) -> str | None:
    """Return a string, or the string of a number; None for one too long."""
    return (text if text[0] == '"' else f'"{text}"') if len(text) <= LONGEST_NAME + 2 else None


def _parse(contents: Contents, path: Path, report: Report) -> Iterator[MessageSpec]:
    """Let cantools read the file, piece by piece."""
    definitions = "".join(each.text + each.default for each in contents.definitions.values())
    for piece in _pieces(contents.identified.values()):
        for identified, parsed in _load(definitions, piece, report):
            multiplexers = {
                name: multiplexer for multiplexer, signals in identified.selections.items() for name in signals
            }
            for declared, each in zip(identified.messages, parsed, strict=True):
                selections = _selection_of(declared, identified, multiplexers, report)
                yield _message(each, declared, identified, selections, path, report)


def _pieces(identified: Iterable[Identified]) -> Iterator[list[Identified]]:
    piece: list[Identified] = []
    count = 0
    for each in identified:
        piece.append(each)
        count += sum(1 + len(message.signals) for message in each.messages)
        if count >= PIECE:
            yield piece
            piece, count = [], 0
    if piece:
        yield piece


def _load(
    definitions: str, piece: Sequence[Identified], report: Report
) -> Iterator[tuple[Identified, list[ParsedMessage]]]:
    """Let cantools read a piece; if it refuses it, each identifier of it on its own."""
    import cantools  # noqa: PLC0415 - it costs more than reading the file, which most starts find in the cache
    from cantools.database.can import Database as ParsedDatabase  # noqa: PLC0415 - likewise
    from cantools.database.errors import UnsupportedDatabaseFormatError  # noqa: PLC0415 - likewise

    text = [definitions]
    for identified in piece:
        for message in identified.messages:
            text += message.text, *(signal.text for signal in message.signals.values())
        text += identified.attributes.values()
    try:
        with _quiet():
            parsed = cantools.database.load_string("".join(text), "dbc", strict=False, sort_signals=None)
    except UnsupportedDatabaseFormatError as error:
        if len(piece) > 1:
            for identified in piece:
                yield from _load(definitions, [identified], report)
        else:
            first, reason = piece[0].messages[0], " ".join(str(error.e_dbc).split())
            report(first.line, f"message '{first.name}' that cantools does not take ({reason[:200]}): left out")
        return
    assert isinstance(parsed, ParsedDatabase)  # noqa: S101 - what cantools gives for a DBC
    messages = iter(parsed.messages)
    for identified in piece:
        yield identified, [next(messages) for _ in identified.messages]


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


_Selection = tuple[str | None, frozenset[int]]
"""A signal's multiplexer, None where every frame carries the signal, and the values of it that select the signal."""


def _selection_of(
    message: DeclaredMessage, identified: Identified, multiplexers: Mapping[str, str], report: Report
) -> dict[str, _Selection]:
    """Find what selects each signal, as cantools does: a signal that nothing selects is in every frame.

    Args:
        message: the message.
        identified: with the selections by `SG_MUL_VAL_`.
        multiplexers: of those selections, by signal.
        report: called for each signal that is marked as selected and that nothing selects.
    """
    marked = [name for name, signal in message.signals.items() if signal.mark.endswith("M")]
    only = marked[0] if len(marked) == 1 else None
    found: dict[str, _Selection] = {}
    for name, signal in message.signals.items():
        multiplexer = multiplexers.get(name) if only is None else only if only != name else None
        if not signal.mark:
            continue
        if multiplexer is None:
            if signal.mark != "M":
                why = (
                    "no SG_MUL_VAL_ says by which multiplexer" if len(marked) > 1 else "there is no multiplexer for it"
                )
                report(
                    signal.line,
                    f"signal '{name}' of message '{message.name}' is marked {signal.mark}, but {why}: taken from every "
                    "frame",
                )
            continue
        ids = identified.selections.get(multiplexer, {}).get(name)
        own = frozenset({int(signal.mark[1:])}) if only is not None else frozenset()
        found[name] = multiplexer, own if ids is None else ids
    return found


def _message(
    parsed: ParsedMessage,
    declared: DeclaredMessage,
    identified: Identified,
    selections: Mapping[str, _Selection],
    path: Path,
    report: Report,
) -> MessageSpec:
    if CLASSIC_LENGTH < parsed.length <= FD_LENGTH and not parsed.is_fd:
        report(
            declared.line,
            f"message '{parsed.name}' has {parsed.length} bytes but is not marked CAN FD: taken as CAN FD",
        )
    names = {name: signal.name for name, signal in zip(declared.signals, parsed.signals, strict=True)}
    signals = []
    for (name, text), signal in zip(declared.signals.items(), parsed.signals, strict=True):
        multiplexer, ids = selections.get(name, (None, frozenset()))
        signals.append(
            _signal(
                signal,
                text,
                comment=identified.comments.get(name, ""),
                choices=identified.choices.pop(name, None),  # the first message that has the signal takes it
                multiplexer=None if multiplexer is None else names.get(multiplexer, multiplexer),
                ids=ids,
            )
        )
    return MessageSpec(
        name=parsed.name,
        can_id=parsed.frame_id | (EXTENDED if parsed.is_extended_frame else 0),
        length=parsed.length,
        signals=tuple(sorted(signals, key=bits.first_bit)),
        is_fd=parsed.is_fd or parsed.length > CLASSIC_LENGTH,
        cycle_time=_seconds(parsed.cycle_time),
        comment=identified.comments.get("", ""),
        file=path,
        line=declared.line,
    )


def _seconds(cycle: object) -> float | None:
    """Convert `GenMsgCycleTime`, milliseconds, which some files define as text."""
    return cycle / 1000 if isinstance(cycle, int | float) and cycle > 0 else None


def _signal(
    parsed: ParsedSignal,
    declared: DeclaredSignal,
    *,
    comment: str,
    choices: Mapping[int, str] | None,
    multiplexer: str | None,
    ids: frozenset[int],
) -> SignalSpec:
    order: Literal["little", "big"] = "little" if parsed.byte_order == "little_endian" else "big"
    return SignalSpec(
        name=parsed.name,
        start=parsed.start,
        length=parsed.length,
        byte_order=order,
        signed=parsed.is_signed,
        is_float=parsed.is_float,
        scale=_number(parsed.scale),
        offset=_number(parsed.offset),
        minimum=None if parsed.minimum is None else _number(parsed.minimum),
        maximum=None if parsed.maximum is None else _number(parsed.maximum),
        unit=declared.unit,
        choices=choices,
        initial=parsed.raw_initial,
        is_multiplexer=declared.mark.endswith("M"),
        multiplexer_signal=multiplexer,
        multiplexer_ids=ids,
        comment=comment,
        line=declared.line,
    )


def _number(number: float) -> float:
    """Return a whole number that no signal of 64 bits has as a float, which overflows to infinity."""
    return number if abs(number) <= 1 << 64 else float(number)
