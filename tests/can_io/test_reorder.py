"""Order of time: windows, late frames, and steps of the clock."""

from __future__ import annotations

import time
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.reorder import LAST_PAUSE_NS, STEP_NS, ReorderBuffer, TimedItem
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock, block_of
from candaemon.frames.times import LATEST_NS
from tests.support.effort import examples

MS = 1_000_000
S = 1000 * MS
HOUR = 3600 * S
START = 1_533_226_488 * S


def frame(time_ns: int, bus: int = 0, can_id: int = 0x100) -> Frame:
    return Frame(START + time_ns, bus, can_id, b"")


def relative(items: list[TimedItem]) -> list[int]:
    return [item.time_ns - START for item in items]


def run(sequencer: ReorderBuffer, items: list[TimedItem]) -> list[TimedItem]:
    """All ways to use a sequencer must agree."""
    other, third = (
        ReorderBuffer(sequencer._window_ns, step_ns=sequencer._step_ns, max_gap_ns=sequencer._max_gap_ns)
        for _ in range(2)
    )
    pushed = [out for item in items for out in other.push(item)] + other.flush()
    found = list(sequencer.sequenced(items))
    together = [out for k in range(0, len(items), 7) for out in third.push_all(items[k : k + 7])] + third.flush()
    assert found == pushed == together
    names = ("late", "reordered", "backward_steps", "forward_steps", "offset_ns")
    for each in (sequencer, third):
        assert [getattr(each, name) for name in names] == [getattr(other, name) for name in names]
    return found


def test_in_order_passes_untouched() -> None:
    items: list[TimedItem] = [frame(0), frame(0, 1), Tick(START + 5), frame(5), frame(10 * S)]
    sequencer = ReorderBuffer()
    out = run(sequencer, items)
    assert all(a is b for a, b in zip(out, items, strict=True))


def test_window_sorts_and_keeps_the_order_of_equals() -> None:
    items: list[TimedItem] = [frame(0), frame(20 * MS), frame(15 * MS, 1), frame(20 * MS, 1), frame(100 * MS)]
    sequencer = ReorderBuffer(10 * MS)
    assert run(sequencer, items) == [items[0], items[2], items[1], items[3], items[4]]
    assert (sequencer.reordered, sequencer.late) == (1, 0)


def test_window_holds_back_no_longer_than_it_says() -> None:
    sequencer = ReorderBuffer(10 * MS)
    assert sequencer.push(frame(0)) == []
    assert sequencer.push(frame(9 * MS)) == []
    assert relative(sequencer.push(Tick(START + 10 * MS))) == [0]
    assert relative(sequencer.flush()) == [9 * MS, 10 * MS]
    assert sequencer.flush() == []


def test_late_frames_are_passed_on_at_the_time_of_the_last() -> None:
    sequencer = ReorderBuffer()
    assert relative(run(sequencer, [frame(0), frame(50 * MS), frame(10 * MS, 1), frame(60 * MS)])) == [
        0,
        50 * MS,
        50 * MS,
        60 * MS,
    ]
    assert (sequencer.late, sequencer.offset_ns) == (1, 0)


def test_later_than_the_window_is_late() -> None:
    sequencer = ReorderBuffer(10 * MS)
    items: list[TimedItem] = [frame(0), frame(50 * MS), frame(70 * MS), frame(45 * MS, 1), frame(80 * MS)]
    assert relative(run(sequencer, items)) == [0, 50 * MS, 50 * MS, 70 * MS, 80 * MS]
    assert (sequencer.late, sequencer.reordered) == (1, 1)


def test_a_clock_set_back_is_rebased() -> None:
    sequencer = ReorderBuffer()
    items: list[TimedItem] = [
        frame(0),
        frame(S),
        frame(S - HOUR),
        frame(S - HOUR + 50 * MS),
        frame(S - HOUR + 100 * MS),
    ]
    assert relative(run(sequencer, items)) == [0, S, S, S + 50 * MS, S + 100 * MS]
    assert (sequencer.backward_steps, sequencer.offset_ns, sequencer.late) == (1, HOUR, 0)


def test_a_clock_set_back_and_right_again() -> None:
    sequencer = ReorderBuffer()
    items: list[TimedItem] = [frame(0), frame(-HOUR), frame(50 * MS - HOUR), frame(100 * MS), frame(150 * MS)]
    assert relative(run(sequencer, items)) == [0, 0, 50 * MS, 100 * MS, 150 * MS]


def test_frames_of_the_clock_before_a_step_are_no_step() -> None:
    sequencer = ReorderBuffer(5 * MS)
    items: list[TimedItem] = [
        frame(0),
        frame(100 * MS - HOUR),
        frame(2 * MS, 1),
        frame(110 * MS - HOUR),
        frame(14 * MS, 1),
    ]
    out = run(sequencer, items)
    assert sequencer.backward_steps == 1
    assert relative(out) == [0, 0, 2 * MS, 10 * MS, 14 * MS]


def test_a_pause_in_a_log_is_obeyed() -> None:
    sequencer = ReorderBuffer()
    assert relative(run(sequencer, [frame(0), frame(HOUR), frame(HOUR + 1)])) == [0, HOUR, HOUR + 1]
    assert sequencer.forward_steps == 0


