"""Blocks of several logs, or of several groups of one, as one: in order of time, without holding more than they must.

Within a log the order stays as recorded: a frame counts as late as the latest one before it. A log is begun when the
others have come to its first frame, so that logs that follow one another are open one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from candaemon.arrays import Integers
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock, block_of, joined_blocks

LogBlock: TypeAlias = FrameBlock | Sequence[Frame]
"""Consecutive frames of a log."""


@dataclass(frozen=True, slots=True)
class TimedLog:
    """A log that is to be read among others.

    Attributes:
        first_ns: time of its first frame.
        begin: begins to read it.
    """

    first_ns: int
    begin: Callable[[], Iterable[LogBlock]]


def merged(logs: Sequence[TimedLog]) -> Iterator[LogBlock]:
    """Yield the frames of all logs in order of time; those of one instant in the order of the logs.

    Args:
        logs: in order of their first frames.
    """
    waiting = list(reversed(logs))
    active: list[_Reading] = []
    while waiting or active:  # ends: each round begins a log, or passes on a block's frames
        if not active:
            active.append(_Reading(waiting.pop()))
        active = [each for each in active if each.fill()]
        if not active:
            continue
        known_ns = min(each.last_ns for each in active)
        if waiting and waiting[-1].first_ns <= known_ns:
            active.append(_Reading(waiting.pop()))
        elif len(active) == 1:
            yield active[0].whole()
        else:
            yield _in_order([each.until(known_ns) for each in active])


class _Reading:
    """A log that is being read.

    Attributes:
        last_ns: how late the last frame of its block counts.
    """

    def __init__(self, log: TimedLog) -> None:
        self._blocks = iter(log.begin())
        self._block: LogBlock | None = None
        self._times = np.empty(0, np.int64)
        self._latest_ns = log.first_ns
        self.last_ns = log.first_ns

    def fill(self) -> bool:
        """Have a block with frames; return whether there is one."""
        while self._block is None:  # ends: the blocks do
            block = next(self._blocks, None)
            if block is None:
                return False
            if len(block):
                self._block = block
                times = block.time_ns if isinstance(block, FrameBlock) else [frame[0] for frame in block]
                self._times = np.maximum.accumulate(np.maximum(times, self._latest_ns))
                self.last_ns = self._latest_ns = int(self._times[-1])
        return True

    def whole(self) -> LogBlock:
        """Take the whole block."""
        block, self._block = self._block, None
        return block if block is not None else []

    def until(self, time_ns: int) -> tuple[FrameBlock, Integers]:
        """Take the frames up to a time, it included; return them with how late each counts."""
        block = self._block if isinstance(self._block, FrameBlock) else block_of(self._block or [])
        count = int(np.searchsorted(self._times, time_ns, side="right"))
        taken = block.rows(slice(0, count)), self._times[:count]
        rest = count < len(block)
        self._block, self._times = (block.rows(slice(count, None)) if rest else None), self._times[count:]
        return taken


def _in_order(pieces: Sequence[tuple[FrameBlock, Integers]]) -> FrameBlock:
    """Return the frames of several logs in order of time."""
    order = np.argsort(np.concatenate([times for _, times in pieces]), kind="stable")
    return joined_blocks([block for block, _ in pieces]).rows(order)
