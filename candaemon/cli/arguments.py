"""Common to several commands: help texts, and argument types for numbers."""

from __future__ import annotations

import argparse
import math
from typing import Final

CONFIG: Final = "configuration (YAML), or the name of one that comes with candaemon"
SCENARIO: Final = "scenario (YAML), or the name of one that comes with candaemon"
LOG_FORMATS: Final = ".log (candump), .asc, .blf, .csv, .trc, by its suffix; .gz after it too"


def positive(text: str) -> float:
    """Read a finite number over 0."""
    value = not_negative(text)
    if value == 0.0:
        raise argparse.ArgumentTypeError(f"found {text}, expected a number over 0")
    return value


def not_negative(text: str) -> float:
    """Read a finite number, 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"found '{text}', expected a number, 0 or more")
    return value
