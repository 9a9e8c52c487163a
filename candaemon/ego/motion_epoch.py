"""Quantities of ego motion that belong to one instant, each with an age and a rate of its own.

A clock, which is one of the quantities, begins an epoch. It is complete as soon as everything has come that is due by
its own rate; what is slow, silent or new is not waited for. What is due and does not come ends with the next beat.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

SHORTEST_PERIOD_NS: Final = 1_000_000
"""Between two frames, below which they were stamped in a batch."""
EARLY, LATE = 0.5, 2.5
"""Periods since it came last, between which a quantity is due; beyond, it is silent."""


@dataclass(slots=True)
class ReceivedSignal:
    """A quantity as it came last.

    Attributes:
        value: SI.
        arrived_ns: when.
        period_ns: between two of them, smoothed; 0 before the second.
    """

    value: float
    arrived_ns: int
    period_ns: int = 0


@dataclass(slots=True)
class MotionEpochState:
    """What came of ego motion.

    Attributes:
        time_ns: when the latest epoch began.
        is_open: whether it is still to be completed.
        waiting: quantities that are due in it.
        signals: every quantity that ever came.
    """

    time_ns: int = 0
    is_open: bool = False
    waiting: set[str] = field(default_factory=set)
    signals: dict[str, ReceivedSignal] = field(default_factory=dict)


class MotionEpoch:
    """Gathers the quantities of one instant from frames of different rates, of which any may be lost or silent.

    Args:
        clock: the quantity whose frame begins an epoch.
        others: the quantities that are waited for where they are due.
        longest_period: s, of any quantity; one that comes more rarely is silent between.

    Attributes:
        state: what it remembers.
    """

    def __init__(self, clock: str, others: Iterable[str], longest_period: float) -> None:
        self._clock, self._others = clock, frozenset(others)
        self._longest_ns = round(longest_period * 1e9)
        self._state = MotionEpochState()

    @property
    def state(self) -> MotionEpochState:
        """What it remembers.

        Raises:
            ValueError: a state that is set waits for other quantities than the configuration's.
        """
        return self._state

    @state.setter
    def state(self, state: MotionEpochState) -> None:
        if not state.waiting <= self._others:
            raise ValueError("other quantities than the configuration's")
        if any(signal.period_ns < 0 for signal in state.signals.values()):
            raise ValueError("a quantity with a negative period")
        self._state = state

    def take(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> bool:
        """Take the quantities of one frame; return whether it completes an epoch.

        An epoch that is open when its clock comes again does not become more complete: it is to be used before.
        """
        state = self._state
        signals, waiting = state.signals, state.waiting
        for name, value in zip(names, values):  # noqa: B905 - binding pairs them once for all frames
            if value != value:  # NaN: the DBC's multiplexer left it out
                continue
            signal = signals.get(name)
            if name == self._clock:
                self._begin(time_ns, signal)
            if signal is None:
                signals[name] = ReceivedSignal(value, time_ns)
            else:
                interval_ns = time_ns - signal.arrived_ns
                if interval_ns > SHORTEST_PERIOD_NS and interval_ns != signal.period_ns:
                    self._learn_period(signal, interval_ns)
                signal.value, signal.arrived_ns = value, time_ns
            waiting.discard(name)
        if waiting or not state.is_open:
            return False
        state.is_open = False
        return True

    def fresh(self, name: str) -> float | None:
        """Return the latest value of a quantity that was not silent when the epoch began; else None."""
        state = self._state
        signal = state.signals.get(name)
        if signal is None or state.time_ns - signal.arrived_ns > LATE * (signal.period_ns or self._longest_ns):
            return None
        return signal.value

    def belongs(self, name: str) -> bool:
        """Return whether the latest value of a quantity is of the epoch's own instant."""
        state, signal = self._state, self._state.signals.get(name)
        if signal is None:
            return False
        if signal.arrived_ns == state.time_ns:
            return True
        period_ns = state.signals[self._clock].period_ns or self._longest_ns
        return abs(state.time_ns - signal.arrived_ns) <= EARLY * period_ns

    def _begin(self, time_ns: int, clock: ReceivedSignal | None) -> None:
        """Begin an epoch; after a pause, and at first, everything is due."""
        state = self._state
        state.time_ns, state.is_open = time_ns, True
        interval_ns = self._longest_ns if clock is None else time_ns - clock.arrived_ns
        period_ns = (clock and clock.period_ns) or min(interval_ns, self._longest_ns)
        paused = clock is None or interval_ns > LATE * period_ns
        state.waiting.clear()
        for name in self._others:
            signal = state.signals.get(name)
            if signal is None:
                due = clock is None
            else:
                age_ns, own_ns = time_ns - signal.arrived_ns, signal.period_ns or period_ns
                due = age_ns >= EARLY * own_ns and (paused or age_ns <= LATE * own_ns)
            if due:
                state.waiting.add(name)

    def _learn_period(self, signal: ReceivedSignal, interval_ns: int) -> None:
        """Follow the interval at which a quantity comes; a pause, or frames stamped in a batch, move it little."""
        before = signal.period_ns
        interval_ns = min(interval_ns, self._longest_ns)
        signal.period_ns = before + (min(interval_ns, 2 * before) - before) // 4 if before else interval_ns
