"""The recorded drive: what the daemon makes of it, judged by a reader of its own that shares no code with it."""

from __future__ import annotations

import csv
import gzip
import json
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest
import yaml
from cantools.database.can import Database
from numpy.typing import NDArray

from candaemon.arrays import Floats
from candaemon.cli.main import main
from tests.support.paths import ROOT
from tests.support.rav4 import of_points

CYCLES, SLOTS = 1200, 16
MOUNT = 3.6  # m, the radar ahead of the rear axle, as configured
LONG = 3.0  # s, radar tracks that count
LOGS = {"toyota_rav4_ins": "drive_with_ins.log.gz", "toyota_rav4": "drive.log.gz"}
PREDICTED = {0.5: (0.20, 0.27), 1.0: (0.30, 0.37)}  # m, largest RMSE along and across


@dataclass(frozen=True)
class Radar:
    """What the radar said: (cycle, slot) arrays; `run` numbers its own tracks, −1 where there is none."""

    time: Floats
    x: Floats
    y: Floats
    rate: Floats
    run: NDArray[np.int64]
    long_runs: frozenset[int]

    def cycle(self, time: float) -> int | None:
        nearest = int(np.argmin(np.abs(self.time - time)))
        return nearest if abs(self.time[nearest] - time) < 0.03 else None


@pytest.fixture(scope="module")
def radar(drive: Path) -> Radar:
    loaded = cantools.database.load_file(ROOT / "dbc" / "toyota_rav4_radar.dbc")
    assert isinstance(loaded, Database)
    decode: Callable[..., Any] = loaded.decode_message
    shape = (CYCLES, SLOTS)
    time, (x, y, rate) = np.zeros(CYCLES), np.full((3, *shape), np.nan)
    valid, new = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    cycle, counter = -1, -1
    with gzip.open(drive / "drive.log.gz", "rt") as lines:
        for line in lines:
            stamp, channel, frame = line.split()[:3]
            can_id, _, data = frame.partition("#")
            slot = int(can_id, 16) - 0x210
            if channel != "can1" or not 0 <= slot < SLOTS:
                continue
            said = decode(slot + 0x210, bytes.fromhex(data), decode_choices=False)
            if said["COUNTER"] != counter:
                cycle, counter = cycle + 1, said["COUNTER"]
                time[cycle] = float(stamp[1:-1])
            x[cycle, slot], y[cycle, slot], rate[cycle, slot] = said["LONG_DIST"], -said["LAT_DIST"], said["REL_SPEED"]
            valid[cycle, slot], new[cycle, slot] = said["VALID"], said["NEW_TRACK"]
    run, number = np.full(shape, -1), 0
    for slot in range(SLOTS):
        for k in range(CYCLES):
            if k and (x[k, slot] >= 255 or (new[k, slot] and not new[k - 1, slot])):
                number += 1
            if valid[k, slot] and x[k, slot] < 255:
                run[k, slot] = number
        number += 1
    spans = {int(i): np.ptp(time[(run == i).any(axis=1)]) for i in np.unique(run) if i >= 0}
    return Radar(time, x, y, rate, run, frozenset(i for i, span in spans.items() if span >= LONG))


@dataclass(frozen=True)
class Result:
    config: Path
    folder: Path
    summary: dict[str, Any]
    tracks: list[dict[str, str]]
    predictions: list[dict[str, str]]
    latency: float  # s by which the times of obstacles lie before those of the frames


VEHICLES, POINTS = "vehicles", "points"
"""An obstacle is a vehicle, as the configurations have it; or a point, by a tracker that was set for this drive."""


def runs(*trackers: str) -> pytest.MarkDecorator:
    """Let a test have the results of some trackers, each with both configurations."""
    both = (("toyota_rav4_ins", ()), ("toyota_rav4", pytest.mark.slow))
    params = [pytest.param((name, each), id=f"{name}-{each}", marks=marks) for each in trackers for name, marks in both]
    return pytest.mark.parametrize("result", params, indirect=True, scope="module")


