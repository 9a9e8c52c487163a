"""Checked configurations in the cache: the same as checked, and never in the way."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from candaemon.config import load, settings_cache
from candaemon.config.load import load_config
from candaemon.config.settings import Config
from candaemon.config.settings_cache import MOST_ENTRIES, entry_name, from_plain, to_plain
from candaemon.config.yaml_text import parse_yaml, read_yaml
from candaemon.errors import ConfigError
from tests.support.paths import ROOT

SHIPPED = sorted((ROOT / "config").glob("*.yaml"))
YAML = ROOT / "config" / "esr_ins.yaml"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where the entries of this test are."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "candaemon" / "config"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Return the files that are parsed from here on."""
    paths: list[Path] = []

    def noted(text: str, path: Path) -> Any:
        paths.append(path)
        return parse_yaml(text, path)

    monkeypatch.setattr("candaemon.config.yaml_text.parse_yaml", noted)  # imported when a file is parsed
    return paths


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_comes_back_is_what_was_checked(path: Path) -> None:
    checked = Config.model_validate(read_yaml(path)[0], strict=True)
    back = from_plain(json.loads(json.dumps(to_plain(checked))))
    assert back == checked
    assert repr(back) == repr(checked)  # the order of keys, 1 and 1.0
    assert to_plain(back) == to_plain(checked)  # what was given, and what are defaults
    assert back.dumped() == checked.model_dump(mode="json", by_alias=True)


def test_a_file_is_checked_once_wherever_it_lies(tmp_path: Path, folder: Path, parsed: list[Path]) -> None:
    copy = tmp_path / "copy.yaml"
    copy.write_bytes(YAML.read_bytes())
    first, second = load_config(YAML), load_config(copy)
    assert parsed == [YAML]
    assert second.config == first.config
    assert second.lines == first.lines
    assert second.path == copy
    assert second.line_of(("sensors", "front", "mount")) > 1
    assert len(list(folder.iterdir())) == 1
    copy.write_bytes(YAML.read_bytes() + b"\n")
    load_config(copy)
    assert parsed == [YAML, copy]


@pytest.mark.usefixtures("folder")
def test_what_is_wrong_is_told_each_time_with_its_line(tmp_path: Path, parsed: list[Path]) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(YAML.read_text(encoding="utf-8").replace("\nsensors:", "\nsensor:"), encoding="utf-8")
    told = []
    for _ in range(2):
        with pytest.raises(ConfigError) as refused:
            load_config(path)
        told.append(str(refused.value))
    assert told[0] == told[1]
    assert "wrong.yaml:" in told[0]
    assert parsed == [path, path]


@pytest.mark.parametrize("damage", [b"", b"x", b"\0" * 400], ids=["a byte less", "a byte", "zeros"])
def test_a_damaged_entry_is_checked_anew(folder: Path, parsed: list[Path], damage: bytes) -> None:
    expected = load_config(YAML)
    (entry,) = folder.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(damage or whole[:-1])
    again = load_config(YAML)
    assert (again.config, again.lines) == (expected.config, expected.lines)
    assert len(parsed) == 2
    assert entry.read_bytes() == whole


def test_another_version_or_other_modules_check_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [entry_name("text"), entry_name("texts")]
    for of, other in (("__version__", "0.0.0"), ("_sources", lambda: "other"), ("_FORM", "0")):
        with monkeypatch.context() as patch:
            patch.setattr(settings_cache, of, other)
            names.append(entry_name("text"))
    assert len({*names}) == 5
    assert entry_name("text") == names[0]


def test_without_a_folder_every_file_is_checked(monkeypatch: pytest.MonkeyPatch, parsed: list[Path]) -> None:
    monkeypatch.setattr(load, "cache_folder", lambda _kind: None)
    assert load_config(YAML).config == load_config(YAML).config
    assert len(parsed) == 2


def test_an_entry_may_have_so_many_bytes(folder: Path, monkeypatch: pytest.MonkeyPatch, parsed: list[Path]) -> None:
    load_config(YAML)
    (entry,) = folder.iterdir()
    size = len(entry.read_bytes()) - 32
    for most, kept in ((size, 1), (size - 1, 0)):
        monkeypatch.setattr(settings_cache, "LONGEST_ENTRY", most)
        entry.unlink(missing_ok=True)
        assert load_config(YAML).config == load_config(YAML).config
        assert len(list(folder.iterdir())) == kept
    assert len(parsed) == 1 + 1 + 2


def test_a_folder_may_have_so_many_entries(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settings_cache, "MOST_ENTRIES", 2)
    assert MOST_ENTRIES > 2
    names = []
    for number in range(3):
        path = tmp_path / f"{number}.yaml"
        text = YAML.read_text(encoding="utf-8") + f"# {number}\n"
        path.write_text(text, encoding="utf-8")
        load_config(path)
        names.append(entry_name(text))
        os.utime(folder / names[-1], ns=(number, number))
    assert {entry.name for entry in folder.iterdir()} == set(names[1:])


def test_a_hit_imports_no_parser_and_says_the_same(tmp_path: Path) -> None:
    script = (
        "import sys; from candaemon.cli.main import main; code = main(sys.argv[1:]); "
        "print(code, sorted({'yaml'} & set(sys.modules)), file=sys.stderr)"
    )
    command = [sys.executable, "-c", script, "check", str(YAML)]
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    assert [run.stderr.splitlines()[-1] for run in runs] == ["0 ['yaml']", "0 []"]
    assert runs[0].stdout == runs[1].stdout
