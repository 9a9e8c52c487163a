"""A run without Dask: the bytes of `replay`, going on where it was, and failures that cost nobody else."""

from __future__ import annotations

import json
import os
import resource
import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from candaemon.cli.main import main
from candaemon.errors import InputError
from candaemon.fleet import drive_task, result_store
from candaemon.fleet.dataset import ReplayOptions, records_in, table_file, table_files
from candaemon.fleet.drive_task import DriveOrder, replayed_into
from candaemon.fleet.fleet_figures import load_figures
from candaemon.fleet.fleet_page import report_of
from candaemon.fleet.kept_configuration import MOST_BOUND, kept_binding
from candaemon.fleet.result_store import FolderStore, store_at
from tests.support.fleets import CONFIG, Inline, run_inline, short_drives, simulated, tables


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    return short_drives(folder / "logs", 3, simulated(folder))


@pytest.fixture(scope="module")
def whole(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a run in which nothing went wrong."""
    folder = tmp_path_factory.mktemp("whole") / "results"
    assert run_inline(logs, folder).computed == 3
    return folder


@pytest.fixture
def results(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "results"))


def test_each_result_is_that_of_replay_alone(logs: list[Path], whole: Path, tmp_path: Path) -> None:
    for log in logs[:2]:
        assert main(["replay", str(CONFIG), str(log), "--parquet", str(tmp_path / log.stem)]) == 0
        for table, name in table_files(log.stem).items():
            assert (whole / name).read_bytes() == (tmp_path / log.stem / f"{table}.parquet").read_bytes()


def test_what_is_there_is_not_computed_again(logs: list[Path], results: Path) -> None:
    again = run_inline(logs, results)
    assert (again.kept, again.computed) == (3, 0)
    os.utime(logs[0])  # another stamp, the same content
    workers = Inline()
    again = run_inline(logs, results, workers=workers)
    assert (again.kept, again.computed, again.failed) == (3, 0, {})
    assert records_in(store_at(str(results)))["d000"].inputs[0]["stamp"].endswith(str(logs[0].stat().st_mtime_ns))


def test_a_drive_whose_log_or_results_changed_is_computed(
    logs: list[Path], whole: Path, results: Path, tmp_path: Path
) -> None:
    shutil.rmtree(results / "tracks" / "drive=d001")
    (results / "records" / "d002.json").write_text("{", encoding="utf-8")
    again = run_inline(logs, results)
    assert (again.kept, again.computed) == (1, 2)
    assert tables(results) == tables(whole)
    log = tmp_path / "d000.log"
    log.write_bytes(logs[0].read_bytes()[:-200])
    assert run_inline([log], results).computed == 1
    assert tables(results) != tables(whole)


def test_a_log_that_changes_while_it_is_computed_is_set_aside(
    logs: list[Path], whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, results = tmp_path / "d000.log", tmp_path / "results"
    shutil.copy(logs[0], log)

    def changed(folder: Path, order: DriveOrder, paths: Sequence[Path]) -> dict[str, Any]:
        log.write_bytes(log.read_bytes()[:-200])
        return replayed_into(folder, order, paths)

    with monkeypatch.context() as patch:
        patch.setattr(drive_task, "replayed_into", changed)
        ended = run_inline([log], results)
    assert (ended.computed, ended.failed) == (
        0,
        {"d000": f"{log}: it changed while it was read; wait until it is written, and run again"},
    )
    assert not tables(results)
    shutil.copy(logs[0], log)
    assert run_inline([log], results).computed == 1
    assert tables(results).items() <= tables(whole).items()


def test_a_kept_configuration_that_was_edited_is_written_again(logs: list[Path], results: Path) -> None:
    (kept,) = results.glob("configurations/*/config/*.yaml")
    text = kept.read_text(encoding="utf-8")
    assert "noise: {range: 0.25" in text
    kept.write_text(text.replace("noise: {range: 0.25", "noise: {range: 0.95"), encoding="utf-8")
    run_inline(logs, results)
    assert kept.read_text(encoding="utf-8") == text


def test_another_configuration_is_computed_anew(logs: list[Path], results: Path, tmp_path: Path) -> None:
    text = CONFIG.read_text(encoding="utf-8").replace("../dbc", str(CONFIG.parents[1] / "dbc"))
    other = tmp_path / "other.yaml"
    other.write_text(text, encoding="utf-8")
    assert run_inline(logs[:1], results, other).computed == 1


def test_a_stopped_run_goes_on_to_the_same_dataset(logs: list[Path], whole: Path, tmp_path: Path) -> None:
    class Stopped(Inline):
        def outcomes(self, orders, *, alone=False):  # type: ignore[no-untyped-def]
            yield next(super().outcomes(orders, alone=alone))
            raise KeyboardInterrupt

    results = tmp_path / "results"
    with pytest.raises(KeyboardInterrupt):
        run_inline(logs, results, workers=Stopped())
    assert len(tables(results)) == 4
    again = run_inline(logs, results)
    assert (again.kept, again.computed) == (1, 2)
    assert tables(results) == tables(whole)


def test_a_failed_drive_is_tried_again_and_set_aside(logs: list[Path], whole: Path, tmp_path: Path) -> None:
    damaged, pipe, bomb = tmp_path / "damaged.log", tmp_path / "pipe.log", tmp_path / "bomb.log.gz"
    damaged.write_bytes(os.urandom(5000))
    bomb.write_bytes(b"\x1f\x8b" + os.urandom(5000))
    os.mkfifo(pipe)
    results, workers = tmp_path / "results", Inline()
    ended = run_inline([*logs, damaged, pipe, bomb, tmp_path / "missing.log"], results, workers=workers)
    assert (ended.computed, sorted(ended.failed)) == (3, ["bomb", "damaged", "missing", "pipe"])
    assert sorted(workers.alone) == sorted(ended.failed)
    assert "there is no such log" in ended.failed["missing"]
    assert "it is no regular file" in ended.failed["pipe"]
    assert tables(results) == tables(whole)
    told = json.loads((results / "failed" / "missing.json").read_text(encoding="utf-8"))
    assert told["reason"] == ended.failed["missing"]
    shutil.copy(logs[0], tmp_path / "missing.log")
    mended = run_inline([tmp_path / "missing.log"], results)
    assert (mended.computed, mended.failed) == (1, {})
    assert not (results / "failed" / "missing.json").exists()


def test_a_full_disk_costs_no_result_that_is_there(logs: list[Path], whole: Path, results: Path) -> None:
    shutil.rmtree(results / "tracks" / "drive=d001")
    before = tables(results)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        ended = run_inline(logs, results)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (ended.kept, ended.computed) == (2, 0)
    assert "too large" in ended.failed["d001"]
    assert tables(results) == before
    assert not list((results / ".incoming").iterdir())
    assert run_inline(logs, results).computed == 1
    assert tables(results) == tables(whole)


def test_results_on_another_file_system_are_the_same(logs: list[Path], whole: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    for log in logs:
        memory.pipe_file(f"/logs/{log.name}", log.read_bytes())
    assert run_inline(["memory://logs/*.log"], "memory://results").computed == 3
    found = {name: memory.cat_file(f"/results/{name}") for name in tables(whole)}
    assert found == tables(whole)
    assert run_inline(["memory://logs"], "memory://results").kept == 3
    there = load_figures("memory://results").drives.values()
    assert [each.values for each in there] == [each.values for each in load_figures(str(whole)).drives.values()]
    assert not [name for name in memory.find("/results") if name.endswith(".part")]


def test_drives_of_former_runs_are_told(logs: list[Path], results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As those of logs that are gone, and of those that failed: reports go on counting them."""
    (results / "failed").mkdir()
    (results / "failed" / "gone.json").write_text("{}", encoding="utf-8")
    assert main(["fleet", "run", str(CONFIG), str(logs[1]), "-o", str(results)]) == 0
    told = capsys.readouterr().err
    assert f"warning: {results} holds drives of former runs too" in told
    assert "d000, d002, gone; to be rid of one, remove records/NAME.json" in told
    (results / "failed" / "gone.json").unlink()
    assert run_inline(logs, results).others == ()


def test_lost_or_refused_is_what_came_and_was_of_no_use(logs: list[Path], whole: Path, tmp_path: Path) -> None:
    """A short frame counts once, though its scan misses it; error frames are no losses."""
    assert {each.values["losses"] for each in load_figures(str(whole)).drives.values()} == {0.0}
    lines = logs[0].read_text(encoding="ascii").splitlines(keepends=True)
    number = next(number for number, line in enumerate(lines) if " can1 " in line)
    time = lines[number].partition(" ")[0]
    lines[number] = f"{lines[number].partition('#')[0]}#00\n"
    log = tmp_path / "short.log"
    log.write_text("".join([*lines, f"{time} can1 20000004#0004000000000000\n"]), encoding="ascii")
    assert run_inline([log], tmp_path / "results").computed == 1
    (drive,) = load_figures(str(tmp_path / "results")).drives.values()
    assert drive.values["losses"] == pytest.approx(1e3 / len(lines))


def test_a_drive_whose_tables_are_gone_counts_as_failed(
    whole: Path, results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gone, short = (table_file(*each) for each in (("summaries", "d001"), ("cycles", "d002")))
    (results / gone).unlink()
    (results / short).write_bytes((results / short).read_bytes()[:-1])
    found = load_figures(str(results))
    assert list(found.drives) == ["d000"]
    assert found.incomplete == ("d001", "d002")
    assert found.failed == {"d001": f"{gone}: missing or damaged since its run", "d002": found.failed["d002"]}
    assert main(["fleet", "compare", str(whole), str(results), "--fail-on", "missing"]) == 1
    out, err = capsys.readouterr()
    assert "1 drives the same to the byte" in out
    assert f"warning: drives d001, d002 of {results} count as failed" in err


def test_a_folder_may_be_called_as_one_of_a_drive(whole: Path, tmp_path: Path) -> None:
    called = Path(shutil.copytree(whole, tmp_path / "drive=k"))
    assert load_figures(str(called)) == load_figures(str(whole))
    assert report_of(load_figures(str(called)), store_at(str(called))).moments


@pytest.mark.parametrize("table", ["summaries", "cycles"])
def test_a_table_that_cannot_be_read_is_named(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str
) -> None:
    path = results / table_file(table, "d001")
    path.write_bytes(path.read_bytes()[:-4] + b"none")
    page = tmp_path / "page.html"
    assert main(["fleet", "report", str(results), "-o", str(page)]) == 1
    told = capsys.readouterr().err
    assert f"{path}: cannot be read" in told
    assert "remove it, and run the same 'fleet run' again" in told
    assert not page.exists()


@pytest.mark.parametrize("options", [{}, {"channels": 5}, 5, None])
def test_a_record_with_other_options_is_none(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: object
) -> None:
    path = results / "records" / "d001.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"options": options}))
    assert main(["fleet", "report", str(results), "-o", str(tmp_path / "page.html")]) == 1
    assert "it is no record of a drive; remove it" in capsys.readouterr().err


def test_a_report_replaces_nothing_that_it_reads(results: Path) -> None:
    before = {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    for name in ("records/d000.json", table_file("cycles", "d001")):
        assert main(["fleet", "report", str(results), "-o", str(results / name)]) == 2
    assert before == {path: path.read_bytes() for path in results.rglob("*") if path.is_file()}
    for _ in range(2):
        assert main(["fleet", "report", str(results), "-o", str(results / "report.html")]) == 0


def test_the_command_of_a_moment_replays_it_as_the_run_did(logs: list[Path], tmp_path: Path) -> None:
    """Its channels are those of the run's --map, and its range is by the log's clock."""
    parquet = pytest.importorskip("pyarrow.parquet")
    log, results = tmp_path / "drive.log", tmp_path / "results"
    log.write_text(logs[2].read_text(encoding="ascii").replace(" can1 ", " can9 "), encoding="ascii")
    assert run_inline([log], results, options=ReplayOptions({"can9": "radar"})).computed == 1
    found = report_of(load_figures(str(results)), store_at(str(results)))
    (moment,) = found.moments
    cycles = parquet.read_table(results / table_file("cycles", "drive")).to_pylist()
    worst = max((each for each in cycles if each["nis"]), key=lambda each: float(each["nis"] / each["nis_expected"]))
    command = shlex.split(moment.replay)
    begin, end = (command[command.index(option) + 1] for option in ("--from", "--to"))
    assert float(begin.removeprefix("@")) == pytest.approx(worst["time"] - 2.0, abs=0.006)
    assert float(end.removeprefix("@")) == pytest.approx(worst["time"] + 2.0, abs=0.006)
    assert main(command[1:]) == 0
    assert all("--map can9=radar" in each for each in (moment.view, *(drive.view for drive in found.worst)))


def test_two_runs_do_not_write_to_one_folder(tmp_path: Path) -> None:
    store = store_at(str(tmp_path))
    with store.exclusive(), pytest.raises(InputError, match="another run writes here"), store.exclusive():
        pass


def test_what_a_broken_attempt_left_is_removed(tmp_path: Path) -> None:
    left = tmp_path / ".incoming" / "0" / "tracks.parquet.part"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half")
    store = store_at(str(tmp_path))
    assert store.sizes() == {}
    with store.exclusive():
        assert not left.exists()


def test_a_result_that_is_read_has_a_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = FolderStore(str(tmp_path))
    store.write("records/a.json", b"1234")
    monkeypatch.setattr(result_store, "LARGEST_RESULT", 4)
    assert store.read("records/a.json") == b"1234"
    monkeypatch.setattr(result_store, "LARGEST_RESULT", 3)
    with pytest.raises(InputError, match="longer than 3 bytes"):
        store.read("records/a.json")


def test_a_worker_keeps_so_many_configurations() -> None:
    assert kept_binding.cache_parameters()["maxsize"] == MOST_BOUND


def test_a_log_whose_name_is_not_utf_8_costs_no_other_drive(logs: list[Path], whole: Path, tmp_path: Path) -> None:
    odd = tmp_path / os.fsdecode(b"bad\xff.log")
    shutil.copy(logs[0], odd)
    results = tmp_path / "results"
    ended = run_inline([odd, *logs], results)
    assert (ended.computed, list(ended.failed)) == (3, ["bad_"])
    assert "its name is not UTF-8" in ended.failed["bad_"]
    assert tables(results) == tables(whole)
    assert json.loads((results / "failed" / "bad_.json").read_text(encoding="utf-8"))["logs"] == [
        f"{tmp_path}/bad\\udcff.log"
    ]


def test_results_and_configurations_whose_names_are_not_utf_8_are_refused(logs: list[Path], tmp_path: Path) -> None:
    """DuckDB finds no table there, and a record could not name the configuration."""
    odd = tmp_path / os.fsdecode(b"r\xff")
    with pytest.raises(InputError, match="its name is not UTF-8"):
        run_inline(logs, odd)
    with pytest.raises(InputError, match="its name is not UTF-8"):
        load_figures(str(odd))
    assert not odd.exists()
    with pytest.raises(InputError, match="its name is not UTF-8"):
        run_inline(logs, tmp_path / "results", odd / "esr_ins.yaml")
