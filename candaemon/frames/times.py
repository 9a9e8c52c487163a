"""The range of instants, and what lies beyond it: what has not happened and what will not."""

from __future__ import annotations

from typing import Final

LATEST_NS: Final = (1 << 62) - 1
"""ns: the last instant that a frame can have, in the year 2116; the first one is 0, in 1970.

Half of what 64 bits hold: an instant plus the difference of any two instants is still less than `NEVER_NS`, whatever
the clock was set to. See `candaemon.can_io.reorder` for how that holds after many steps of a clock.
"""
NEVER_NS: Final = (1 << 63) - 1
"""ns: later than anything; the deadline of what is not open."""
LONG_AGO_NS: Final = -(1 << 62)
"""ns: before anything, with room to be subtracted from."""
