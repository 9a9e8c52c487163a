"""Memory stays flat however long the service runs."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.support.paths import ROOT

FRAMES = 1_370_000
WARM = 350_000
"""Frames in which the recording's ring has turned over three times, and the allocator has seen every size."""
LIMIT = 1_000_000


@pytest.mark.slow
def test_a_million_frames_leave_memory_as_it_was() -> None:
    """In a process of its own: what other tests have left behind would hide it."""
    run = [sys.executable, "-m", "tests.soak", "--frames", str(FRAMES)]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    warm = [(frames, resident) for frames, resident, _ in told["memory"] if frames >= WARM]
    assert warm[-1][0] - warm[0][0] >= 1_000_000 - FRAMES // 20
    assert max(resident for _, resident in warm[len(warm) // 2 :]) - warm[0][1] < LIMIT, done.stderr
    unread = told["losses"].get("unread", 0)
    assert told["received"] + unread == told["frames"]
    assert unread < 1000  # put in as it was stopped
    assert told["dropped"] == unread
    assert told["losses"].keys() <= {"unread", "objects_impossible"}
    assert told["obstacles"] > 1000
