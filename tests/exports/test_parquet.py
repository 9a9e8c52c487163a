"""A drive in Parquet: the rows of the CSV tables, read by pyarrow and by DuckDB, with units in the schema."""

from __future__ import annotations

import csv
import json
import sys
from collections import Counter
from pathlib import Path

import duckdb
import numpy as np
import pyarrow.parquet as pq
import pytest

from candaemon.cli.main import main
from candaemon.evaluation.tables import parse_time
from candaemon.exports.drive_tables import CYCLES, DETECTIONS, SUMMARIES, TABLES, TRACKS, UNKNOWN
from candaemon.exports.parquet import ROWS_A_GROUP, ParquetTable
from candaemon.files.outputs import OutputFile
from tests.project.pages import PAGES
from tests.support.paths import ROOT

SHORT = "duration: 4\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}}]\n"
RECORDED = ROOT.parent / "shared" / "data" / "rav4_drive" / "drive_with_ins.log.gz"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a short drive, replayed into tables of both kinds."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "short.yaml").write_text(SHORT, encoding="utf-8")
    log = str(folder / "drive.log")
    assert main(["simulate", str(folder / "short.yaml"), "esr_ins", "-o", log]) == 0
    assert main(["replay", "esr_ins", log, *outputs(folder)]) == 0
    return folder


def outputs(folder: Path) -> list[str]:
    return [
        "--tracks",
        str(folder / "tracks.csv"),
        "--parquet",
        str(folder / "tables"),
        "--summary",
        str(folder / "summary.json"),
    ]


def asked(query: str) -> tuple[float, ...]:
    """Return the one row that DuckDB answers."""
    (row,) = duckdb.connect().execute(query).fetchall()
    return tuple(map(float, row))


