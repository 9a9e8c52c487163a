"""Prints every comparison: `python -m tests.benchmarks`."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from .comparisons import CHAINS, PARTS
from .timing import timed


def main() -> None:
    """Measure and print, one line a comparison."""
    for make in (*CHAINS.values(), *PARTS.values()):
        with TemporaryDirectory() as folder:
            print(timed(make(Path(folder))), flush=True)


if __name__ == "__main__":
    main()
