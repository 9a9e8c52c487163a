"""What the log says of a bus that comes and goes."""

from __future__ import annotations

import logging
from collections import deque
from typing import Final

logger = logging.getLogger(__name__)

MOST: Final = 10
WITHIN_S: Final = 60.0
"""So many messages within that time: a bus with a short circuit goes off ten times a second while it lasts."""


class Notices:
    """Logs whether a bus is there when that changes; one that changes too often is told of later, as it is then.

    Args:
        name: of the bus in the configuration.

    Attributes:
        told_up: what the log has been told; set where somebody else tells it.
    """

    def __init__(self, name: str) -> None:
        self.told_up = True
        self._name = name
        self._times_s: deque[float] = deque(maxlen=MOST)

    def tell(self, now_s: float, *, up: bool, error: str) -> None:
        """Tell whether the bus is up, and why it is not; to be asked again now and then.

        Args:
            now_s: monotonic s.
            up: whether it is.
            error: why it is down.
        """
        if up == self.told_up:
            return
        if len(self._times_s) == MOST and now_s - self._times_s[0] < WITHIN_S:
            return
        self._times_s.append(now_s)
        self.told_up = up
        if up:
            logger.info("bus '%s' is up", self._name)
        else:
            logger.warning("bus '%s' is down: %s", self._name, error)
