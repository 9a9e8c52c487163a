"""What computes a drive: the code of candaemon and the libraries whose arithmetic and files its results are."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

from candaemon._version import __version__

_LIBRARIES = ("numpy", "scipy", "cantools", "pyarrow")


@cache
def software() -> dict[str, str]:
    """Return the versions by which results may differ; `code` is a hash of candaemon's own files."""
    package, code = Path(__file__).resolve().parents[1], hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        code.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    libraries = {name: version(name) for name in _LIBRARIES}
    python = ".".join(map(str, sys.version_info[:2]))
    return {
        "candaemon": __version__,
        "code": code.hexdigest()[:16],
        "python": python,
        "machine": platform.machine(),
        **libraries,
    }


def difference(found: dict[str, str], expected: dict[str, str]) -> str:
    """Return how one differs from another, in words; empty where it does not."""
    return ", ".join(
        f"{key} {found.get(key, 'missing')} instead of {expected[key]}"
        for key in expected
        if found.get(key) != expected[key]
    )
