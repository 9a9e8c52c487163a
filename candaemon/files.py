"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from candaemon.errors import InputError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file so that whoever reads it finds the former content or this one, never a part of either.

    What is no regular file, such as a pipe or `/dev/stdout`, is written in place.

    Args:
        path: the file; one that is there is replaced.
        content: text is written as UTF-8.

    Raises:
        InputError: it cannot be written; names the path.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        if _is_special(path):
            path.write_bytes(data)
            return
        part = path.with_name(f".{path.name}.part")
        try:
            part.write_bytes(data)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error.strerror) from error


def check_writable(path: Path) -> None:
    """Refuse a path before the work is done whose result could not be written to it.

    Raises:
        InputError: it is a folder, or in none that can be written to; names the path.
    """
    if path.is_dir():
        raise _unwritable(path, "it is a folder")
    if _is_special(path):
        return
    if not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
        raise _unwritable(path, "there is no such folder, or no right to write to it")


def make_folder(path: Path) -> None:
    """Create a folder, and those above it, unless it is there.

    Raises:
        InputError: it cannot be created, or a file is in its place; names the path.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error.strerror) from error


def _is_special(path: Path) -> bool:
    """Tell whether something other than a regular file is there, which must not be replaced by one."""
    return path.is_symlink() or (path.exists() and not path.is_file())


def _unwritable(path: Path, reason: str | None) -> InputError:
    """Say that nothing can be written to a path."""
    return InputError(f"cannot be written: {reason}; choose another path", file=path)
