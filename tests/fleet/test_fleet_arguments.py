"""The arguments of `candaemon fleet`, and what it says where it cannot begin."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from candaemon.cli.fleet import MOST_PERCENT, MOST_WORKERS
from candaemon.cli.main import main


def refused(*words: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["fleet", *words])
    return int(stop.value.code or 0)


def test_a_run_has_so_many_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nothing = ["run", "esr_ins", str(tmp_path), "-o", str(tmp_path / "out"), "--workers"]
    assert main(["fleet", *nothing, str(MOST_WORKERS)]) == 1  # no log is there
    assert refused(*nothing, str(MOST_WORKERS + 1)) == 2
    assert refused(*nothing, "0") == 2
    assert f"from 1 to {MOST_WORKERS}" in capsys.readouterr().err


def test_a_percentage_has_a_largest(tmp_path: Path) -> None:
    runs = ["compare", str(tmp_path), str(tmp_path), "--least"]
    assert main(["fleet", *runs, f"{MOST_PERCENT:g}"]) == 1  # no drive is there
    assert refused(*runs, f"{MOST_PERCENT + 1:g}") == 2


@pytest.mark.parametrize("words", [["compare", "a", "b", "--fail-on", "weather"], ["run", "esr_ins"], []])
def test_wrong_usage_is_refused(words: list[str]) -> None:
    assert refused(*words) == 2


def test_processes_here_and_a_scheduler_exclude_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "esr_ins", str(tmp_path), "-o", "out", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"]
    assert main(["fleet", *words]) == 2
    assert "--workers and --memory" in capsys.readouterr().err


def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.log").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "pyarrow", None)
        assert main(["fleet", "run", "esr_ins", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
        assert "a run of a fleet needs pyarrow" in capsys.readouterr().err
    assert main(["fleet", "run", "esr_ins", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "pip install 'candaemon[fleet]'" in capsys.readouterr().err
    assert main(["fleet", "run", "esr_ins", "s3://bucket/a.log", "-o", str(tmp_path / "out")]) == 2
    assert "pip install 'candaemon[fleet]'" in capsys.readouterr().err


def test_an_unknown_kind_of_location_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "run", "esr_ins", "nowhere://a/*.log", "-o", str(tmp_path / "out")]) == 2
    assert "nowhere" in capsys.readouterr().err
