"""When a track manoeuvres: the decision of Zhang et al. 2016, batched over tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state

_LONGEST = 2.0
"""Intervals, as which one comparison counts at most."""


@dataclass(frozen=True, slots=True)
class SwitchRule:
    """When a track changes its model, (7), (8) and the section "Calculation" of Zhang et al. 2016.

    Source: Zhang et al. 2016, eqs. (7), (8).

    Samples need not be even: two speeds are compared at the samples nearest to an interval apart, for what the change
    comes to over an interval, and T1 and T2 end at the comparisons nearest to them.

    Attributes:
        threshold: Th1, change of speed over one interval as a share of the speed, from which on it is a manoeuvre.
        least_change: m/s, a smaller change is none: of a vehicle at rest, Th1 of the paper is zero.
        manoeuvre_time: T1, s of change without a break until it is a manoeuvre.
        steady_time: T2, s without change until it is over.
        interval: s between two speeds that are compared, the paper's sampling period. At a higher rate the speeds in
            between are not looked at: the threshold is one of acceleration, and filtered noise has more of it the
            shorter the time.
    """

    threshold: float = 0.05
    least_change: float = 0.1
    manoeuvre_time: float = 10.0
    steady_time: float = 20.0
    interval: float = 1.0


@dataclass(slots=True)
class ManoeuvreState:
    """What a `ManoeuvreWatch` remembers of n tracks.

    Attributes:
        step: s of the latest prediction.
        compared: velocities that the next ones are compared with, (n, A), m/s.
        since: s since those, (n,).
        against: s for which the decision in force has been contradicted, (n,).
        manoeuvring: the decision (n,).
    """

    step: float
    compared: Floats
    since: Floats
    against: Floats
    manoeuvring: Booleans


class ManoeuvreWatch:
    """Watches the speeds of n tracks; rows are tracks.

    Args:
        axes: of a track: 1, or 2 in the plane.
        rule: when to decide otherwise.
    """

    def __init__(self, axes: int, rule: SwitchRule) -> None:
        self._rule = rule
        self._axes = axes
        self._state = self._empty()

    def __len__(self) -> int:
        return len(self._state.manoeuvring)

    @property
    def state(self) -> ManoeuvreState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: ManoeuvreState) -> None:
        self._state = checked_state(state, self._empty())

    @property
    def manoeuvring(self) -> Booleans:
        """The decision (n,); a track begins with a manoeuvre, as the paper's step (1) does."""
        return self._state.manoeuvring

    def _empty(self) -> ManoeuvreState:
        return ManoeuvreState(0.0, np.zeros((0, self._axes)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.bool_))

    def spawn(self, velocity: Floats) -> None:
        """Append tracks with their velocities (k, A), m/s."""
        k, state = len(velocity), self._state
        state.compared = np.concatenate([state.compared, velocity])
        state.since = np.concatenate([state.since, np.zeros(k)])
        state.against = np.concatenate([state.against, np.zeros(k)])
        state.manoeuvring = np.concatenate([state.manoeuvring, np.ones(k, dtype=np.bool_)])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        state = self._state
        state.compared, state.since = state.compared[rows], state.since[rows]
        state.against, state.manoeuvring = state.against[rows], state.manoeuvring[rows]

    def advance(self, dt: float) -> None:
        """Let dt pass, s."""
        self._state.step = dt
        self._state.since += dt

    def watch(self, rows: Indices, velocity: Floats) -> None:
        """Take the filtered velocities of the rows just measured; where an interval is over, compare and decide.

        Source: Zhang et al. 2016, eqs. (7), (8).

        What speaks against the decision in force must do so without a break. A gap without measurements is one
        comparison, and counts as two intervals at most.

        Args:
            rows: (m,), each once.
            velocity: (m, A), m/s.
        """
        since = self._state.since[rows]
        # the next sample is farther from the end of the interval
        due = since + np.minimum(since, self._state.step) / 2 >= self._rule.interval
        if due.any():
            self._compare(rows[due], velocity[due])

    def _compare(self, rows: Indices, velocity: Floats) -> None:
        """Compare velocities with those an interval ago, (7) and (8); decide otherwise where the time has come."""
        rule, state = self._rule, self._state
        elapsed = state.since[rows]
        change = np.linalg.norm(velocity - state.compared[rows], axis=1) * rule.interval
        threshold = np.maximum(rule.threshold * np.linalg.norm(velocity, axis=1), rule.least_change) * elapsed
        manoeuvring = state.manoeuvring[rows]
        contrary = (change > threshold) != manoeuvring
        counted = np.minimum(elapsed, _LONGEST * rule.interval)
        against = np.where(contrary, state.against[rows] + counted, 0.0)
        required = np.where(manoeuvring, rule.steady_time, rule.manoeuvre_time)
        over = contrary & (against + counted / 2 >= required)
        state.manoeuvring[rows] = manoeuvring ^ over
        state.against[rows] = np.where(over, 0.0, against)
        state.compared[rows], state.since[rows] = velocity, 0.0
