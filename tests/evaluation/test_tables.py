from __future__ import annotations

import gzip
import math
import tracemalloc
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.errors import InputError
from candaemon.evaluation.tables import (
    BODY_NUMBERS,
    COLUMNS,
    EARTH_COLUMNS,
    LONGEST_ROW,
    STATES,
    TRACK_COLUMNS,
    TRUTH_COLUMNS,
    PredictionWriter,
    TrackWriter,
    format_time,
    parse_time,
    read_tracks,
    read_truth,
    track_columns,
)
from candaemon.files.outputs import OutputFile
from candaemon.frames.bodies import CLASSES
from candaemon.frames.times import LATEST_NS
from tests.support.builders import HandFed, Seen

HEADER = ",".join(COLUMNS) + "\n"
ROW = "1533226488.434433,7,confirmed,10.5,-1,20,0,0,0,,,,,0.1,0.1,0.2,0.2,1.5,0:3;1:12\n"
CYCLE: Mapping[str, Any] = {
    "id": np.array([3, 2**62]),
    "state": np.array([1, 2], dtype=np.int8),
    "x": np.array([12.34567, -0.00001]),
    "y": [1.0, 2.0],
    "vx": np.array([np.nan, np.inf]),
    "objects": ("0:5;1:2", ""),
}


def written(tmp_path: Path, text: str, name: str = "t.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1533226488.434433", 1_533_226_488_434_433_000),
        ("1533226488.434433123", 1_533_226_488_434_433_123),
        ("-0.5", -500_000_000),
        ("3", 3_000_000_000),
        ("1.5e-3", 1_500_000),
        ("0.30000000000000004", 300_000_000),
    ],
)
def test_time_is_exact(text: str, time_ns: int) -> None:
    assert parse_time(text) == time_ns


@pytest.mark.parametrize("text", ["", "nan", "inf", "now", "1e30", "1e999999999", "9999999999.0", "-4611686018.5"])
def test_time_out_of_reach_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        parse_time(text)


@given(st.integers(-LATEST_NS, LATEST_NS))
@settings(deadline=None)
def test_time_round_trips(time_ns: int) -> None:
    assert parse_time(format_time(time_ns)) == time_ns


def test_time_is_written_with_the_digits_it_needs() -> None:
    assert format_time(1_533_226_488_434_433_000) == "1533226488.434433"
    assert format_time(1_533_226_488_434_433_120) == "1533226488.434433120"
    assert format_time(-1_500_000_000) == "-1.500000"


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz"])
def test_written_tracks_are_read_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with OutputFile(path) as file, TrackWriter(file) as writer:
        writer.write_cycle(1_000_000_000, CYCLE)
        writer.write_cycle(1_050_000_000, {"id": [], "state": []})
        writer.write_cycle(1_100_000_001, {"id": [3], "state": ["coasting"], "x": [1.0], "y": [2.0]})
    table = read_tracks(path)
    assert table.time_ns.tolist() == [1_000_000_000, 1_000_000_000, 1_100_000_001]
    assert table.id.tolist() == [3, 2**62, 3]
    assert [STATES[code] for code in table.state] == ["confirmed", "coasting", "coasting"]
    assert table.x.tolist() == [12.3457, 0.0, 1.0]
    assert np.isnan(table.vx).all()
    assert table.objects.tolist() == ["0:5;1:2", "", ""]


