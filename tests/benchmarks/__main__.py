"""Prints every comparison: `python -m tests.benchmarks`."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from . import live
from .comparisons import CHAINS, PARTS
from .timing import timed


def main() -> None:
    """Measure and print, one line a comparison."""
    for make in (*CHAINS.values(), *PARTS.values()):
        with TemporaryDirectory() as folder:
            print(timed(make(Path(folder))), flush=True)
    live.print_comparisons(blocks=3)


if __name__ == "__main__":
    main()
