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
    assert result.received + sum(result.lost.values()) == result.sent, str(result)
    assert result.lost == {}, str(result)


def test_twice_the_rate_is_taken_or_counted_to_the_last_frame(tmp_path: Path, note: Note) -> None:
    """A fast machine takes it whole; one that is too slow or busy for it loses frames in its kernel, which counts."""
    endured = endure(8000, 3.0, tmp_path)
    note(endured)
    assert endured.received + sum(endured.lost.values()) == endured.sent, str(endured)
    assert endured.received > endured.sent / 2, str(endured)
    assert endured.lost.keys() <= {"kernel_lost", "unread"}, str(endured)


def test_a_daemon_that_does_not_run_loses_what_its_counts_say(tmp_path: Path, note: Note) -> None:
    endured = endure(8000, 3.0, tmp_path, paused_from=1.5)
    note(endured)
    assert endured.received + sum(endured.lost.values()) == endured.sent, str(endured)
    assert endured.lost.keys() == {"kernel_lost", "unread"}, str(endured)