def test_cycles_written_at_once_are_those_written_one_after_the_other(tmp_path: Path) -> None:
    places = {"x": np.array([1.0, 2.0]), "y": np.array([-0.5, math.nan])}
    columns: dict[str, Any] = {"id": np.array([4, 2**62]), "state": np.array([1, 2]), **places}
    cycles: list[tuple[int, Mapping[str, Any]]] = [
        (1_000_000_000, CYCLE),
        (1_050_000_000, {"id": [], "state": []}),
        (1_100_000_001, {**columns, "objects": ["0:5", ""], "latitude": np.array([48.1, 48.2])}),
        (1_150_000_000, {**columns, "objects": ["", "1:7"]}),
        (1_200_000_000, {**columns, "class": np.array([1, 2])}),
        (1_250_000_000, columns),
    ]
    for name, at_once in (("a.csv", True), ("b.csv", False)):
        with OutputFile(tmp_path / name) as file, TrackWriter(file, (*EARTH_COLUMNS, "class")) as writer:
            for part in (cycles,) if at_once else ((cycle,) for cycle in cycles):
                writer.write_cycles(part)
    written_at_once = (tmp_path / "a.csv").read_bytes()
    assert written_at_once == (tmp_path / "b.csv").read_bytes()
    assert written_at_once.count(b"\n") == 11
    assert b"1.100000001,4,confirmed,1.0000,-0.5000" in written_at_once
    with (
        OutputFile(tmp_path / "c.csv") as file,
        TrackWriter(file) as writer,
        pytest.raises(ValueError, match="latitude"),
    ):
        writer.write_cycles(cycles)


def test_bytes_are_the_expected_ones_and_repeat(tmp_path: Path) -> None:
    for name in ("a.csv", "a.csv.gz", "b.csv.gz"):
        with OutputFile(tmp_path / name) as file, TrackWriter(file) as writer:
            writer.write_cycle(1_000_000_000, CYCLE)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "time,id,state,x,y,vx,vy,ax,ay,east,north,ve,vn,sx,sy,svx,svy,age,objects"
    assert lines[1] == "1.000000,3,confirmed,12.3457,1.0000,,,,,,,,,,,,,,0:5;1:2"
    assert lines[2] == f"1.000000,{2**62},coasting,0.0000,2.0000,,,,,,,,,,,,,,"
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    assert gzip.decompress((tmp_path / "a.csv.gz").read_bytes()) == (tmp_path / "a.csv").read_bytes()


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5))
@settings(deadline=None)
def test_numbers_come_back_within_half_a_digit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("numbers") / "t.csv"
    with OutputFile(path) as file, TrackWriter(file) as writer:
        ids = list(range(len(values)))
        writer.write_cycle(0, {"id": ids, "state": ["actor"] * len(values), "x": values, "y": values, "east": values})
    table = read_truth(path)
    assert np.abs(table.x - values).max() <= 0.5001e-4
    assert "-0.0000" not in path.read_text().replace("\n", ",").split(",")
    np.testing.assert_array_equal(table.x, table.east)


