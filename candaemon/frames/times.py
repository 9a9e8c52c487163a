"""Instants beyond every recording, for what has not happened and what will not."""

from __future__ import annotations

from typing import Final

NEVER_NS: Final = (1 << 63) - 1
"""ns: later than anything; the deadline of what is not open."""
LONG_AGO_NS: Final = -(1 << 62)
"""ns: before anything, with room to be subtracted from."""
