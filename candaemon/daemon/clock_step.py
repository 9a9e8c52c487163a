"""Distinguishes a step of the system clock from a pause of the process: both look like a gap in the time stamps."""

from __future__ import annotations

import time
from collections.abc import Callable

_SET_NS = 100_000_000
"""Difference in one iteration of the core loop that only a step explains: time servers slew 0.5 ms a second."""
_REMEMBERED_NS = 10_000_000_000
"""How long frames that were stamped before the clock was set may wait in a buffer."""


def since_boot_ns() -> int:
    """Return the ns since the machine started, those of its sleep among them."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class ClockStepDetector:
    """Compares the clock of the frames with one that nobody can set.

    Args:
        steady: that clock, ns; it goes on while the process or the machine sleeps.
    """

    def __init__(self, steady: Callable[[], int] = since_boot_ns) -> None:
        self._steady = steady
        self._ahead_ns: int | None = None
        self._set_ns: int | None = None

    def was_set(self, now_ns: int) -> bool:
        """Return whether the clock was set of late; to be called in each iteration.

        Args:
            now_ns: what it says, read after the frames whose time stamps are in question.
        """
        steady_ns = self._steady()
        ahead_ns = now_ns - steady_ns
        if self._ahead_ns is not None and abs(ahead_ns - self._ahead_ns) > _SET_NS:
            self._set_ns = steady_ns
        self._ahead_ns = ahead_ns
        return self._set_ns is not None and steady_ns - self._set_ns <= _REMEMBERED_NS

    def explains(self, delay_ns: int, now_ns: int) -> bool:
        """Return whether a delay is none, but a frame that was stamped before the clock was set and used after it.

        Args:
            delay_ns: from a frame's time stamp until now.
            now_ns: what the clock says.
        """
        return abs(delay_ns) > _SET_NS and self.was_set(now_ns)
