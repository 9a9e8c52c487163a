"""The recording and the disk: bounds that hold, and a disk that is full, slow or without links."""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.recording import EventSettings, RecordingSettings
from candaemon.daemon.daemon import Daemon
from candaemon.errors import InputError
from candaemon.frames.frame import Frame, Tick
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.recording_files import header_beside, logs_in, number_of
from candaemon.recording.event_archive import Event
from candaemon.recording.recorder import Recorder
from candaemon.recording.ring import Ring
from candaemon.recording.writer_thread import WriterThread
from tests.support.bound import binding

SECOND_NS = 1_000_000_000
LINE = b"(1700000000.000000) radar 500#0011223344556677\n"


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


class _Daemon:
    """What a recording looks at."""

    def __init__(self, of: Binding) -> None:
        self.pipeline = Pipeline(of)
        self.buses: tuple[object, ...] = ()


class Fed:
    """A recording that is given frames at a rate."""

    def __init__(self, of: Binding, folder: Path, **settings: Any) -> None:
        self.now_s = 0.0
        self.frames = 0
        self.settings = RecordingSettings.model_validate(settings)
        self.recording = Recorder(self.settings, folder, of, clock=lambda: self.now_s)
        self.daemon = cast("Daemon", _Daemon(of))
        self.recording.on_start(self.daemon)

    def feed(self, seconds: float, rate: int = 2000) -> None:
        """Give frames for some time, in turns of 10 ms."""
        for _ in range(round(seconds * 100)):
            begin_ns = SECOND_NS + round(self.now_s * 1e9)
            step_ns = SECOND_NS // rate
            data = bytes(range(8))
            frames = [Frame(begin_ns + k * step_ns, 0, 0x500 + k % 64, data) for k in range(rate // 100)]
            self.recording.on_items(frames)
            self.recording.on_iteration(self.daemon)
            self.frames += len(frames)
            self.now_s += 0.01

    def figures(self) -> dict[str, Any]:
        return dict(self.recording.counts())

    def stop(self) -> dict[str, Any]:
        self.recording.on_stop(self.daemon)
        return self.figures()


def until(done: Callable[[], bool]) -> None:
    limit = time.monotonic() + 10
    while not done():
        assert time.monotonic() < limit
        time.sleep(0.005)


def size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.glob("*.*"))


def ring_of(folder: Path) -> list[str]:
    """Return the names of the logs that the service would take for its ring."""
    ring = Ring(folder, RecordingSettings())
    ring.close()
    return [file.log for file in ring.files]


def test_a_flood_stays_within_its_share_of_the_disk(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path, disk=2.0, file_seconds=30.0)
    most = 0
    for _ in range(8):
        fed.feed(1.0, rate=20_000)
        until(lambda: fed.figures()["items"] >= fed.frames - 2000)
        most = max(most, size(tmp_path))
    figures = fed.stop()
    assert 1_500_000 < most <= 2_000_000
    assert figures["bytes"] == size(tmp_path)
    assert figures["lost"] == 0
    assert (number_of(logs_in(tmp_path)[-1]) or 0) > 20  # files of an eighth of the share


def test_the_ring_holds_its_minutes_over_restarts(of: Binding, tmp_path: Path) -> None:
    for _ in range(2):
        fed = Fed(of, tmp_path, minutes=0.1, file_seconds=1.0)
        fed.feed(10.0, rate=100)
        assert fed.stop()["lost"] == 0
    spans = [header.time_ns for log in logs_in(tmp_path) if (header := header_beside(log))]
    numbers = [number_of(log) or 0 for log in logs_in(tmp_path)]
    assert 6e9 <= spans[-1] + SECOND_NS - spans[0] <= 8.5e9
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert numbers[-1] > 15
    left = Ring(tmp_path, RecordingSettings(minutes=0.1, file_seconds=1.0))
    assert left.bytes == sum(file.size for file in left.files) == size(tmp_path)
    left.close()


def test_what_a_kill_left_half_done_goes(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path, file_seconds=1.0)
    fed.feed(1.0)
    fed.stop()
    (tmp_path / ".2026-01-01T00-00-00.000Z-000009.state.part").write_bytes(b"half")
    (tmp_path / "2026-01-01T00-00-00.000Z-000009.state").write_bytes(b"of no log")
    (log,) = logs_in(tmp_path)
    log.with_suffix(".state").write_bytes(b"damaged")
    assert ring_of(tmp_path) == [log.name]
    assert {path.name for path in tmp_path.iterdir()} == {"configurations", log.name, f"{log.stem}.state"}


def test_a_full_disk_is_counted_told_once_and_waited_for(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    fed = Fed(of, tmp_path, file_seconds=1.0, retry=0.5, flush=0.1)
    fed.feed(1.5)
    until(lambda: fed.figures()["items"] >= fed.frames - 400)
    kept = size(tmp_path)
    write, full = os.write, [True]

    def refusing(descriptor: int, data: memoryview) -> int:
        if full[0]:
            write(descriptor, data[: len(data) // 2])  # as a disk does that has some room left
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data)

    monkeypatch.setattr("candaemon.recording.ring.os.write", refusing)
    with caplog.at_level(logging.INFO):
        for _ in range(30):
            fed.feed(0.1)
            time.sleep(0.005)
        assert fed.figures()["lost"] > 2000
        assert size(tmp_path) < kept + 400_000
        full[0] = False
        for _ in range(20):
            fed.feed(0.1)
            time.sleep(0.005)
        until(lambda: fed.figures()["recording"])
    figures = fed.stop()
    refusals = [text for text in caplog.messages if "No space left" in text]
    assert len(refusals) == 1
    assert str(tmp_path) in refusals[0]
    assert any("recorded again" in text for text in caplog.messages)
    assert figures["pauses"] >= 2
    assert figures["items"] + figures["lost"] == fed.frames
    for log in logs_in(tmp_path):
        text = log.read_bytes()
        assert text == b"" or text.endswith(b"\n")
    begins = [header.begins for log in logs_in(tmp_path) if (header := header_beside(log))]
    assert "gap" in begins


def test_a_slow_disk_costs_input_and_never_waits(of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fed = Fed(of, tmp_path, buffer=0.2, flush=0.05, retry=0.2)
    fed.feed(0.1)
    until(lambda: fed.figures()["files"] == 1)
    write, slow = os.write, [True]

    def dragging(descriptor: int, data: memoryview) -> int:
        while slow[0]:
            time.sleep(0.001)
        return write(descriptor, data)

    monkeypatch.setattr("candaemon.recording.ring.os.write", dragging)
    fed.feed(5.0, rate=4000)
    assert fed.figures()["lost"] > 10_000
    assert not fed.figures()["recording"]
    slow[0] = False
    until(lambda: fed.figures()["items"] > 100)
    time.sleep(0.05)
    fed.feed(1.0)
    figures = fed.stop()
    assert figures["items"] + figures["lost"] == fed.frames
    assert [header.begins for log in logs_in(tmp_path) if (header := header_beside(log))] == ["start", "gap"]


def test_a_stop_waits_for_no_disk(of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fed = Fed(of, tmp_path)
    released = [False]

    def stuck(_descriptor: int, data: memoryview) -> int:
        while not released[0]:
            time.sleep(0.001)
        return len(data)

    monkeypatch.setattr("candaemon.recording.ring.os.write", stuck)
    fed.feed(0.5)
    began = time.monotonic()
    fed.stop()
    assert time.monotonic() - began < 0.5
    released[0] = True


def test_a_disk_that_refuses_from_the_start_is_not_said_to_record(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuses(*_: object) -> Ring:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with caplog.at_level(logging.INFO), monkeypatch.context() as patched:
        patched.setattr("candaemon.recording.writer_thread.Ring", refuses)
        Fed(of, tmp_path / "refused").stop()
        assert ["not recorded, the disk refuses" in text for text in caplog.messages] == [True]
    caplog.clear()
    with caplog.at_level(logging.INFO):
        Fed(of, tmp_path / "taken").stop()
    assert caplog.messages == [f"recorded into {tmp_path / 'taken'}"]


def test_a_folder_that_cannot_be_written_to_is_refused(of: Binding, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="cannot be written"):
        Recorder(RecordingSettings(), tmp_path / "file", of)


@pytest.mark.parametrize("links", [True, False])
def test_kept_events_are_bounded_and_whole(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, links: bool
) -> None:
    def no_links(*_paths: object, **_folders: object) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    if not links:
        monkeypatch.setattr("candaemon.files.own_folder.os.link", no_links)
    events = EventSettings(before=1.0, after=1.0, kept=3)
    disk = WriterThread(tmp_path, RecordingSettings(minutes=0.05, file_seconds=1.0, events=events))
    for second in range(1, 31):
        disk.begin(second * SECOND_NS, b"state", of, "digest")
        assert disk.write(LINE * second, second)
        if second % 5 == 0:
            disk.archive(Event("mark", f"no {second}/a", second * SECOND_NS + SECOND_NS // 2))
    disk.close(5.0)
    kept = sorted((tmp_path / "events").iterdir())
    assert [event.name.split("Z-")[1] for event in kept] == ["mark-no_20_a", "mark-no_25_a", "mark-no_30_a"]
    for event, second in zip(kept, (20, 25, 30), strict=True):
        expected = range(second - 1, min(second + 2, 31))
        assert [number_of(log) for log in logs_in(event)] == list(expected)
        assert [log.read_bytes() for log in logs_in(event)] == [LINE * n for n in expected]
        assert all(log.with_suffix(".state").read_bytes() == b"state" for log in logs_in(event))
        assert list((event / "configuration").rglob("demo.yaml"))
    assert disk.counts.events == 6


def test_events_take_no_more_than_their_share(of: Binding, tmp_path: Path) -> None:
    events = EventSettings(before=0.0, after=0.0, disk=0.5)
    disk = WriterThread(tmp_path, RecordingSettings(file_seconds=1.0, events=events))
    for second in range(1, 9):
        disk.begin(second * SECOND_NS, b"state", of, "digest")
        assert disk.write(LINE * 500, 500)
        disk.archive(Event("mark", "", second * SECOND_NS + 1))
    disk.close(5.0)
    files = [file for file in (tmp_path / "events").rglob("*") if file.is_file()]
    inodes = {file.stat().st_ino: file.stat().st_size for file in files}
    assert sum(inodes.values()) <= 500_000 + 500 * len(LINE)
    assert 2 <= len(list((tmp_path / "events").iterdir())) <= 6


def test_nothing_is_kept_where_no_event_may_be(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path, events={"kept": 0})
    fed.feed(0.1)
    fed.recording.on_mark(fed.daemon)
    assert fed.stop()["events"] == 0
    assert not (tmp_path / "events").exists()


def test_ticks_alone_are_recorded(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path)
    for k in range(10):
        fed.recording.on_items([Tick(SECOND_NS + k)])
        fed.recording.on_items([])
    fed.stop()
    (log,) = logs_in(tmp_path)
    lines = log.read_text().splitlines()
    assert lines[:2] == ["(0000000001.000000) tick 000#", "(0000000001.000000001) tick 000#"]
    assert lines[-1] == "(0000000001.000000009) tick 001#"
    assert len(lines) == 11
