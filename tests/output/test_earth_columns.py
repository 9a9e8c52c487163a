"""Latitude and longitude of obstacles: in the tables, on the wire, and where they are not known."""

from __future__ import annotations

import csv
import gzip
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.cli.check import check_report
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.tables import (
    COLUMNS,
    EARTH_COLUMNS,
    TRACK_COLUMNS,
    TRUTH_COLUMNS,
    TrackWriter,
    read_tracks,
    track_columns,
)
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT
from tests.support.simulated import scenario

EARTH_RADIUS, FLATTENING = 6_378_137.0, 1 / 298.257_223_563
NOT_KNOWN = (90.000_000_1, 180.000_000_1)


def changed(tmp_path: Path, config: str, *changes: tuple[str, str]) -> Path:
    """Write one of the project's configurations with some text replaced."""
    text = (ROOT / "config" / f"{config}.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "vehicle.yaml"
    path.write_text(text)
    return path


def line_of(path: Path, text: str) -> int:
    return next(k for k, line in enumerate(path.read_text().splitlines(), start=1) if text in line)


def metres(latitude: Floats, longitude: Floats, of: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return how far north and east places (deg) lie of others, m, by the radii of curvature: right within 1 km."""
    squared = FLATTENING * (2 - FLATTENING)
    phi = np.radians(of[0])
    curve = np.sqrt(1 - squared * np.sin(phi) ** 2)
    north = np.radians(latitude - of[0]) * EARTH_RADIUS * (1 - squared) / curve**3
    east = np.radians(longitude - of[1]) * EARTH_RADIUS / curve * np.cos(phi)
    return north, east


@dataclass(frozen=True)
class Simulated:
    cycles: list[Cycle]
    pipeline: Pipeline
    folder: Path


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    """Return ten seconds through `esr_ins_fd`; the INS is told no sooner than a second after the radar."""
    folder = tmp_path_factory.mktemp("simulated")
    binding = bind(load_config(ROOT / "config" / "esr_ins_fd.yaml"))
    simulation = simulate(scenario("highway").model_copy(update={"duration": 10.0}), binding, 1)
    pipeline = Pipeline(binding)
    assert binding.ego is not None
    place = binding.ego.database.messages["LatitudeLongitude"].can_id
    frames = list(simulation.frames())
    late = [f for f in frames if not (f.can_id == place and f.time_ns < frames[0].time_ns + 1_000_000_000)]
    cycles = list(pipeline.run(late))
    with OutputFile(folder / "tracks.csv") as file, TrackWriter(file, (*EARTH_COLUMNS, *TRACK_COLUMNS)) as table:
        for cycle in cycles:
            table.write_cycle(cycle.obstacles.time_ns, track_columns(cycle.obstacles, ["front"], cycle.georeference))
    with OutputFile(folder / "truth.csv") as file, TrackWriter(file, TRUTH_COLUMNS) as table:
        for row in simulation.truth():
            table.write_cycle(row.time_ns, row.columns)
    return Simulated(cycles, pipeline, folder)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as lines:
        return list(csv.DictReader(lines))


def test_the_tables_last_columns_are_empty_until_the_place_is_known(simulated: Simulated) -> None:
    rows = rows_of(simulated.folder / "tracks.csv")
    assert tuple(rows[0]) == (*COLUMNS, "latitude", "longitude", *TRACK_COLUMNS)
    known = [bool(row["latitude"]) for row in rows]
    assert known == sorted(known)
    assert 10 < known.index(True) < len(known) / 4
    assert all(bool(row["latitude"]) == bool(row["longitude"]) for row in rows)
    assert {len(row["latitude"].partition(".")[2]) for row in rows if row["latitude"]} == {9}


def test_evaluation_reads_the_longer_table(simulated: Simulated) -> None:
    assert len(read_tracks(simulated.folder / "tracks.csv")) == len(rows_of(simulated.folder / "tracks.csv"))
    assert evaluate(simulated.folder / "tracks.csv", simulated.folder / "truth.csv").errors.position < 1.0


def decoded(frames: Sequence[Frame], database: Database) -> dict[int, dict[str, Any]]:
    """Return the occupied slots of a cycle's frames by obstacle, as another CAN tool reads them."""
    decode: Callable[..., Any] = database.decode_message
    status = database.get_message_by_name("OBSTACLE_STATUS").frame_id
    slots = [decode(frame.can_id, frame.data, decode_choices=False) for frame in frames if frame.can_id != status]
    return {slot["Id"]: slot for slot in slots if slot["State"]}


def test_the_dbc_says_what_stands_for_not_known() -> None:
    database = cantools.database.load_file(ROOT / "dbc" / "obstacles_fd.dbc")
    assert isinstance(database, Database)
    for slot in range(32):
        message = database.get_message_by_name(f"OBSTACLE_{slot:02d}")
        for name, value in zip(("Latitude", "Longitude"), NOT_KNOWN, strict=True):
            signal = message.get_signal_by_name(name)
            assert f"{value:.7f} stands for not known" in (signal.comment or "")
            assert signal.maximum == value
            assert (signal.scale, signal.unit) == (1e-7, "deg")


def test_the_wire_carries_what_the_table_says(simulated: Simulated) -> None:
    database = cantools.database.load_file(ROOT / "dbc" / "obstacles_fd.dbc")
    assert isinstance(database, Database)
    rows = rows_of(simulated.folder / "tracks.csv")
    told = {(row["time"], int(row["id"])): row for row in rows}
    compared = unknown = 0
    for cycle in simulated.cycles:
        time = f"{cycle.obstacles.time_ns * 1e-9:.6f}"
        for identity, slot in decoded(cycle.frames, database).items():
            row = told[time, identity]
            if row["latitude"]:
                assert slot["Latitude"] == pytest.approx(float(row["latitude"]), abs=0.51e-7)
                assert slot["Longitude"] == pytest.approx(float(row["longitude"]), abs=0.51e-7)
                compared += 1
            else:
                assert (slot["Latitude"], slot["Longitude"]) == pytest.approx(NOT_KNOWN, abs=1e-9)
                unknown += 1
    assert compared > 500
    assert unknown > 10
    assert simulated.pipeline.saturated == 0


def test_places_are_those_of_the_simulated_obstacles(simulated: Simulated) -> None:
    """The truth is level metres from the scenario's own start on earth."""
    start = scenario("highway").ego.start
    truth = rows_of(simulated.folder / "truth.csv")
    actors: dict[str, list[tuple[float, float]]] = {}
    for row in truth:
        actors.setdefault(row["time"], []).append((float(row["north"]), float(row["east"])))
    off = []
    home = np.array(start.latitude), np.array(start.longitude)
    for row in rows_of(simulated.folder / "tracks.csv"):
        if row["latitude"] and row["state"] == "confirmed" and row["time"] in actors:
            there = metres(np.array(float(row["latitude"])), np.array(float(row["longitude"])), home)
            off.append(min(np.hypot(*np.subtract(there, actor)) for actor in actors[row["time"]]))
    assert len(off) > 500
    assert np.median(off) < 1.0  # of a vehicle's centre; a radar sees its outline


def test_without_gnss_nothing_is_placed() -> None:
    binding = bind(load_config(ROOT / "config" / "esr_ins.yaml"))
    assert Pipeline(binding).georeferencer is None


def test_gnss_needs_the_fixes(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        "esr_ins_fd",
        ("    latitude: LatitudeLongitude.PosLat\n", ""),
        ("    longitude: LatitudeLongitude.PosLon\n", ""),
    )
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert f"{path}:{line_of(path, 'gnss:')}: ego.gnss: needs the fixes" in str(caught.value)


def test_places_on_the_wire_need_gnss(tmp_path: Path) -> None:
    path = changed(tmp_path, "esr_ins_fd", ("  gnss: {}", "  # gnss: {}"))
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert f"{path}:{line_of(path, 'longitude: Longitude,')}: output.signals.latitude: no place on earth" in str(
        caught.value
    )
    assert "output.signals.longitude" in str(caught.value)


def test_a_number_out_of_range_is_told_with_its_line(tmp_path: Path) -> None:
    path = changed(tmp_path, "esr_ins_fd", ("gnss: {}", "gnss: {filter: {kind: imm, switch_rate: -1}}"))
    with pytest.raises(ConfigError, match=r"ego\.gnss\.filter\.\S*switch_rate: found -1"):
        load_config(path)


@pytest.mark.parametrize(
    ("gnss", "said"),
    [
        ("{}", "the level frame drifting 0.1 m per √s"),
        ("{filter: {kind: switching}}", "smoothed by CV or CS, switched"),
        ("{filter: {kind: imm}, hold: 9}", "smoothed by an IMM of CV, CA"),
    ],
)
def test_check_tells_the_placement(tmp_path: Path, gnss: str, said: str) -> None:
    path = changed(tmp_path, "esr_ins_fd", ("gnss: {}", f"gnss: {gnss}"))
    sheet = next(sheet for sheet in check_report(bind(load_config(path))) if sheet.title == "own motion")
    rows = {row[0]: row[1] for row in sheet.rows}
    assert said in rows["place on earth"]
    assert f"good for {9 if 'hold' in gnss else 60} s" in rows["fixes"]


@dataclass(frozen=True)
class Replayed:
    folder: Path
    tracks: list[dict[str, str]]
    summary: dict[str, Any]


@pytest.fixture(scope="module")
def replayed(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    """Return the recorded drive with the INS's fixes used."""
    folder = tmp_path_factory.mktemp("placed")
    config = changed(folder, "toyota_rav4_ins", ("sensors:", "  gnss: {noise: 0.5}\nsensors:"))
    tracks, summary = folder / "t.csv", folder / "s.json"
    log = drive / "drive_with_ins.log.gz"
    assert main(["replay", str(config), str(log), "--tracks", str(tracks), "--summary", str(summary)]) == 0
    return Replayed(folder, rows_of(tracks), json.loads(summary.read_text()))


@pytest.fixture(scope="module")
def pose(drive: Path) -> dict[str, Floats]:
    """Return the drive's own pose, which the INS's frames were made of."""
    with gzip.open(drive / "pose_enu.csv.gz", "rt") as lines:
        rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.slow
def test_the_other_columns_of_the_drive_stay_as_they_are(replayed: Replayed, drive: Path) -> None:
    log, plain = replayed.folder / "start.log", replayed.folder / "plain.csv"
    with gzip.open(drive / "drive_with_ins.log.gz", "rt") as lines:
        log.write_text("".join(islice(lines, 12_000)))
    assert main(["replay", str(ROOT / "config" / "toyota_rav4_ins.yaml"), str(log), "--tracks", str(plain)]) == 0
    expected = rows_of(plain)[:-32]  # the last cycle is the shorter log's own
    placed = [{name: cell for name, cell in row.items() if name not in EARTH_COLUMNS} for row in replayed.tracks]
    assert len(expected) > 500
    assert placed[: len(expected)] == expected


def test_the_drives_fixes_are_all_used(replayed: Replayed) -> None:
    gnss = replayed.summary["gnss"]
    assert gnss["fixes"] == 1200
    assert gnss["invalid"] == gnss["unplaced"] == gnss["rejected"] == gnss["restarts"] == 0
    assert gnss["innovation_rms"] < 0.05
    assert 0.0 < gnss["deviation"] < 0.5


def test_seen_from_where_the_ins_was_every_obstacle_is_where_the_radar_saw_it(
    replayed: Replayed, pose: dict[str, Floats]
) -> None:
    """Latitude and longitude, less those of the drive's own pose, turned by its heading, are x and y."""
    table = {
        name: np.array([float(row[name]) for row in replayed.tracks]) for name in ("latitude", "longitude", "x", "y")
    }
    seconds = [int(row["time"].partition(".")[0]) for row in replayed.tracks]
    first = int(pose["t_unix_utc"][0])
    time = np.array(
        [
            s - first + float("0." + row["time"].partition(".")[2])
            for s, row in zip(seconds, replayed.tracks, strict=True)
        ]
    )
    at = pose["t_unix_utc"] - first
    own = np.interp(time, at, pose["lat_deg"]), np.interp(time, at, pose["lon_deg"])
    compass = np.radians(np.interp(time, at, pose["vehicle_heading_deg_cw_from_north"]))
    north, east = metres(table["latitude"], table["longitude"], own)
    ahead = np.cos(compass) * north + np.sin(compass) * east
    left = np.sin(compass) * north - np.cos(compass) * east
    inside = (time > at[0]) & (time < at[-1])
    assert inside.sum() > 8000
    np.testing.assert_allclose(ahead[inside], table["x"][inside], atol=0.08)
    np.testing.assert_allclose(left[inside], table["y"][inside], atol=0.08)
