"""Whatever a command writes: it appears whole, replaces nothing on a failure, and never what the command reads.

The options are found by their types, so that one that is added without a case here fails.
"""

from __future__ import annotations

import argparse
import errno
import os
import re
import shutil
import stat
from dataclasses import dataclass
from importlib import import_module
from itertools import permutations
from pathlib import Path

import pytest

from candaemon.cli.arguments import output_folder, output_path
from candaemon.cli.main import COMMANDS, main
from candaemon.files import outputs
from candaemon.papers import registry
from tests.support.experiments import invented
from tests.support.paths import ROOT

pytestmark = pytest.mark.usefixtures("logging_as_it_was")

POSITIONAL = "OUT"
"""An output that is named without an option."""


@dataclass(frozen=True)
class Command:
    """A command that succeeds in the folder of the fixture.

    Attributes:
        words: its arguments without options that write; they name only files that are there.
        inputs: the files that it reads.
        missing: the same arguments with a mistyped name of an input.
        required: an output that it cannot do without.
    """

    words: tuple[str, ...]
    inputs: tuple[str, ...]
    missing: tuple[str, ...]
    required: tuple[str, ...] = ()

    def arguments(self, *options: str) -> list[str]:
        """Return its arguments with these options."""
        given = [*self.words, *(() if self.required[:1] == options[:1] else self.required), *options]
        return [word for word in given if word != POSITIONAL]


DBC = ("oxts.dbc", "esr.dbc", "obstacles.dbc")
CASES = {
    "replay": Command(
        ("replay", "car.yaml", "drive.log"), ("car.yaml", "drive.log", *DBC), ("replay", "car.yaml", "typo.log")
    ),
    "report": Command(
        ("report", "car.yaml", "drive.log"),
        ("car.yaml", "drive.log", *DBC),
        ("report", "car.yaml", "typo.log"),
        ("--output", "new.html"),
    ),
    "simulate": Command(
        ("simulate", "short.yaml", "car.yaml"),
        ("short.yaml", "car.yaml", *DBC),
        ("simulate", "typo.yaml", "car.yaml"),
        ("--output", "new.log"),
    ),
    "evaluate": Command(
        ("evaluate", "tracks.csv", "truth.csv"), ("tracks.csv", "truth.csv"), ("evaluate", "typo.csv", "truth.csv")
    ),
    "convert": Command(("convert", "drive.log"), ("drive.log",), ("convert", "typo.log"), (POSITIONAL, "new.log")),
    "calibrate": Command(
        ("calibrate", "car.yaml", "drive.log"), ("car.yaml", "drive.log", *DBC), ("calibrate", "car.yaml", "typo.log")
    ),
    "init": Command(("init", "esr.dbc", "--yes", "--force"), ("esr.dbc",), ("init", "typo.dbc", "--yes", "--force")),
    "papers": Command(("papers", "000-table-1", "--runs", "2"), (), ("papers", "typo")),
}
OPTIONS = {
    "replay": {
        "--output": "o.log",
        "--tracks": "t.csv",
        "--predictions": "p.csv.gz",
        "--detections": "d.csv",
        "--summary": "s.json",
        "--mcap": "m.mcap",
        "--layout": "l.json",
    },
    "report": {"--output": "r.html", "--summary": "s.json"},
    "simulate": {"--output": "o.log", "--truth": "t.csv", "--origins": "s.csv"},
    "evaluate": {"--json": "e.json"},
    "convert": {POSITIONAL: "c.log"},
    "calibrate": {"--output": "p.yaml"},
    "init": {"--output": "c.yaml"},
    "papers": {"--json": "p.json"},
}
"""Each option that writes a file, with a name for it."""
FOLDERS = {("papers", "--plots"), ("replay", "--parquet"), ("run", "--record")}
"""Options that write into a folder, each tested with its command."""
NO_FILE = {("papers", "NAME"), ("status", "NAME"), ("view", "ADDRESS")}
"""Arguments that are plain words."""

EACH = [(command, option, name) for command, options in OPTIONS.items() for option, name in options.items()]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a drive of a second, its configuration, scenario and tables."""
    folder = tmp_path_factory.mktemp("prepared")
    for name in DBC:
        shutil.copy(ROOT / "dbc" / name, folder)
    car = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc/", "")
    (folder / "car.yaml").write_text(car, encoding="utf-8")
    scenario = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    (folder / "short.yaml").write_text(scenario.replace("duration: 40", "duration: 1"), encoding="utf-8")
    drive = ["-o", str(folder / "drive.log"), "--truth", str(folder / "truth.csv")]
    assert main(["simulate", str(folder / "short.yaml"), str(folder / "car.yaml"), *drive]) == 0
    tracks = ["--tracks", str(folder / "tracks.csv")]
    assert main(["replay", str(folder / "car.yaml"), str(folder / "drive.log"), *tracks]) == 0
    return folder


@pytest.fixture
def folder(prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of that folder, the current one; the experiments of the papers take no time."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "EXPERIMENTS", (invented("000-table-1"),))
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def actions(command: str) -> list[argparse.Action]:
    parser = argparse.ArgumentParser(add_help=False)
    import_module(f"candaemon.cli.{command.replace('-', '_')}").add_arguments(parser)
    return parser._actions


def written_by(command: str, kind: object) -> set[str]:
    """Return the long names of a command's options with a type."""
    return {(action.option_strings or [str(action.metavar)])[-1] for action in actions(command) if action.type is kind}


