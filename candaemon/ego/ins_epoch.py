"""Quantities that a source tells in a burst of frames, of which any may be lost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_SHORTEST_PERIOD_NS = 1_000_000


class InsEpoch:
    """Gathers the quantities of one instant from the frames that tell them.

    Args:
        needed: the quantities that make a burst complete.
        clock: the one among them whose frame gives the burst's time.
        longest_period: s between two bursts, until the clock has shown the period.

    Attributes:
        needed: as given.
        time_ns: when the clock came last.
        value: the latest of every quantity told, needed or not.
    """

    def __init__(self, needed: Iterable[str], clock: str, longest_period: float) -> None:
        self.needed = frozenset(needed)
        self.time_ns = 0
        self.value: dict[str, float] = {}
        self._clock = clock
        self._missing = set(self.needed)
        self._arrived_ns: dict[str, int] = {}
        self._period_ns = round(longest_period * 1e9)

    def take(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> bool:
        """Take the quantities of one frame; tell whether it completes a burst: each has come afresh."""
        if self._clock in names:
            self._beat(time_ns)
        for name, value in zip(names, values):  # noqa: B905 - binding pairs them once for all frames
            if value == value:  # not NaN: the DBC's multiplexer may leave it out
                self.value[name] = value
                self._arrived_ns[name] = time_ns
                self._missing.discard(name)
        if not self._missing:
            # what has waited since the burst before, because a frame was lost, does not belong to this one
            self._missing.update(name for name in self.needed if time_ns - self._arrived_ns[name] > self._period_ns / 2)
        if self._missing:
            return False
        self._missing.update(self.needed)
        return True

    def _beat(self, time_ns: int) -> None:
        """Note when the clock came; the shortest time between two is the bursts' period."""
        interval_ns = time_ns - self.time_ns
        if interval_ns > _SHORTEST_PERIOD_NS:
            self._period_ns = min(self._period_ns, interval_ns)
        self.time_ns = time_ns
