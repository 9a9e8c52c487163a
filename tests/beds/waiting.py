"""Waits for what another process does."""

from __future__ import annotations

import time
from collections.abc import Callable

POLL_S = 0.02


def wait_until(condition: Callable[[], bool], timeout_s: float, expected: Callable[[], str] | str) -> None:
    """Return as soon as a condition holds.

    Args:
        condition: asked again and again.
        timeout_s: longest wait, s.
        expected: what was waited for, for the message; called once if it is a function.

    Raises:
        AssertionError: it does not hold in time.
    """
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"not within {timeout_s:g} s: {expected if isinstance(expected, str) else expected()}")
        time.sleep(POLL_S)
