"""Drives as people have them: several logs, parts, standard input, other formats, and what became of detections."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from candaemon.cli.main import main
from tests.support.bound import binding
from tests.support.paths import ROOT

COMMAND = [sys.executable, "-m", "candaemon"]

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a simulated drive of 4 s, `drive.log`, and its tracks."""
    folder = tmp_path_factory.mktemp("drive")
    scenario = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    (folder / "short.yaml").write_text(scenario.replace("duration: 40", "duration: 4"), encoding="utf-8")
    assert (
        main(["simulate", str(folder / "short.yaml"), "esr_ins", "-o", str(folder / "drive.log"), "--seed", "3"]) == 0
    )
    assert main(replaying(folder / "drive.log", "--tracks", folder / "tracks.csv")) == 0
    return folder


def replaying(*words: Path | str) -> list[str]:
    return ["replay", "esr_ins", *map(str, words)]


@pytest.mark.parametrize("suffix", [".pcapng", ".log.xz", ".mf4", ".blf"])
def test_a_drive_converted_there_and_back_is_the_same(short: Path, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("asammdf")
    log = short / "drive.log"
    assert main(["convert", str(log), str(tmp_path / f"there{suffix}")]) == 0
    assert main(["convert", str(tmp_path / f"there{suffix}"), str(tmp_path / "back.log")]) == 0
    if suffix in (".pcapng", ".log.xz"):
        assert (tmp_path / "back.log").read_bytes() == log.read_bytes()
    assert main(replaying(tmp_path / f"there{suffix}", "--tracks", tmp_path / "tracks.csv")) == 0
    same = (tmp_path / "tracks.csv").read_bytes() == (short / "tracks.csv").read_bytes()
    assert same or suffix == ".blf"  # which holds microseconds


def test_several_logs_and_parts_are_one_drive(short: Path, tmp_path: Path) -> None:
    lines = (short / "drive.log").read_bytes().splitlines(keepends=True)
    for number in range(3):
        part = lines[number * len(lines) // 3 : (number + 1) * len(lines) // 3]
        (tmp_path / f"part{number}.log").write_bytes(b"".join(part))
    parts = [tmp_path / f"part{number}.log" for number in (2, 0, 1)]
    assert main(replaying(*parts, "--tracks", tmp_path / "tracks.csv")) == 0
    assert (tmp_path / "tracks.csv").read_bytes() == (short / "tracks.csv").read_bytes()
    assert main(["convert", *map(str, parts), str(tmp_path / "whole.log")]) == 0
    assert (tmp_path / "whole.log").read_bytes() == b"".join(lines)
    assert main(["convert", str(short / "drive.log"), str(tmp_path / "middle.log"), "--from", "1", "--to", "2"]) == 0
    middle = (tmp_path / "middle.log").read_bytes()
    assert middle in (tmp_path / "whole.log").read_bytes()
    assert main(replaying(short / "drive.log", "--from", "1", "--to", "2", "--summary", tmp_path / "s.json")) == 0
    log = json.loads((tmp_path / "s.json").read_text())["log"]
    assert log["frames"] == middle.count(b"\n")
    assert log["frames"] + log["outside"] == log["lines"]


def test_convert_says_what_it_does_not_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.log").write_bytes(
        b"(1.000000) can0 123#01\n(1.000001) can1 123#02\n(1.000002) can1 123#R\n(1.0) tick 000#\ngarbage\n"
    )
    assert main(["convert", str(tmp_path / "a.log"), str(tmp_path / "a.csv")]) == 0
    told = capsys.readouterr()
    assert "frames: 2" in told.out
    assert "not written: 1 malformed; 1 remote frames; 1 ticks; which of 2 channels a frame is of" in told.err
    assert main(["convert", str(tmp_path / "a.log"), str(tmp_path / "a.txt")]) == 1
    assert main(["convert", str(tmp_path / "a.log"), str(tmp_path / "b.log"), "--from", "9"]) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.log"]


def test_convert_says_what_comes_back_as_something_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, asc = tmp_path / "a.log", tmp_path / "a.asc"
    log.write_bytes(b"(1.0) vcan1 201#02\n(1.1) can1 101#01\n(1.2) can0 100##3AB\n(0.9) can0 100#\n")
    assert main(["convert", str(log), str(asc)]) == 0
    assert (
        "not written: names of channels (vcan1 is read as can2); 1 time stamps before the first one, raised to it "
        "(.asc begins there); the date (.asc counts from the first frame); the flags BRS and ESI of 1 CAN FD frames; "
        "whether a frame was sent or received\n"
    ) in capsys.readouterr().err
    assert main(["convert", str(asc), str(tmp_path / "b.log")]) == 0
    assert [line.split()[1] for line in (tmp_path / "b.log").read_text().splitlines()] == [
        "can2",
        "can1",
        "can0",
        "can0",
    ]


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_a_number_in_one_log_is_no_name_of_another(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "names.log").write_bytes(b"(1600000000.0) radar 123#01\n")
    (tmp_path / "numbers.log").write_bytes(b"(1600000000.5) can0 200#01\n")
    logs = [str(tmp_path / "names.log"), str(tmp_path / f"numbers{suffix}")]
    assert main(["convert", str(tmp_path / "numbers.log"), logs[1]]) == 0
    assert main(["convert", *logs, str(tmp_path / "both.blf")]) == 0
    assert main(["convert", str(tmp_path / "both.blf"), str(tmp_path / "both.log")]) == 0
    said = {line.split()[2]: line.split()[1] for line in (tmp_path / "both.log").read_text().splitlines()}
    assert said == {"123#01": "can1", "200#01": "can0"}


def test_what_became_of_each_detection(short: Path, tmp_path: Path) -> None:
    table, summary = tmp_path / "detections.csv", tmp_path / "summary.json"
    assert main(replaying(short / "drive.log", "--detections", table, "--summary", summary)) == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    fates = Counter(row["fate"] for row in rows)
    counts = json.loads(summary.read_text())["tracks"]
    assert len(rows) == counts["detections"]
    assert fates["updated"] + fates["initiated"] == counts["used"]
    with (short / "tracks.csv").open(newline="") as file:
        obstacles = {(row["time"], row["id"]): row for row in csv.DictReader(file)}
    for row in rows:
        assert (row["id"] == "") == (row["fate"] == "unused")
        assert (row["nis"] == "") == (row["fate"] != "updated")
        if row["id"]:
            obstacle = obstacles[row["time"], row["id"]]
            away = abs(float(row["x"]) - float(obstacle["x"])) + abs(float(row["y"]) - float(obstacle["y"]))
            assert away < 15  # in vehicle axes both; a vehicle has several reflections


def test_standard_input_may_be_a_file(short: Path, tmp_path: Path) -> None:
    """Its format is told by what it begins with, which must not be missing when it is read."""
    tracks = tmp_path / "tracks.csv"
    with (short / "drive.log").open("rb") as log:
        done = subprocess.run(
            [*COMMAND, *replaying("-", "--tracks", tracks)], stdin=log, capture_output=True, check=False
        )
    assert done.returncode == 0, done.stderr
    assert tracks.read_bytes() == (short / "tracks.csv").read_bytes()


def test_a_device_takes_a_log_as_candump_writes_it(short: Path, tmp_path: Path) -> None:
    log, expected = tmp_path / "to.log", tmp_path / "named.log"
    with log.open("wb") as stream:
        command = [*COMMAND, "convert", str(short / "drive.log"), "/dev/stdout", "--from", "1", "--to", "2"]
        done = subprocess.run(command, stdout=stream, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 0, done.stderr
    assert main(["convert", str(short / "drive.log"), str(expected), "--from", "1", "--to", "2"]) == 0
    assert log.read_bytes().startswith(expected.read_bytes())
    assert expected.stat().st_size > 10_000


def test_what_is_printed_stays_out_of_a_file_on_standard_output(short: Path, tmp_path: Path) -> None:
    expected = tmp_path / "named.log"
    assert main(replaying(short / "drive.log", "-o", expected)) == 0
    done = subprocess.run([*COMMAND, *replaying(short / "drive.log", "-o", "-")], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == expected.read_bytes()
    assert b"log.frames: " in done.stderr


@pytest.mark.parametrize("name", ["t.xlsx", "t.parquet.gz"])
def test_a_table_that_is_not_written_is_refused(
    short: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(replaying(short / "drive.log", "--tracks", tmp_path / name)) == 2
    assert "expected one that ends in .csv or .csv.gz" in capsys.readouterr().err
    assert main(replaying(short / "drive.log", "--detections", tmp_path / "d.parquet")) == 2
    assert not list(tmp_path.iterdir())


def test_a_folder_of_a_recording_is_a_drive(short: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    lines = (short / "drive.log").read_bytes().splitlines(keepends=True)
    for number, part in enumerate((lines[: len(lines) // 2], lines[len(lines) // 2 :])):
        (folder / f"part{number}.log").write_bytes(b"".join(part))
    assert main(["convert", str(folder), str(tmp_path / "whole.log")]) == 0
    assert (tmp_path / "whole.log").read_bytes() == (short / "drive.log").read_bytes()
    assert main(["check", "esr_ins", "--log", str(folder)]) == 0


@pytest.mark.parametrize(
    "words", [["convert", "FOLDER", "o.log"], ["check", "esr_ins", "--log", "FOLDER"], ["report", "esr_ins", "FOLDER"]]
)
def test_a_folder_without_a_log_is_refused(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    assert main([word.replace("FOLDER", "empty") for word in words]) == 1
    assert "empty: no log in this folder; expected files of a recording" in capsys.readouterr().err


def test_a_gear_or_any_signal_that_never_comes_is_told(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (short / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    ego = binding("esr_ins").ego
    assert ego is not None
    (can_id,) = (can_id for can_id, message in ego.messages.items() if "curvature" in message.quantities)
    curvature = f" can2 {can_id & 0x1FFFFFFF:X}#"
    log = tmp_path / "drive.log"
    log.write_text("".join(line for line in lines if curvature not in line), encoding="utf-8")
    assert main(replaying(log)) == 0
    assert "own motion: curvature never came" in capsys.readouterr().err


def test_a_range_of_time_that_ends_before_it_begins_is_refused(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["convert", str(short / "drive.log"), str(tmp_path / "c.log"), "--from", "2", "--to", "1"]
    assert main(command) == 2
    assert "--to is not after --from" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_standard_input_ends_with_ctrl_c_and_keeps_its_results(short: Path, tmp_path: Path) -> None:
    content = (short / "drive.log").read_bytes()
    assert len(content) > 1 << 18  # more than a pipe holds: what is written has been read, but for that
    tracks = tmp_path / "tracks.csv"
    command = [*COMMAND, *replaying("-", "--tracks", tracks)]

    def heed() -> None:  # what runs the tests may ignore SIGINT, and so would the process
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, preexec_fn=heed) as process:  # noqa: PLW1509 - no threads here
        assert process.stdin is not None
        process.stdin.write(content)
        process.stdin.flush()
        process.send_signal(signal.SIGINT)
        # the input stays open: nothing but the signal ends it
        assert process.stdout is not None
        told = process.stdout.read()
        assert process.wait(120) == 0
    read = tracks.read_bytes()
    assert read.count(b"\n") > 10
    assert (short / "tracks.csv").read_bytes().startswith(read[: len(read) // 2])
    assert b"log.frames: " in told
