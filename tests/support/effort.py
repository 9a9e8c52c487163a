"""How many examples a property is tried on: a share by default, all of them where CANDAEMON_THOROUGH is set."""

from __future__ import annotations

import os

_FEWEST, _SHARE = 10, 8


def examples(thorough: int, fewest: int = _FEWEST) -> int:
    """Return how many examples to draw.

    Args:
        thorough: as many as CI draws.
        fewest: as many as are drawn by default where a share would be fewer.
    """
    return thorough if os.environ.get("CANDAEMON_THOROUGH") else max(min(thorough, fewest), thorough // _SHARE)
