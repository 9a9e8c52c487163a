"""The frames of one cycle: a sequence like any other, and the same text."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from candaemon.can_io.logs.candump import candump_text
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_batch import FrameBatch

TIME_NS = 1_533_226_488_434_433_000
PAYLOADS = [(0x26A, bytes.fromhex("08FFFB0000001884")), (0x1234567 | EXTENDED, b""), (0x123, bytes(range(12)))]
FRAMES = [
    Frame(TIME_NS, 1, 0x26A, bytes.fromhex("08FFFB0000001884")),
    Frame(TIME_NS, 1, 0x1234567 | EXTENDED, b""),
    Frame(TIME_NS, 1, 0x123, bytes(range(12)), True),
]


def test_a_frame_batch_is_a_sequence_of_frames() -> None:
    instant = FrameBatch(TIME_NS, 1, PAYLOADS, {0x123})
    assert len(instant) == 3
    assert list(instant) == FRAMES
    assert [instant[k] for k in range(3)] == FRAMES
    assert list(instant[1:]) == FRAMES[1:]
    assert instant[-1] in instant
    assert not FrameBatch(TIME_NS, 1, [])
    with pytest.raises(IndexError):
        instant[3]


def test_a_log_holds_the_same() -> None:
    names = ["can0", "radar"]
    assert candump_text(FrameBatch(TIME_NS, 1, PAYLOADS, {0x123}), names) == candump_text(FRAMES, names)
    assert candump_text(FrameBatch(TIME_NS, 1, []), names) == b""


@pytest.mark.parametrize("can_ids", [range(0x500, 0x510), [0x7FF, 0x1234567 | EXTENDED], [0x12 | EXTENDED, EXTENDED]])
def test_full_frames_are_the_same_text(can_ids: Sequence[int]) -> None:
    payloads = [(can_id, bytes(range(k, k + 8))) for k, can_id in enumerate(can_ids)]
    for time_ns in (TIME_NS, TIME_NS + 1):
        instant = FrameBatch(time_ns, 0, payloads)
        assert candump_text(instant, ["can-ü"]) == candump_text(list(instant), ["can-ü"])
