"""A DBC file's bytes, read within limits; apart from what parses them, which a file that was parsed before spares."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from candaemon.errors import DatabaseError
from candaemon.files.bounded import FileReader, read_bounded

LONGEST_FILE: Final = 8 << 20
"""Bytes of a DBC file, at most."""


def read_database(path: Path, read: FileReader = read_bounded) -> bytes:
    """Read a DBC file's bytes.

    Args:
        path: the file.
        read: reads it.

    Raises:
        DatabaseError: it cannot be read.
    """
    try:
        return read(path, LONGEST_FILE)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise DatabaseError(f"cannot be read ({reason}); expected a DBC file", file=path) from error
