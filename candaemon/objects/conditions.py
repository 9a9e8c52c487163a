"""Conditions on signals: tested over a whole scan, and turned round to find a value that passes or fails."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

from candaemon.binding.location import SettingLocation
from candaemon.config.base import Condition
from candaemon.dbc.bits import raw_limits, raw_width, to_raw
from candaemon.dbc.types import SignalSpec

Test: TypeAlias = Callable[[Any], Any]
"""Test of one value, or elementwise of a row of values."""

NEARLY: Final = 1e-6
"""Share of a signal's step within which a number of the configuration means a value of the signal."""


def on_grid(signal: SignalSpec, value: float) -> float:
    """Bring a number to the value that the decoder gives for it, where it is one of the signal's values.

    A step of 0.1 decodes three steps as 0.30000000000000004, which `in: [0.3]` should find.
    """
    if signal.is_float or signal.scale == 0:
        return value
    nearest = round(to_raw(signal, value)) * signal.scale + signal.offset
    return nearest if abs(nearest - value) <= NEARLY * abs(signal.scale) else value


def compile_condition(condition: Condition, signal: SignalSpec, where: SettingLocation) -> Test:
    """Make the test of a condition.

    Args:
        condition: from the configuration.
        signal: the signal it is on.
        where: the condition's place.

    Raises:
        ConfigError: the signal can have none of the values that should pass.

    """
    tests: list[Test] = []
    if condition.values is not None:
        values = tuple(on_grid(signal, value) for value in condition.values)
        low, high = width = value_width(signal)
        if not any(_possible(signal, value, width) for value in values):
            raise where.error(
                f"'{signal.name}' can have none of these values; it goes from {low:g} to {high:g} by {signal.scale:g}"
            )
        tests.append(_one_of(values))
    for bound, compare in (
        (condition.min, operator.ge),
        (condition.max, operator.le),
        (condition.below, operator.lt),
        (condition.above, operator.gt),
    ):
        if bound is not None:
            tests.append(_compared(compare, on_grid(signal, bound)))
    return tests[0] if len(tests) == 1 else _every(tests)


def _compared(compare: Callable[[Any, Any], Any], bound: float) -> Test:
    return lambda value: compare(value, bound)


def _one_of(values: Sequence[float]) -> Test:
    first, *others = values

    def test(value: Any) -> Any:
        passed = value == first
        for other in others:
            passed = passed | (value == other)
        return passed

    return test


def _every(tests: Sequence[Test]) -> Test:
    first, *others = tests

    def test(value: Any) -> Any:
        passed = first(value)
        for other in others:
            passed = passed & other(value)
        return passed

    return test


def value_limits(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest value that can be sent in a signal."""
    low, high = (raw * signal.scale + signal.offset for raw in raw_limits(signal))
    return min(low, high), max(low, high)


def value_width(signal: SignalSpec) -> tuple[float, float]:
    """Least and greatest value that a signal's bits can hold, whatever range the DBC gives."""
    low, high = (raw * signal.scale + signal.offset for raw in raw_width(signal))
    return min(low, high), max(low, high)


def _possible(signal: SignalSpec, value: float, limits: tuple[float, float]) -> bool:
    low, high = limits
    step = abs(signal.scale) * NEARLY
    return low - step <= value <= high + step and on_grid(signal, value) == value


def candidates(signal: SignalSpec, conditions: Sequence[Condition]) -> list[float]:
    """List values of a signal that its conditions tell apart, the plainest first."""
    step = 0.0 if signal.is_float else abs(signal.scale)
    low, high = limits = value_limits(signal)
    listed = [value for condition in conditions for value in condition.values or ()]
    bounds = [
        near
        for condition in conditions
        for bound in (condition.min, condition.max, condition.above, condition.below)
        if bound is not None
        for near in (bound, bound + (step or 1.0), bound - (step or 1.0))
    ]
    wanted = [*listed, 0.0, *bounds, low, high, *(low + step * n for n in range(1, 16))]
    return [on_grid(signal, value) for value in wanted if _possible(signal, on_grid(signal, value), limits)]


def first_that(values: Sequence[float], holds: Callable[[float], bool]) -> float | None:
    """First value for which something holds."""
    return next((value for value in values if holds(value)), None)


def passing_interval(
    signal: SignalSpec, conditions: Sequence[Condition], test: Callable[[float], bool]
) -> tuple[float, float]:
    """Least and greatest value that pass all conditions, to which a measured quantity is brought when written."""
    passing = [value for value in candidates(signal, conditions) if test(value)]
    low, high = value_limits(signal)
    return (low if test(low) else min(passing, default=low)), (high if test(high) else max(passing, default=high))
