"""Values of ego motion that cannot be true: no number, outside the DBC's range, or changed faster than can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isnan, radians
from sys import float_info
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.binding.bound import EgoMessage
from candaemon.config.protection import MotionPlausibilitySettings
from candaemon.frames.times import LONG_AGO_NS
from candaemon.objects.signals import SignalBinding, dbc_range
from candaemon.protection.monitor import FrameFaults

SPEEDS: Final = frozenset({"speed", "left_wheels", "right_wheels", "velocity_north", "velocity_east"})
LEAST_INTERVAL: Final = 0.02
"""s, of a change: frames that come closer together than they were measured make none faster."""


@dataclass(slots=True)
class MotionFaults(FrameFaults):
    """Frames of ego motion that were not used, each under one cause.

    Attributes:
        not_finite: frames with a value that is no number.
        out_of_range: frames with a value outside the DBC's range.
        impossible: frames with a value that has changed faster than it can.
    """

    not_finite: int = 0
    out_of_range: int = 0
    impossible: int = 0

    @property
    def refused(self) -> int:
        """Frames that were not used, for whatever cause."""
        return self.failed + self.not_finite + self.out_of_range + self.impossible


@dataclass(slots=True)
class ValueHistory:
    """What one value was.

    Attributes:
        latest: the last one received, SI.
        latest_ns: its time.
        accepted: the last one that was no jump, SI.
        accepted_ns: its time.
    """

    latest: float = 0.0
    latest_ns: int = LONG_AGO_NS
    accepted: float = 0.0
    accepted_ns: int = LONG_AGO_NS


@dataclass(slots=True)
class MotionPlausibilityState:
    """What each value of a message of ego motion was, in the order of its quantities."""

    values: list[ValueHistory] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Limit:
    """What one value of a message of ego motion may be, and how fast it may change."""

    low: float
    high: float
    rate: float
    optional: bool

    def jumps(self, before: ValueHistory, value: float, time_ns: int) -> bool:
        """Return whether a value is too far from the last one received and the last one accepted; remember it."""
        jumps = self._far(value - before.latest, time_ns - before.latest_ns)
        jumps = jumps and self._far(value - before.accepted, time_ns - before.accepted_ns)
        before.latest, before.latest_ns = value, time_ns
        if not jumps:
            before.accepted, before.accepted_ns = value, time_ns
        return jumps

    def _far(self, change: float, interval_ns: int) -> bool:
        return abs(change) > self.rate * max(interval_ns * 1e-9, LEAST_INTERVAL)


class MotionPlausibility:
    """Judges the values of one message of ego motion.

    Args:
        message: the message.
        settings: what is asked of it.
        faults: where frames that are refused are counted; the owner's.

    Attributes:
        faults: as given.
    """

    def __init__(self, message: EgoMessage, settings: MotionPlausibilitySettings, faults: MotionFaults) -> None:
        self.faults = faults
        self._limits = [_limit(binding, settings) for binding in message.bindings]
        self._rated = [(index, limit) for index, limit in enumerate(self._limits) if limit.rate < float_info.max]
        self._low: Floats = np.array([limit.low for limit in self._limits])
        self._high: Floats = np.array([limit.high for limit in self._limits])
        self._state = MotionPlausibilityState([ValueHistory() for _ in self._limits])

    @property
    def state(self) -> MotionPlausibilityState:
        """What it remembers.

        Raises:
            ValueError: a state that is set does not fit the message.
        """
        return self._state

    @state.setter
    def state(self, state: MotionPlausibilityState) -> None:
        if len(state.values) != len(self._limits):
            raise ValueError(f"{len(state.values)} values of a message of ego motion, expected {len(self._limits)}")
        self._state = state

    @property
    def remembers(self) -> bool:
        """Whether `note` does anything."""
        return bool(self._rated)

    def admits(self, time_ns: int, values: Sequence[float]) -> bool:
        """Return whether a frame's values can be true; one whose values cannot is counted.

        Args:
            time_ns: time stamp of the frame.
            values: SI, in the order of the message's quantities; NaN where the DBC's multiplexer leaves one out.
        """
        faults = self.faults
        for value, limit in zip(values, self._limits):  # noqa: B905 - binding pairs them once for all frames
            if limit.low <= value <= limit.high:
                continue
            if not isnan(value):
                faults.out_of_range += 1
                return False
            if not limit.optional:
                faults.not_finite += 1
                return False
        jumps = False
        for index, limit in self._rated:  # each remembers its value, whatever the others are
            value = values[index]
            if not isnan(value) and limit.jumps(self._state.values[index], value, time_ns):
                jumps = True
        faults.impossible += jumps
        return not jumps

    def surely(self, times_ns: Integers, values: Floats) -> Booleans:
        """Return of which frames, in order of time, it is sure that `admits` would return True; nothing is remembered.

        To be called before the first of them is judged or noted; each value is to be there.

        Args:
            times_ns: time stamps of the frames (n,).
            values: as for `admits` (n, values).
        """
        inside: Booleans = np.logical_and.reduce((values >= self._low) & (values <= self._high), axis=1)
        sure = inside.copy()
        sure[1:] &= inside[:-1]  # else the value before was not the one that is remembered
        for index, limit in self._rated:
            before = self._state.values[index]
            change = np.abs(np.diff(values[:, index], prepend=before.latest))
            seconds = np.diff(times_ns, prepend=before.latest_ns) * 1e-9
            sure &= change <= limit.rate * np.maximum(seconds, LEAST_INTERVAL)
        return sure

    def note(self, time_ns: int, values: Sequence[float]) -> None:
        """Remember the values of a frame that can be true; arguments as `admits`."""
        for index, _ in self._rated:
            before = self._state.values[index]
            before.latest = before.accepted = values[index]
            before.latest_ns = before.accepted_ns = time_ns


def _limit(binding: SignalBinding, settings: MotionPlausibilitySettings) -> _Limit:
    """Return what one value may be."""
    limits = dbc_range(binding) if settings.ranges else None
    low, high = (-float_info.max, float_info.max) if limits is None else limits
    rate = None
    if binding.quantity in SPEEDS:
        rate = settings.max_acceleration
    elif binding.quantity == "yaw_rate" and settings.max_yaw_acceleration_deg is not None:
        rate = radians(settings.max_yaw_acceleration_deg)
    optional = binding.signal.multiplexer_signal is not None
    return _Limit(low, high, float_info.max if rate is None else rate, optional)