def test_a_pause_after_a_step_is_obeyed() -> None:
    sequencer = ReorderBuffer()
    items: list[TimedItem] = [frame(0), frame(-HOUR), frame(-HOUR + 60 * S), frame(-HOUR + 61 * S)]
    assert relative(run(sequencer, items)) == [0, 0, 60 * S, 61 * S]


def test_a_clock_set_forward_is_rebased_where_pauses_cannot_be() -> None:
    sequencer = ReorderBuffer(max_gap_ns=10 * S)
    items: list[TimedItem] = [frame(0), frame(9 * S), frame(HOUR), Tick(START + HOUR + 50 * MS)]
    assert relative(run(sequencer, items)) == [0, 9 * S, 9 * S, 9 * S + 50 * MS]
    assert (sequencer.forward_steps, sequencer.backward_steps) == (1, 0)


@settings(deadline=None, max_examples=examples(200))
@given(
    offsets=st.lists(st.integers(-2 * HOUR, 2 * HOUR) | st.integers(-300 * MS, 300 * MS), max_size=40),
    window=st.sampled_from([0, MS, 50 * MS, 400 * MS]),
    max_gap=st.sampled_from([None, S, 10 * S]),
)
def test_time_never_runs_backwards_and_nothing_is_lost(offsets: list[int], window: int, max_gap: int | None) -> None:
    items: list[TimedItem] = [frame(offset, can_id=i) for i, offset in enumerate(offsets)]
    out = run(ReorderBuffer(window, max_gap_ns=max_gap), items)
    stamps = [item.time_ns for item in out]
    assert stamps == sorted(stamps)
    assert sorted(item.can_id for item in out if isinstance(item, Frame)) == list(range(len(items)))
    if max_gap is not None and len(stamps) > 1:
        assert max(b - a for a, b in pairwise(stamps)) <= max_gap + window


@settings(deadline=None, max_examples=examples(50))
@given(
    places=st.lists(st.integers(0, 399), max_size=4),
    offset=st.sampled_from([-HOUR, -10 * MS, HOUR]),
    max_gap=st.sampled_from([None, S, 10 * S]),
)
def test_batches_change_nothing(places: list[int], offset: int, max_gap: int | None) -> None:
    items: list[TimedItem] = [frame(i * MS + offset * (i in places)) for i in range(400)]
    assert len(run(ReorderBuffer(max_gap_ns=max_gap), items)) == len(items)


@settings(deadline=None)
@given(
    gaps=st.lists(st.integers(0, 20 * MS), min_size=1, max_size=40),
    jitter=st.lists(st.integers(0, 10 * MS), min_size=40, max_size=40),
)
def test_a_window_as_wide_as_the_jitter_restores_the_order(gaps: list[int], jitter: list[int]) -> None:
    stamps = [sum(gaps[:i]) for i in range(len(gaps))]
    arrival = sorted(range(len(stamps)), key=lambda i: stamps[i] + jitter[i])
    sequencer = ReorderBuffer(10 * MS)
    assert relative(run(sequencer, [frame(stamps[i]) for i in arrival])) == stamps
    assert sequencer.late == 0


@settings(deadline=None, max_examples=examples(200))
@given(
    times=st.lists(
        st.integers(0, LATEST_NS) | st.integers(0, S) | st.sampled_from([LATEST_NS, LAST_PAUSE_NS, START]), max_size=40
    ),
    window=st.sampled_from([0, 50 * MS]),
    max_gap=st.sampled_from([None, S]),
)
def test_no_steps_of_the_clock_lead_out_of_range(times: list[int], window: int, max_gap: int | None) -> None:
    items = [Frame(time_ns, 0, i, b"") for i, time_ns in enumerate(times)]
    out = run(ReorderBuffer(window, max_gap_ns=max_gap), [*items])
    assert all(0 <= item.time_ns <= LAST_PAUSE_NS + len(items) * STEP_NS for item in out)
    blocks = list(ReorderBuffer(window, max_gap_ns=max_gap).sequenced_blocks([block_of(items)] if items else []))
    in_blocks = [item for block in blocks for item in (block.frames() if isinstance(block, FrameBlock) else block)]
    assert in_blocks == out


@pytest.mark.parametrize(("time_ns", "forward", "backward"), [(-5, 0, 1), (1 << 80, 1, 0), (LAST_PAUSE_NS, 0, 0)])
def test_a_live_clock_out_of_range_is_a_step(time_ns: int, forward: int, backward: int) -> None:
    sequencer = ReorderBuffer()
    first, second = sequencer.push(Tick(time_ns))[0].time_ns, sequencer.push(Tick(time_ns + 5))[0].time_ns
    assert 0 <= first <= LAST_PAUSE_NS
    assert second - first == 5
    assert [each.time_ns for each in ReorderBuffer().push_all([Tick(time_ns), Tick(time_ns + 5)])] == [first, second]
    assert (sequencer.forward_steps, sequencer.backward_steps) == (forward, backward)


def test_costs_little_where_all_is_in_order() -> None:
    frames = [frame(i) for i in range(200_000)]
    start = time.process_time()
    assert sum(1 for _ in ReorderBuffer().sequenced(frames)) == len(frames)
    # reached: 0.04 µs a frame
    assert (time.process_time() - start) / len(frames) < 1e-6
