"""Log records as lines that are safe to print and to store, whatever they quote."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Final, TypeAlias

from candaemon.errors import CandaemonError
from candaemon.printable import printable

ANSWER: Final = {"answer": True}
"""`extra` of a record that answers a request: however many are like it, none is left out."""

ExceptionInfo: TypeAlias = tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]


def text_of(record: logging.LogRecord) -> str:
    """Return what a record says: on one line, or, where it quotes an error of ours, on one line for each of several."""
    text = record.getMessage()
    quoted = record.args if isinstance(record.args, tuple) else ()
    several = any(isinstance(each, CandaemonError) for each in quoted)
    return _printable_lines(text) if several else printable(text)


class LineFormatter(logging.Formatter):
    """Formats a record so that nothing it quotes begins another line or acts on a terminal.

    A traceback follows on lines of its own.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the base class's
        """Return the record's text."""
        record.message = text_of(record)
        return super().formatMessage(record)

    def formatException(self, ei: ExceptionInfo) -> str:  # noqa: N802 - the base class's
        """Return the lines of a traceback."""
        return _printable_lines(super().formatException(ei))


def _printable_lines(text: str) -> str:
    """Make a text of several lines safe to print."""
    return "\n".join(map(printable, text.split("\n")))
