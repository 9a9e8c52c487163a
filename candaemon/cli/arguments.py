"""Common to several commands: help texts, and argument types for numbers and for what is read and written."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

from candaemon.printable import printable

CONFIG: Final = "configuration (YAML), or the name of one that comes with candaemon"
SCENARIO: Final = "scenario (YAML), or the name of one that comes with candaemon"
LOG_FORMATS: Final = ".log (candump), .asc, .blf, .csv, .trc, by its suffix; .gz after it too"

LARGEST_SEED: Final = 2**64 - 1
"""Largest seed of random numbers."""
SLOWEST: Final = 0.001
"""Least multiple of real time."""
FASTEST: Final = 1_000_000.0
"""Largest multiple of real time."""

_LONGEST_QUOTED = 60  # characters


def input_path(text: str) -> Path:
    """Read the path of what a command reads."""
    return _path(text)


def output_path(text: str) -> Path:
    """Read the path of a file that a command writes."""
    return _path(text)


def output_folder(text: str) -> Path:
    """Read the path of a folder that a command writes to."""
    return _path(text)


def _path(text: str) -> Path:
    if not text:
        raise refused(text, "a path")
    return Path(text)


def refused(text: str, expected: str) -> argparse.ArgumentTypeError:
    """Return the error of an argument that is not what is expected."""
    return argparse.ArgumentTypeError(f"found '{printable(text, _LONGEST_QUOTED)}', expected {expected}")


def number(least: float, most: float, unit: str = "") -> Callable[[str], float]:
    """Return a reader of numbers within bounds, both included."""
    expected = f"a number from {least:.12g} to {most:.12g} {unit}".rstrip()

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise refused(text, expected)
        return value

    return read


def whole_number(least: int, most: int) -> Callable[[str], int]:
    """Return a reader of whole numbers within bounds, both included."""
    expected = f"a whole number from {least} to {most}"

    def read(text: str) -> int:
        digits = text.isascii() and text.isdigit() and len(text) <= len(str(most))
        if not (digits and least <= int(text) <= most):
            raise refused(text, expected)
        return int(text)

    return read


seed = whole_number(0, LARGEST_SEED)
"""Reads the seed of random numbers."""
speed = number(SLOWEST, FASTEST)
"""Reads a multiple of real time."""
