"""How commands end, whatever their streams, encoding and file names are: the right exit code, and all results."""

from __future__ import annotations

import gc
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from candaemon.cli.main import main
from tests.support.paths import ROOT

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a drive of a second, with truth and tracks."""
    folder = tmp_path_factory.mktemp("drive")
    scenario = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    (folder / "short.yaml").write_text(scenario.replace("duration: 40", "duration: 1"), encoding="utf-8")
    simulated = ["-o", str(folder / "drive.log"), "--truth", str(folder / "truth.csv")]
    assert main(["simulate", str(folder / "short.yaml"), "esr_ins", *simulated]) == 0
    tracks = ["--tracks", str(folder / "tracks.csv")]
    assert main(["replay", "esr_ins", str(folder / "drive.log"), *tracks]) == 0
    return folder


def ended(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a shell's line in which `candaemon` is this one."""
    line = f'candaemon() {{ {shlex.quote(sys.executable)} -m candaemon "$@"; }}; {command}'
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    done = subprocess.run(["bash", "-c", line], cwd=folder, env=surroundings, capture_output=True, check=False)
    assert b"Traceback" not in done.stderr
    assert b"Exception ignored" not in done.stderr
    return done


@pytest.mark.parametrize(
    ("streams", "code", "said"),
    [
        (">&-", 0, b""),
        ("2>&-", 0, b""),
        ("<&- >&- 2>&-", 0, b""),
        ("2>/dev/full", 0, b""),
        (">/dev/full", 1, b"candaemon: error: standard output: No space left on device\n"),
        (">/dev/full 2>&1", 1, b""),
        ("| true; exit ${PIPESTATUS[0]}", 0, b""),
    ],
)
def test_streams_that_take_nothing_cost_no_result(drive: Path, streams: str, code: int, said: bytes) -> None:
    """The files are whole; results that standard output has lost are a failure, messages are none."""
    done = ended(f"candaemon simulate short.yaml esr_ins -o again.log --truth again.csv {streams}", drive)
    assert done.returncode == code
    assert done.stderr == said
    assert (drive / "again.log").read_bytes() == (drive / "drive.log").read_bytes()
    assert (drive / "again.csv").read_bytes() == (drive / "truth.csv").read_bytes()
    for name in ("again.log", "again.csv"):
        (drive / name).unlink()


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("candaemon --help > /dev/full", 1),
        ("candaemon schema | head -1; exit ${PIPESTATUS[0]}", 0),
        ("candaemon replay --speed x 2> /dev/full", 2),
        ("candaemon replay demo typo.log 2>&-", 1),
        ("candaemon replay demo typo.log 2> /dev/full", 1),
    ],
)
def test_the_exit_code_says_what_became_of_the_work(drive: Path, command: str, code: int) -> None:
    assert ended(command, drive).returncode == code


def test_a_reader_that_has_gone_costs_no_other_result(drive: Path) -> None:
    ended("candaemon replay esr_ins drive.log -o whole.log", drive)
    for table in ("tracks", "detections"):
        told = f"candaemon replay esr_ins drive.log --{table} - -o one.log | true; exit ${{PIPESTATUS[0]}}"
        done = ended(told, drive)
        assert done.returncode == 0
        assert b"Broken pipe" not in done.stderr
        assert (drive / "one.log").read_bytes() == (drive / "whole.log").read_bytes()
        (drive / "one.log").unlink()
    done = ended("candaemon convert drive.log - | true; exit ${PIPESTATUS[0]}", drive)
    assert (done.returncode, done.stderr) == (0, b"")
    (drive / "whole.log").unlink()


def test_results_are_written_before_they_are_printed(drive: Path) -> None:
    done = ended("candaemon replay esr_ins drive.log --summary s.json > /dev/full", drive)
    assert done.returncode == 1
    assert json.loads((drive / "s.json").read_bytes())["cycles"]["told"] == 20


@pytest.mark.parametrize("encoding", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "POSIX", "PYTHONUTF8": "0"}])
def test_an_encoding_without_our_characters_costs_only_these(drive: Path, encoding: dict[str, str]) -> None:
    done = ended("candaemon evaluate tracks.csv truth.csv", drive, **encoding)
    assert done.returncode == 0, done.stderr
    assert b"GOSPA" in done.stdout
    done = ended("candaemon schema", drive, **encoding)
    assert done.returncode == 0
    assert "√" in json.dumps(json.loads(done.stdout), ensure_ascii=False)


def test_a_file_name_that_is_no_utf8_is_a_file_name(drive: Path) -> None:
    name = b"caf\xe9\x1b[2J".decode("utf-8", "surrogateescape")
    command = ["candaemon", "simulate", "short.yaml", "esr_ins", "-o", f"{name}.log", "--truth", f"{name}.csv"]
    done = ended(shlex.join(command), drive)
    assert done.returncode == 0, done.stderr
    assert (drive / f"{name}.log").read_bytes() == (drive / "drive.log").read_bytes()
    replayed = ["candaemon", "replay", "esr_ins", f"{name}.log", "--tracks", f"{name}.csv", "--summary", f"{name}.json"]
    done = ended(shlex.join(replayed), drive)
    assert done.returncode == 0, done.stderr
    assert (drive / f"{name}.csv").read_bytes() == (drive / "tracks.csv").read_bytes()
    refused = ended(shlex.join([*replayed, "-o", f"no{name}/o.log"]), drive)
    assert refused.returncode == 1
    assert rb"nocaf\udce9\x1b[2J/o.log: cannot be written: there is no such folder" in refused.stderr


def test_what_cannot_be_read_is_not_said_to_be_unwritable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_path: Path) -> Path:
        raise OSError(5, "Input/output error", "/srv/config.yaml")

    monkeypatch.setattr("candaemon.cli.check.find_config", fail)
    assert main(["check", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "candaemon: error: /srv/config.yaml: Input/output error\n"


def test_a_replay_leaves_the_search_for_unreachable_objects_as_it_was(drive: Path) -> None:
    usual = gc.get_threshold()
    assert main(["replay", "esr_ins", str(drive / "drive.log")]) == 0
    assert gc.get_threshold() == usual
