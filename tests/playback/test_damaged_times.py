"""Logs with damaged time stamps: no replay without end, and no more lost than the damage."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bound import Binding
from candaemon.can_io.reorder import LAST_PAUSE_NS
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import block_of
from candaemon.frames.times import LATEST_NS, NEVER_NS
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.replay import Replayed, ReplayRequest, replay
from candaemon.playback.summary import summarise
from tests.support.bound import binding
from tests.support.recorded import as_log, highway

S = 1_000_000_000
CONFIG = "esr_ins"


@pytest.fixture(scope="module")
def lines() -> list[bytes]:
    of = binding(CONFIG)
    return as_log(of, highway(of, 3.0)).splitlines(keepends=True)


def replayed(lines: list[bytes], folder: Path, speed: float | None = None) -> tuple[Replayed, bytes]:
    log, out = folder / "drive.log", folder / "out.log"
    log.write_bytes(b"".join(lines))
    return replay(binding(CONFIG), ReplayRequest(log, out, speed=speed)), out.read_bytes()


def with_second(line: bytes, first_digits: bytes) -> bytes:
    return b"(" + first_digits + line[1 + len(first_digits) :]


def test_damaged_digits_change_nothing_but_their_frames(lines: list[bytes], tmp_path: Path) -> None:
    damaged = list(lines)
    expected = list(lines)
    for place, digits in ((300, b"8"), (600, b"7"), (900, b"35"), (1200, b"43"), (1300, b"00"), (1400, b"35")):
        damaged[place] = with_second(lines[place], digits)
        expected[place] = lines[place - 1][:19] + lines[place][19:]
    expected[300] = expected[600] = b""
    result, out = replayed(damaged, tmp_path)
    assert (result.log.malformed, result.stray_times) == (2, 4)
    assert result.log.examples[0].startswith("line 301:")
    assert summarise(result)["clock"]["stray"] == 4
    assert result.log.frames == len(lines) - 2
    assert out == replayed(expected, tmp_path)[1]


@pytest.mark.parametrize("speed", [None, 1e9])
def test_many_jumps_through_all_of_time_end(lines: list[bytes], tmp_path: Path, speed: float | None) -> None:
    """Bursts of several frames are no stray times: each is a pause or a set clock, and none leads out of range."""
    damaged = list(lines)
    jumps = [b"0", b"45", b"40", b"0", b"42", b"35", b"0", b"46", b"00"]
    for begin, digits in zip(range(200, 1100, 100), jumps, strict=True):
        damaged[begin : begin + 50] = [with_second(line, digits) for line in damaged[begin : begin + 50]]
    result, out = replayed(damaged, tmp_path, speed)
    assert result.log.frames + result.log.malformed == len(lines)
    assert result.sequence.backward_steps + result.sequence.forward_steps > 5
    assert result.last_ns <= LAST_PAUSE_NS + 10 * S
    cycles = result.pipeline.counts
    most_a_jump = 10.0 / min(sensor.settings.cycle_time for sensor in binding(CONFIG).sensors) + 10
    assert cycles.coasting_cycles <= (2 * len(jumps) + 1) * most_a_jump
    assert {len(stamp) for stamp in re.findall(rb"^\((\d+)\.", out, re.MULTILINE)} == {10}


def test_a_pause_of_years_is_not_waited_for(lines: list[bytes], tmp_path: Path) -> None:
    late = [with_second(line, b"2") for line in lines[200:210]]
    began = time.monotonic()
    result, _ = replayed([*lines[:200], *late], tmp_path, 1.0)
    assert result.last_ns - result.first_ns > 10**9 * S // 2
    assert time.monotonic() - began < 60


def coasting(of: Binding, jump_ns: int) -> int:
    """Return how many cycles a pause makes."""
    frames = highway(of, 2.0)
    pipeline = Pipeline(of)
    for _ in pipeline.run(frames):
        pass
    return sum(1 for _ in pipeline.run([Tick(frames[-1].time_ns + jump_ns)]))


@pytest.mark.parametrize("jump_ns", [20 * S, 3_600 * S, 10**18, LATEST_NS, NEVER_NS, 1 << 80])
def test_a_pause_makes_a_bounded_number_of_cycles(jump_ns: int) -> None:
    of = binding(CONFIG)
    cycle = min(sensor.settings.cycle_time for sensor in of.sensors)
    expected = of.settings.supervision.longest_coasting / cycle
    assert expected - 2 <= coasting(of, jump_ns) <= expected + len(of.sensors) + 2


def test_blocks_at_the_edges_of_time_end() -> None:
    of = binding(CONFIG)
    frames = highway(of, 1.0)
    for shift in (-frames[0].time_ns, LATEST_NS - frames[-1].time_ns):
        moved = [Frame(frame[0] + shift, *frame[1:]) for frame in frames]
        cycles = list(Pipeline(of).run_blocks([block_of(moved)]))
        assert [len(cycle.obstacles) for cycle in cycles] == [
            len(cycle.obstacles) for cycle in Pipeline(of).run_blocks([block_of(frames)])
        ]
        assert np.all(np.diff([cycle.time_ns for cycle in cycles]) >= 0)
