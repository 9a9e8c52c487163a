"""How many examples a property is tried on: a share by default, all of them where CANDAEMON_THOROUGH is set."""

from __future__ import annotations

import os

_FEWEST, _SHARE = 10, 8


def examples(thorough: int) -> int:
    """Return how many examples to draw.

    Args:
        thorough: as many as CI draws.
    """
    return thorough if os.environ.get("CANDAEMON_THOROUGH") else max(min(thorough, _FEWEST), thorough // _SHARE)
