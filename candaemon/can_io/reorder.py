"""Puts frames of several buses in order of time, and keeps steps of the clock out of it.

Time never runs backwards behind a sequencer, and equal times keep the order in which they came:

- Within the *window* frames are sorted. They are held back for that long, measured by the newest time stamp seen.
- A frame that is older than what was passed on already, but by no more than the *step*, is late (it waited in a driver,
  or the window is too short): it is passed on at once with the time of the last one. Counted as `late`.
- A frame that is older by more than that shows that the clock was set back. Time goes on from the newest time seen:
  the difference is added to this and all further time stamps. Counted as `backward_steps`.
- A frame that is far ahead is a pause of the recording in a log, and so is obeyed; live, where a tick comes every few
  milliseconds, it shows that the clock was set forward: given `max_gap_ns`, it is treated like a step backwards and
  counted as `forward_steps`.
- When the clock is set, other buses may still deliver frames with the clock as it was: for these the difference before
  the last step holds. Without that each would look like another step.

The times passed on lie in 0 … `LATEST_NS`, whatever comes and however often the clock is set: a pause moves time on to
`LAST_PAUSE_NS` at most, and one that would lead further is rebased like a step forward, as is a first time stamp out of
that range. From there time goes on by no more than a step from one item to the next: it takes ten years to `LATEST_NS`.
"""

from __future__ import annotations

from bisect import insort_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from operator import itemgetter
from typing import Final, TypeAlias

import numpy as np

from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock, block_of, joined_blocks
from candaemon.frames.times import LATEST_NS, NEVER_NS

TimedItem: TypeAlias = Frame | Tick
ItemBlock: TypeAlias = FrameBlock | Sequence[TimedItem]

STEP_NS = 200_000_000
"""Default lateness in ns from which on the clock must have been set back: time servers slew it by less than 128 ms."""

LAST_PAUSE_NS: Final = LATEST_NS - 10 * 366 * 86_400 * 1_000_000_000
"""Latest instant in ns that a pause or the first time stamp leads to: ten years are left from there."""

_BATCH = 128  # items
_time_of = itemgetter(0)


@dataclass(slots=True)
class ReorderCounts:
    """What several sequencers counted together.

    Attributes:
        backward_steps, forward_steps, reordered, late: as theirs.
    """

    backward_steps: int = 0
    forward_steps: int = 0
    reordered: int = 0
    late: int = 0

    def add(self, sequence: ReorderBuffer) -> None:
        """Add the counts of one."""
        self.backward_steps += sequence.backward_steps
        self.forward_steps += sequence.forward_steps
        self.reordered += sequence.reordered
        self.late += sequence.late