@pytest.fixture(scope="module")
def result(request: pytest.FixtureRequest, drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Result:
    name, tracker = request.param
    folder = tmp_path_factory.mktemp(f"{name}-{tracker}")
    return replayed(of_points(name, folder) if tracker == POINTS else ROOT / "config" / f"{name}.yaml", drive, folder)


def replayed(config: Path, drive: Path, folder: Path) -> Result:
    outputs = {
        "-o": folder / "out.log",
        "--tracks": folder / "t.csv",
        "--predictions": folder / "p.csv",
        "--summary": folder / "s.json",
    }
    options = [str(word) for pair in outputs.items() for word in pair]
    code = main(["replay", str(config), str(drive / LOGS[config.stem]), *options])
    assert code == 0
    tracks, predictions = (_rows(folder / name) for name in ("t.csv", "p.csv"))
    front = yaml.safe_load(config.read_text())["sensors"]["front"]
    summary = json.loads((folder / "s.json").read_text())
    return Result(config, folder, summary, tracks, predictions, front.get("latency", 0.0))


def _rows(table: Path) -> list[dict[str, str]]:
    with table.open() as lines:
        return list(csv.DictReader(lines))


@runs(VEHICLES, POINTS)
def test_no_frame_is_lost_and_none_uncounted(result: Result) -> None:
    summary = result.summary
    sensor = summary["sensors"]["front"]
    assert (sensor["used"], sensor["scans"]) == (2 * SLOTS * CYCLES, CYCLES)
    assert not any(sensor[fate] for fate in ("missing", "short", "checksum", "late", "duplicate", "surplus"))
    car = summary["buses"]["car"]
    assert (car["short"], car["spare_short"]) == (0, 1559)  # of 0x262 and 0x3F6, which nothing asks for
    assert sum(bus["frames"] for bus in summary["buses"].values()) == summary["log"]["frames"]
    assert summary["log"]["malformed"] == 0
    assert summary["tracks"]["used"] == summary["tracks"]["detections"]
    assert summary["output"]["saturated"] == 0


@pytest.mark.slow
@runs(VEHICLES, POINTS)
def test_two_runs_give_the_same_bytes(result: Result, drive: Path, tmp_path: Path) -> None:
    replayed(result.config, drive, tmp_path)
    for name in ("out.log", "t.csv", "p.csv", "s.json"):
        assert (tmp_path / name).read_bytes() == (result.folder / name).read_bytes()


def prediction_errors(result: Result, radar: Radar) -> dict[float, Floats]:
    errors = defaultdict(list)
    for row in result.predictions:
        slot, horizon = int(row["object"]), float(row["horizon"])
        made = radar.cycle(float(row["time"]) + result.latency)
        due = radar.cycle(float(row["time"]) + result.latency + horizon)
        if made is None or due is None:
            continue
        run = int(radar.run[made, slot])
        if run in radar.long_runs and radar.run[due, slot] == run:
            measured = radar.x[due, slot] + MOUNT, radar.y[due, slot]
            errors[horizon].append((measured[0] - float(row["x"]), measured[1] - float(row["y"])))
    return {horizon: np.sqrt(np.mean(np.square(each), axis=0)) for horizon, each in errors.items()}


@runs(VEHICLES, POINTS)
def test_predictions_meet_the_radars_own_later_word(result: Result, radar: Radar) -> None:
    errors = prediction_errors(result, radar)
    assert errors.keys() == PREDICTED.keys()
    for horizon, (along, across) in PREDICTED.items():
        assert errors[horizon][0] <= along
        assert errors[horizon][1] <= across


@runs(VEHICLES, POINTS)
def test_what_stands_still_is_told_to_stand_still(result: Result, radar: Radar) -> None:
    assert result.summary["stationary"]["runs"] >= 20
    assert result.summary["stationary"]["vx"] <= 0.27
    assert result.summary["stationary"]["speed"] <= 0.45


@runs(POINTS)
def test_nis_is_what_it_should_be(result: Result) -> None:
    nis = result.summary["nis"]
    assert nis["mean"] == pytest.approx(nis["expected"], rel=0.15)


@runs(VEHICLES)
def test_innovations_are_within_the_bounds_that_are_told(result: Result) -> None:
    """Of vehicles they are mostly smaller than those of white noise, and now and then larger, as reflections slide."""
    assert result.summary["nis"]["coverage_95"] == pytest.approx(0.95, abs=0.015)


def ids_of_runs(
    result: Result, radar: Radar, *, told: frozenset[str] = frozenset(("tentative", "confirmed", "coasting"))
) -> dict[int, list[tuple[int, int, str]]]:
    """Return for each of the radar's tracks (cycle, slot, id) of the obstacles of some states that used it."""
    found = defaultdict(list)
    for row in result.tracks:
        if row["state"] not in told:
            continue
        k = radar.cycle(float(row["time"]) + result.latency)
        assert k is not None
        for used in filter(None, row["objects"].split(";")):
            slot = int(used.rpartition(":")[2])
            found[int(radar.run[k, slot])].append((k, slot, row["id"]))
    return found


@runs(POINTS)
def test_no_obstacle_changes_its_id_over_a_radar_track(result: Result, radar: Radar) -> None:
    found = ids_of_runs(result, radar)
    assert radar.long_runs <= found.keys()
    assert [run for run in radar.long_runs if len({name for _, _, name in found[run]}) > 1] == []


@runs(VEHICLES)
def test_no_vehicle_changes_its_id_over_a_radar_track_once_confirmed(result: Result, radar: Radar) -> None:
    """Tentative, one that was lost sight of has a number of its own; confirmed, that which it had before."""
    found = ids_of_runs(result, radar, told=frozenset(("confirmed", "coasting")))
    assert radar.long_runs <= found.keys()
    assert [run for run in radar.long_runs if len({name for _, _, name in found[run]}) > 1] == []


@runs(VEHICLES, POINTS)
def test_no_id_survives_a_slot_reuse_onto_another_vehicle(result: Result, radar: Radar) -> None:
    """A slot that jumps by more than a vehicle moves in a cycle, and more than it is long, has another vehicle."""
    at = {(k, slot): name for uses in ids_of_runs(result, radar).values() for k, slot, name in uses}
    jumps = 0
    for (k, slot), name in at.items():
        if (k + 1, slot) in at and radar.run[k, slot] != radar.run[k + 1, slot]:
            apart = np.hypot(radar.x[k + 1, slot] - radar.x[k, slot], radar.y[k + 1, slot] - radar.y[k, slot])
            faster = abs(radar.rate[k + 1, slot] - radar.rate[k, slot])
            if apart > 8.0 or faster > 4.0:
                jumps += 1
                assert at[k + 1, slot] != name
    assert jumps > 30


@runs(VEHICLES, POINTS)
def test_a_vehicle_is_one_obstacle(result: Result) -> None:
    cycles = defaultdict(list)
    for row in result.tracks:
        if row["state"] != "tentative":
            cycles[row["time"]].append([float(row[name]) for name in ("x", "y", "vx")])
    samples = duplicates = 0
    for rows in cycles.values():
        apart = np.abs(np.array(rows)[:, None] - np.array(rows))
        close = (apart < [3.0, 1.0, 1.0]).all(axis=2)
        duplicates += int((close.sum(axis=1) > 1).sum())
        samples += len(rows)
    assert samples > 5000
    assert duplicates < 0.05 * samples