def same_as_csv(folder: Path) -> int:
    """Hold that the tracks in Parquet are those in CSV, as DuckDB and as pyarrow read them; return the rows."""
    with (folder / "tracks.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    table = pq.read_table(folder / "tables" / "tracks.parquet")
    assert table.column_names == [column.name for column in TRACKS.columns]
    assert table["time_ns"].to_pylist() == [parse_time(row["time"]) for row in rows]
    for column in (each for each in TRACKS.columns if each.name in rows[0]):
        texts, values = [row[column.name] for row in rows], table[column.name].to_pylist()
        match column.kind:
            case "number" if column.name == "time":
                assert values == pytest.approx([float(text) for text in texts], abs=1e-6)
            case "number":
                assert [value is None for value in values] == [not text for text in texts], column.name
                found, wanted = np.array(values, np.float64), np.array([float(text or "nan") for text in texts])
                decimals = 9 if column.unit == "deg" else 4
                assert not (np.abs(found - wanted) > 0.51 * 10**-decimals).any(), column.name
            case _:
                assert list(map(str, values)) == texts, column.name
    joined = (
        f"from '{folder}/tables/tracks.parquet' p join read_csv('{folder}/tracks.csv') c "
        "on p.id = c.id and abs(p.time - c.time) < 1e-5"
    )
    assert asked(f"select count(*), sum(abs(p.x - c.x) > 6e-5), sum(p.state <> c.state) {joined}") == (len(rows), 0, 0)
    return len(rows)


def test_tracks_are_those_of_the_csv(drive: Path) -> None:
    assert same_as_csv(drive) > 50


def test_a_table_of_tracks_is_parquet_by_its_name(drive: Path) -> None:
    whole = drive / "other.parquet"
    assert main(["replay", "esr_ins", str(drive / "drive.log"), "--tracks", str(whole)]) == 0
    assert whole.read_bytes() == (drive / "tables" / "tracks.parquet").read_bytes()


@pytest.mark.slow
def test_smoothing_is_that_of_the_csv(drive: Path, tmp_path: Path) -> None:
    assert main(["replay", "esr_ins", str(drive / "drive.log"), "--smooth", "0.5", *outputs(tmp_path)]) == 0
    assert same_as_csv(tmp_path) > 50
    smoothed = pq.read_table(tmp_path / "tables" / "tracks.parquet")["x"]
    assert smoothed != pq.read_table(drive / "tables" / "tracks.parquet")["x"]


def test_detections_add_up_to_the_summary(drive: Path) -> None:
    figures = json.loads((drive / "summary.json").read_text(encoding="utf-8"))
    table = pq.read_table(drive / "tables" / "detections.parquet")
    fates = Counter(table["fate"].to_pylist())
    assert table.num_rows == figures["tracks"]["detections"]
    assert fates["updated"] + fates["initiated"] == figures["tracks"]["used"]
    nis = table["nis"].drop_null().to_numpy()
    assert len(nis) == fates["updated"] == figures["nis"]["samples"]
    assert nis.mean() == pytest.approx(figures["nis"]["mean"], abs=1e-6)
    assert table["id"].null_count == fates["unused"]


def test_a_detection_is_where_its_obstacle_is(drive: Path) -> None:
    tables = f"'{drive}/tables/detections.parquet' d join '{drive}/tables/tracks.parquet' t using (time_ns, id)"
    along, across, rows = asked(
        f"select max(abs(d.x - t.x)), max(abs(d.y - t.y)), count(*) from {tables} where t.state = 'confirmed'"  # noqa: S608
    )
    assert along < 4
    assert across < 4
    assert rows > 50


def test_cycles_add_up_to_the_summary(drive: Path) -> None:
    figures = json.loads((drive / "summary.json").read_text(encoding="utf-8"))
    cycles = pq.read_table(drive / "tables" / "cycles.parquet")
    assert cycles.num_rows == figures["cycles"]["told"]
    assert cycles["detections"].drop_null().to_numpy().sum() == figures["tracks"]["detections"]
    assert cycles["frames"].to_numpy().sum() == figures["output"]["frames"]
    states = np.sum([cycles[name].to_numpy() for name in ("tentative", "confirmed", "coasting")])
    assert states == pq.read_metadata(drive / "tables" / "tracks.parquet").num_rows
    assert cycles["speed"].drop_null().to_numpy() == pytest.approx(20.0, abs=0.5)


def test_summaries_hold_every_figure(drive: Path) -> None:
    figures = json.loads((drive / "summary.json").read_text(encoding="utf-8"))
    rows = pq.read_table(drive / "tables" / "summaries.parquet").to_pylist()
    found = {row["key"]: row["value"] for row in rows}
    assert found["nis.mean"] == figures["nis"]["mean"]
    assert found["predictions.1.x"] == figures["predictions"][1]["x"]
    assert found["sensors.front.scans"] == figures["sensors"]["front"]["scans"]
    assert len(found) == len(rows)


@pytest.mark.parametrize("form", TABLES.values(), ids=TABLES)
def test_the_schema_says_unit_and_meaning(form: object, drive: Path) -> None:
    (table,) = [each for each in (TRACKS, DETECTIONS, CYCLES, SUMMARIES) if each is form]
    schema = pq.read_schema(drive / "tables" / f"{table.name}.parquet")
    assert schema.metadata is not None
    assert schema.metadata[b"row"].decode() == table.row
    for column in table.columns:
        metadata = schema.field(column.name).metadata or {}
        assert metadata[b"unit"].decode() == column.unit
        assert metadata[b"description"].decode() == column.meaning
    page = PAGES["docs/exports.md"].text
    for column in table.columns:
        assert f"| `{column.name}` | {column.unit or '—'} | {column.meaning} |" in page, column.name


def test_the_same_drive_gives_the_same_bytes(drive: Path, tmp_path: Path) -> None:
    assert main(["replay", "esr_ins", str(drive / "drive.log"), *outputs(tmp_path)]) == 0
    for form in TABLES.values():
        first, second = (folder / "tables" / f"{form.name}.parquet" for folder in (drive, tmp_path))
        assert first.read_bytes() == second.read_bytes(), form.name


def test_rows_are_written_in_groups_of_a_size(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with OutputFile(path) as file, ParquetTable(file, CYCLES) as table:
        for _ in range(2):
            table.add(ROWS_A_GROUP - 1, {"time_ns": 5, "sensor": "front"})
            table.add(1, {"time_ns": 6})
        table.add(3, {"time_ns": 7})
    groups = pq.read_metadata(path)
    assert [groups.row_group(k).num_rows for k in range(groups.num_row_groups)] == [ROWS_A_GROUP, ROWS_A_GROUP, 3]


def test_what_is_unknown_is_null_and_what_is_the_same_everywhere_is_a_column(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with OutputFile(path) as file, ParquetTable(file, DETECTIONS, {"drive": "monday"}) as table:
        table.add(
            2,
            {
                "x": np.array([1.0, np.nan]),
                "id": np.array([UNKNOWN, 7]),
                "fate": np.array([2, 0], np.int8),
                "sensor": "rear",
                "new": np.array([True, False]),
            },
        )
        table.add(1, {"y": [np.inf], "fate": ["initiated"]})
    rows = pq.read_table(path).to_pylist()
    assert [row["drive"] for row in rows] == ["monday"] * 3
    assert [row["x"] for row in rows] == [1.0, None, None]
    assert [row["id"] for row in rows] == [None, 7, None]
    assert [row["fate"] for row in rows] == ["unused", "updated", "initiated"]
    assert [row["new"] for row in rows] == [True, False, None]
    assert [row["y"] for row in rows] == [None, None, None]


def test_columns_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with OutputFile(tmp_path / "t.parquet") as file, ParquetTable(file, CYCLES) as table:
        with pytest.raises(ValueError, match="no such columns"):
            table.add(1, {"colour": "red"})
        with pytest.raises(ValueError, match="2 values of east, expected 3"):
            table.add(3, {"east": [1.0, 2.0]})


def test_a_missing_library_is_named_with_its_extra(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["replay", "esr_ins", str(drive / "drive.log"), "--tracks", str(tmp_path / "t.parquet")]) == 2
    assert "pip install 'candaemon[parquet]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_log_without_a_usable_frame_leaves_no_table(tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_text("(1.000000) can0 123#00\n", encoding="utf-8")
    assert main(["replay", "esr_ins", str(tmp_path / "drive.log"), "--parquet", str(tmp_path / "tables")]) == 1
    assert not list((tmp_path / "tables").iterdir())


@pytest.mark.slow
@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded drive is not there")
def test_the_recorded_drive_is_that_of_the_csv(tmp_path: Path) -> None:
    assert main(["replay", "toyota_rav4_ins", str(RECORDED), *outputs(tmp_path)]) == 0
    assert same_as_csv(tmp_path) > 5000
    assert pq.read_metadata(tmp_path / "tables" / "cycles.parquet").num_rows == 1200
