"""Files from outside, read whole and never further than a limit."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

FileReader: TypeAlias = Callable[[Path, int], bytes]
"""Reads a file (path, most bytes) as `read_bounded` does, with its errors."""


def read_bounded(path: Path, longest: int, *, follow: bool = True, special: bool = False) -> bytes:
    """Read a file that must not be longer than a limit.

    What is read counts, not what the file system says of the length: a file may grow, and `/proc` says 0.

    Args:
        path: the file.
        longest: most bytes.
        follow: whether a link is followed, where the file may be one.
        special: whether a pipe or a device is read, too. Without it, opening one waits for nobody.

    Raises:
        OSError: as for `open`; EFBIG where the file is longer, EINVAL where it is no regular file, each with a
            `strerror` that says so.
    """
    flags = os.O_RDONLY | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW) | (0 if special else os.O_NONBLOCK)
    with open(os.open(path, flags), "rb", buffering=0) as file:  # noqa: PTH123 - a descriptor, which `Path` cannot open
        mode = os.fstat(file.fileno()).st_mode
        if stat.S_ISDIR(mode):
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not (special or stat.S_ISREG(mode)):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        pieces, remaining = [], longest + 1
        while remaining and (piece := file.read(remaining)):
            pieces.append(piece)
            remaining -= len(piece)
    if not remaining:
        raise OSError(errno.EFBIG, f"it is longer than {longest:,} bytes, the most that is read", str(path))
    return b"".join(pieces)


def read_anything(path: Path, longest: int) -> bytes:
    """Read a file, or a pipe or a device such as `/dev/stdin`, as `read_bounded` does."""
    return read_bounded(path, longest, special=True)
