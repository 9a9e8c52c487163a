"""Where the time of a replay goes: each stage its own time, and the same bytes as without."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from candaemon.cli.main import main
from candaemon.playback import stage_times
from candaemon.playback.stage_times import REST, STAGES, StageTimes, rows
from candaemon.tracking.tracker import Tracker
from candaemon.tracking.vehicle_tracker import VehicleTracker
from tests.support.bound import binding
from tests.support.recorded import as_log, highway


class Clock:
    """A clock that work moves on."""

    def __init__(self) -> None:
        self.now_ns = 0

    def work(self, seconds: int) -> int:
        self.now_ns += seconds * 1_000_000_000
        return seconds

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(stage_times, "thread_time_ns", clock)
    return clock


class Worker:
    def __init__(self, clock: Clock) -> None:
        self.clock = clock

    def outer(self) -> int:
        self.clock.work(1)
        return 2 * self.inner() + self.clock.work(2)

    def inner(self) -> int:
        return self.clock.work(4)

    def fails(self) -> None:
        self.clock.work(1)
        raise KeyError


def test_what_a_stage_calls_of_another_counts_for_that_one_alone(clock: Clock) -> None:
    times, worker = StageTimes(), Worker(clock)
    times.watch(worker, {"outer": "update", "inner": "predict", "fails": "trust"})
    clock.work(8)
    assert worker.outer() == 10
    with pytest.raises(KeyError):
        worker.fails()
    clock.work(16)
    spent = {stage: each for stage, each in times.seconds().items() if each}
    assert spent == {"predict": 4.0, "update": 3.0, "trust": 1.0, REST: 24.0}


def test_items_count_where_they_are_made_and_not_where_they_are_used(clock: Clock) -> None:
    def made() -> Iterator[int]:
        for _ in range(3):
            yield clock.work(2)
        clock.work(1)

    times = StageTimes()
    assert [clock.work(each) for each in times.each("read the log", made())] == [2, 2, 2]
    assert times.seconds()["read the log"] == 7.0
    assert times.seconds()[REST] == 6.0


def test_rows_are_shares_of_the_whole() -> None:
    assert rows({"predict": 0.3, "update": 0.0, REST: 0.1}, 100) == (
        ("predict", "0.300", "75.0%", "3000"),
        (REST, "0.100", "25.0%", "1000"),
        ("together", "0.400", "100.0%", "4000"),
    )


@pytest.mark.parametrize("tracker", [Tracker, VehicleTracker])
def test_trackers_name_their_own_parts(tracker: type[Tracker | VehicleTracker]) -> None:
    assert all(callable(getattr(tracker, name)) for name in tracker.STAGES)
    assert set(tracker.STAGES.values()) <= set(STAGES)


def test_a_profiled_replay_writes_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of, log = binding("demo"), tmp_path / "drive.log"
    log.write_bytes(as_log(of, highway(of, 3.0)))
    told = []
    for options in ([], ["--profile"]):
        out, tracks = tmp_path / f"{len(options)}.log", tmp_path / f"{len(options)}.csv"
        assert main(["replay", "demo", str(log), "-o", str(out), "--tracks", str(tracks), *options]) == 0
        told.append((out.read_bytes(), tracks.read_bytes()))
    assert told[0] == told[1]
    printed = capsys.readouterr().out
    after = printed[printed.index("processor time") :].splitlines()
    found = {line[2:].split("  ")[0] for line in after[2:]}
    assert found == {*STAGES, REST, "together"}
