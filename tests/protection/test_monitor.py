"""Frames one after another: counters that stand, jump and start again, messages that babble and fall silent."""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candaemon.protection.monitor import FrameFaults, FrameMonitor, FrameMonitorSettings
from tests.support.builders import ns

ID = 0x123
CYCLE_NS = ns(0.05)


def monitor(**plan: Any) -> FrameMonitor:
    """Make a monitor that watches a counter of 16 values, steps of 3 allowed."""
    watched = FrameMonitorSettings(counter=itemgetter(0), counter_values=16, max_step=3)
    return FrameMonitor(replace(watched, **plan), FrameFaults())


def admitted(of: FrameMonitor, counters: list[int], *, start: float = 0.0) -> list[bool]:
    """Send frames a cycle apart; tell which were used."""
    return [of.admits(ID, bytes((c,)), ns(start) + k * CYCLE_NS) for k, c in enumerate(counters)]


def test_a_counter_that_goes_on_is_used_and_wraps() -> None:
    of = monitor()
    assert all(admitted(of, [13, 14, 15, 0, 1]))
    assert of.faults == FrameFaults()


def test_small_steps_are_frames_lost() -> None:
    of = monitor()
    assert all(admitted(of, [14, 1, 2, 4]))
    assert of.faults == FrameFaults(lost=3)


def test_a_repeated_frame_is_not_used() -> None:
    of = monitor()
    assert admitted(of, [5, 5, 5, 6]) == [True, False, False, True]
    assert of.faults == FrameFaults(repeated=2)


@pytest.mark.parametrize(("settle", "used"), [(1, [False, True, True]), (2, [False, False, True])])
def test_after_a_jump_it_has_to_settle(settle: int, used: list[bool]) -> None:
    of = monitor(settle=settle)
    assert admitted(of, [3, 9, 10, 11]) == [True, *used]
    assert of.faults == FrameFaults(jumped=settle)


def test_a_jump_may_be_used_as_a_loss() -> None:
    of = monitor(use_jumps=True)
    assert all(admitted(of, [3, 9, 10]))
    assert of.faults == FrameFaults(lost=5)


def test_a_counter_beyond_its_values_is_a_jump_and_says_nothing_else() -> None:
    of = monitor(counter_values=15)
    assert admitted(of, [13, 14, 15, 0, 1]) == [True, True, False, True, True]
    assert of.faults == FrameFaults(jumped=1)


def test_after_a_silence_the_counter_may_start_anywhere() -> None:
    of = monitor(timeout_ns=ns(0.5))
    assert all(admitted(of, [1, 2]))
    assert all(admitted(of, [9, 10], start=0.7))
    assert of.faults == FrameFaults(timeouts=1)
    assert admitted(of, [1, 2], start=1.0) == [False, True]  # a jump, for there was no silence


def test_messages_are_judged_each_on_its_own() -> None:
    of = monitor()
    assert of.admits(1, bytes((4,)), 0)
    assert of.admits(2, bytes((4,)), 0)
    assert not of.admits(1, bytes((4,)), CYCLE_NS)


def rated() -> FrameMonitor:
    """Make a monitor that lets twice the nominal rate pass."""
    return monitor(counter=None, spacing_ns=CYCLE_NS // 2, slack_ns=CYCLE_NS)


@given(st.lists(st.integers(-CYCLE_NS // 2, CYCLE_NS // 2), min_size=2, max_size=200))
def test_jitter_of_half_a_cycle_is_not_too_fast(jitter: list[int]) -> None:
    of = rated()
    times = sorted(k * CYCLE_NS + late for k, late in enumerate(jitter))
    assert all(of.admits(ID, b"", time_ns) for time_ns in times)


def test_a_babbling_sender_is_held_to_the_rate() -> None:
    of = rated()
    used = sum(of.admits(ID, b"", ns(0.001) * k) for k in range(10_000))
    assert used == pytest.approx(10.0 / 0.025, abs=4)
    assert of.faults == FrameFaults(too_fast=10_000 - used)


class Refusing:
    """Stands for a checksum that is wrong in every payload of zeros."""

    def verify(self, can_id: int, data: bytes) -> bool:
        return any(data) and can_id == ID

    def seal(self, can_id: int, payload: bytes) -> bytes:
        raise NotImplementedError

    def fill(self, can_ids: npt.NDArray[np.int64], payloads: npt.NDArray[np.uint8]) -> None:
        raise NotImplementedError


def test_what_fails_the_checksum_moves_no_counter() -> None:
    of = monitor(protector=Refusing())
    assert admitted(of, [1, 0, 2, 0, 3]) == [True, False, True, False, True]
    assert of.faults == FrameFaults(checksum=2)


@given(
    frames=st.lists(st.tuples(st.integers(0, 20), st.integers(0, ns(0.2))), max_size=100),
    plan=st.fixed_dictionaries(
        {
            "counter_values": st.integers(2, 16),
            "max_step": st.integers(1, 5),
            "settle": st.integers(1, 4),
            "use_jumps": st.booleans(),
            "timeout_ns": st.sampled_from([ns(0.1), 1 << 62]),
            "spacing_ns": st.sampled_from([0, CYCLE_NS]),
        }
    ),
)
def test_every_frame_is_used_or_fails_once(frames: list[tuple[int, int]], plan: dict[str, Any]) -> None:
    of, time_ns, used = monitor(**plan), 0, 0
    for counter, later_ns in frames:
        time_ns += later_ns
        used += of.admits(ID, bytes((counter,)), time_ns)
    assert used + of.faults.failed == len(frames)
    assert of.faults.lost >= 0


def test_a_sender_that_goes_on_with_one_frame_is_never_used_again() -> None:
    """Its frames come: that is no silence, however long none was used."""
    of = monitor(timeout_ns=ns(0.5))
    assert all(admitted(of, [k % 16 for k in range(20)]))
    assert not any(admitted(of, [3] * 400, start=1.0))
    assert (of.faults.repeated, of.faults.timeouts) == (400, 0)
