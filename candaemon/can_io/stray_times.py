"""Puts right single time stamps of a log that are far from both neighbours: a damaged digit, no pause and no set clock.

Obeyed as a pause, one damaged digit would let every obstacle end and move all that follows by years. The frame itself
is kept, at the time of the one before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from candaemon.arrays import Integers
from candaemon.can_io.logs.merge import LogBlock
from candaemon.frames.frame_block import FrameBlock, joined_blocks

FAR_NS: Final = 1_000_000_000
"""ns: a time stamp further than that from the one before it, ahead or behind, is stray if the next one is not."""


class StrayTimes:
    """Corrects the stray time stamps of one log, or of logs that were recorded one after another.

    The last frame of a block is held back while it is not known what comes after it.

    Attributes:
        corrected: frames whose time was set to that of the frame before.
    """

    def __init__(self) -> None:
        self.corrected = 0
        self._before_ns: int | None = None

    def removed(self, blocks: Iterable[LogBlock]) -> Iterator[LogBlock]:
        """Return all frames, in the same order, without stray times; the first two of a log are taken as they are."""
        held: LogBlock | None = None
        for block in chain(blocks, [None]):
            if block is not None:
                if not len(block):
                    continue
                held = block if held is None else _joined(held, block)
            if held is None:
                return
            # without an end to wait for, the last frame is what it says
            passed, held = self._settled(held, final=block is None)
            yield passed

    def _settled(self, block: LogBlock, *, final: bool) -> tuple[LogBlock, LogBlock | None]:
        """Return the frames that are settled, corrected, and the last one if it is not."""
        times = _times(block)
        before_ns = int(times[0]) if self._before_ns is None else self._before_ns
        far = np.flatnonzero(np.abs(np.diff(times, prepend=before_ns)) > FAR_NS)
        if not len(far):
            self._before_ns = int(times[-1])
            return block, None
        corrected: dict[int, int] = {}
        end = len(times)
        for row in far.tolist():
            usual_ns = corrected.get(row - 1, int(times[row - 1])) if row else before_ns
            if abs(int(times[row]) - usual_ns) <= FAR_NS:
                continue  # back from a stray one
            if row == len(times) - 1:
                end = end if final else row
            elif abs(int(times[row + 1]) - usual_ns) <= FAR_NS:
                corrected[row] = usual_ns
        self.corrected += len(corrected)
        if end:
            self._before_ns = corrected.get(end - 1, int(times[end - 1]))
        held = None if end == len(times) else _rows(block, slice(end, None))
        return _rows(_with_times(block, corrected), slice(0, end)), held


def _times(block: LogBlock) -> Integers:
    """Return the time stamps of a block."""
    return block.time_ns if isinstance(block, FrameBlock) else np.array([frame[0] for frame in block], np.int64)


def _rows(block: LogBlock, rows: slice) -> LogBlock:
    """Return some consecutive frames of a block."""
    return block.rows(rows) if isinstance(block, FrameBlock) else block[rows]


def _joined(first: LogBlock, second: LogBlock) -> LogBlock:
    """Return two blocks of one log as one."""
    if isinstance(first, FrameBlock) and isinstance(second, FrameBlock):
        return joined_blocks([first, second])
    one, other = (list(block.frames()) if isinstance(block, FrameBlock) else block for block in (first, second))
    return [*one, *other]


def _with_times(block: LogBlock, corrected: Mapping[int, int]) -> LogBlock:
    """Return a block with other times in some rows."""
    if not corrected:
        return block
    if isinstance(block, FrameBlock):
        times = block.time_ns.copy()
        times[list(corrected)] = list(corrected.values())
        return replace(block, time_ns=times)
    frames = list(block)
    for row, time_ns in corrected.items():
        frames[row] = frames[row]._replace(time_ns=time_ns)
    return frames
