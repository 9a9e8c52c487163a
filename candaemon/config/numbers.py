"""Types of numbers that several settings share; every number of a configuration has a least and a greatest value."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

LARGEST_SIGNAL: Final = 1e39
"""Greatest magnitude of a value in a signal's own unit: what 64 bits and a float of 32 hold."""
LARGEST_FACTOR: Final = 1e12
"""Greatest magnitude of a signal's scale and offset."""
SMALLEST: Final = 1e-12
"""Least magnitude of a number other than 0: far below what anything is measured to, and its square is no 0."""

SignalValue = Annotated[float, Field(ge=-LARGEST_SIGNAL, le=LARGEST_SIGNAL)]
Factor = Annotated[float, Field(ge=-LARGEST_FACTOR, le=LARGEST_FACTOR)]
Identity = Annotated[int, Field(ge=0, lt=2**63)]
