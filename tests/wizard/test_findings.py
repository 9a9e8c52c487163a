"""`candaemon check --log`: each mistake is found where it was made, and nothing is said of what is right."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.wizard.findings import LogFinding, findings
from tests.support import small_car
from tests.support.bound import binding as shipped
from tests.support.paths import ROOT
from tests.wizard.drives import survey_log

W = "WHEEL_SPEEDS.WHEEL_SPEED_F"

MISTAKES = {
    # name: configuration, what is replaced, by what, where it is found
    "side": ("toyota_rav4", "y: -LAT_DIST", "y: LAT_DIST", "signals.y"),
    "sense of the rate": ("toyota_rav4", "range_rate: REL_SPEED", "range_rate: -REL_SPEED", "signals.range_rate"),
    "unit of the rate": (
        "toyota_rav4",
        "range_rate: REL_SPEED",
        "range_rate: {signal: REL_SPEED, unit: km/h}",
        "signals.range_rate",
    ),
    "swapped places": (
        "toyota_rav4",
        "{x: LONG_DIST, y: -LAT_DIST",
        "{x: LAT_DIST, y: LONG_DIST",
        "signals.range_rate",
    ),
    "swapped rate": (
        "toyota_rav4",
        "range_rate: REL_SPEED",
        "range_rate: {signal: REL_ACCEL, unit: m/s}",
        "range_rate",
    ),
    "too few slots": ("toyota_rav4", "slots: 16", "slots: 12", "objects.slots"),
    "not the first slot": ("toyota_rav4", "slots: 16", "slots: 15\n      first: 1", "sensors.front"),
    "counter that is none": ("esr_ins", "signal: CAN_TX_TRACK_ROLLING_COUNT", "signal: CAN_TX_TRACK_WIDTH", "scan"),
    "channel": ("toyota_rav4", "radar: {channel: can1}", "radar: {channel: can7}", "buses.radar"),
    "swapped channels": (
        "toyota_rav4",
        "car: {channel: can0}\n  radar: {channel: can1}",
        "car: {channel: can1}\n  radar: {channel: can0}",
        "sensors.front.bus",
    ),
    "mounting": ("toyota_rav4", "mount: {x: 3.6}", "mount: {x: 3.6, yaw_deg: 8}", "mount.yaw_deg"),
    "looks back": ("toyota_rav4", "mount: {x: 3.6}", "mount: {x: -1, yaw_deg: 180}", "sensors.front"),
    "valid the other way": ("toyota_rav4", "{signal: VALID, in: [1]}", "{signal: VALID, in: [0]}", "sensors.front"),
    "valid never": (
        "toyota_rav4",
        "{signal: LONG_DIST, below: 255}",
        "{signal: LONG_DIST, above: 300}",
        "sensors.front",
    ),
    "new the other way": (
        "toyota_rav4",
        "new: [{signal: NEW_TRACK, in: [1]}]",
        "new: [{signal: NEW_TRACK, in: [0]}]",
        "new",
    ),
    "noise too small": (
        "toyota_rav4",
        "noise: {x: 0.1, y: 0.04, range_rate: 0.035}",
        "noise: {x: 0.01, y: 0.01, range_rate: 0.006}",
        "noise",
    ),
    "noise too large": (
        "toyota_rav4",
        "noise: {x: 0.1, y: 0.04, range_rate: 0.035}",
        "noise: {x: 1, y: 1, range_rate: 0.6}",
        "noise",
    ),
    "kind of checksum": ("toyota_rav4", "kind: toyota", "kind: xor", "protection"),
    "cycle time": ("toyota_rav4", "cycle_time: 0.05", "cycle_time: 0.1", "cycle_time"),
    "sign of the yaw rate": (
        "esr_ins",
        "curvature: -TrackSlipCurvature.Curvature",
        "yaw_rate: {signal: TrackSlipCurvature.Curvature, unit: rad/s, scale: 14}",
        "signals",
    ),
    "unit of own speed": (
        "toyota_rav4",
        f"left_wheels: [{W}L, {W[:-1]}RL]\n    right_wheels: [{W}R, {W[:-1]}RR]",
        "speed: {signal: WHEEL_SPEEDS.WHEEL_SPEED_FL, unit: mph}",
        "ego",
    ),
    "time-out": ("toyota_rav4", "timeout: 0.035", "timeout: 0.004", "sensors.front"),
    "header's count": ("ars408", "count: Obj_NofObjects", "count: Obj_InterfaceVersion", "scan"),
    "unit of the angle": (
        "esr_ins",
        "azimuth: -CAN_TX_TRACK_ANGLE",
        "azimuth: {signal: CAN_TX_TRACK_ANGLE, unit: deg, scale: -0.3}",
        "azimuth",
    ),
}


STALE = {
    # name: configuration, its DBC file, what an older edition has elsewhere (a pattern), how, where it is found
    "place": (
        "toyota_rav4",
        "toyota_rav4_radar",
        r"(SG_ LONG_DIST : )15",
        r"\g<1>14",
        "signals.range_rate",
    ),
    "scale ahead": ("toyota_rav4", "toyota_rav4_radar", r"(LONG_DIST .*)\(0.01,", r"\1(0.05,", "range_rate"),
    "scale across": ("toyota_rav4", "toyota_rav4_radar", r"(LAT_DIST .*)\(0.04,", r"\1(0.08,", "signals.y"),
    "sign": ("esr_ins", "esr", r"(SG_ CAN_TX_TRACK_ANGLE .*@\d)-", r"\1+", "plausibility"),
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Logs of the survey drive that were simulated so far, by configuration."""
    return {}


