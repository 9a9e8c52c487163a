"""A condition of the configuration compiled for its signal, and turned round: a value that passes or fails it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from candaemon.binding.location import SettingLocation
from candaemon.config.base import Condition
from candaemon.dbc.bits import NEARLY, as_decoded, readable, representable_values, sendable_values
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.objects.conditions import CompiledCondition, TabulatedCondition

TABULATED_BITS: Final = 8
"""Bits of the longest signal whose condition becomes a table."""


def compile_condition(condition: Condition, signal: SignalSpec, location: SettingLocation) -> CompiledCondition:
    """Compile a condition for the values that the decoder gives.

    Args:
        condition: from the configuration.
        signal: the signal it is on.
        location: the condition's place.

    Raises:
        ConfigError: the signal can have none of the values that should pass.

    """
    values = tuple(as_decoded(signal, value) for value in condition.values or ())
    if values:
        low, high = width = representable_values(signal)
        if not any(_possible(signal, value, width) for value in values):
            raise location.error(
                f"'{signal.name}' can have none of these values; it goes from {low:g} to {high:g} by {signal.scale:g}"
            )
    bounds = (
        (operator.ge, condition.min),
        (operator.le, condition.max),
        (operator.lt, condition.below),
        (operator.gt, condition.above),
    )
    return CompiledCondition(
        values, tuple((compare, as_decoded(signal, bound)) for compare, bound in bounds if bound is not None)
    )


def tabulate(
    condition: CompiledCondition, signal: SignalSpec, message: MessageSpec
) -> CompiledCondition | TabulatedCondition:
    """Make a table of a condition on a short unsigned number that every frame carries; leave any other as it is."""
    plain = not (signal.signed or signal.is_float) and (signal.scale, signal.offset) == (1, 0)
    always = readable(message, signal) and not any(each.is_multiplexer for each in message.signals)
    if not plain or not always or signal.length > TABULATED_BITS:
        return condition
    passes = [bool(condition.passes(float(value))) for value in range(1 << signal.length)]
    return TabulatedCondition(np.array(passes, np.bool_))


def candidates(signal: SignalSpec, conditions: Sequence[Condition]) -> list[float]:
    """List values of a signal that its conditions distinguish, the plainest first."""
    step = 0.0 if signal.is_float else abs(signal.scale)
    low, high = limits = sendable_values(signal)
    listed = [value for condition in conditions for value in condition.values or ()]
    bounds = [
        near
        for condition in conditions
        for bound in (condition.min, condition.max, condition.above, condition.below)
        if bound is not None
        for near in (bound, bound + (step or 1.0), bound - (step or 1.0))
    ]
    wanted = [*listed, 0.0, *bounds, low, high, *(low + step * n for n in range(1, 16))]
    return [as_decoded(signal, value) for value in wanted if _possible(signal, as_decoded(signal, value), limits)]


def first_that(values: Sequence[float], holds: Callable[[float], bool]) -> float | None:
    """Return the first value for which something holds, None where it holds for none."""
    return next((value for value in values if holds(value)), None)


def passing_interval(
    signal: SignalSpec, conditions: Sequence[Condition], passes: Callable[[float], bool]
) -> tuple[float, float]:
    """Return the least and greatest value that pass all conditions; a measured quantity is clipped to them."""
    passing = [value for value in candidates(signal, conditions) if passes(value)]
    low, high = sendable_values(signal)
    return (low if passes(low) else min(passing, default=low)), (high if passes(high) else max(passing, default=high))


def _possible(signal: SignalSpec, value: float, limits: tuple[float, float]) -> bool:
    low, high = limits
    step = abs(signal.scale) * NEARLY
    return low - step <= value <= high + step and as_decoded(signal, value) == value
