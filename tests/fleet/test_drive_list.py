"""Which drives are meant: names, folders, patterns, recordings, manifests."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candaemon.errors import ConfigError, InputError
from candaemon.fleet import drive_list
from candaemon.fleet.drive_list import FleetDrive, drives_of
from candaemon.fleet.locations import files_at
from tests.support.fleets import CONFIG


def listed(*logs: Path | str, manifests: tuple[Path, ...] = ()) -> list[FleetDrive]:
    return drives_of([str(log) for log in logs], [str(each) for each in manifests], CONFIG)


def names(*logs: Path | str) -> list[str]:
    return [drive.name for drive in listed(*logs)]


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    for name in ("monday/drive.log", "tuesday/drive.log.gz", "tuesday/other.blf", "notes.txt", "a b/.hidden.log"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"")
    return tmp_path


def test_a_folder_stands_for_its_logs_and_names_tell_them_apart(logs: Path) -> None:
    assert names(logs) == ["_.hidden", "monday-drive", "tuesday-drive", "other"]
    assert names(logs / "monday") == ["drive"]


def test_linked_folders_are_followed_once(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    far = tmp_path_factory.mktemp("far")
    (far / "far.log").write_bytes(b"")
    recording = far / "ring"
    recording.mkdir()
    (recording / "2026-11-21T22-12-52.123Z-000041.log").write_bytes(b"x")
    (far / "back").symlink_to(logs)
    for name in ("another", "linked"):
        (logs / "monday" / name).symlink_to(far)
    assert sorted(names(logs)) == ["_.hidden", "far", "monday-drive", "other", "ring", "tuesday-drive"]
    assert [drive.logs for drive in listed(logs) if drive.name == "monday-drive"] == [(f"{logs}/monday/drive.log",)]


def test_patterns_go_through_folders_and_a_log_named_twice_is_one(logs: Path) -> None:
    assert names(logs / "**" / "*.log*", logs / "monday" / "drive.log") == ["monday-drive", "tuesday-drive"]


def test_a_recording_is_one_drive(tmp_path: Path) -> None:
    folder = tmp_path / "car" / "ring"
    folder.mkdir(parents=True)
    for name in ("2026-11-21T22-12-52.123Z-000041.log", "2026-11-21T22-12-52.123Z-000041.state"):
        (folder / name).write_bytes(b"x")
    (drive,) = listed(tmp_path)
    assert (drive.name, drive.logs) == ("ring", (str(folder),))
    assert [Path(each.location).suffix for each in files_at(drive.logs)] == [".log", ".state"]


def test_a_folder_or_pattern_without_a_log_is_refused(tmp_path: Path) -> None:
    for nothing in (tmp_path, tmp_path / "*.log"):
        with pytest.raises(InputError, match="no log is found"):
            listed(nothing)
    with pytest.raises(ConfigError, match="there is no drive"):
        listed()


MANIFEST = """drive,log,configuration,tags,weather
one,monday/drive.log,,road=town; vehicle=7,rain
,tuesday/drive.log.gz;tuesday/other.blf,demo,,
"""


def test_a_manifest_names_drives_configurations_and_tags(logs: Path) -> None:
    path = logs / "manifest.csv"
    path.write_text(MANIFEST, encoding="utf-8")
    one, two = listed(manifests=(path,))
    assert one.tags == {"road": "town", "vehicle": "7", "weather": "rain"}
    assert (one.name, one.logs, one.configuration) == ("one", (f"{logs}/monday/drive.log",), CONFIG)
    assert (two.name, len(two.logs), two.configuration.name, two.tags) == ("drive", 2, "demo.yaml", {})


def test_a_manifest_may_be_parquet(logs: Path) -> None:
    path = logs / "manifest.parquet"
    pq.write_table(pa.table({"log": ["monday/drive.log"], "drive": ["one"], "year": [2018], "tags": [None]}), path)
    (drive,) = listed(manifests=(path,))
    assert (drive.name, drive.tags) == ("one", {"year": "2018"})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("drive,logs\na,b\n", r":1: .*expected 'log'.*; rename 'logs' to 'log'"),
        ("log,drive\na.log,../up\n", r":2: drive: found '\.\./up'"),
        ("log\n\n ;\n", r":3: 'log' is empty"),
        ("log,tags\na.log,rain\n", ":2: tags: found 'rain'"),
        ("log,tags\na.log\n", ":2: found 1 cells, expected 2"),
        ("log,log\na,b\n", ":1: a column is there twice"),
        ("log\n", "names no drive"),
        ("log,configuration\na.log,none_such\n", ":2: there is no such configuration"),
    ],
)
def test_a_wrong_manifest_is_told_by_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "manifest.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        listed(manifests=(path,))


def test_two_drives_of_one_name_are_refused(logs: Path) -> None:
    path = logs / "manifest.csv"
    path.write_text("drive,log\nother,monday/drive.log\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="two drives are called other; give each a name"):
        listed(logs / "tuesday" / "other.blf", manifests=(path,))


def test_a_manifest_has_a_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "manifest.csv"
    path.write_text("log\na.log\n", encoding="utf-8")
    monkeypatch.setattr(drive_list, "LARGEST_MANIFEST", path.stat().st_size)
    assert len(listed(manifests=(path,))) == 1
    monkeypatch.setattr(drive_list, "LARGEST_MANIFEST", path.stat().st_size - 1)
    with pytest.raises(InputError, match="longer than"):
        listed(manifests=(path,))


def test_a_run_has_so_many_drives(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive_list, "MOST_DRIVES", 4)
    assert len(listed(logs)) == 4
    monkeypatch.setattr(drive_list, "MOST_DRIVES", 3)
    with pytest.raises(ConfigError, match="found 4 drives, expected 3"):
        listed(logs)


def test_a_name_has_a_longest(tmp_path: Path) -> None:
    path = tmp_path / "manifest.csv"
    path.write_text(f"drive,log\n{'x' * drive_list.LONGEST_NAME},a.log\n", encoding="utf-8")
    assert len(listed(manifests=(path,))) == 1
    path.write_text(f"drive,log\n{'x' * (drive_list.LONGEST_NAME + 1)},a.log\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="characters at most"):
        listed(manifests=(path,))
    assert len(names(tmp_path / f"{'y' * (drive_list.LONGEST_NAME + 1)}.log")[0]) == drive_list.LONGEST_NAME
