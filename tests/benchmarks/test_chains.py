"""The whole chain beside the naive one: the same states, many times faster."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from candaemon.pipeline.cycle import Cycle

from . import naive
from .chains import cycles, naive_cycles, reduced_binding, simulated_log
from .comparisons import CHAINS
from .conftest import Note
from .timing import held


def test_states_are_the_naive_chains(tmp_path: Path) -> None:
    """With id association and no merging, over the whole run, in each cycle the same tracks with the same states."""
    log = simulated_log(tmp_path / "states.log", 20.0)
    reference = naive_cycles(naive.CurrentStatistical, log, tmp_path / "naive.log")
    slot_of: dict[int, int] = {}
    compared = 0
    for cycle, expected in zip(cycles(reduced_binding(), log, tmp_path / "candaemon.log"), reference, strict=True):
        obstacles = cycle.obstacles
        assert obstacles.time_ns == expected.time_ns
        slot_of.update(zip(obstacles.id[obstacles.used_row].tolist(), obstacles.used_object.tolist(), strict=True))
        slots = [slot_of[each] for each in obstacles.id.tolist()]
        assert sorted(slots) == sorted(expected.tracks)
        states = np.array([expected.tracks[slot].filter.state for slot in slots])
        np.testing.assert_allclose(_states(cycle), states, rtol=0, atol=1e-9)
        compared += len(slots)
    assert compared > 25_000
    frames = [path.read_text().count("\n") for path in (tmp_path / "naive.log", tmp_path / "candaemon.log")]
    assert frames == [compared, compared]


def _states(cycle: Cycle) -> NDArray[np.float64]:
    """Return the states as the naive chain has them: [x, ẋ, ẍ, y, ẏ, ÿ] in the level frame."""
    obstacles, heading = cycle.obstacles, cycle.pose.heading
    acceleration = (obstacles.ax + 1j * obstacles.ay) * np.exp(1j * heading)
    return np.stack(
        [obstacles.east, obstacles.ve, acceleration.real, obstacles.north, obstacles.vn, acceleration.imag], axis=1
    )


@pytest.mark.parametrize("name", CHAINS)
def test_the_chain_is_fast(name: str, tmp_path: Path, note: Note) -> None:
    result = held(CHAINS[name](tmp_path))
    note(result)
    assert result.ratio >= result.comparison.least, str(result)
