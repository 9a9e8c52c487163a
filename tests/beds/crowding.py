"""How crowded the machine around a guest is, which the guest does not see: told by a file."""

from __future__ import annotations

import os
from pathlib import Path

CROWDING = "CANDAEMON_CROWDING"
"""Environment variable: the file."""


def tell_crowding(path: Path) -> None:
    """Write down how many processes want each of this machine's processors, as of the last minute."""
    part = path.with_suffix(".part")
    part.write_text(f"{os.getloadavg()[0] / (os.cpu_count() or 1):.2f}", encoding="ascii")
    part.replace(path)


def crowding() -> float:
    """Return how many times as long work takes here as on a machine that does nothing else; 1 at least."""
    return max(float(Path(os.environ[CROWDING]).read_text(encoding="ascii")), 1.0)
