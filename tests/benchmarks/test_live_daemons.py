"""candaemon beside the naive daemon, live: less CPU, sooner, evenly, and nothing lost at twice the rate."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from .conftest import Note
from .live_wire import GROUPS

pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

from .live import CASES, endure, held  # not without msgpack


@pytest.fixture(autouse=True)
def _alone() -> None:
    """What answers when is no measure of anything while other tests want the processors."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        pytest.skip("measured with the machine to itself: python -m pytest tests/benchmarks")


@pytest.fixture(autouse=True)
def _multicast() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((GROUPS[0], 9))
        except OSError as error:
            pytest.skip(f"no multicast on this machine: {error}")


@pytest.mark.parametrize("name", CASES)
def test_live_it_takes_less_and_answers_sooner(name: str, tmp_path: Path, note: Note) -> None:
    result = held(CASES[name], tmp_path, blocks=5, seconds=1.5)
    note(result)
    if not result.holds and result.stalled > 0.05:
        pytest.skip(f"the machine is too busy to measure on: {result}")
    assert result.holds, str(result)


def test_twice_the_rate_is_taken_whole(tmp_path: Path, note: Note) -> None:
    endured = endure(8000, 3.0, tmp_path)
    note(endured)
    assert (endured.received, endured.lost) == (endured.sent, {}), str(endured)
