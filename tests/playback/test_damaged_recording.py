"""A recording of which some files are damaged, or are no files: what is sound is replayed, and the rest is named."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.pipeline.saved_state import fingerprint
from candaemon.playback.recording_files import header_beside, logs_in, runs
from candaemon.recording.recorder import Recorder
from tests.support.bound import binding
from tests.support.recorded import driven, highway, replayed


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


@pytest.fixture(scope="module")
def sound(of: Binding, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record some files, one going on in the other."""
    folder = tmp_path_factory.mktemp("recorded") / "ring"
    with driven(of, Recorder(RecordingSettings(file_seconds=0.5), folder, of)) as run:
        run.feed(highway(of, 1.4))
        run.stop()
    assert len(logs_in(folder)) >= 3
    return folder


@pytest.fixture(scope="module")
def whole(of: Binding, sound: Path, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Return what each of its files leads to."""
    folder = tmp_path_factory.mktemp("parts")
    copy(sound, folder)  # a replay leaves its output there
    return [replayed(of, folder / log.name) for log in logs_in(sound)]


@pytest.fixture
def ring(sound: Path, tmp_path: Path) -> Path:
    """Copy the recording, to be damaged."""
    folder = tmp_path / "ring"
    folder.mkdir()
    copy(sound, folder)
    return folder


def copy(recording: Path, folder: Path) -> None:
    for log in logs_in(recording):
        for path in (log, log.with_suffix(".state")):
            (folder / path.name).write_bytes(path.read_bytes())


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("damaged", [0, 1, 2])
@pytest.mark.parametrize("at", [0, -1])
def test_a_damaged_state_costs_no_more_than_its_own_file(
    of: Binding, ring: Path, whole: list[bytes], damaged: int, at: int, caplog: pytest.LogCaptureFixture
) -> None:
    flip(logs_in(ring)[damaged].with_suffix(".state"), at)
    found = replayed(of, ring)
    if at == -1 and damaged:  # the state of a file that goes on where the one before ends is not needed
        assert found == b"".join(whole)
    else:
        assert found == b"".join(part for k, part in enumerate(whole) if k != damaged)
        assert [text for text in caplog.messages if logs_in(ring)[damaged].name in text and "left out" in text]


def test_where_all_is_damaged_the_first_is_named(of: Binding, ring: Path, caplog: pytest.LogCaptureFixture) -> None:
    for log in logs_in(ring):
        flip(log.with_suffix(".state"), -1)
    with pytest.raises(InputError, match=rf"{logs_in(ring)[0].stem}\.state: the state is damaged.*--fresh"):
        replayed(of, ring)
    assert not caplog.messages
    assert replayed(of, ring, fresh=True)


@pytest.mark.parametrize("suffix", [".log", ".state"])
@pytest.mark.parametrize(
    "make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("nowhere"), lambda path: path.symlink_to("/dev/zero")]
)
def test_what_is_no_file_is_left_out_and_waits_for_nobody(
    of: Binding,
    ring: Path,
    whole: list[bytes],
    suffix: str,
    make: Callable[[Path], object],
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = logs_in(ring)[1]
    log.with_suffix(suffix).unlink()
    make(log.with_suffix(suffix))
    assert replayed(of, ring) == b"".join(whole[:1] + whole[2:])
    assert [text for text in caplog.messages if log.stem in text and "left out" in text]
    if suffix == ".state":
        with pytest.raises(InputError, match=f"{log.stem}.state: .*--fresh"):
            replayed(of, log)


def test_a_log_without_its_state_is_not_taken_for_the_end_of_another(
    of: Binding, ring: Path, whole: list[bytes], caplog: pytest.LogCaptureFixture
) -> None:
    logs_in(ring)[1].with_suffix(".state").unlink()
    assert replayed(of, ring) == b"".join(whole[:1] + whole[2:])
    assert [text for text in caplog.messages if "its state is missing" in text]


def test_logs_without_any_state_are_one_drive(of: Binding, ring: Path) -> None:
    for state in ring.glob("*.state"):
        state.unlink()
    assert replayed(of, ring) == replayed(of, ring, fresh=True) != b""


def test_what_a_header_says_is_shown_in_few_safe_words(
    of: Binding, ring: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log, other, *_ = logs_in(ring)
    state = log.with_suffix(".state")
    head, _, content = state.read_bytes().partition(b"\n")
    header = header_beside(log)
    assert header is not None
    long = b'"version": "' + b"\\u001b[31m\\n" * 50_000 + b'"'
    state.write_bytes(head.replace(f'"version": "{header.version}"'.encode(), long, 1) + b"\n" + content)
    key = b'"configuration": {"' + b"\\u2028x" * 50_000 + b'": "' + b"y" * 50_000 + b'", '
    head, _, content = other.with_suffix(".state").read_bytes().partition(b"\n")
    other.with_suffix(".state").write_bytes(head.replace(b'"configuration": {', key, 1) + b"\n" + content)
    with caplog.at_level(logging.WARNING):
        runs(ring, fingerprint(of))
    assert len(caplog.messages) == 2
    assert max(map(len, caplog.messages)) < 1000
    assert all(text.isprintable() for text in caplog.messages)
