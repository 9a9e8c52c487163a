"""What a guest's kernel has for itself: a clock that can be set and limits that can be changed."""

from __future__ import annotations

import time
from pathlib import Path


def is_own_kernel() -> bool:
    """Return whether this runs in user-mode Linux, whose kernel no one else uses."""
    return "User Mode Linux" in Path("/proc/cpuinfo").read_text(encoding="utf-8")


class OwnClock:
    """The guest's time of day, which a test may set."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    def step(self, seconds: float) -> None:
        """Set it forward, or back by a negative number."""
        time.clock_settime(time.CLOCK_REALTIME, time.time() + seconds)

    def restore(self) -> None:
        """Undo all steps."""
        time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + self._offset_s)


class Sysctl:
    """The guest's kernel settings, which a test may change."""

    def __init__(self) -> None:
        self._before: dict[Path, str] = {}

    def set(self, name: str, value: int) -> None:
        """Change one, such as net.core.rmem_max."""
        path = Path("/proc/sys", *name.split("."))
        self._before.setdefault(path, path.read_text(encoding="ascii"))
        path.write_text(f"{value}\n", encoding="ascii")

    def restore(self) -> None:
        """Undo all changes."""
        for path, value in self._before.items():
            path.write_text(value, encoding="ascii")
