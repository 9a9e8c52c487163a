"""Conditions on signals as data: tested over all objects of a scan at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Floats

Comparison: TypeAlias = Callable[[Any, float], Any]
"""`operator.ge`, `le`, `lt` or `gt`."""


@dataclass(frozen=True, slots=True)
class CompiledCondition:
    """A test of one signal's decoded value: it is one of the values, and every bound holds.

    Attributes:
        values: those that pass, as the decoder gives them; empty where any does.
        bounds: comparisons that must hold, each with what the value is compared with.

    """

    values: tuple[float, ...]
    bounds: tuple[tuple[Comparison, float], ...]

    def passes(self, value: Any) -> Any:
        """Return whether a value passes, or elementwise for an array of values."""
        passed = None
        if self.values:
            first, *others = self.values
            passed = value == first
            for other in others:
                passed = passed | (value == other)
        for compare, bound in self.bounds:
            holds = compare(value, bound)
            passed = holds if passed is None else passed & holds
        return passed


@dataclass(frozen=True, slots=True)
class TabulatedCondition:
    """A test of a short unsigned number by look-up: one step, whatever it compares with.

    Attributes:
        table: whether each of the signal's values passes, from 0 on.

    """

    table: Booleans

    def passes(self, value: Floats) -> Booleans:
        """Return elementwise whether decoded values pass."""
        return self.table.take(value.astype(np.intp))


@dataclass(frozen=True, slots=True)
class KnownCondition:
    """A test that a signal has none of the values that say that the quantity is not known.

    Attributes:
        unknown: those values.
        near: how near to one is as good.

    """

    unknown: tuple[float, ...]
    near: float

    def passes(self, value: Floats) -> Booleans:
        """Return elementwise whether decoded values pass."""
        passed = np.ones(value.shape, np.bool_)
        for each in self.unknown:
            passed &= np.abs(value - each) >= self.near
        return passed
