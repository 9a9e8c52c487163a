"""A ring's folder with anything in it: the service starts, nothing of others is touched, and what is wrong is told."""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots, fingerprint
from candaemon.playback.recording_files import logs_in, number_of, runs, stem, time_in
from candaemon.recording import ring as ring_module
from candaemon.recording.recorder import Recorder
from candaemon.recording.ring import HIGHEST_NUMBER, MOST_TOLD, Ring
from tests.support.bound import binding
from tests.support.recorded import driven, highway, replayed

SECOND_NS = 1_000_000_000
STEM = stem(1_700_000_000 * SECOND_NS, 7)
LINE = b"(1700000000.000000) radar 500#0011223344556677\n"


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


@pytest.fixture(scope="module")
def state(of: Binding) -> bytes:
    return Snapshots(of).dump(Pipeline(of), begins="start", time_ns=1_700_000_000 * SECOND_NS)


def put(folder: Path, state: bytes, name: str = STEM) -> Path:
    """Put a sound file into a ring; return its log."""
    log = folder / f"{name}.log"
    log.write_bytes(LINE)
    log.with_suffix(".state").write_bytes(state)
    return log


def found(folder: Path, **settings: float) -> list[str]:
    """Return the logs that a service which starts takes for its ring."""
    ring = Ring(folder, RecordingSettings.model_validate(settings))
    ring.close()
    return [file.log for file in ring.files]