def log_of(name: str, logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    if name not in logs:
        logs[name] = survey_log(shipped(name), tmp_path_factory.mktemp(name))
    return logs[name]


def spoilt(name: str, right: str, wrong: str, folder: Path) -> Path:
    """Write a configuration with a mistake."""
    text = (ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    assert right in text
    path = folder / "spoilt.yaml"
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_found(
    mistake: str, logs: dict[str, Path], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    name, right, wrong, where = MISTAKES[mistake]
    path = spoilt(name, right, wrong, tmp_path)
    found = findings(bind(load_config(path)), [log_of(name, logs, tmp_path_factory)])
    assert any(where in ".".join(map(str, each.where)) for each in found), [str(each) for each in found]


@pytest.mark.slow
@pytest.mark.parametrize("stale", STALE)
def test_a_stale_database_is_found(
    stale: str, logs: dict[str, Path], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    name, file, right, wrong, where = STALE[stale]
    dbc = tmp_path / "stale.dbc"
    text = (ROOT / "dbc" / f"{file}.dbc").read_text(encoding="utf-8")
    dbc.write_text(re.sub(right, wrong, text), encoding="utf-8")
    path = spoilt(name, str(ROOT / "dbc" / f"{file}.dbc"), str(dbc), tmp_path)
    found = findings(bind(load_config(path)), [log_of(name, logs, tmp_path_factory)])
    assert any(where in ".".join(map(str, each.where)) for each in found), [str(each) for each in found]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["toyota_rav4", "ars408", "esr_ins", "acura_ilx", "tesla_continental"])
def test_nothing_is_said_of_what_is_right(
    name: str, logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> None:
    assert findings(shipped(name), [log_of(name, logs, tmp_path_factory)]) == []


def test_nothing_is_said_of_own_speed_where_nothing_stands_and_cars_are_followed(tmp_path: Path) -> None:
    log = tmp_path / "highway.log"
    assert main(["simulate", "highway", "esr_ins", "-o", str(log)]) == 0
    assert findings(shipped("esr_ins"), [log]) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "log"), [("toyota_rav4", "drive.log.gz"), ("toyota_rav4_ins", "drive_with_ins.log.gz")]
)
def test_nothing_is_said_of_the_recorded_drive(name: str, log: str, drive: Path) -> None:
    assert findings(shipped(name), [drive / log]) == []


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [20, 45, 90, -60])
def test_the_mounting_is_said_to_be_turned_by_as_much_as_it_is(yaw_deg: int, drive: Path, tmp_path: Path) -> None:
    path = spoilt("toyota_rav4", "mount: {x: 3.6}", f"mount: {{x: 3.6, yaw_deg: {yaw_deg}}}", tmp_path)
    (found,) = findings(bind(load_config(path)), [drive / "drive.log.gz"])
    told = re.search(r"add (-?[\d.]+) to yaw_deg", str(found))
    assert told is not None
    assert float(told[1]) == pytest.approx(-yaw_deg, abs=3.0)


@pytest.mark.slow
def test_a_yaw_rate_in_a_unit_far_too_large_is_found_though_nothing_moves_by_it(drive: Path, tmp_path: Path) -> None:
    rate = "yaw_rate: {signal: KINEMATICS.YAW_RATE, unit: rad/s}"
    path = spoilt("toyota_rav4", "yaw_rate: KINEMATICS.YAW_RATE", rate, tmp_path)
    (found,) = findings(bind(load_config(path)), [drive / "drive.log.gz"])
    assert "of own turns: its unit, or that of the yaw rate" in str(found)


def test_the_command_names_the_line_and_repeats_guesses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = survey_log(shipped("gm_lrr"), tmp_path)
    path = spoilt("gm_lrr", "cycle_time: 0.0714", "cycle_time: 0.2 # guess: nobody knows", tmp_path)
    assert main(["check", str(path), "--log", str(log)]) == 0
    told = capsys.readouterr().out
    line = (
        path.read_text(encoding="utf-8")
        .splitlines()
        .index("    cycle_time: 0.2 # guess: nobody knows # 14 scans a second")
    )
    assert f"spoilt.yaml:{line + 1}" in told
    assert "sensors.front.cycle_time: found 0.2 s, but scans came every 0.07" in told
    assert "nobody knows" in told


def test_nothing_is_said_of_slots_that_a_header_does_not_count(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    assert main(["simulate", "turning_ego", "ford_mrr_fd", "-o", str(log)]) == 0
    assert findings(shipped("ford_mrr_fd"), [log]) == []


IN_PARTS = small_car.DBC.replace(
    ' SG_ DIST_LONG : 8|12@1+ (0.0625,0) [0|255] "m" CAR\n SG_ DIST_LAT : 20|12@1- (0.03125,0) [-64|63] "m" CAR\n',
    ' SG_ PART M : 6|2@1+ (1,0) [0|3] "" CAR\n'
    ' SG_ DIST_LONG m0 : 8|12@1+ (0.0625,0) [0|255] "m" CAR\n'
    ' SG_ DIST_LAT m0 : 20|12@1- (0.03125,0) [-64|63] "m" CAR\n',
).replace("SG_ REL_SPEED : 32|12", "SG_ REL_SPEED m1 : 32|12")
BY_NUMBER = "".join(
    f' SG_ R{k:02d} m{k} : 8|12@1+ (0.0625,0) [0|255] "m" CAR\n'
    f' SG_ A{k:02d} m{k} : 20|12@1- (0.05,0) [-100|100] "deg" CAR\n'
    f' SG_ V{k:02d} m{k} : 32|12@1- (0.0625,0) [-128|127] "m/s" CAR\n'
    f' SG_ C{k:02d} m{k} : 44|4@1+ (1,0) [0|15] "" CAR\n'
    for k in range(16)
)


def test_nothing_is_said_of_a_count_of_objects_in_parts(tmp_path: Path) -> None:
    parts = ", ".join(f"{{message: OBJECT, id_signal: INDEX, when: {{PART: {part}}}}}" for part in (0, 1))
    yaml = small_car.YAML.replace("{message: OBJECT, id_signal: INDEX}", parts)
    config = small_car.written(tmp_path, yaml, IN_PARTS)
    assert contradictions(config, tmp_path) == []


def test_nothing_is_said_of_a_counter_that_each_slot_has(tmp_path: Path) -> None:
    before, _, after = small_car.DBC.partition("BO_ 1025")
    index = 'BO_ 1025 OBJECT: 8 CAR\n SG_ INDEX M : 0|4@1+ (1,0) [0|15] "" CAR\n'
    dbc = before + index + BY_NUMBER + after[after.index("BO_ 1026") :]
    yaml = re.sub("scan: .*", 'scan: {close: counter, signal: "C{slot:02d}"}', small_car.YAML)
    yaml = re.sub(
        "signals: {x.*", 'signals: {range: "R{slot:02d}", azimuth: "A{slot:02d}", range_rate: "V{slot:02d}"}', yaml
    )
    yaml = re.sub("noise: .*", "noise: {range: 0.15, azimuth_deg: 0.5, range_rate: 0.12}", yaml)
    yaml = re.sub("      (valid|new): .*\n", "", yaml)
    config = small_car.written(tmp_path, yaml, dbc)
    assert contradictions(config, tmp_path) == []


def contradictions(config: Path, folder: Path) -> list[str]:
    """Return what is said of a configuration by a log that was simulated by it."""
    log = folder / "drive.log"
    assert main(["simulate", "guard_rail", str(config), "-o", str(log)]) == 0
    return [each.text for each in findings(bind(load_config(config)), [log])]


def short_town(folder: Path) -> str:
    """Write the first seconds of traffic in a town; return the scenario's path."""
    text = (ROOT / "config" / "scenarios" / "traffic_town.yaml").read_text(encoding="utf-8")
    path = folder / "scene.yaml"
    path.write_text(re.sub(r"duration: \d+", "duration: 6", text, count=1), encoding="utf-8")
    return str(path)


def two_radars(offsets: tuple[int, int], folder: Path) -> Path:
    """Simulate a drive with two radars of one kind; return the log."""
    before, front = small_car.YAML.split("  front:\n")
    mounts = "mount: {x: 3.6}", "mount: {x: -1, yaw_deg: 180}"
    radars = [
        front.replace("mount: {x: 3.6}", f"{mount}\n    id_offset: {offset}")
        for mount, offset in zip(mounts, offsets, strict=True)
    ]
    both = small_car.written(folder, f"{before}  front:\n{radars[0]}  rear:\n{radars[1]}")
    log = folder / "drive.log"
    assert main(["simulate", short_town(folder), str(both), "-o", str(log)]) == 0
    assert not twins(both, log)
    return log


def twins(config: Path, log: Path) -> list[LogFinding]:
    """Return what is said of further devices."""
    return [each for each in findings(bind(load_config(config)), [log]) if "id_offset" in each.text]


@pytest.mark.parametrize(
    ("of", "other", "written"),
    [(0, 0x10, "0x10"), (0x30, 0x10, "0x10"), (0x10, -0x10, "-0x10"), (0, -0x80, "-0x80"), (-0x80, -0xA0, "-0xa0")],
)
def test_a_second_device_of_a_kind_is_told_until_it_has_a_sensor(
    of: int, other: int, written: str, tmp_path: Path
) -> None:
    log = two_radars((of, other), tmp_path)
    mount = "mount: {x: 3.6}"
    of_one = small_car.YAML.replace(mount, f"{mount}\n    id_offset: {of}")
    (told,) = twins(small_car.written(tmp_path, of_one), log)
    assert told.where == ("sensors", "front")
    before, _, cure = told.text.partition("Give that a sensor with ")
    assert before
    assert cure == f"id_offset: {written}"
    cured = small_car.written(tmp_path, small_car.YAML.replace(mount, f"{mount}\n    {cure}"))
    assert load_config(cured).config.sensors["front"].id_offset == other


@pytest.mark.parametrize(("slower", "told"), [(1.1, True), (1.4, False), (2.5, False), (0.7, False), (0.4, False)])
def test_what_comes_at_another_rate_is_no_second_device(slower: float, told: bool, tmp_path: Path) -> None:
    """Strange messages of the same lengths, as far apart as the radar's: by chance, where a bus is full."""
    config, log = small_car.written(tmp_path), tmp_path / "drive.log"
    assert main(["simulate", short_town(tmp_path), str(config), "-o", str(log)]) == 0
    frames = [(float(line[1 : line.index(")")]), line) for line in log.read_text(encoding="utf-8").splitlines()]
    (begun, _), (over, _) = frames[0], frames[-1]
    strange = [
        ((time - begun + again * (over - begun)) * slower + begun, line.replace(" 40", " 48"))
        for again in range(3)
        for time, line in frames
        if " 400#" in line or " 401#" in line
    ]
    ordered = sorted([*frames, *(each for each in strange if each[0] < over)])
    lines = [f"({time:.6f}) {line.partition(') ')[2]}" for time, line in ordered]
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert bool(twins(config, log)) == told
