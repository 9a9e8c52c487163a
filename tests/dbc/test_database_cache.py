"""Parsed DBC files in the cache: the same as parsed, and never in the way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from candaemon.dbc import database_cache
from candaemon.dbc.database import load_database, parse_database
from candaemon.dbc.database_cache import MOST_ENTRIES, entry_name, from_plain, load_cached, to_plain
from candaemon.dbc.types import Database
from candaemon.errors import DatabaseError
from candaemon.files.bounded import FileReader
from tests.support.paths import DATA, ROOT

FILES = sorted([*(ROOT / "dbc").glob("*.dbc"), *(DATA / "dbc").glob("toyota*.dbc")])
DBC = ROOT / "dbc" / "oxts.dbc"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Return the files that are parsed from here on."""
    paths: list[Path] = []
    parse = parse_database

    def noted(content: bytes, path: Path) -> Database:
        paths.append(path)
        return parse(content, path)

    monkeypatch.setattr("candaemon.dbc.database.parse_database", noted)  # imported when a file is parsed
    return paths


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_what_comes_back_is_what_was_parsed(path: Path) -> None:
    database = load_database(path)
    assert from_plain(to_plain(database), path) == database


def test_numbers_and_names_of_any_size_come_back(tmp_path: Path) -> None:
    path = tmp_path / "a.dbc"
    path.write_text(
        'BO_ 1 A: 8 B\n SG_ S m1 : 0|64@1- (1e-300,18446744073709551616) [-9e99|0] "\u00b0" B\n'
        ' SG_ M M : 0|1@1+ (1,0) [0|0] "" B\n\nBO_ 2 A: 8 B\nBO_ 1 C: 8 B\n\n'
        f'VAL_ 1 S {"9" * 300} "large" -1 "\\"q\\"" ;\n'
    )
    folder = tmp_path / "cache"
    first, second = load_cached(path, folder=folder), load_cached(path, folder=folder)
    assert first == second == load_database(path)
    assert [str(each) for each in first.warnings] == [str(each) for each in second.warnings]
    assert first.warnings
    signal = second.messages["A"].signal("S")
    assert signal.choices == {int("9" * 300): "large", -1: '"q"'}
    assert signal.multiplexer_ids == {1}


def test_a_file_is_parsed_once_wherever_it_lies(tmp_path: Path, parsed: list[Path]) -> None:
    copy, folder = tmp_path / "copy.dbc", tmp_path / "cache"
    copy.write_bytes(DBC.read_bytes())
    load_cached(DBC, folder=folder)
    moved = load_cached(copy, folder=folder)
    assert parsed == [DBC]
    assert moved.path == copy
    assert all(message.file == copy for message in moved.messages.values())
    copy.write_bytes(DBC.read_bytes() + b"\n")
    load_cached(copy, folder=folder)
    assert parsed == [DBC, copy]


@pytest.mark.parametrize("damage", [b"", b"x", b"\0" * 400], ids=["empty", "a byte", "zeros"])
def test_a_damaged_entry_is_parsed_anew(tmp_path: Path, parsed: list[Path], damage: bytes) -> None:
    folder = tmp_path / "cache"
    expected = load_cached(DBC, folder=folder)
    (entry,) = folder.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(damage or whole[:-1])
    assert load_cached(DBC, folder=folder) == expected
    assert len(parsed) == 2
    assert entry.read_bytes() == whole


def test_another_version_parses_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    before = entry_name(b"content")
    monkeypatch.setattr(database_cache, "__version__", "0.0.0")
    assert entry_name(b"content") != before != entry_name(b"contents")


def test_a_folder_of_others_or_none_is_not_used(tmp_path: Path, parsed: list[Path]) -> None:
    shared, file = tmp_path / "shared", tmp_path / "file"
    shared.mkdir()
    shared.chmod(0o777)
    file.touch()
    for folder in (shared, file, file / "below"):
        assert load_cached(DBC, folder=folder).messages
    assert len(parsed) == 3
    assert not list(shared.iterdir())


def test_a_link_in_the_folder_is_not_followed(tmp_path: Path, parsed: list[Path]) -> None:
    folder, elsewhere = tmp_path / "cache", tmp_path / "elsewhere"
    load_cached(DBC, folder=folder)
    (entry,) = folder.iterdir()
    entry.rename(elsewhere)
    entry.symlink_to(elsewhere)
    load_cached(DBC, folder=folder)
    assert len(parsed) == 2
    assert not entry.is_symlink()


def test_an_entry_may_have_so_many_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parsed: list[Path]) -> None:
    load_cached(DBC, folder=tmp_path / "first")
    (entry,) = (tmp_path / "first").iterdir()
    size = len(entry.read_bytes()) - 32
    for most, kept in ((size, 1), (size - 1, 0)):
        monkeypatch.setattr(database_cache, "LONGEST_ENTRY", most)
        folder = tmp_path / str(most)
        assert load_cached(DBC, folder=folder) == load_cached(DBC, folder=folder)
        assert len(list(folder.iterdir())) == kept
    assert len(parsed) == 1 + 1 + 2


def test_a_folder_may_have_so_many_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_cache, "MOST_ENTRIES", 2)
    assert MOST_ENTRIES > 2
    folder = tmp_path / "cache"
    names = []
    for number in range(3):
        path = tmp_path / f"{number}.dbc"
        path.write_text(f'BO_ {number} A: 8 B\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n')
        load_cached(path, folder=folder)
        names.append(entry_name(path.read_bytes()))
        os.utime(folder / names[-1], ns=(number, number))
    assert {entry.name for entry in folder.iterdir()} == set(names[1:])


def test_what_cannot_be_read_says_so_with_a_cache_too(tmp_path: Path) -> None:
    def fails(_path: Path, _longest: int) -> bytes:
        raise OSError(5, "no medium")

    reader: FileReader = fails
    with pytest.raises(DatabaseError, match="no medium"):
        load_cached(tmp_path / "a.dbc", reader, tmp_path / "cache")


def test_a_hit_imports_neither_the_parser_nor_python_can(tmp_path: Path) -> None:
    script = (
        "import sys; from candaemon.cli.main import main; code = main(sys.argv[1:]); "
        "print(code, sorted({'cantools', 'can'} & set(sys.modules)), file=sys.stderr)"
    )
    command = [sys.executable, "-c", script, "check", str(ROOT / "config" / "esr_ins.yaml")]
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    assert "cantools" in runs[0].stderr.splitlines()[-1]
    assert runs[1].stderr.splitlines()[-1] == "0 []"
    assert runs[0].stdout == runs[1].stdout