def entries(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def instead(path: Path, make: Callable[[Path], object]) -> None:
    """Put something else in a file's place."""
    path.unlink()
    make(path)


KINDS: dict[str, Callable[[Path], object]] = {
    "folder": Path.mkdir,
    "full folder": lambda path: (path / "below").mkdir(parents=True),
    "pipe": os.mkfifo,
    "dangling link": lambda path: path.symlink_to("nowhere"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "link to a folder": lambda path: path.symlink_to("/etc"),
    "link to a file": lambda path: path.symlink_to("/etc/passwd"),
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("suffix", [".log", ".state"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_file_is_set_aside(
    tmp_path: Path, state: bytes, kind: str, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    other = put(tmp_path, state, stem(1_700_000_001 * SECOND_NS, 8))
    bad = put(tmp_path, state).with_suffix(suffix)
    instead(bad, KINDS[kind])
    before = bad.lstat()
    with caplog.at_level(logging.WARNING):
        logs = found(tmp_path)
    aside = tmp_path / f"{bad.name}.damaged"
    assert (aside.lstat().st_ino, aside.lstat().st_mode) == (before.st_ino, before.st_mode)
    assert logs == ([other.name] if suffix == ".log" else [f"{STEM}.log", other.name])
    assert [bad.name in text and "set aside" in text for text in caplog.messages][:1] == [True]
    told = len(caplog.messages)
    with caplog.at_level(logging.WARNING):
        assert found(tmp_path) == logs
    assert len(caplog.messages) == told  # once
    if suffix == ".log":  # a state of no log is what a kill leaves; this one is kept with its log
        assert (tmp_path / f"{STEM}.state.damaged").read_bytes() == state


def test_a_state_of_no_log_that_is_no_file_stays(tmp_path: Path) -> None:
    for name in (f"{STEM}.state", f".{STEM}.state.part"):
        (tmp_path / name).mkdir()
    assert not found(tmp_path)
    assert entries(tmp_path) == {f"{STEM}.state", f".{STEM}.state.part"}


HEADS: dict[str, Callable[[bytes], bytes]] = {
    "a surrogate": lambda head: head.replace(b'"configuration": {', b'"configuration": {"\\ud800": "x", ', 1),
    "nested": lambda _: b'{"a":' * 100_000 + b"\n",
    "nested in the format": lambda _: b'{"format": ' + b"[" * 50_000 + b"\n",
    "a long number": lambda head: head.replace(b'"time_ns": 17', b'"time_ns": 17' + b"0" * 5000, 1),
    "another time": lambda head: head.replace(b'"time_ns": 17', b'"time_ns": -17', 1),
    "no end of the line": lambda _: b" " * (1 << 21),
    "nothing": lambda _: b"",
}


@pytest.mark.parametrize("head", HEADS)
def test_a_damaged_header_keeps_no_service_from_starting(tmp_path: Path, of: Binding, state: bytes, head: str) -> None:
    log = put(tmp_path, state)
    log.with_suffix(".state").write_bytes(HEADS[head](state))
    assert found(tmp_path) == [log.name]
    sound = put(tmp_path, state, stem(1_700_000_001 * SECOND_NS, 8))
    assert [run.logs[-1] for run in runs(tmp_path, fingerprint(of))][-1] == sound


def test_no_damaged_byte_keeps_a_service_from_starting(tmp_path: Path, of: Binding, state: bytes) -> None:
    log = put(tmp_path, state)
    head = state[: state.index(b"\n") + 1]
    for at in range(0, len(head), 331):
        for bits in (0x01, 0x80):
            log.with_suffix(".state").write_bytes(head[:at] + bytes([head[at] ^ bits]) + head[at + 1 :])
            assert found(tmp_path) == [log.name]
            with suppress(InputError):
                runs(tmp_path, fingerprint(of))


@pytest.mark.parametrize(
    ("number", "of_the_ring"), [("1" + "0" * 30, 0), ("9" * 220, 0), ("١" * 6, 0), ("9" * 12, 0), ("000000", 1)]
)
def test_numbers_out_of_all_bounds_are_of_no_ring(tmp_path: Path, number: str, of_the_ring: int) -> None:
    (tmp_path / f"2026-01-01T00-00-00.000Z-{number}.log").write_bytes(b"")
    ring = Ring(tmp_path, RecordingSettings())
    ring.begin(stem(SECOND_NS, ring.highest + 1), SECOND_NS, b"state", "")
    ring.close()
    assert ring.highest == 0
    assert len(ring.files) == 1 + of_the_ring


def test_the_highest_number_leaves_room_for_more(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for number in (HIGHEST_NUMBER, HIGHEST_NUMBER + 1):
        put(tmp_path, b"state", stem(SECOND_NS, number))
    ring = Ring(tmp_path, RecordingSettings())
    ring.close()
    assert ring.highest == HIGHEST_NUMBER
    assert [number_of(Path(file.log)) for file in ring.files] == [HIGHEST_NUMBER]
    assert "its number leaves none" in caplog.messages[0]
    assert entries(tmp_path) >= {
        f"{stem(SECOND_NS, HIGHEST_NUMBER + 1)}{suffix}.damaged" for suffix in (".log", ".state")
    }


@pytest.mark.parametrize("name", ["2026-13-01T00-00-00.000Z-000001", "0000-00-00T99-99-99.999Z-000001"])
def test_a_time_that_is_none_is_the_files(tmp_path: Path, name: str) -> None:
    log = put(tmp_path, b"state", name)
    assert time_in(name) is None
    ring = Ring(tmp_path, RecordingSettings())
    ring.close()
    assert [file.begin_ns for file in ring.files] == [log.stat().st_mtime_ns]


def test_messages_of_a_start_are_bounded(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for number in range(MOST_TOLD + 5):
        (tmp_path / f"{stem(SECOND_NS, number)}.log").mkdir()
    assert not found(tmp_path)
    assert len(caplog.messages) == MOST_TOLD + 1
    assert caplog.messages[-1].endswith("5 more such files")


def test_what_cannot_be_renamed_is_left_out(
    tmp_path: Path, state: bytes, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_names: str, **_folders: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    instead(put(tmp_path, state), Path.mkdir)
    monkeypatch.setattr("candaemon.files.own_folder.os.rename", refuse)
    assert not found(tmp_path)
    assert "left out, it cannot be renamed: Read-only file system" in caplog.messages[0]


def test_holes_and_files_of_others_take_nothing_of_the_rings_share(tmp_path: Path, state: bytes) -> None:
    sparse, sound = put(tmp_path, state), put(tmp_path, state, stem(1_700_000_001 * SECOND_NS, 8))
    os.truncate(sparse, 1 << 40)
    (tmp_path / "theirs.log").write_bytes(bytes(2_000_000))
    ring = Ring(tmp_path, RecordingSettings(disk=1.0))
    ring.begin(stem(1_700_000_002 * SECOND_NS, 9), 1_700_000_002 * SECOND_NS, state, "")
    ring.close()
    assert [file.log for file in ring.files][:2] == [sparse.name, sound.name]
    assert (tmp_path / "theirs.log").exists()


def test_a_file_whose_entry_became_a_folder_costs_the_ring_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ring = Ring(tmp_path, RecordingSettings(minutes=0.01, file_seconds=1.0))
    for number in range(1, 4):
        ring.begin(stem(number * SECOND_NS, number), number * SECOND_NS, b"state", "")
        ring.write(LINE)
        if number == 1:
            instead(tmp_path / f"{stem(SECOND_NS, 1)}.log", Path.mkdir)
    ring.close()
    assert len(ring.files) == 2
    assert (tmp_path / f"{stem(SECOND_NS, 1)}.log").is_dir()
    assert "cannot be removed" in caplog.messages[0]


def test_no_link_in_the_folder_is_followed(tmp_path: Path, of: Binding) -> None:
    """Whatever names another user guessed: nothing outside changes, and nothing of it is lost in silence."""
    folder, victim = tmp_path / "ring", tmp_path / "victim"
    folder.mkdir()
    victim.mkdir()
    (victim / "file").write_bytes(b"precious")
    recorder = Recorder(RecordingSettings(file_seconds=1.0), folder, of)
    frames = highway(of, 1.2)
    begin_ns = frames[0].time_ns
    for milliseconds in (-1, 0, 1):
        for number in (1, 2, 3):
            name = stem(begin_ns + milliseconds * 1_000_000, number)
            for planted in (f"{name}.log", f"{name}.state", f".{name}.state.part"):
                (folder / planted).symlink_to(victim / "file")
    (folder / "events").symlink_to(victim)
    (folder / "configurations").symlink_to(victim)
    with driven(of, recorder) as run:
        run.feed(frames)
        run.daemon.mark()
        run.daemon.run_once()
        run.stop()
    counts = recorder.counts()
    assert entries(victim) == {"file"}
    assert (victim / "file").read_bytes() == b"precious"
    assert counts["items"] == 0
    assert int(counts["lost"]) >= len(frames)


def test_what_is_recorded_is_for_its_user_alone(tmp_path: Path, of: Binding) -> None:
    mask = os.umask(0)
    try:
        recorder = Recorder(RecordingSettings(file_seconds=1.0), tmp_path / "a" / "ring", of)
        with driven(of, recorder) as run:
            run.feed(highway(of, 1.2))
            run.daemon.mark()
            run.daemon.run_once()
            run.stop()
    finally:
        os.umask(mask)
    every = [tmp_path / "a" / "ring", *(tmp_path / "a" / "ring").rglob("*")]
    modes = {path: path.stat().st_mode & 0o777 for path in every}
    assert {path.suffix for path in every} >= {".log", ".state", ".json", ".yaml", ".dbc"}
    assert {path for path, mode in modes.items() if mode != (0o700 if path.is_dir() else 0o600)} == set()


def test_a_ring_of_an_earlier_version_starts_and_is_closed_to_others(
    tmp_path: Path, of: Binding, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "ring"
    for seconds in (1.1, 0.3):
        recorder = Recorder(RecordingSettings(file_seconds=1.0), folder, of)
        with driven(of, recorder) as run:
            run.feed(highway(of, seconds))
            run.daemon.mark()
            run.daemon.run_once()
            run.stop()
        assert recorder.counts()["lost"] == 0
        if seconds == 1.1:
            for path in [folder, *folder.rglob("*")]:
                path.chmod(0o775 if path.is_dir() else 0o664)
    assert [text for text in caplog.messages if "others had access to it, which is taken away" in text]
    assert {path.stat().st_mode & 0o777 for path in (folder, folder / "events", folder / "configurations")} == {0o700}
    assert replayed(of, folder)


def test_a_folder_of_others_is_refused_with_what_to_do(tmp_path: Path, of: Binding) -> None:
    folder = tmp_path / "ring"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(InputError, match=r"ring: cannot be written: others may write to it; `chmod go-w .*ring`"):
        Recorder(RecordingSettings(), folder, of)
    folder.chmod(0o1777)  # as /tmp
    with pytest.raises(InputError, match="others may write"):
        Recorder(RecordingSettings(), folder, of)
    folder.chmod(0o775)  # not of candaemon
    with pytest.raises(InputError, match="others may write"):
        Recorder(RecordingSettings(), folder, of)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_folder_of_another_user_is_refused(tmp_path: Path, of: Binding) -> None:
    folder = tmp_path / "ring"
    folder.mkdir(0o700)
    os.chown(folder, 12345, 12345)
    with pytest.raises(InputError, match=r"belongs to another user; `chown` it"):
        Recorder(RecordingSettings(), folder, of)
    (tmp_path / "link").symlink_to("/root")
    os.lchown(tmp_path / "link", 12345, 12345)
    with pytest.raises(InputError, match=r"it is a link of another user"):
        Recorder(RecordingSettings(), tmp_path / "link", of)


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.ENOSPC])
def test_a_disk_that_refuses_at_the_start_costs_the_recording_alone(
    tmp_path: Path, of: Binding, number: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    refuses = [True]
    scandir = os.scandir

    def refusing(folder: int) -> object:
        if refuses[0]:
            raise OSError(number, os.strerror(number))
        return scandir(folder)

    monkeypatch.setattr("candaemon.files.own_folder.os.scandir", refusing)
    put(tmp_path, b"state", stem(SECOND_NS, 41))
    recorder = Recorder(RecordingSettings(retry=0.1), tmp_path, of)
    frames = highway(of, 1.2)
    with driven(of, recorder) as run:
        run.feed(frames[: len(frames) // 2])
        assert run.sent.frames
        assert not recorder.counts()["recording"]
        assert int(recorder.counts()["lost"]) >= len(frames) // 2
        assert "not recorded, the disk refuses" in caplog.text
        assert os.strerror(number) in caplog.text
        refuses[0] = False
        limit = time.monotonic() + 10
        while not recorder._disk.has_room:
            assert time.monotonic() < limit
            time.sleep(0.01)
        time.sleep(0.1)  # the core loop asks again after `retry`
        run.feed(frames[len(frames) // 2 :])
        run.stop()
    counts = recorder.counts()
    assert counts["recording"]
    assert int(counts["items"]) > 100
    assert [number_of(log) for log in logs_in(tmp_path)] == [41, 42]


def test_a_folder_of_a_million_files_is_scanned_in_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the limit and beyond; with a lower one, a million takes 8 s."""
    monkeypatch.setattr(ring_module, "MOST_FILES", 300)
    for number in range(1, 302):
        put(tmp_path, b"state", stem(number * SECOND_NS, number))
    looked: list[str] = []
    own_file = ring_module._Aside.own_file

    def counted(aside: ring_module._Aside, name: str) -> os.stat_result | None:
        looked.append(name)
        return own_file(aside, name)

    monkeypatch.setattr(ring_module._Aside, "own_file", counted)
    ring = Ring(tmp_path, RecordingSettings(minutes=1440.0))
    assert (len(ring.files), len(looked), ring.highest) == (301, 600, 301)
    ring.begin(stem(400 * SECOND_NS, 302), 400 * SECOND_NS, b"state", "")
    ring.close()
    assert len(ring.files) == len(logs_in(tmp_path)) == 300
