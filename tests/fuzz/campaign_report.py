"""A campaign with a progress bar, and its result as lines; one that was ended goes on where it was."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .campaign import Result, Share, attempt, digest_of, split
from .progress import ProgressLines

_GROWTH = 1_000_000  # bytes
_LONG = 400_000  # frames from which on a share's memory is judged


def report(frames: int, seed: int, drive: Path | None, processes: int, parts: int, results: Path | None) -> int:
    """Run a campaign and print what it came to; return the exit code.

    Args:
        frames: altogether.
        seed: of chance.
        drive: log that is mutated for half of them.
        processes: that share the work.
        parts: campaigns that this one is split into, each with its own seed and digest.
        results: file that each share's result is added to; shares in it are not run again.
    """
    campaigns = split(frames, seed, drive, parts)
    began = time.monotonic()
    done: list[Result] = []
    with ProgressLines("frames", frames) as bar:
        coming = _results([share for campaign in campaigns for share in campaign], processes, results, bar.advance)
        for campaign in campaigns:
            part = []
            for result in (next(coming) for _ in campaign):
                part.append(result)
                bar.line(_line(result))
            done += part
            if parts > 1:
                seconds = time.monotonic() - began
                bar.line(f"part of {_sum(part)}; after {seconds:.0f} s: {_sum(done)}")
    grown = max((result.grown for result in done if result.share.frames >= _LONG), default=0)
    failed = [result for result in done if result.error]
    print(
        f"{_sum(done)}; seed {seed}, {len(failed) or 'no'} exception or value out of its range; "
        f"state at most {max(each.state for each in done) / 1e3:.0f} kB, memory grew by {grown / 1e6:.2f} MB at most; "
        f"{time.monotonic() - began:.0f} s"
    )
    if grown > _GROWTH:
        print(f"memory grew by more than {_GROWTH / 1e6:.0f} MB", file=sys.stderr)
        return 1
    for result in failed:
        share = result.share
        again = f"from tests.fuzz.campaign import *; run({share!r})"
        print(f"{result.error}\n  again: python -c {shlex.quote(f'from pathlib import *; {again}')}", file=sys.stderr)
    return 1 if failed else 0


def _results(
    shares: Sequence[Share], processes: int, known: Path | None, progress: Callable[[int], None]
) -> Iterator[Result]:
    """Yield the result of each share, in order: from the file where it is known, else by running it."""
    found = _read(known)
    missing = [share for share in shares if share not in found]
    coming = _run_all(missing, processes, progress)
    for share in shares:
        if share in found:
            progress(share.frames)
            yield found[share]
            continue
        result = next(coming)
        if known is not None:
            with known.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(result), default=str) + "\n")
        yield result


def _run_all(shares: Sequence[Share], processes: int, progress: Callable[[int], None]) -> Iterator[Result]:
    if processes == 1:
        for share in shares:
            yield attempt(share, progress)
        return
    with ProcessPoolExecutor(processes) as pool:
        for result in pool.map(attempt, shares):
            progress(result.share.frames)
            yield result


def _read(known: Path | None) -> dict[Share, Result]:
    """Return the results in a file, by their share."""
    if known is None or not known.exists():
        return {}
    results = [_result(json.loads(line)) for line in known.read_text(encoding="utf-8").splitlines()]
    return {result.share: result for result in results}


def _result(row: dict[str, Any]) -> Result:
    share = row["share"]
    drive = share["drive"]
    return Result(**row | {"share": Share(**share | {"drive": None if drive is None else Path(drive)})})


def _sum(results: Sequence[Result]) -> str:
    return (
        f"{sum(each.share.frames for each in results)} frames: {sum(each.cycles for each in results)} cycles, "
        f"{sum(each.sent for each in results)} frames sent, sha256 {digest_of(results)}"
    )


def _line(result: Result) -> str:
    """Return a share's result as a line."""
    share = result.share
    if result.error:
        return f"{share.config}, seed {share.seed}: {result.error}"
    source = "drive" if share.drive is not None else "simulated and random"
    return (
        f"{share.config}, {source}: {share.frames} frames, {result.cycles} cycles, {result.most} obstacles at most, "
        f"{result.sent} frames sent, {result.refused} refused, state {result.state / 1e3:.0f} kB, "
        f"grew by {result.grown / 1e6:.2f} MB, digest {result.digest[:16]}"
    )