def test_further_columns_stand_at_the_end_and_come_back(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with OutputFile(path) as file, TrackWriter(file, TRUTH_COLUMNS) as writer:
        body: dict[str, Any] = {
            "heading": [-1.5, math.nan],
            "length": [4.5, 0.0],
            "class": ["car", "standing"],
            "sides": [2, math.nan],
        }
        writer.write_cycle(0, {"id": [1, 2], "state": [3, 5], "x": [1.0, 2.0], "y": [0.0, 0.0], **body})
    lines = path.read_text().splitlines()
    assert lines[0].endswith(",objects,heading,yaw_rate,length,width,center_x,center_y,class,sides")
    assert lines[1].endswith(",,-1.5000,,4.5000,,,,car,2")
    assert lines[2].endswith(",,,,0.0000,,,,standing,")
    table = read_truth(path)
    assert table.heading.tolist() == pytest.approx([-1.5, math.nan], nan_ok=True)
    assert table.sides.tolist() == pytest.approx([2.0, math.nan], nan_ok=True)
    assert [CLASSES[code] for code in table.kind] == ["car", "standing"]
    assert np.isnan(table.existence).all()


def test_a_tracks_body_stands_at_the_end_and_what_is_unknown_is_empty(tmp_path: Path) -> None:
    fed = HandFed(lifecycle={"confirm": 1, "window": 2})
    for k in range(40):
        time = 0.05 * k
        told = fed.scan(time, [Seen(1, 20.0 + 10.0 * time, 0.0, 10.0), Seen(2, 30.0, 8.0)])
    told = replace(
        told,
        length=np.array([4.5, np.nan]),
        kind=np.array([CLASSES.index("truck"), 0], np.int8),
        kind_likelihood=np.array([0.75, np.nan]),
    )
    path = tmp_path / "t.csv"
    with OutputFile(path) as file, TrackWriter(file, TRACK_COLUMNS) as writer:
        writer.write_cycle(0, track_columns(told, ["front"]))
    ends = [line.split(",objects,")[-1].split(",")[-9:] for line in path.read_text().splitlines()]
    assert tuple(ends[0][-9:]) == TRACK_COLUMNS
    first, second = (dict(zip(TRACK_COLUMNS, end, strict=True)) for end in ends[1:])
    assert float(first["heading"]) == pytest.approx(0.0, abs=0.01)
    assert abs(float(first["yaw_rate"])) < 0.01
    assert (first["length"], first["width"], first["class"], first["class_likelihood"]) == (
        "4.5000", "", "truck", "0.7500"
    )  # fmt: skip
    assert (second["heading"], second["yaw_rate"], second["length"], second["class"], second["class_likelihood"]) == (
        "", "", "", "unknown", ""
    )  # fmt: skip
    table = read_tracks(path)
    np.testing.assert_array_equal(table.center_x, table.x)
    assert table.existence.tolist() == [1.0, 1.0]


def test_a_class_that_there_is_not_is_refused(tmp_path: Path) -> None:
    text = HEADER.strip() + ",class\n" + ROW.strip() + ",tank\n"
    with pytest.raises(InputError, match=r"t\.csv:2: class is 'tank'; expected unknown, car"):
        read_tracks(written(tmp_path, text))


def test_a_table_without_further_columns_is_read(tmp_path: Path) -> None:
    table = read_tracks(written(tmp_path, HEADER + ROW))
    assert all(np.isnan(getattr(table, name)).all() for name in BODY_NUMBERS)
    assert table.kind.tolist() == [0]


def test_an_unknown_column_or_a_wrong_length_is_refused(tmp_path: Path) -> None:
    with OutputFile(tmp_path / "t.csv") as file, TrackWriter(file) as writer:
        with pytest.raises(ValueError, match="existence"):
            writer.write_cycle(0, {"id": [1], "state": [1], "existence": [1.0]})
        with pytest.raises(ValueError, match="different length"):
            writer.write_cycle(0, {"id": [1, 2], "state": [1], "x": [0.0, 0.0]})
        first: dict[str, list[float]] = {"id": [1, 2], "state": [1, 1], "x": [7.0]}
        second: dict[str, list[float]] = {"id": [3], "state": [1], "x": [8.0, 9.0]}
        with pytest.raises(ValueError, match="different length"):
            writer.write_cycles([(0, first), (1, second)])


def test_predictions_are_written(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    with OutputFile(path) as file, PredictionWriter(file) as writer:
        none = np.zeros(0, dtype=np.int64)
        writer.write_cycles(
            [
                (2_000_000_000, 0.5, np.array([9]), np.array([4]), np.array([[1.00004, np.nan]])),
                (2_000_000_000, 1.0, none, none, np.zeros((0, 2))),
                (2_000_000_000, 1.0, np.array([9]), np.array([14]), np.array([[-1e-9, 2.0]])),
            ]
        )
        writer.write_cycles([])
    assert path.read_text().splitlines() == [
        "time,horizon,id,object,x,y",
        "2.000000,0.5,9,4,1.0000,",
        "2.000000,1.0,9,14,0.0000,2.0000",
    ]


def test_rows_are_ordered_and_extra_columns_and_blank_lines_ignored(tmp_path: Path) -> None:
    later = ROW.replace("434433", "534433")
    text = "\ufeff" + HEADER.strip() + ",note\n" + later.strip() + ",x\n\n" + ROW.strip() + ",y\n"
    table = read_tracks(written(tmp_path, text))
    assert np.diff(table.time_ns).tolist() == [100_000_000]
    assert table.objects.tolist() == ["0:3;1:12"] * 2
    assert math.isnan(table.east[0])


def test_a_header_alone_is_a_table_without_rows(tmp_path: Path) -> None:
    assert len(read_tracks(written(tmp_path, HEADER))) == 0


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("", None, "empty file; expected a header with time,id"),
        (HEADER.replace("svx,", ""), 1, "column svx missing"),
        (HEADER + ROW + ROW[:40], 3, "6 cells; expected 19"),
        (HEADER + ROW.replace("1533226488.434433", "noon"), 2, "time is 'noon'; expected decimal seconds"),
        (HEADER + ROW.replace(",7,", ",seven,"), 2, "id is 'seven'; expected an integer"),
        (HEADER + ROW.replace(",7,", f",{2**63},"), 2, "expected an integer"),
        (
            HEADER + ROW.replace("confirmed", "actor"),
            2,
            "expected tentative or confirmed or coasting .is this the truth",
        ),
        (HEADER + ROW.replace("10.5", "far"), 2, "x is 'far'; expected a number or nothing"),
        (HEADER + ROW.replace("10.5", "inf"), 2, "x is 'inf'"),
        (HEADER + ROW.replace("10.5", ""), 2, "x is empty"),
        (HEADER + ROW.replace("0:3", "3"), 2, "objects is '3;1:12'; expected sensor:object"),
        (HEADER + ROW + "\n" + ROW, 4, "same time and id as in line 2"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, text: str, line: int | None, expected: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=expected) as caught:
        read_tracks(path)
    assert caught.value.file == str(path)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("filler", "found"),
    [
        ("x" * 100, "a row of more than 65,536 characters"),
        (",", "a row of more than 65,536 characters"),
        ('"\n",', "a row of more than 65,536 characters"),
        ("\n", "a row of more than 65,536 characters"),
        (ROW, "same time and id as in line 2"),
        (ROW + ROW.replace("88.", "89."), "same time and id as in line 2"),
        (ROW.replace(",7,", f",{'9' * 5000},"), "id is '9999"),
    ],
)
def test_a_small_table_that_unpacks_to_much_takes_little(tmp_path: Path, filler: str, found: str) -> None:
    path = tmp_path / "t.csv.gz"
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    much = (filler * ((4 << 20) // len(filler))).encode()
    parts = [packer.compress((HEADER + ROW).encode()), *(packer.compress(much) for _ in range(25)), packer.flush()]
    path.write_bytes(b"".join(parts))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=found):
            read_tracks(path)
        assert tracemalloc.get_traced_memory()[1] < 40_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_row_has_a_longest(tmp_path: Path, beyond: int) -> None:
    header = HEADER.strip() + ",remark\n"
    row = ROW.strip() + ","
    path = written(tmp_path, header + row + "x" * (LONGEST_ROW + beyond - len(row) - 1) + "\n")
    if beyond:
        with pytest.raises(InputError, match=r"t\.csv:2: a row of more than 65,536 characters"):
            read_tracks(path)
    else:
        assert len(read_tracks(path)) == 1


def test_long_texts_cost_no_other_row(tmp_path: Path) -> None:
    rows = [ROW.replace("1533226488.", f"{second}.") for second in range(5000)]
    rows[7] = rows[7].replace("0:3;1:12", ";".join(["0:3"] * 10_000))
    path = written(tmp_path, HEADER + "".join(rows))
    tracemalloc.start()
    try:
        assert len(read_tracks(path)) == 5000
        assert tracemalloc.get_traced_memory()[1] < 40_000_000
    finally:
        tracemalloc.stop()


def test_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_tracks(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_tracks(tmp_path)
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress((HEADER + ROW * 9).encode())[:-12])
    with pytest.raises(InputError, match="damaged or truncated gzip"):
        read_tracks(cut)
    plain = written(tmp_path, HEADER, "plain.csv.gz")
    with pytest.raises(InputError, match="damaged or truncated gzip"):
        read_tracks(plain)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_tracks(binary)
