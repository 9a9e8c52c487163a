"""`candaemon init`: strange layouts in, the right mapping out, or a guess that says so."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding, BoundSensor
from candaemon.cli.main import main
from candaemon.config.ego import OdometrySettings
from candaemon.config.load import load_config
from candaemon.config.settings import Config
from candaemon.wizard.draft import GUESS
from candaemon.wizard.trial import try_on
from tests.support import small_car
from tests.support.bound import binding as shipped
from tests.support.paths import DATA, ROOT
from tests.wizard.drives import survey_log

MEASURED = ("x", "y", "range", "azimuth", "range_rate", "vx", "vy")
slow = pytest.mark.slow


def mapping(sensor: BoundSensor) -> dict[str, tuple[str, float]]:
    """Return the signal of each measured quantity, and its SI value."""
    return {
        each.quantity: (each.signal.name, each.gain) for each in sensor.reader.bindings if each.quantity in MEASURED
    }


def made(dbcs: list[Path], log: Path | None, folder: Path) -> tuple[Binding, str]:
    """Let the command make a configuration; return it and its text."""
    path = folder / "made.yaml"
    words = ["init", *map(str, dbcs), "--yes", "-o", str(path), *([] if log is None else ["--log", str(log)])]
    assert main(words) == 0
    return bind(load_config(path)), path.read_text(encoding="utf-8")


def guessed(text: str, key: str) -> bool:
    """Return whether the line of a key is marked as a guess."""
    return any(f"# {GUESS}" in line for line in text.splitlines() if line.strip().startswith(f"{key}:"))


@pytest.mark.parametrize(
    "name",
    [
        "gm_lrr",
        pytest.param("ars408", marks=slow),
        pytest.param("chrysler_pacifica", marks=slow),
        pytest.param("toyota_rav4", marks=slow),
        pytest.param("esr_ins", marks=slow),
        pytest.param("mando", marks=slow),
        pytest.param("tesla_continental", marks=slow),
        pytest.param("acura_ilx", marks=slow),
    ],
)
def test_shipped_layouts_are_found_from_a_log(name: str, tmp_path: Path) -> None:
    of = shipped(name)
    log = survey_log(of, tmp_path)
    right, wanted = of.sensors[0], [Path(of.sensors[0].database.path)]
    assert of.ego is not None
    found, text = made([*wanted, Path(of.ego.database.path)], log, tmp_path)
    sensor = found.sensors[0]
    for quantity, (signal, gain) in mapping(right).items():
        assert mapping(sensor)[quantity][0] == signal, quantity
        assert mapping(sensor)[quantity][1] == pytest.approx(gain), quantity
        assert not guessed(text, quantity), quantity
    assert found.ego is not None
    assert found.ego.settings.kind == of.ego.settings.kind
    assert sensor.settings.cycle_time == pytest.approx(right.settings.cycle_time, rel=0.03)
    tried, expected = try_on(found, [log]), try_on(of, [log])
    assert tried.score.nis.mean == pytest.approx(tried.score.nis.expected, rel=0.3)
    scans = expected.pipeline.assemblers[0].counts.scans
    assert tried.pipeline.assemblers[0].counts.scans == pytest.approx(scans, abs=2)
    assert tried.pipeline.assemblers[0].counts.incomplete <= 2


@pytest.mark.parametrize("logged", [False, True])
def test_a_gear_with_a_table_of_values_tells_reverse(logged: bool, tmp_path: Path) -> None:
    config = small_car.written(tmp_path, dbc=f'{small_car.DBC}VAL_ 1027 GEAR 0 "P" 7 "R" 3 "D" ;\n')
    log = tmp_path / "drive.log"
    if logged:
        assert main(["simulate", "guard_rail", str(config), "-o", str(log)]) == 0
    found, text = made([tmp_path / "car.dbc"], log if logged else None, tmp_path)
    assert "reverse: {signal: GEAR_BOX.GEAR, in: [7]}" in text
    assert found.ego is not None
    assert found.ego.reverse is not None
    assert guessed(text, "reverse") != logged


@pytest.mark.parametrize(("every", "limit"), [(0.5, None), (0.98, None), (1.5, 4.5), (2.02, 6.1), (5.0, 15.0)], ids=str)
def test_a_gear_that_comes_seldom_is_believed_for_longer(every: float, limit: float | None, tmp_path: Path) -> None:
    config = small_car.written(tmp_path, dbc=f'{small_car.DBC}VAL_ 1027 GEAR 0 "P" 7 "R" 3 "D" ;\n')
    log = tmp_path / "drive.log"
    assert main(["simulate", "turning_ego", str(config), "-o", str(log)]) == 0
    frames = [
        (float(line[1 : line.index(")")]), line)
        for line in log.read_text(encoding="utf-8").splitlines()
        if " 403#" not in line
    ]
    (begun, _), (over, _) = frames[0], frames[-1]
    times = [begun + k * every for k in range(round((over - begun) / every))]
    frames += [(time, f"({time:.6f}) can0 403#0300") for time in times]
    log.write_text("".join(f"{line}\n" for _, line in sorted(frames)), encoding="utf-8")
    found, text = made([tmp_path / "car.dbc"], log, tmp_path)
    assert found.ego is not None
    settings = found.ego.settings
    assert isinstance(settings, OdometrySettings)
    default = OdometrySettings.model_fields["reverse_age_limit"].default
    assert settings.reverse_age_limit == pytest.approx(default if limit is None else limit)
    assert (f"# s; GEAR_BOX came {every:.2f} s after the one before" in text) == (limit is not None)


def test_the_value_of_a_gear_is_written_with_all_its_digits(tmp_path: Path) -> None:
    wide = small_car.DBC.replace("BO_ 1027 GEAR_BOX: 2", "BO_ 1027 GEAR_BOX: 4").replace("GEAR : 0|4", "GEAR : 0|24")
    small_car.written(tmp_path, dbc=f'{wide}VAL_ 1027 GEAR 8388609 "R" 3 "D" ;\n')
    _, text = made([tmp_path / "car.dbc"], None, tmp_path)
    assert "reverse: {signal: GEAR_BOX.GEAR, in: [8388609]}" in text


@pytest.mark.parametrize("speed", [0.01, 0.3])
def test_the_noise_of_own_speed_is_measured(speed: float, tmp_path: Path) -> None:
    loaded = shipped("toyota_rav4").loaded
    tree = loaded.config.model_dump(by_alias=True, exclude_unset=True)
    tree["ego"]["noise"] = {"speed": speed}
    of = bind(replace(loaded, config=Config.model_validate(tree)))
    assert of.ego is not None
    dbcs = [Path(of.sensors[0].database.path), Path(of.ego.database.path)]
    found, text = made(dbcs, survey_log(of, tmp_path), tmp_path)
    assert found.ego is not None
    settings = found.ego.settings
    assert isinstance(settings, OdometrySettings)
    assert settings.noise.speed == pytest.approx(max(speed / 2, 0.03), rel=0.15)  # of the mean of four wheels
    assert ("slip and bumps" in text) == (speed < 0.06)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["multiplexed_radar", "ford_mrr_fd", "ford_mrr"])
def test_stranger_layouts_are_found_from_a_log(name: str, tmp_path: Path) -> None:
    of = shipped(name)
    log = survey_log(of, tmp_path)
    right, settings = of.sensors[0], of.sensors[0].settings
    assert of.ego is not None
    found, _ = made([Path(right.database.path), Path(of.ego.database.path)], log, tmp_path)
    sensor = found.sensors[0]
    for quantity, (signal, gain) in mapping(right).items():
        assert mapping(sensor)[quantity][0] == signal, quantity
        assert mapping(sensor)[quantity][1] == pytest.approx(gain), quantity
    assert sensor.settings.objects.slots == settings.objects.slots
    assert len(sensor.settings.objects.points) == len(settings.objects.points)
    assert (sensor.settings.looks is None) == (settings.looks is None)


@pytest.mark.slow
def test_the_recorded_drive_is_configured_by_its_public_files(drive: Path, tmp_path: Path) -> None:
    dbcs = [DATA / "dbc" / "toyota_adas.dbc", DATA / "dbc" / "toyota_nodsu_pt_generated.dbc"]
    _, text = made(dbcs, drive / "drive.log.gz", tmp_path)
    assert not any(guessed(text, key) for key in (*MEASURED, "yaw_rate", "left_wheels"))
    assert "reverse: {signal: GEAR_PACKET.GEAR, in: [16]}" in text  # the other gear of the file is a hybrid's
    summary = tmp_path / "summary.json"
    assert main(["replay", str(tmp_path / "made.yaml"), str(drive / "drive.log.gz"), "--summary", str(summary)]) == 0
    told = json.loads(summary.read_text())
    assert "tracker:" not in text
    half, second = told["predictions"]
    assert half["x"] <= 0.20
    assert second["x"] <= 0.30
    assert half["y"] <= 0.27
    assert second["y"] <= 0.37
    assert told["stationary"]["vx"] <= 0.27
    assert told["stationary"]["speed"] <= 0.45
    assert told["duplicates"]["share"] <= 0.05


@pytest.mark.parametrize(
    "text",
    [
        "".join(f"BO_ {n} M{n:x}: 8 X\n" for n in range(100_000)),
        "".join(f'BO_ {n} {"9a" * 60}{n}: 8 X\n SG_ {"x9" * 60}_{n} : 0|8@1+ (1,0) [0|0] "" X\n' for n in range(3000)),
        'BO_ 1 DOOR: 8 X\n SG_ OPEN : 0|1@1+ (1,0) [0|1] "" X\n',
    ],
    ids=["1e5 messages", "absurd names", "no radar"],
)
def test_a_file_without_a_radar_ends_with_a_word(text: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "strange.dbc"
    path.write_text(text, encoding="utf-8")
    begun = time.process_time()
    assert main(["init", str(path), "--yes"]) == 2
    assert time.process_time() - begun < 10
    told = capfd.readouterr().err
    assert "strange.dbc" in told
    assert "expected" in told


def test_an_edited_configuration_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, words = (
        tmp_path / "mine.yaml",
        ["init", str(ROOT / "dbc/esr.dbc"), "--yes", "-o", str(tmp_path / "mine.yaml")],
    )
    path.write_text("# edited\n", encoding="utf-8")
    assert main(words) == 2
    assert "it is there, and may have been edited; choose another name, or --force" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "# edited\n"
    assert main([*words, "--force"]) == 0
    assert GUESS in path.read_text(encoding="utf-8")
    command = [sys.executable, "-m", "candaemon", *words[:-1], "-"]
    with (tmp_path / "printed.yaml").open("wb") as stream:
        assert subprocess.run(command, stdout=stream, stderr=subprocess.DEVNULL, check=False).returncode == 0
    assert GUESS in (tmp_path / "printed.yaml").read_text(encoding="utf-8")


def test_words_of_a_table_of_values_are_taken_whole(tmp_path: Path) -> None:
    """An ESR's slots are empty by `no_target`, and predicted ones are in three ways."""
    found, _ = made([ROOT / "dbc" / "esr.dbc"], None, tmp_path)
    (valid,) = found.sensors[0].settings.objects.valid
    (right,) = shipped("esr_ins").sensors[0].settings.objects.valid
    assert (valid.signal, valid.values) == (right.signal, right.values)
    assert valid.values == (1.0, 2.0, 3.0, 5.0)


def test_names_alone_give_guesses_that_are_marked(tmp_path: Path) -> None:
    found, text = made([ROOT / "dbc" / "esr.dbc", ROOT / "dbc" / "oxts.dbc"], None, tmp_path)
    assert mapping(found.sensors[0])["azimuth"][0] == "CAN_TX_TRACK_ANGLE"
    assert all(guessed(text, key) for key in ("azimuth", "range_rate", "scan", "mount", "radar"))
