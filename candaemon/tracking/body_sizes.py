"""How large vehicles usually are, and from when on the size of a body counts as known."""

from __future__ import annotations

from typing import Final

CAR_LENGTH: Final = 4.5
CAR_WIDTH: Final = 1.8
"""m, of a body of which nothing is known."""
LORRY_LENGTH: Final = 13.0
"""m, of what is longer than its sensor can tell."""
WALKER: Final = (0.5, 0.6)
RIDER: Final = (1.8, 0.7)
"""m, length and width of who walks or rides."""
TOLD_LENGTH: Final = 1.0
"""m²; a length known better was told by a sensor."""
TOLD_WIDTH: Final = 0.1
"""m²; a width known better was told by a sensor."""
SMALL: Final = CAR_LENGTH / 2
"""m; what is shorter was found to be small."""
ENOUGH: Final = 2.5
"""m of a length that reflections have shown: it is no rider."""
SURELY_ALONE: Final = 1.0 + 1e-9
"""`BodyTable.alone` of who was told from others so surely that nothing but someone small shows."""
