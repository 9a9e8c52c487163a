"""The most memory that a process held, whatever its parent held: `ru_maxrss` counts what was there before `exec`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

PEAK_MIB: Final = "float(open('/proc/self/status').read().partition('VmHWM:')[2].split()[0]) / 1024"
"""For the code of a process of its own: MiB."""


def peak_bytes() -> int:
    """Return the most bytes that this process held since its start, or since its peak was reset."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024
