"""Each item that a recording is given is written, lost or waiting, and counted once; marks cost no other event."""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.recording import EventSettings, RecordingSettings
from candaemon.daemon.daemon import Daemon
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.recording_files import logs_in, number_of
from candaemon.recording import event_archive
from candaemon.recording.event_archive import LONGEST_EVENT_S, Event, archive_configuration
from candaemon.recording.recorder import MARK_INTERVAL_S, Recorder
from candaemon.recording.ring import Ring
from candaemon.recording.writer_thread import WriterThread
from tests.support.bound import binding

SECOND_NS = 1_000_000_000
LINE = b"(1700000000.000000) radar 500#0011223344556677\n"


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


def until(done: Callable[[], bool]) -> None:
    limit = time.monotonic() + 20
    while not done():
        assert time.monotonic() < limit
        time.sleep(0.005)


class Fed:
    """A recording that is given frames, in a time of its own."""

    def __init__(self, of: Binding, folder: Path, **settings: Any) -> None:
        self.now_s = 0.0
        self.frames = 0
        self.recording = Recorder(RecordingSettings.model_validate(settings), folder, of, clock=lambda: self.now_s)
        daemon = type("Watched", (), {"pipeline": Pipeline(of), "buses": ()})()
        self.daemon = cast("Daemon", daemon)
        self.recording.on_start(self.daemon)

    def feed(self, turns: int = 1, *, marked: bool = False) -> None:
        """Give 20 frames in each turn of 10 ms, with or without a mark."""
        for _ in range(turns):
            begin_ns = SECOND_NS + round(self.now_s * 1e9)
            self.recording.on_items([Frame(begin_ns + k * 500_000, 0, 0x500 + k, bytes(8)) for k in range(20)])
            self.frames += 20
            if marked:
                self.recording.on_mark(self.daemon)
            self.recording.on_iteration(self.daemon)
            self.now_s += 0.01

    def figures(self) -> dict[str, Any]:
        return dict(self.recording.counts())

    def settled(self) -> None:
        """Wait until the thread has done all that it was given."""
        until(lambda: self.recording._disk._waiting == 0)

    def stop(self) -> dict[str, Any]:
        self.recording.on_stop(self.daemon)
        return self.figures()


