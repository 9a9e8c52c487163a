"""Where targets put the files that they let candaemon read."""

from __future__ import annotations

from atexit import register
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp


@cache
def scratch() -> Path:
    """Return a folder of this process, in memory where the system has such; it goes with the process."""
    memory = Path("/dev/shm")  # noqa: S108 - mkdtemp makes a folder of its own there
    folder = Path(mkdtemp(prefix="candaemon-fuzz-", dir=memory if memory.is_dir() else None))
    register(rmtree, folder, ignore_errors=True)
    return folder
