"""How many cycles the tests of filters that must last run: few by default, 50 minutes at 20 Hz with `-m slow`."""

from __future__ import annotations

import pytest

CYCLES = 60_000
FEW = 3_000

few_and_many_cycles = pytest.mark.parametrize("cycles", [FEW, pytest.param(CYCLES, marks=pytest.mark.slow)])
"""Decorates a test that takes the number of cycles."""