@pytest.mark.parametrize("removed", ["the log", "the folder", "another in its place"])
def test_what_is_written_to_a_removed_file_is_lost_and_counted(
    of: Binding, tmp_path: Path, removed: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "ring"
    fed = Fed(of, folder, flush=0.05, retry=0.3)
    fed.feed(10)
    until(lambda: int(fed.recording.counts()["items"]) >= 80)
    before = int(fed.recording.counts()["items"])
    (log,) = logs_in(folder)
    if removed == "the folder":
        shutil.rmtree(folder)
    else:
        log.unlink()
    if removed == "another in its place":
        log.write_bytes(b"mine")
    with caplog.at_level(logging.INFO):
        fed.feed(10)
        until(lambda: int(fed.recording.counts()["lost"]) > 0)
        fed.feed(1)
        assert not fed.recording.counts()["recording"]
        fed.feed(100)
        figures = fed.stop()
    assert "the file being written was removed" in caplog.text
    assert figures["recording"]
    assert figures["items"] + figures["lost"] == fed.frames
    assert f"recorded again, after {figures['lost']} items in all were left out" in caplog.text
    rest = [each for each in logs_in(folder) if each.name != log.name]
    kept = sum(each.read_bytes().count(b"\n") for each in rest) - 1  # the last line says that it ends
    assert kept == figures["items"] - before
    assert removed != "another in its place" or log.read_bytes() == b"mine"


def test_what_a_stuck_disk_has_not_taken_at_the_end_is_counted(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    write = Ring.write

    def stuck(ring: Ring, text: bytes) -> None:
        released.wait(60)
        write(ring, text)

    monkeypatch.setattr(Ring, "write", stuck)
    monkeypatch.setattr("candaemon.recording.recorder._CLOSING_S", 0.05)
    fed = Fed(of, tmp_path, flush=0.05)
    fed.feed(20)
    figures = fed.stop()
    assert (figures["items"], figures["lost"]) == (0, fed.frames)
    released.set()
    fed.recording._disk._thread.join(20)
    assert (fed.recording.counts()["items"], fed.recording.counts()["lost"]) == (0, fed.frames)


def test_a_storm_of_marks_is_one_event_and_costs_no_other(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path, flush=0.1, file_seconds=1.0, events={"kept": 3, "before": 0.5, "after": 1.0, "faults": []})
    fed.feed(100)
    for kind in ("bus", "lost"):
        fed.recording._disk.archive(Event(kind, "radar", SECOND_NS))
    fed.feed(400, marked=True)  # 100 a second
    fed.feed(300)
    figures = fed.stop()
    assert figures["lost"] == figures["events_lost"] == 0
    assert figures["items"] == fed.frames
    assert figures["events"] == 3
    kept = sorted((tmp_path / "events").iterdir(), key=lambda event: event.name.split("Z-")[1])
    assert [event.name.split("Z-")[1] for event in kept] == ["bus-radar", "lost-radar", "mark"]
    numbers = [number_of(log) for log in logs_in(kept[-1])]
    assert numbers[-1] == 6  # 1 s after the last mark, at 5 s
    assert numbers == list(range(1, 7))


def test_marks_apart_are_events_apart(of: Binding, tmp_path: Path) -> None:
    fed = Fed(of, tmp_path, events={"after": 0.0, "faults": []})
    for turn_s, is_event in ((0.0, True), (0.99 * MARK_INTERVAL_S, False), (MARK_INTERVAL_S, True)):
        before = fed.figures()["events"]
        fed.now_s = turn_s
        fed.feed(marked=True)
        fed.settled()
        assert fed.figures()["events"] - before == is_event
    fed.stop()


def test_an_event_is_prolonged_up_to_a_limit(of: Binding, tmp_path: Path) -> None:
    disk = WriterThread(tmp_path, RecordingSettings(events=EventSettings(after=200.0)))
    limit_ns = round(LONGEST_EVENT_S * 1e9)
    disk.begin(SECOND_NS, b"state", of, "digest")
    for later_ns in (0, 150 * SECOND_NS, limit_ns - 1, limit_ns):
        disk.archive(Event("mark", "", SECOND_NS + later_ns))
    disk.archive(Event("mark", "other", SECOND_NS + 1))
    disk.archive(Event("mark", "", 0))  # the clock was set back
    disk.close(20.0)
    assert disk.counts.events == 4
    assert len(list((tmp_path / "events").iterdir())) == 4


def test_an_event_before_anything_is_recorded_is_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    disk = WriterThread(tmp_path, RecordingSettings())
    disk.archive(Event("mark", "", 0))
    disk.archive(Event("sensor", "front", 0))
    disk.close(20.0)
    assert (disk.counts.events, disk.counts.events_lost) == (0, 2)
    assert caplog.messages == [
        f"the event {event} is not kept: nothing is recorded yet" for event in ("mark", "sensor front")
    ]


def test_a_name_of_any_length_is_part_of_an_events_name(of: Binding, tmp_path: Path) -> None:
    disk = WriterThread(tmp_path, RecordingSettings())
    disk.begin(SECOND_NS, b"state", of, "digest")
    for about in ("x" * 1000, "\U00020000" * 300, "../../up", "a\n\udcff\x00b", "."):
        disk.archive(Event("sensor", about, SECOND_NS))
    disk.close(20.0)
    assert (disk.counts.events, disk.counts.events_lost) == (5, 0)
    assert {event.parent for event in (tmp_path / "events").rglob("*.log")} == set((tmp_path / "events").iterdir())


def test_a_configuration_that_is_gone_or_too_long_ends_no_recording(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sizes = sorted(Path(path).stat().st_size for path in (str(of.loaded.path), *of.databases))
    monkeypatch.setattr(event_archive, "LARGEST_SOURCE", sizes[-1])
    ring = Ring(tmp_path, RecordingSettings())
    archive_configuration(ring.folder, of, "at")
    assert not caplog.messages
    monkeypatch.setattr(event_archive, "LARGEST_SOURCE", sizes[-1] - 1)
    archive_configuration(ring.folder, of, "beyond")
    ring.close()
    assert ["not kept beside the recording" in text for text in caplog.messages] == [True]
    kept = {name: len(list((tmp_path / "configurations" / name).rglob("*.*"))) for name in ("at", "beyond")}
    assert kept["at"] == kept["beyond"] + 1 == len(sizes)


def test_an_event_that_cannot_be_removed_costs_no_younger_one(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_name: str, *, dir_fd: int) -> None:
        raise PermissionError(dir_fd, os.strerror(1))

    monkeypatch.setattr("candaemon.files.own_folder.shutil.rmtree", refuse)
    disk = WriterThread(tmp_path, RecordingSettings(events=EventSettings(kept=1)))
    disk.begin(SECOND_NS, b"state", of, "digest")
    for about in "abc":
        disk.archive(Event("sensor", about, SECOND_NS))
    disk.close(20.0)
    assert (disk.counts.events, disk.counts.events_lost) == (3, 0)
    assert "cannot be removed" in caplog.text
