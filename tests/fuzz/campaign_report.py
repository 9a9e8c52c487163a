"""A campaign with a progress bar, and its result as a table and one line."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from .campaign import Result, Share, digest_of, run, shares

_GROWTH = 1_000_000  # bytes
_LONG = 400_000  # frames from which on a share's memory is judged


def report(frames: int, seed: int, drive: Path | None, processes: int) -> int:
    """Run a campaign and print what it came to; return the exit code.

    Args:
        frames: altogether.
        seed: of chance.
        drive: log that is mutated for half of them.
        processes: that share the work.
    """
    parts = shares(frames, seed, drive)
    began = time.monotonic()
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("frames", total=frames)
        results = []
        for result in _results(parts, processes, lambda more: bar.advance(task, more)):
            results.append(result)
            print(_line(result), flush=True)
    seconds = time.monotonic() - began
    grown = [result.grown for result in results if result.share.frames >= _LONG]
    print(
        f"{sum(part.frames for part in parts)} frames, seed {seed}: {sum(each.cycles for each in results)} cycles, "
        f"{sum(each.sent for each in results)} frames sent, no exception, no value that is no number; "
        f"state at most {max(each.state for each in results) / 1e3:.0f} kB, "
        f"memory grew by {max(grown, default=0) / 1e6:.2f} MB at most; "
        f"digest {digest_of(results):08x}; {seconds:.0f} s"
    )
    if max(grown, default=0) > _GROWTH:
        print(f"memory grew by more than {_GROWTH / 1e6:.0f} MB", file=sys.stderr)
        return 1
    return 0


def _results(parts: Sequence[Share], processes: int, progress: Callable[[int], None]) -> Iterator[Result]:
    """Yield the result of each share, in order."""
    if processes == 1:
        for part in parts:
            yield run(part, progress)
        return
    with ProcessPoolExecutor(processes) as pool:
        for result in pool.map(run, parts):
            progress(result.share.frames)
            yield result


def _line(result: Result) -> str:
    """Return a share's result as a line."""
    share = result.share
    source = "drive" if share.drive is not None else "simulated and random"
    return (
        f"{share.config}, {source}: {share.frames} frames, {result.cycles} cycles, {result.most} obstacles at most, "
        f"{result.sent} frames sent, {result.refused} refused, state {result.state / 1e3:.0f} kB, "
        f"grew by {result.grown / 1e6:.2f} MB, digest {result.digest:08x}"
    )
