"""candaemon beside the naive daemon, live: nothing lost; CPU and latency are printed."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from .conftest import Note
from .live_wire import GROUPS

pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

from .live import CASES, compare, endure  # not without msgpack

pytestmark = pytest.mark.benchmark


@pytest.fixture(autouse=True)
def _multicast() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((GROUPS[0], 9))
        except OSError as error:
            pytest.skip(f"no multicast on this machine: {error}")


@pytest.mark.parametrize("name", CASES)
def test_nothing_is_lost_beside_the_naive_daemon(name: str, tmp_path: Path, note: Note) -> None:
    result = compare(CASES[name], tmp_path, blocks=5, seconds=1.5)
    note(result)
    assert (result.received, result.lost) == (result.sent, {}), str(result)


def test_of_twice_the_rate_most_is_taken(tmp_path: Path, note: Note) -> None:
    """An idle machine takes it whole; one that is too busy for it loses frames in its kernel."""
    endured = endure(8000, 3.0, tmp_path)
    note(endured)
    assert endured.received > endured.sent / 2, str(endured)
    assert endured.lost.keys() <= {"kernel_lost"}, str(endured)
