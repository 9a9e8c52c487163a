"""Quantities that a source sends in a burst of frames, of which any may be lost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from candaemon.frames.times import LONG_AGO_NS

_SHORTEST_PERIOD_NS = 1_000_000


@dataclass(slots=True)
class InsEpochState:
    """What came of the current burst and of those before.

    Attributes:
        period_ns: of the bursts, the longest there may be until it was seen.
        missing: needed quantities that have not come in the current burst.
        time_ns: when the clock came last.
        is_open: whether the burst of that time is not complete yet.
        incomplete: bursts that the clock of the next one ended.
        value: the latest value of every quantity received, needed or not.
        arrived_ns: when it came.
    """

    period_ns: int
    missing: set[str]
    time_ns: int = LONG_AGO_NS
    is_open: bool = False
    incomplete: int = 0
    value: dict[str, float] = field(default_factory=dict)
    arrived_ns: dict[str, int] = field(default_factory=dict)


class InsEpoch:
    """Gathers the quantities of one instant from the frames that carry them.

    Args:
        needed: the quantities that make a burst complete.
        clock: the one among them whose frame gives the burst's time.
        longest_period: s between two bursts, until the clock has shown the period.

    Attributes:
        needed: as given.
        state: what it remembers.
    """

    def __init__(self, needed: Iterable[str], clock: str, longest_period: float) -> None:
        self.needed = frozenset(needed)
        self._clock = clock
        self._longest_ns = round(longest_period * 1e9)
        self._state = InsEpochState(self._longest_ns, set(self.needed))

    @property
    def state(self) -> InsEpochState:
        """What it remembers.

        Raises:
            ValueError: a state that is set does not fit the quantities needed.
        """
        return self._state

    @state.setter
    def state(self, state: InsEpochState) -> None:
        if not (state.missing <= self.needed <= state.missing | state.arrived_ns.keys()):
            raise ValueError("other quantities than the configuration's")
        if state.period_ns <= 0:
            raise ValueError("a period that is not above 0")
        if state.value.keys() != state.arrived_ns.keys():
            raise ValueError("a quantity without a time")
        self._state = state

    def take(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> bool:
        """Take the quantities of one frame; return whether it completes a burst: each has come afresh."""
        state = self._state
        if self._clock in names:
            self._beat(time_ns)
        for name, value in zip(names, values):  # noqa: B905 - binding pairs them once for all frames
            if value == value:  # not NaN: the DBC's multiplexer may leave it out
                state.value[name] = value
                state.arrived_ns[name] = time_ns
                state.missing.discard(name)
        if not state.missing:
            # what has waited since the burst before, because a frame was lost, does not belong to this one
            overdue = (name for name in self.needed if time_ns - state.arrived_ns[name] > state.period_ns / 2)
            state.missing.update(overdue)
        if state.missing:
            return False
        state.missing.update(self.needed)
        state.is_open = False
        return True

    def _beat(self, time_ns: int) -> None:
        """Note when the clock came, and follow the bursts' period: a pause, or a frame that waited, moves it little."""
        state = self._state
        interval_ns, before = time_ns - state.time_ns, state.period_ns
        if interval_ns > _SHORTEST_PERIOD_NS:
            is_known = before < self._longest_ns
            state.period_ns = before + (min(interval_ns, 2 * before) - before) // 4 if is_known else interval_ns
            state.period_ns = min(state.period_ns, self._longest_ns)
        state.incomplete += state.is_open
        state.time_ns, state.is_open = time_ns, True