@pytest.mark.parametrize("command", COMMANDS)
def test_each_path_is_read_or_written_and_each_option_that_writes_is_tested_here(command: str) -> None:
    assert written_by(command, output_path) == OPTIONS.get(command, {}).keys()
    assert {(command, option) for option in written_by(command, output_folder)} == {
        each for each in FOLDERS if each[0] == command
    }
    for action in actions(command):
        if action.type is None and action.nargs != 0 and action.choices is None:
            assert (command, action.metavar) in NO_FILE
        assert action.type not in {Path, str, int, float, open}
        assert not isinstance(action.type, argparse.FileType)  # opened before anything is checked


@pytest.mark.parametrize(("command", "option", "name"), EACH)
def test_an_output_is_replaced_when_it_is_whole_and_keeps_link_and_mode(
    folder: Path, command: str, option: str, name: str
) -> None:
    (folder / "runs").mkdir()
    target = folder / "runs" / f"7-{name}"
    target.write_bytes(b"former")
    target.chmod(0o640)
    (folder / name).symlink_to(target)
    assert main(CASES[command].arguments(option, name)) == 0
    assert (folder / name).is_symlink()
    assert target.read_bytes() not in {b"", b"former"}
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert [each.name for each in target.parent.iterdir()] == [target.name]
    assert not list(folder.glob("*.part"))


@pytest.mark.parametrize(("command", "option", "name"), EACH)
def test_an_output_is_never_what_the_command_reads(
    folder: Path, command: str, option: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, read in enumerate(CASES[command].inputs):
        way = folder / name
        match number % 3:
            case 0:
                way = folder / read
            case 1:
                way.symlink_to(folder / read)
            case _:
                way.hardlink_to(folder / read)
        before = contents(folder)
        assert main(CASES[command].arguments(option, str(way))) == 2, read
        assert "the file is named twice" in capsys.readouterr().err
        assert contents(folder) == before
        (folder / name).unlink(missing_ok=True)


@pytest.mark.parametrize("command", OPTIONS)
def test_no_two_outputs_are_one_file(folder: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(folder)
    for first, second in permutations(OPTIONS[command], 2):
        assert main(CASES[command].arguments(first, "one.log", second, f".{os.sep}one.log")) == 2
        assert "the file is named twice" in capsys.readouterr().err
    assert contents(folder) == before


@pytest.mark.parametrize("command", OPTIONS)
def test_a_mistyped_input_leaves_all_that_is_there(folder: Path, command: str) -> None:
    for name in OPTIONS[command].values():
        (folder / name).write_bytes(b"former")
    before = contents(folder)
    options = [word for pair in OPTIONS[command].items() for word in pair]
    assert main([*CASES[command].missing, *options]) in {1, 2}
    assert contents(folder) == before


@pytest.mark.parametrize(("command", "option", "name"), EACH)
def test_what_cannot_be_written_is_found_before_the_work(
    folder: Path, command: str, option: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "folder").mkdir()
    others = [(other, word) for other, word in OPTIONS[command].items() if other != option]
    for _, word in others:
        (folder / word).write_bytes(b"former")
    before = {each: each.read_bytes() for each in folder.iterdir() if each.is_file()}
    for wrong in (f"no/{name}", f"car.yaml/{name}", "folder"):
        options = [word for pair in [*others, (option, wrong)] for word in pair if word != POSITIONAL]
        assert main([*CASES[command].words, *options]) == 1
        told = capsys.readouterr()
        assert told.out == ""
        assert f"{wrong}: cannot be written" in told.err or f"{wrong}: found the suffix" in told.err
    assert {each: each.read_bytes() for each in folder.iterdir() if each.is_file()} == before


@pytest.mark.parametrize(("command", "option", "name"), EACH)
def test_a_full_disk_leaves_what_is_there_and_nothing_else(
    folder: Path,
    command: str,
    option: str,
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refuse(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", refuse)
    (folder / name).write_bytes(b"former")
    before = contents(folder)
    assert main(CASES[command].arguments(option, name)) == 1
    assert "cannot be written: No space left on device" in capsys.readouterr().err
    assert contents(folder) == before


@pytest.mark.parametrize(("command", "option", "name"), EACH)
def test_an_interruption_leaves_what_is_there_and_names_what_it_has(
    folder: Path,
    command: str,
    option: str,
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sync = os.fsync

    def interrupt(descriptor: int) -> None:
        sync(descriptor)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    (folder / name).write_bytes(b"former")
    before = contents(folder)
    assert main(CASES[command].arguments(option, name)) == 130
    after = contents(folder)
    parts = {each for each in after if each.endswith(outputs.PART)}
    assert f"{name}.part" in parts
    assert {each: content for each, content in after.items() if each not in parts} == before
    told = capsys.readouterr().err
    assert all(f"is in {folder / each}" in told for each in parts)


def test_all_files_are_written_in_one_way() -> None:
    """Whoever opens a file for writing elsewhere has a reason that is told here."""
    reasons = {
        "files/outputs.py": "that way",
        "files/own_folder.py": "a recording, whose files grow",
        "recording/ring.py": "likewise",
        "recording/event_archive.py": "likewise",
        "cli/standard_streams.py": "the null device",
        "wizard/trial.py": "what is tried and thrown away, in a folder of its own",
        "fleet/result_store.py": "the lock of a folder of results, which stays empty",
        "daemon/trial_load.py": "which process the kernel ends first",
    }
    writes = re.compile(r"""open\([^)]*["'](?:[wax][bt]?|r[bt]?\+)\+?["']|write_(text|bytes)\(|O_WRONLY|O_RDWR""")
    package = ROOT / "candaemon"
    found = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if writes.search(path.read_text(encoding="utf-8"))
    }
    assert "files/outputs.py" in found
    assert found <= reasons.keys()
