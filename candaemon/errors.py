"""The exception tree.

::

    CandaemonError              anything candaemon raises on purpose
    ├── ConfigError             the YAML, the DBC files or how they fit: exit code 2
    │   └── DatabaseError       a DBC file that cannot be loaded even tolerantly
    └── InputError              a log or table that cannot be used at all: exit code 1
        └── BusError            a live bus that cannot be opened, read or written
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from candaemon.printable import printable

MOST_PROBLEMS: Final = 50
"""Most problems that one error tells, a line each."""
LONGEST_MESSAGE: Final = 4000
"""Longest message of one error, in characters; of a longer one the middle is left out."""


class CandaemonError(Exception):
    """Base of every error that candaemon raises on purpose.

    Whatever the texts quote, the error's text has a line for itself and one for each of the others, and is safe to
    print.

    Args:
        message: what was found, what was expected, what to do.
        file: the file it was found in, where there is one.
        line: 1-based line in that file, where it is known.
        others: found at the same time; told after it.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        file: Path | str | None = None,
        line: int | None = None,
        others: Sequence[CandaemonError] = (),
    ) -> None:
        self.message = printable(_shortened(message))
        self.file = None if file is None else printable(str(file))
        self.line = line
        self.others = tuple(others)
        super().__init__(str(self))

    def __str__(self) -> str:
        lines = [self._own_line(), *map(str, self.others[:MOST_PROBLEMS])]
        left_out = len(self.others) - MOST_PROBLEMS
        return "\n".join([*lines, f"and {left_out:,} more"] if left_out > 0 else lines)

    def _own_line(self) -> str:
        if self.file is None:
            return self.message
        where = self.file if self.line is None else f"{self.file}:{self.line}"
        return f"{where}: {self.message}"


def _shortened(message: str) -> str:
    """Return a message without its middle where it is too long: the end says what to do."""
    if len(message) <= LONGEST_MESSAGE:
        return message
    half = LONGEST_MESSAGE // 2
    return f"{message[:half]} … {message[-half:]}"


class ConfigError(CandaemonError):
    """A configuration that cannot be used: the YAML, its DBC files, or how the two fit together."""

    exit_code = 2


class DatabaseError(ConfigError):
    """A DBC file that cannot be loaded, even tolerantly."""


class InputError(CandaemonError):
    """A log or table that cannot be used at all."""


class BusError(InputError):
    """A live bus that cannot be opened, read or written."""
