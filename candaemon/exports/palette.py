"""The colours of all drawings: Okabe and Ito's, which colour-blind eyes distinguish."""

from __future__ import annotations

from typing import Final

SERIES: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Of curves, in this order."""

STATES: Final = ("#8C8C8C", "#0072B2", "#E69F00")
"""Of obstacles that are tentative, confirmed, coasting."""


def components(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, 0 to 1, of `#RRGGBB`."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue
