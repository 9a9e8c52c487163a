"""Single time stamps of a log that are far from their neighbours."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from candaemon.can_io.logs.merge import LogBlock
from candaemon.can_io.logs.read import frames_of
from candaemon.can_io.stray_times import FAR_NS, StrayTimes
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import block_of

S = 1_000_000_000
START = 1_533_226_488 * S
YEAR = 31_557_600 * S


def frames(times: Iterable[int]) -> list[Frame]:
    return [Frame(START + time_ns, 0, k, b"\x01") for k, time_ns in enumerate(times)]


def corrected(log: list[Frame], size: int, *, arrays: bool) -> tuple[list[int], int]:
    """Return the relative times of a log in blocks of some size, and how many were corrected."""
    strays = StrayTimes()
    parts = [log[at : at + size] for at in range(0, len(log), size)]
    blocks: list[LogBlock] = [block_of(part) if arrays else part for part in parts]
    out = list(frames_of(strays.removed(blocks)))
    assert [frame[1:] for frame in out] == [frame[1:] for frame in log]
    return [frame.time_ns - START for frame in out], strays.corrected


@pytest.mark.parametrize("arrays", [True, False])
@pytest.mark.parametrize("size", [1, 2, 3, 100])
@pytest.mark.parametrize("off", [3 * YEAR, 10 * S, -10 * S, -3 * YEAR])
def test_one_damaged_time_stamp_moves_nothing_else(off: int, size: int, arrays: bool) -> None:
    times = [k * 10_000_000 for k in range(12)]
    for place in range(1, 11):
        log = frames(time_ns + off * (k == place) for k, time_ns in enumerate(times))
        out, count = corrected(log, size, arrays=arrays)
        assert out == [*times[:place], times[place - 1], *times[place + 1 :]]
        assert count == 1


@pytest.mark.parametrize(
    "times", [[0, 1, 2, YEAR, YEAR + 1], [0, 1, -YEAR, 1 - YEAR], [0, S, 2 * S, S], [0, 5 * S], [7]]
)
@pytest.mark.parametrize("size", [1, 2, 100])
def test_pauses_and_set_clocks_are_left_alone(times: list[int], size: int) -> None:
    assert corrected(frames(times), size, arrays=True) == (times, 0)


@pytest.mark.parametrize(("off", "count"), [(FAR_NS, 0), (FAR_NS + 1, 1), (-FAR_NS - 1, 1)])
def test_a_second_is_not_far(off: int, count: int) -> None:
    assert corrected(frames([0, 1, 1 + off, 2]), 100, arrays=True)[1] == count


@given(
    steps=st.lists(st.integers(-2 * FAR_NS, 2 * FAR_NS) | st.integers(0, FAR_NS // 100), max_size=40),
    size=st.integers(1, 41),
)
def test_blocks_of_any_size_give_the_same(steps: list[int], size: int) -> None:
    log = frames(sum(steps[:k]) for k in range(len(steps)))
    assert corrected(log, size, arrays=True) == corrected(log, 100, arrays=False)
