"""Files are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from candaemon.errors import InputError
from candaemon.files.atomic import atomic_write, check_writable, make_folder


def test_a_file_is_replaced_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    atomic_write(path, "a long first one\n")
    check_writable(path)
    atomic_write(path, "β\n")
    assert path.read_text(encoding="utf-8") == "β\n"
    assert [each.name for each in tmp_path.iterdir()] == ["a.json"]


def test_a_link_goes_on_pointing_to_its_file_which_is_replaced_whole(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    link, target = tmp_path / "latest.json", tmp_path / "runs" / "7.json"
    link.symlink_to(target)
    atomic_write(link, "first")
    opened = target.open(encoding="utf-8")
    atomic_write(link, "second")
    with opened:
        assert opened.read() == "first"  # whoever reads it reads one of the two
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "second"
    assert [each.name for each in target.parent.iterdir()] == ["7.json"]


def test_a_disk_that_fails_leaves_the_former_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    atomic_write(path, "first")

    def fill(part: Path, data: bytes) -> int:
        with part.open("wb") as file:
            file.write(data[:2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill)
    with pytest.raises(InputError, match=r"a\.json: cannot be written: No space left"):
        atomic_write(path, "second")
    assert path.read_text(encoding="utf-8") == "first"
    assert [each.name for each in tmp_path.iterdir()] == ["a.json"]


def test_what_is_no_regular_file_stays_what_it_is(tmp_path: Path) -> None:
    link, target = tmp_path / "link", tmp_path / "target"
    link.symlink_to(target)
    for path in (link, Path(os.devnull)):
        check_writable(path)
        atomic_write(path, "text")
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "text"
    assert Path(os.devnull).is_char_device()


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for path in (tmp_path, tmp_path / "no" / "a.json"):
        for refused in (lambda path: atomic_write(path, ""), check_writable):
            with pytest.raises(InputError, match=f"{path}: cannot be written"):
                refused(path)
    with pytest.raises(InputError, match="file/plots: cannot be written"):
        make_folder(file / "plots")


def test_a_folder_without_the_right_to_write_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _path, _mode: False)  # root has every right
    with pytest.raises(InputError, match="no right to write"):
        make_folder(tmp_path)


def test_a_folder_is_made_with_those_above_it(tmp_path: Path) -> None:
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
