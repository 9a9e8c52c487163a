"""A recording whose folder others have a hand in: what they remove does not end it, what is theirs stays."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

from candaemon.binding.bound import Binding
from candaemon.can_io.port import BusState, PortCounts
from candaemon.config.recording import EventSettings, RecordingSettings
from candaemon.errors import InputError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.recording_files import logs_in, number_of, stem
from candaemon.recording.event_archive import Event
from candaemon.recording.event_detector import EventDetector
from candaemon.recording.ring import Ring
from candaemon.recording.writer_thread import WriterThread
from tests.support.bound import binding

if TYPE_CHECKING:
    from candaemon.daemon.daemon import Daemon

SECOND_NS = 1_000_000_000
LINE = b"(1700000000.000000) radar 500#0011223344556677\n"


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


def lasting(kept: int) -> RecordingSettings:
    """Return settings with which events stay open to the end."""
    return RecordingSettings(file_seconds=1.0, events=EventSettings(before=1.0, after=60.0, kept=kept))


def begin(disk: WriterThread, of: Binding, second: int) -> None:
    """Begin a file that holds a line."""
    disk.begin(second * SECOND_NS, b"state", of, "digest")
    assert disk.write(LINE, 1)


def mark(disk: WriterThread, second: int) -> None:
    disk.archive(Event("mark", str(second), second * SECOND_NS + 1))


def until_idle(disk: WriterThread, written: int) -> None:
    """Wait until the thread has done all that it was given."""
    for _ in range(1000):
        if disk.counts.items + disk.counts.lost >= written:
            return
        disk._thread.join(0.005)
    pytest.fail("the disk's thread does not come to an end")


def test_an_event_that_gives_way_while_it_is_open_costs_nothing_else(of: Binding, tmp_path: Path) -> None:
    disk = WriterThread(tmp_path, lasting(kept=1))
    for second in range(1, 9):
        begin(disk, of, second)
        if second in {3, 4, 5}:
            mark(disk, second)
    disk.close(5.0)
    assert (disk.counts.items, disk.counts.lost, disk.refusals, disk.counts.events) == (8, 0, 0, 3)
    (event,) = (tmp_path / "events").iterdir()
    assert event.name.endswith("mark-5")
    assert [number_of(log) for log in logs_in(event)] == [4, 5, 6, 7, 8]


def test_events_removed_by_hand_cost_nothing_else(
    of: Binding, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    disk = WriterThread(tmp_path, lasting(kept=9))
    begin(disk, of, 1)
    mark(disk, 1)
    begin(disk, of, 2)
    until_idle(disk, 2)
    with caplog.at_level(logging.WARNING):
        shutil.rmtree(tmp_path / "events")
        for second in range(3, 6):
            begin(disk, of, second)
        mark(disk, 5)
        disk.close(5.0)
    assert (disk.counts.items, disk.counts.lost, disk.refusals, disk.counts.events) == (5, 0, 0, 2)
    assert ["not kept any further" in text for text in caplog.messages] == [True]
    assert [event.name[-6:] for event in (tmp_path / "events").iterdir()] == ["mark-5"]


def test_a_folder_removed_by_hand_is_made_again(of: Binding, tmp_path: Path) -> None:
    folder = tmp_path / "ring"
    folder.mkdir()
    disk = WriterThread(folder, RecordingSettings())
    begin(disk, of, 1)
    until_idle(disk, 1)
    shutil.rmtree(folder)
    begin(disk, of, 2)
    disk.close(5.0)
    (log,) = logs_in(folder)
    assert log.read_bytes() == LINE
    assert disk.counts.lost == 0


def test_no_file_goes_on_behind_one_whose_end_was_refused(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, refused = Ring.write, [LINE * 2]

    def full(ring: Ring, text: bytes) -> None:
        if text in refused:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(ring, text)

    monkeypatch.setattr(Ring, "write", full)
    disk = WriterThread(tmp_path, RecordingSettings())
    begin(disk, of, 1)
    disk.write(LINE * 2, 2)
    disk.begin(2 * SECOND_NS, b"state", of, "digest", goes_on=True)
    disk.write(LINE, 1)
    begin(disk, of, 3)
    disk.close(5.0)
    assert [number_of(log) for log in logs_in(tmp_path)] == [1, 3]
    assert (disk.counts.items, disk.counts.lost, disk.refusals) == (2, 3, 1)


def test_files_of_others_are_not_of_the_ring(tmp_path: Path) -> None:
    names = {"drive-20240101.log", "drive-20240101.state", "notes.state", "candump-2024-11-21_120000.log"}
    for name in names:
        (tmp_path / name).write_bytes(b"mine")
    ring = Ring(tmp_path, RecordingSettings())
    ring.close()
    assert not ring.files
    assert {path.name for path in tmp_path.iterdir()} == names


def test_folders_of_others_stay(of: Binding, tmp_path: Path) -> None:
    places = [tmp_path / name for name in ("events/mine", "configurations/mine", "configurations/0123456789ab")]
    for place in places:
        place.mkdir(parents=True)
    disk = WriterThread(tmp_path, RecordingSettings(events=EventSettings(kept=1)))
    for second in (1, 2):
        begin(disk, of, second)
        mark(disk, second)
    begin(disk, of, 3)
    disk.close(5.0)
    assert disk.refusals == 0
    assert [place.exists() for place in places] == [True, True, False]
    assert {event.name[-6:] for event in (tmp_path / "events").iterdir()} == {"mine", "mark-2"}


def test_events_wait_for_a_disk_that_hangs_in_bounds(
    of: Binding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr(Ring, "write", lambda *_: released.wait(60))
    disk = WriterThread(tmp_path, RecordingSettings(buffer=0.1))
    begin(disk, of, 1)
    for second in range(200):
        mark(disk, second)
    assert 100 <= disk.counts.events_lost < 110
    released.set()
    disk.close(60.0)
    assert disk.counts.events + disk.counts.events_lost == 200


def test_a_file_that_goes_leaves_no_log_without_its_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ring = Ring(tmp_path, RecordingSettings())
    ring.begin(stem(SECOND_NS, 1), SECOND_NS, b"state", "")
    removed = []

    def half(name: str, *, dir_fd: int) -> None:
        assert dir_fd == ring.folder.descriptor
        removed.append(name)
        raise OSError("the disk is gone")

    monkeypatch.setattr("candaemon.files.own_folder.os.unlink", half)
    with pytest.raises(OSError, match="gone"):
        ring._drop()
    assert (removed, len(ring.files)) == ([f"{stem(SECOND_NS, 1)}.log"], 1)
    ring.close()


def test_two_services_do_not_share_a_folder(tmp_path: Path) -> None:
    first = WriterThread(tmp_path, RecordingSettings())
    with pytest.raises(InputError, match="another service records into it"):
        WriterThread(tmp_path, RecordingSettings())
    first.close(5.0)
    WriterThread(tmp_path, RecordingSettings()).close(5.0)


def test_what_is_synced_is_the_state_and_its_name_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    force = os.fsync

    def noted(descriptor: int) -> None:
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        force(descriptor)

    monkeypatch.setattr("candaemon.recording.ring.os.fsync", noted)
    for sync in (False, True):
        ring = Ring(tmp_path, RecordingSettings(sync=sync))
        ring.begin(stem(SECOND_NS, 1 + sync), SECOND_NS, b"state", "")
        ring.close()
    assert synced == [f"{stem(SECOND_NS, 2)}.state", tmp_path.name]


def test_a_reload_makes_no_event_of_what_was_lost_before(of: Binding) -> None:
    bus = SimpleNamespace(name="radar", counts=PortCounts(), state=BusState(True, 0))
    daemon = cast("Daemon", SimpleNamespace(buses=[bus], pipeline=Pipeline(of)))
    watch = EventDetector(of)
    assert not list(watch.on_iteration(daemon, 0))
    bus.counts.kernel_lost = 7
    assert [event.kind for event in watch.on_iteration(daemon, 1)] == ["lost"]
    later_ns = 1000 * SECOND_NS
    after = EventDetector(of)
    after.go_on_from(watch)
    assert not list(after.on_iteration(daemon, later_ns))
    bus.counts.kernel_lost += 1
    assert [event.kind for event in after.on_iteration(daemon, later_ns)] == ["lost"]
    bus.state = BusState(False, 0, "gone")
    assert [event.kind for event in after.on_iteration(daemon, later_ns)] == ["bus"]
