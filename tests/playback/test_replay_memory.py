"""Memory of a replay stays flat however long the drive is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.memory import LIMIT, long_log, resident_by_minute


@pytest.mark.slow
def test_a_replay_of_minutes_takes_no_more_memory_than_one_of_a_minute(tmp_path: Path) -> None:
    """An hour of it, `python -m tests.benchmarks.memory`, takes some minutes, and grew by 2.7 MB after its first."""
    log = tmp_path.resolve() / "drive.log"
    long_log(log, 5)
    resident = resident_by_minute(log, 5)
    assert len(resident) == 5
    assert min(resident) > 0.0
    assert max(resident) - resident[0] < LIMIT
    assert resident[-1] - resident[2] < LIMIT / 3, "it grows on"
