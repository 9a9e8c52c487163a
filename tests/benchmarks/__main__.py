"""Prints every comparison: `python -m tests.benchmarks`."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from tempfile import TemporaryDirectory

from . import command_times, live
from .comparisons import CHAINS, GROWTH, PARTS
from .parts import BATCH, growth
from .timing import timed


def main() -> None:
    """Measure and print, one line a comparison: the commands first, what they are made of beneath."""
    ArgumentParser(prog="python -m tests.benchmarks", description=__doc__).parse_args()
    with TemporaryDirectory() as folder:
        command_times.print_comparisons(Path(folder))
    for make in (*CHAINS.values(), *PARTS.values()):
        with TemporaryDirectory() as folder:
            print(timed(make(Path(folder))), flush=True)
    for name, (settings, tracks) in GROWTH.items():
        print(
            f"{name}: {tracks // BATCH} times the tracks cost {growth(settings, tracks):.1f} times as much", flush=True
        )
    live.print_comparisons(blocks=3)


if __name__ == "__main__":
    main()
