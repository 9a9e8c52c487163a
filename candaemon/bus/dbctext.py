"""The text of a DBC file as statements, each with its line."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

Report = Callable[[int, str], None]
"""Takes a 1-based line and what was found there."""

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
    """Blot the strings out, so that their content is taken for nothing else."""
    return STRING.sub(lambda found: '"' + "_" * (len(found[0]) - 2) + '"', code)
