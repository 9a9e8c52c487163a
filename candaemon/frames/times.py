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

_NS_EXACT = 4_000_000.0
"""Seconds up to which a float resolves nanoseconds."""
_LATEST_S = LATEST_NS // 1_000_000_000


def nanoseconds(seconds: float) -> int:
    """Return float seconds in nanoseconds, without the digits that the float made up.

    A float of seconds since 1970 holds steps of 0.24 µs, so it is rounded to the microsecond that was meant; one small
    enough to hold nanoseconds is rounded to these.

    Args:
        seconds: time stamp in s.

    Raises:
        ValueError: it is no number, or one before 1970 or after 2116 (`LATEST_NS`).
    """
    if not 0 <= seconds < _LATEST_S:
        raise ValueError(f"time stamp {seconds} s is out of range")
    if seconds < _NS_EXACT:
        return round(seconds * 1e9)
    return round(seconds * 1e6) * 1000
