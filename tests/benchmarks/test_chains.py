"""The whole chain beside the naive one: the same states, and faster however busy the machine is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.frames.frame import Frame
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline

from . import naive
from .chains import naive_cycles, reduced_binding, replayed, simulated_log
from .comparisons import CHAINS
from .conftest import Note
from .timing import timed

pytestmark = pytest.mark.benchmark


def test_states_are_the_naive_chains(tmp_path: Path) -> None:
    """With id association and no merging, over the whole run, in each cycle the same tracks with the same states."""
    binding, output = reduced_binding(), tmp_path / "candaemon.log"
    log = simulated_log(tmp_path / "states.log", 20.0)
    reference = naive_cycles(naive.CurrentStatistical, log, tmp_path / "naive.log")
    slot_of: dict[int, int] = {}
    compared = 0
    sent: list[Frame] = []
    for cycle, expected in zip(_cycles(binding, log), reference, strict=True):
        obstacles = cycle.obstacles
        assert obstacles.time_ns == expected.time_ns
        sent += cycle.frames
        slot_of.update(zip(obstacles.id[obstacles.used_row].tolist(), obstacles.used_object.tolist(), strict=True))
        slots = [slot_of[each] for each in obstacles.id.tolist()]
        assert sorted(slots) == sorted(expected.tracks)
        states = np.array([expected.tracks[slot].filter.state for slot in slots])
        np.testing.assert_allclose(_states(cycle), states, rtol=0, atol=1e-9)
        compared += len(slots)
    assert compared > 25_000
    assert (tmp_path / "naive.log").read_text().count("\n") == len(sent) == compared
    replayed(binding, log, output)
    assert output.read_bytes() == candump_text(sent, [bus.settings.channel for bus in binding.buses])


def _cycles(binding: Binding, log: Path) -> Iterator[Cycle]:
    """Take a log through the pipeline frame by frame."""
    channels = {bus.settings.channel: bus.index for bus in binding.buses}
    return Pipeline(binding).run(read_log(log, channels, LogCounts()))


def _states(cycle: Cycle) -> NDArray[np.float64]:
    """Return the states as the naive chain has them: [x, ẋ, ẍ, y, ẏ, ÿ] in the level frame."""
    obstacles, heading = cycle.obstacles, cycle.pose.heading
    acceleration = (obstacles.ax + 1j * obstacles.ay) * np.exp(1j * heading)
    return np.stack(
        [obstacles.east, obstacles.ve, acceleration.real, obstacles.north, obstacles.vn, acceleration.imag], axis=1
    )


@pytest.mark.parametrize("name", CHAINS)
def test_replay_is_faster_than_the_naive_chain(name: str, tmp_path: Path, note: Note) -> None:
    result = timed(CHAINS[name](tmp_path))
    note(result)
    assert result.ratio >= 2, str(result)
