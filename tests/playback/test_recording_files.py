"""Recordings as they are read back: which files belong together, and what is said of those that do not."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

import candaemon
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import TICK_BUS, LogCounts
from candaemon.errors import InputError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots, fingerprint
from candaemon.pipeline.saved_state.fingerprint import differences
from candaemon.playback.recording_files import Run, runs, stem, utc
from candaemon.playback.replay import ReplayRequest, replay
from tests.support.bound import binding
from tests.support.recorded import as_log, highway, replayed

SECOND_NS = 1_000_000_000
END = b"(1700000009.000000) tick 001#\n"


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


def put(folder: Path, of: Binding, number: int, begins: str, follows: str = "", text: bytes = b"") -> Path:
    """Write a file of a recording that holds a text, with the state of a pipeline that has taken nothing."""
    folder.mkdir(exist_ok=True)
    log = folder / f"{stem(number * SECOND_NS, number)}.log"
    log.write_bytes(text)
    state = Snapshots(of).dump(Pipeline(of), begins=begins, follows=follows, time_ns=number * SECOND_NS)
    log.with_suffix(".state").write_bytes(state)
    return log


def test_names_sort_by_time() -> None:
    times = [0, 999_999_999, SECOND_NS, 1_700_000_000 * SECOND_NS, 1_700_000_000 * SECOND_NS + 1_000_000]
    assert utc(times[-1]) == "2023-11-14T22-13-20.001Z"
    assert sorted(map(utc, times)) == [utc(time_ns) for time_ns in times]


def test_files_that_go_on_in_each_other_are_a_run(of: Binding, tmp_path: Path) -> None:
    a = put(tmp_path, of, 9, "start")
    b = put(tmp_path, of, 10, "rotation", a.name, END)
    c = put(tmp_path, of, 3_000_000, "gap", b.name)
    d = put(tmp_path, of, 3_000_001, "rotation", c.name)
    e = put(tmp_path, of, 3_000_003, "rotation", "the one between is lost")
    f = put(tmp_path, of, 3_000_004, "start", "", END)
    assert runs(tmp_path, fingerprint(of)) == [
        Run((a, b), a.with_suffix(".state"), ends=True),
        Run((c, d), c.with_suffix(".state"), ends=False),
        Run((e,), e.with_suffix(".state"), ends=False),
        Run((f,), f.with_suffix(".state"), ends=True),
    ]
    assert runs(d, fingerprint(of)) == [Run((d,), d.with_suffix(".state"), ends=False)]
    assert runs(tmp_path, fingerprint(of), fresh=True) == [Run((a, b, c, d, e, f), None, ends=True)]


def test_logs_without_states_are_one_drive(of: Binding, tmp_path: Path) -> None:
    frames = highway(of, 1.0)
    (tmp_path / "parts").mkdir()
    for name, part in (("b.log", frames[1000:]), ("a.log", frames[:1000])):
        (tmp_path / "parts" / name).write_bytes(as_log(of, part))
    (tmp_path / "whole.log").write_bytes(as_log(of, frames))
    assert replayed(of, tmp_path / "parts") == replayed(of, tmp_path / "whole.log") != b""


def test_a_damaged_state_costs_its_file_alone(of: Binding, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    a = put(tmp_path, of, 1, "start")
    b = put(tmp_path, of, 2, "rotation", a.name)
    c = put(tmp_path, of, 3, "rotation", b.name)
    b.with_suffix(".state").write_bytes(b"")  # as a power cut leaves it
    with caplog.at_level(logging.WARNING):
        found = runs(tmp_path, fingerprint(of))
    assert [run.logs for run in found] == [(a,), (c,)]
    assert [text for text in caplog.messages if b.name in text and "left out" in text]
    with pytest.raises(InputError, match=f"{b.stem}.state: it is no stored state.*--fresh"):
        runs(b, fingerprint(of))


def test_files_of_another_version_are_left_out(of: Binding, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    a, b = put(tmp_path, of, 1, "start"), put(tmp_path, of, 2, "start")
    state = a.with_suffix(".state")
    state.write_bytes(state.read_bytes().replace(f'"{candaemon.__version__}"'.encode(), b'"0.0.1"', 1))
    with caplog.at_level(logging.WARNING):
        assert [run.logs for run in runs(tmp_path, fingerprint(of))] == [(b,)]
    assert [text for text in caplog.messages if a.name in text and "recorded by candaemon 0.0.1" in text]
    b.unlink()
    with pytest.raises(InputError, match=r"recorded by candaemon 0\.0\.1.*the version that recorded it, or --fresh"):
        runs(tmp_path, fingerprint(of))


def test_what_is_not_there_is_said(of: Binding, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no log in this folder; expected files of a recording, \*\.log"):
        replay(of, ReplayRequest(tmp_path))
    with pytest.raises(InputError, match="there is no such log"):
        replay(of, ReplayRequest(tmp_path / "nothing.log"))


def test_the_first_differences_are_named_and_the_rest_counted(of: Binding) -> None:
    here = fingerprint(of)
    assert differences(here, here) == ""
    there = {**here, **dict.fromkeys(list(here)[:5], "7")}
    assert "and 2 more" in differences(there, here)
    assert "was 7, is " in differences(there, here)
    assert "unheard was 1, is not set" in differences({**here, "unheard": "1"}, here)


def test_a_dbc_file_that_is_gone_differs_from_each_that_is_there(of: Binding) -> None:
    lost = replace(of, databases={"/nowhere/esr.dbc": next(iter(of.databases.values()))})
    assert "DBC esr.dbc was " in differences(fingerprint(of), fingerprint(lost))
    assert ", is unreadable" in differences(fingerprint(of), fingerprint(lost))


def test_dbc_files_of_one_name_are_told_apart(of: Binding, tmp_path: Path) -> None:
    database = next(iter(of.databases.values()))
    paths = [tmp_path / folder / "radar.dbc" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(b"one")
    twice = replace(of, databases={str(path): database for path in paths})
    before = fingerprint(twice)
    paths[0].write_bytes(b"another")
    assert differences(before, fingerprint(twice)).startswith("DBC radar.dbc was ")
    paths[0].write_bytes(b"one")
    paths[1].write_bytes(b"another")
    assert differences(before, fingerprint(twice)).startswith("DBC radar.dbc' was ")


@pytest.mark.parametrize("lines", [3, 40])
def test_ticks_pass_the_time_and_are_no_frames(tmp_path: Path, lines: int) -> None:
    log = tmp_path / "a.log"
    frames = [Frame(k, k % 2, 0x100, b"\x01") for k in range(lines)]
    log.write_bytes(
        candump_text([frame if frame.bus else Frame(frame.time_ns, 0, 0, b"") for frame in frames], ["tick", "can1"])
    )
    for channels in ({"can1": 1}, {"*": 1}, {"tick": 1, "can1": 1}):
        counts = LogCounts()
        assert [(frame.time_ns, frame.bus) for frame in read_log(log, channels, counts)] == [
            (k, 1 if k % 2 else TICK_BUS) for k in range(lines)
        ]
        assert (counts.ticks, counts.frames) == (lines - lines // 2, lines // 2)
        assert not counts.other_channels


def test_a_recording_of_silence_is_no_error(of: Binding, tmp_path: Path) -> None:
    put(tmp_path, of, 1, "start", text=b"(0000000001.000000) tick 000#\n" + END)
    assert replay(of, ReplayRequest(tmp_path)).log.ticks == 2


class Sample(NamedTuple):
    """As samples of own motion are."""

    time_ns: int
    value: float
