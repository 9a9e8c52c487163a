"""`replay --smooth`: the same rows with less error, and what is sent as it was."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.cli.main import main
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.results import Evaluation
from candaemon.tracking.obstacles import MOTION
from tests.benchmarks.chains import imm_config
from tests.support.paths import ROOT

KEPT = ("time", "id", "state", "age", "objects")


def replayed(config: Path | str, log: Path, folder: Path, *options: str) -> list[dict[str, str]]:
    """Replay a log into a folder; return the table of tracks."""
    folder.mkdir()
    outputs = ("-o", str(folder / "o.log"), "--tracks", str(folder / "t.csv"), "--predictions", str(folder / "p.csv"))
    assert main(["replay", str(config), str(log), *outputs, *options]) == 0
    with (folder / "t.csv").open() as lines:
        return list(csv.DictReader(lines))


def column(rows: Iterable[dict[str, str]], name: str) -> Floats:
    return np.array([float(row[name]) for row in rows])


class Drive:
    """A simulated drive, replayed without and with smoothing."""

    def __init__(self, scenario: str, folder: Path, config: Path | str = "esr_ins") -> None:
        self.folder, self.log, self.truth = folder, folder / "drive.log", folder / "truth.csv"
        assert main(["simulate", scenario, "esr_ins", "-o", str(self.log), "--truth", str(self.truth)]) == 0
        self.filtered = replayed(config, self.log, folder / "filtered")
        self.smoothed = replayed(config, self.log, folder / "smoothed", "--smooth", "1")

    def evaluation(self, which: str) -> Evaluation:
        return evaluate(self.folder / which / "t.csv", self.truth)


@pytest.fixture(scope="module")
def brake(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return Drive("automotive_brake", tmp_path_factory.mktemp("brake"))


@pytest.fixture(scope="module")
def cut_in(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return Drive("automotive_cut_in", tmp_path_factory.mktemp("cut_in"))


def test_rows_are_the_same_and_hold_other_motion(brake: Drive) -> None:
    filtered, smoothed = brake.filtered, brake.smoothed
    assert [[row[name] for name in KEPT] for row in smoothed] == [[row[name] for name in KEPT] for row in filtered]
    for name in MOTION:
        assert np.isfinite(column(smoothed, name)).all()
        assert (column(smoothed, name) != column(filtered, name)).mean() > 0.9, name


def test_what_is_sent_and_predicted_is_the_same(brake: Drive) -> None:
    for name in ("o.log", "p.csv"):
        sent = (brake.folder / "filtered" / name).read_bytes()
        assert sent
        assert (brake.folder / "smoothed" / name).read_bytes() == sent


def test_errors_shrink(brake: Drive, cut_in: Drive) -> None:
    for drive in (brake, cut_in):
        before, after = drive.evaluation("filtered"), drive.evaluation("smoothed")
        assert after.errors.position < 0.8 * before.errors.position
        assert after.errors.velocity < 0.65 * before.errors.velocity
        assert after.errors.acceleration < 0.8 * before.errors.acceleration
        assert 4 * 0.6 < after.nees.mean < 4 * 1.5
        assert after.id_switches == before.id_switches


def test_errors_shrink_below_those_of_point_models(brake: Drive, cut_in: Drive, tmp_path: Path) -> None:
    """Smoothing halves what `imm` errs in velocity, and what is smoothed by default errs by less than that half."""
    config = imm_config(tmp_path)
    for scenario, default in (("automotive_brake", brake), ("automotive_cut_in", cut_in)):
        folder = tmp_path / scenario
        folder.mkdir()
        drive = Drive(scenario, folder, config)
        before, after = drive.evaluation("filtered"), drive.evaluation("smoothed")
        assert after.errors.position < 0.8 * before.errors.position
        assert after.errors.velocity < 0.5 * before.errors.velocity
        assert after.errors.acceleration < 0.8 * before.errors.acceleration
        assert 4 * 0.6 < after.nees.mean < 4 * 1.5
        assert default.evaluation("smoothed").errors.velocity < 0.5 * before.errors.velocity


def test_errors_shrink_where_reference_points_move_on_their_bodies(tmp_path: Path) -> None:
    """What crosses shows another part of itself from scan to scan: the filter predicts none of that."""
    drive = Drive("traffic_left_turn", tmp_path)
    before, after = drive.evaluation("filtered"), drive.evaluation("smoothed")
    assert after.errors.position < before.errors.position
    assert after.errors.velocity < 0.95 * before.errors.velocity


def test_two_runs_give_the_same_bytes(brake: Drive, tmp_path: Path) -> None:
    replayed("esr_ins", brake.log, tmp_path / "again", "--smooth", "1")
    assert (tmp_path / "again" / "t.csv").read_bytes() == (brake.folder / "smoothed" / "t.csv").read_bytes()


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "soon", "11"])
def test_a_lag_that_makes_no_sense_is_2(seconds: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["replay", "demo", "a.log", "--tracks", "t.csv", "--smooth", seconds])
    assert stop.value.code == 2


def test_smoothing_without_a_table_is_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "demo", "a.log", "--smooth", "1"]) == 2
    assert "--tracks" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "most"), [("imm", 0.9), ("vehicle", 1.0)])
def test_the_recorded_drives_standing_objects_stand_stiller(
    drive: Path, tmp_path: Path, kind: str, most: float
) -> None:
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    config = tmp_path / "kind.yaml"
    config.write_text(f"{text}tracker: {{estimator: {{kind: {kind}}}}}\n", encoding="utf-8")
    log = tmp_path / "second_half.log"
    with gzip.open(drive / "drive_with_ins.log.gz", "rt") as lines:
        log.write_text("".join(islice(lines, 80_000, None)))
    filtered = replayed(config, log, tmp_path / "f")
    smoothed = replayed(config, log, tmp_path / "s", "--smooth", "1")
    assert [[row[name] for name in KEPT] for row in smoothed] == [[row[name] for name in KEPT] for row in filtered]
    sure = np.array([row["state"] != "tentative" for row in filtered])
    identity = column(filtered, "id")
    before, after = (np.hypot(column(rows, "vx"), column(rows, "vy")) for rows in (filtered, smoothed))
    standing = [
        rows
        for rows in (sure & (identity == each) for each in np.unique(identity))
        if rows.sum() > 40 and np.median(before[rows]) < 0.7
    ]
    assert len(standing) >= 8
    stands = np.any(standing, axis=0)
    assert np.sqrt(np.square(after[stands]).mean()) < most * np.sqrt(np.square(before[stands]).mean())
