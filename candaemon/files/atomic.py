"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from candaemon.errors import InputError

_OTHERS = frozenset({Path("/dev"), Path("/proc")})


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write a file so that whoever reads it finds the former content or this one, never a part of either.

    A link goes on pointing to the file that it names. What is no regular file, such as a pipe, is written in place,
    and so is what lies below `/dev` and `/proc`: `/dev/stdout` may be a file that others write to as well.

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
        target = path.resolve()
        part = target.with_name(f".{target.name}.part")
        try:
            part.write_bytes(data)
            part.replace(target)
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
    folder = path.resolve().parent
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise _unwritable(path, "there is no such folder, or no right to write to it")


def make_folder(path: Path) -> None:
    """Create a folder, and those above it, unless it is there.

    Raises:
        InputError: it cannot be created or written to, or a file is in its place; names the path.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error.strerror) from error
    if not os.access(path, os.W_OK):
        raise _unwritable(path, "there is no right to write to it")


def _is_special(path: Path) -> bool:
    """Return whether something other than a regular file is there, which must not be replaced by one."""
    return not _OTHERS.isdisjoint(path.absolute().parents) or (path.exists() and not path.is_file())


def _unwritable(path: Path, reason: str | None) -> InputError:
    """Say that nothing can be written to a path."""
    return InputError(f"cannot be written: {reason}; choose another path", file=path)