class ReorderBuffer:
    """Passes frames and ticks on in order of time.

    Args:
        window_ns: how long frames are held back to be sorted, in ns; 0 passes them on at once.
        step_ns: lateness in ns from which on the clock is taken to have been set back; at least the window.
        max_gap_ns: distance in ns ahead from which on the clock is taken to have been set forward; None never.

    Attributes:
        backward_steps: times that the clock was set back.
        forward_steps: times that the clock was set forward.
        reordered: items sorted into an earlier place.
        late: items whose time was raised to that of the last one passed on.
        offset_ns: what is added to time stamps, in ns.
    """

    __slots__ = (
        "_before_ns",
        "_held",
        "_max_gap_ns",
        "_newest_ns",
        "_passed_ns",
        "_step_ns",
        "_window_ns",
        "backward_steps",
        "forward_steps",
        "late",
        "offset_ns",
        "reordered",
    )

    def __init__(self, window_ns: int = 0, *, step_ns: int = STEP_NS, max_gap_ns: int | None = None) -> None:
        self._window_ns = window_ns
        self._step_ns = max(step_ns, window_ns)
        self._max_gap_ns = max_gap_ns
        self._newest_ns: int | None = None
        self._passed_ns = 0
        self._held: deque[TimedItem] = deque()
        self._before_ns: int | None = None
        self.offset_ns = 0
        self.backward_steps = 0
        self.forward_steps = 0
        self.reordered = 0
        self.late = 0

    def sequenced(self, items: Iterable[TimedItem]) -> Iterator[TimedItem]:
        """Return all items in order, the held ones at the end; the way for a log that is replayed at a pace.

        Takes them in batches: what is in order passes in C, an item that is late costs its batch alone the longer way.
        """
        return chain(chain.from_iterable(self._runs(iter(items))), self._rest())

    def sequenced_blocks(self, blocks: Iterable[ItemBlock]) -> Iterator[ItemBlock]:
        """As `sequenced`, many items at a time; the way for a log.

        A block is put in order as arrays and stays a block. Only one in which the clock may have been set, and items
        that come as a list, take the way of single items.
        """
        for block in blocks:
            ordered = self._ordered(block) if isinstance(block, FrameBlock) and len(block) else None
            if ordered is not None:
                yield ordered
            else:
                yield from self._runs(block.frames() if isinstance(block, FrameBlock) else iter(block))
        yield self.flush()

    def push(self, item: TimedItem) -> list[TimedItem]:
        """Take an item; return those that can be passed on, in order.

        Args:
            item: a frame or a tick, with the time of its source's clock.
        """
        item = self._in_time(item)
        time_ns = item[0]
        newest_ns = time_ns if self._newest_ns is None else max(self._newest_ns, time_ns)
        self._newest_ns = newest_ns
        held = self._held
        if not held or time_ns >= held[-1][0]:
            held.append(item)
        else:
            self.reordered += 1
            insort_right(held, item, key=_time_of)
        due_ns = newest_ns - self._window_ns
        due = []
        while held and held[0][0] <= due_ns:
            due.append(held.popleft())
        if due:
            self._passed_ns = due[-1][0]
        return due

    def push_all(self, items: list[TimedItem]) -> list[TimedItem]:
        """Take items; return what pushing them one by one would pass on."""
        if self._passes_untouched(items):
            self._newest_ns = self._passed_ns = items[-1][0]
            return items
        return [due for item in items for due in self.push(item)]

    def tune(self, window_ns: int, *, max_gap_ns: int | None = None) -> None:
        """Go on with another window and gap, as the constructor takes them; to be called when nothing is held back."""
        self._window_ns, self._max_gap_ns = window_ns, max_gap_ns
        self._step_ns = max(self._step_ns, window_ns)

    def flush(self) -> list[TimedItem]:
        """Return what is held back, in order."""
        due = list(self._held)
        self._held.clear()
        if due:
            self._passed_ns = due[-1][0]
        return due

    def _rest(self) -> Iterator[TimedItem]:
        """Yield what is held back when it is asked for, not before."""
        yield from self.flush()

    def _runs(self, items: Iterator[TimedItem]) -> Iterator[list[TimedItem]]:
        """Yield what can be passed on, batch by batch."""
        while batch := list(islice(items, _BATCH)):
            if self._passes_untouched(batch):
                self._newest_ns = self._passed_ns = batch[-1][0]
                yield batch
            else:
                for item in batch:
                    yield self.push(item)

    def _passes_untouched(self, batch: list[TimedItem]) -> bool:
        """Return whether pushing the items one by one would give them back as they are."""
        if self._window_ns or self.offset_ns or batch != sorted(batch, key=_time_of):
            return False
        first_ns, last_ns = batch[0][0], batch[-1][0]
        newest_ns = max(first_ns, 0) if self._newest_ns is None else self._newest_ns
        pause_ns = last_ns - newest_ns
        return newest_ns <= first_ns and pause_ns <= self._longest_pause_ns and last_ns <= LAST_PAUSE_NS

    def _ordered(self, block: FrameBlock) -> FrameBlock | None:
        """Return what pushing the frames of a block one by one would pass on.

        None where a time stamp is so far from the newest before it that the clock may have been set, where a frame is
        late despite a window, where a tick is held back, and in the last years: nothing has changed then.
        """
        times = block.time_ns + self.offset_ns
        first_ns = int(times[0]) if self._newest_ns is None else self._newest_ns
        newest = np.maximum.accumulate(np.append(first_ns, times))
        ahead = times - newest[:-1]
        latest = self._window_ns or self._step_ns
        held = [item for item in self._held if isinstance(item, Frame)]
        if ahead.min() < -latest or ahead.max() > self._longest_pause_ns or newest[-1] > LAST_PAUSE_NS:
            return None
        if len(held) < len(self._held) or (self.offset_ns < 0 and times.min() < 0):
            return None
        behind = int(np.count_nonzero(ahead < 0))
        self._newest_ns = newest_ns = int(newest[-1])
        if not self._window_ns:
            self._passed_ns = newest_ns
            self.late += behind
            return block if not (behind or self.offset_ns) else replace(block, time_ns=newest[1:])
        self.reordered += behind
        block = joined_blocks([block_of(held), replace(block, time_ns=times)])
        block = block.rows(np.argsort(block.time_ns, kind="stable"))
        due = int(np.searchsorted(block.time_ns, newest_ns - self._window_ns, side="right"))
        self._held = deque(block.rows(slice(due, None)).frames())
        if due:
            self._passed_ns = int(block.time_ns[due - 1])
        return block.rows(slice(due))

    @property
    def _longest_pause_ns(self) -> int:
        """How far ahead a time stamp can be without the clock, or a leftover of an earlier step, being asked."""
        watched = self._max_gap_ns is not None or self._before_ns is not None
        return self._step_ns if watched else NEVER_NS

    def _in_time(self, item: TimedItem) -> TimedItem:
        """Return the item with its time free of steps and not before what was passed on."""
        source_ns = item[0]
        time_ns = source_ns + self.offset_ns
        newest_ns = self._newest_ns
        if newest_ns is None:
            time_ns = min(max(time_ns, 0), LAST_PAUSE_NS)
            self.offset_ns = time_ns - source_ns
            self.forward_steps += self.offset_ns < 0
            self.backward_steps += self.offset_ns > 0
        elif not -self._step_ns <= time_ns - newest_ns <= self._step_ns:
            time_ns = self._over_a_gap(source_ns, newest_ns)
        if time_ns < self._passed_ns:
            self.late += 1
            time_ns = self._passed_ns
        return item if time_ns == source_ns else item._replace(time_ns=time_ns)

    def _over_a_gap(self, source_ns: int, newest_ns: int) -> int:
        """Return the time of an item whose time stamp is far from the newest: a pause, a step, or a leftover of one."""
        if self._before_ns is not None and abs(source_ns + self._before_ns - newest_ns) <= self._step_ns:
            return source_ns + self._before_ns
        time_ns = source_ns + self.offset_ns
        gap_ns = time_ns - newest_ns
        if gap_ns < 0:
            self.backward_steps += 1
        elif time_ns > LAST_PAUSE_NS or (self._max_gap_ns is not None and gap_ns > self._max_gap_ns):
            self.forward_steps += 1
        else:
            return time_ns
        self._before_ns = self.offset_ns
        self.offset_ns -= gap_ns
        return newest_ns
