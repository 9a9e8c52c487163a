"""Values of own motion that cannot be true: no number, outside the DBC's range, or changed faster than can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, radians
from sys import float_info
from typing import Final

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
    """Frames of own motion that were not used, each under one cause.

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
class _Limit:
    """What one value of a message of own motion may be, and how fast it may change; and what it was."""

    low: float
    high: float
    rate: float
    optional: bool
    told: float = 0.0
    told_ns: int = LONG_AGO_NS
    believed: float = 0.0
    believed_ns: int = LONG_AGO_NS

    def jumps(self, value: float, time_ns: int) -> bool:
        """Tell whether a value is too far from the last one told and the last one believed; remember it."""
        jumps = self._far(value - self.told, time_ns - self.told_ns)
        jumps = jumps and self._far(value - self.believed, time_ns - self.believed_ns)
        self.told, self.told_ns = value, time_ns
        if not jumps:
            self.believed, self.believed_ns = value, time_ns
        return jumps

    def _far(self, change: float, interval_ns: int) -> bool:
        return abs(change) > self.rate * max(interval_ns * 1e-9, LEAST_INTERVAL)


class MotionPlausibility:
    """Judges the values of one message of own motion.

    Args:
        own: the message.
        settings: what is asked of it.
        faults: where frames that are refused are counted.
    """

    def __init__(self, own: EgoMessage, settings: MotionPlausibilitySettings, faults: MotionFaults) -> None:
        self._faults = faults
        self._limits = [_limit(binding, settings) for binding in own.bindings]

    def admits(self, time_ns: int, values: Sequence[float]) -> bool:
        """Tell whether a frame's values can be true; one whose values cannot is counted.

        Args:
            time_ns: time stamp of the frame.
            values: SI, in the order of the message's quantities; NaN where the DBC's multiplexer leaves one out.
        """
        faults = self._faults
        for value, limit in zip(values, self._limits, strict=True):
            if isnan(value):
                if not limit.optional:
                    faults.not_finite += 1
                    return False
            elif not limit.low <= value <= limit.high:
                faults.out_of_range += 1
                return False
        jumps = [
            limit.rate < float_info.max and not isnan(value) and limit.jumps(value, time_ns)
            for value, limit in zip(values, self._limits, strict=True)
        ]
        faults.impossible += any(jumps)
        return not any(jumps)


def _limit(binding: SignalBinding, settings: MotionPlausibilitySettings) -> _Limit:
    """Work out what one value may be."""
    limits = dbc_range(binding) if settings.ranges else None
    low, high = (-float_info.max, float_info.max) if limits is None else limits
    rate = None
    if binding.quantity in SPEEDS:
        rate = settings.max_acceleration
    elif binding.quantity == "yaw_rate" and settings.max_yaw_acceleration_deg is not None:
        rate = radians(settings.max_yaw_acceleration_deg)
    optional = binding.signal.multiplexer_signal is not None
    return _Limit(low, high, float_info.max if rate is None else rate, optional)
