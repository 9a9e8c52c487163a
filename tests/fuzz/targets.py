"""What is fuzzed: each target takes any bytes, and returns if candaemon did with them what it says.

What it returns are counts of what became of the bytes, which a run adds up. A target NAME is the function `fuzz_NAME`
of the module of that name, which is imported when it is asked for: atheris instruments what is imported then.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from importlib import import_module
from typing import TypeAlias, cast

Target: TypeAlias = Callable[[bytes], Counter[str]]

WEIGHTS = {
    "captures": 3,
    "codec": 1,
    "configuration": 3,
    "datagrams": 1,
    "dbc": 3,
    "http": 1,
    "logs": 4,
    "page": 1,
    "pipeline": 3,
    "protection": 1,
    "scenarios": 2,
    "signals": 2,
    "state": 3,
    "status": 1,
    "tables": 2,
}
"""The targets, and their shares of the time that there is for all."""

UNGUIDED = frozenset({"datagrams", "http", "page", "signals"})
"""Targets in which most of the time is the kernel's, so that steering by the code that is reached does not pay."""


def load(name: str) -> Target:
    """Return a target by its name."""
    return cast("Target", getattr(import_module(f".fuzz_{name}", __package__), f"fuzz_{name}"))
