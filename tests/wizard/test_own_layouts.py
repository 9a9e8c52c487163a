"""Layouts that no shipped configuration has: `init` is told nothing of them but their DBC file and a log."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bind_signal import UNITS, normalised_unit
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.stream import LogCounts
from candaemon.cli.main import main
from candaemon.config.ego import InsSettings
from candaemon.config.load import load_config
from candaemon.config.sensors import HeaderScan
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.layouts import find_unnumbered
from candaemon.wizard.object_table import FEWEST_LISTED, object_table
from candaemon.wizard.traffic import LogTraffic, Stream
from tests.support import small_car
from tests.support.paths import ROOT
from tests.wizard.drives import survey_log

HEAD = """\
VERSION ""
NS_ :
BS_:
BU_: RADAR CAR
"""
YAML = """\
name: a layout of its own
buses:
  radar: {{channel: can1}}
  ins: {{channel: can2}}
ego:
  kind: ins
  bus: ins
  dbc: {root}/dbc/oxts.dbc
  signals:
    velocity_north: Velocity.VelNorth
    velocity_east: Velocity.VelEast
    heading: HeadingPitchRoll.AngleHeading
    curvature: -TrackSlipCurvature.Curvature
sensors:
  front:
    bus: radar
    dbc: own.dbc
    mount: {{x: 3.6}}
    cycle_time: 0.05
    timeout: 0.03
{sensor}
    field_of_view: {{range: 120, azimuth_deg: 50}}
"""


def drawn_up(folder: Path, dbc: str, sensor: str) -> tuple[Binding, Binding, str]:
    """Simulate a layout, and let `init` find it; return what is, what was found, and the text of that."""
    (folder / "own.dbc").write_text(HEAD + dbc, encoding="utf-8")
    (folder / "own.yaml").write_text(YAML.format(root=ROOT, sensor=sensor), encoding="utf-8")
    of = bind(load_config(folder / "own.yaml"))
    log = survey_log(of, folder)
    path = folder / "found.yaml"
    dbcs = [folder / "own.dbc", ROOT / "dbc" / "oxts.dbc"]
    assert main(["init", *map(str, dbcs), "--log", str(log), "--yes", "-o", str(path)]) == 0
    return of, bind(load_config(path)), path.read_text(encoding="utf-8")


def same_signals(of: Binding, found: Binding) -> None:
    """Require that each quantity comes from its signal, with its unit and sign."""
    wanted = {each.quantity: (each.signal.name, each.gain) for each in of.sensors[0].reader.bindings}
    made = {each.quantity: (each.signal.name, each.gain) for each in found.sensors[0].reader.bindings}
    for quantity, (signal, gain) in wanted.items():
        assert made[quantity][0] == signal, quantity
        assert made[quantity][1] == pytest.approx(gain), quantity


@pytest.mark.slow
def test_a_list_without_numbers_is_found(tmp_path: Path) -> None:
    of, found, text = drawn_up(
        tmp_path,
        """
BO_ 512 LIST_BEGIN: 4 RADAR
 SG_ AMOUNT : 0|6@1+ (1,0) [0|63] "" CAR
 SG_ TICK : 8|8@1+ (1,0) [0|255] "" CAR

BO_ 513 ECHO: 8 RADAR
 SG_ RANGE : 0|14@1+ (0.02,0) [0|327] "m" CAR
 SG_ ANGLE : 14|12@1- (0.05,0) [-102|102] "" CAR
 SG_ DOPPLER : 26|13@1- (0.02,0) [-81|81] "m/s" CAR
""",
        """\
    objects: {messages: [{message: ECHO, id_signal: false}], slots: 40, identity: false}
    scan: {close: header, message: LIST_BEGIN, count: AMOUNT, counter: TICK}
    signals: {range: RANGE, azimuth: {signal: -ANGLE, unit: deg}, range_rate: -DOPPLER}
    noise: {range: 0.2, azimuth_deg: 0.4, range_rate: 0.1}""",
    )
    same_signals(of, found)
    objects = found.sensors[0].settings.objects
    assert objects.messages[0].id_signal is False
    assert objects.identity is False
    assert found.sensors[0].settings.scan == of.sensors[0].settings.scan
    assert found.sensors[0].settings.cycle_time == pytest.approx(0.05, rel=0.02)
    assert "guess: half as many again" in text


UNNUMBERED = """BO_ 513 ECHO: 8 RADAR
 SG_ RANGE : 0|14@1+ (0.02,0) [0|327] "m" CAR
 SG_ ANGLE : 14|12@1- (0.05,0) [-102|102] "deg" CAR
 SG_ DOPPLER : 26|13@1- (0.02,0) [-81|81] "m/s" CAR
 SG_ STATE : 39|2@1+ (1,0) [0|3] "" CAR
VAL_ 513 STATE 0 "invalid" 1 "new" 2 "measured" 3 "predicted" ;
"""


def test_nothing_is_new_in_a_list_without_numbers(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(HEAD + UNNUMBERED, encoding="utf-8")
    out = tmp_path / "found.yaml"
    assert main(["init", str(tmp_path / "own.dbc"), "-o", str(out)]) == 0
    assert main(["check", str(out)]) == 0
    objects = load_config(out).config.sensors["front"].objects
    assert objects.identity is False
    assert [condition.values for condition in objects.valid] == [(1.0, 2.0)]
    assert not objects.new


def test_a_message_that_comes_alone_is_no_list() -> None:
    message = MessageSpec("ECHO", 513, 8, (SignalSpec("RANGE", 0, 14), SignalSpec("ANGLE", 14, 12)))
    (layout,) = find_unnumbered([message])
    assert layout.unnumbered

    def tabled(burst: int) -> int | None:
        """Return the slots of a list with so many frames in each of 100 bursts."""
        time = (np.arange(100)[:, None] * 0.05 + np.arange(burst) * 0.001).ravel()
        count = len(time)
        stream = Stream(time, np.arange(count), np.full(count, 8, np.uint8), np.ones((count, 8), np.uint8), False)
        traffic = LogTraffic((Path("a.log"),), ("can0",), {(0, 513): stream}, 5.0, LogCounts())
        table = object_table(layout, traffic)
        return None if table is None else table.layout.slots

    assert tabled(FEWEST_LISTED) == 8
    assert tabled(12) == 32
    assert tabled(FEWEST_LISTED - 1) is None


OBJECTS = "".join(
    f"""
BO_ {512 + k} OBJ_{k:02d}: 8 RADAR
 SG_ STATE_{k:02d} : 0|2@1+ (1,0) [0|3] "" CAR
 SG_ RNG_{k:02d} : 2|14@1+ (0.02,0) [0|327] "m" CAR
 SG_ AZ_{k:02d} : 16|12@1- (0.05,0) [-102|102] "deg" CAR
 SG_ RATE_{k:02d} : 28|13@1- (0.02,0) [-81|81] "{{unit}}" CAR
 SG_ ROLL_{k:02d} : 48|4@1+ (1,0) [0|15] "" CAR
"""
    for k in range(20)
)


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "sign"), [("m/s", ""), ("m/s", "-")])
def test_range_rates_over_ground_are_found(tmp_path: Path, unit: str, sign: str) -> None:
    of, found, text = drawn_up(
        tmp_path,
        OBJECTS.replace("{unit}", unit),
        f"""\
    objects:
      messages: ["OBJ_{{slot:02d}}"]
      slots: 20
      valid: [{{signal: "STATE_{{slot:02d}}", in: [2]}}]
      new: [{{signal: "STATE_{{slot:02d}}", in: [1]}}]
    scan: {{close: counter, signal: "ROLL_{{slot:02d}}"}}
    latency: 0.08
    signals: {{range: "RNG_{{slot:02d}}", azimuth: "AZ_{{slot:02d}}", range_rate: "{sign}RATE_{{slot:02d}}"}}
    range_rates: absolute
    noise: {{range: 0.2, azimuth_deg: 0.4, range_rate: 0.1}}""".replace("in: [2]", "in: [1, 2]"),
    )
    same_signals(of, found)
    assert found.sensors[0].settings.range_rates == "absolute"
    assert "the distance changes by it and the way driven" in text
    assert "s, calibrated on what stands, ±" in text
    assert found.sensors[0].settings.latency == pytest.approx(0.08, abs=0.02)
    noise = found.sensors[0].settings.noise
    assert noise.range == pytest.approx(0.2, rel=0.25)
    assert noise.azimuth_deg == pytest.approx(0.4, rel=0.25)


@pytest.mark.slow
def test_velocities_over_ground_are_found(tmp_path: Path) -> None:
    of, found, _ = drawn_up(
        tmp_path,
        OBJECTS.replace("RNG_", "LONG_DIST_")
        .replace("AZ_", "LAT_DIST_")
        .replace('(0.05,0) [-102|102] "deg"', '(0.05,0) [-102|102] "m"')
        .replace("RATE_", "LONG_SPEED_")
        .replace("{unit}", "m/s"),
        """\
    objects:
      messages: ["OBJ_{slot:02d}"]
      slots: 20
      valid: [{signal: "STATE_{slot:02d}", in: [1, 2]}]
      new: [{signal: "STATE_{slot:02d}", in: [1]}]
    scan: {close: counter, signal: "ROLL_{slot:02d}"}
    signals: {x: "LONG_DIST_{slot:02d}", y: "-LAT_DIST_{slot:02d}", vx: "LONG_SPEED_{slot:02d}"}
    rates: absolute
    noise: {x: 0.2, y: 0.3, vx: 0.1}""",
    )
    same_signals(of, found)
    assert found.sensors[0].settings.rates == "absolute"


INS = """VERSION ""
BU_: INS
BO_ 2566844672 GNSS_VEL: 8 INS
 SG_ VelN : 0|16@1- (0.01,0) [-327|327] "m/s" INS
 SG_ VelE : 16|16@1- (0.01,0) [-327|327] "m/s" INS
 SG_ VelD : 32|16@1- (0.01,0) [-327|327] "m/s" INS
BO_ 2566844673 ATTITUDE: 8 INS
 SG_ Roll : 0|16@1- (0.01,0) [-180|180] "deg" INS
 SG_ Heading : 32|16@1+ (0.01,0) [0|360] "deg" INS
BO_ 2566844674 RATES: 8 INS
 SG_ RateX : 0|16@1- (0.01,0) [-327|327] "deg/s" INS
 SG_ RateZ : 32|16@1- (0.01,0) [-327|327] "deg/s" INS
BO_ 2566844675 PLACE: 8 INS
 SG_ Lat : 0|32@1- (1e-07,0) [-90|90] "deg" INS
 SG_ Lon : 32|32@1- (1e-07,0) [-180|180] "deg" INS
"""
INS_SIGNALS = """ego:
  kind: ins
  bus: car
  dbc: ins.dbc
  signals:
    velocity_north: GNSS_VEL.VelN
    velocity_east: GNSS_VEL.VelE
    heading: ATTITUDE.Heading
    latitude: PLACE.Lat
    longitude: PLACE.Lon
    yaw_rate: -RATES.RateZ
"""


def test_an_ins_is_found_by_letters_of_its_axes_and_its_rate_by_the_log(tmp_path: Path) -> None:
    (tmp_path / "ins.dbc").write_text(INS, encoding="utf-8")
    before, _, after = small_car.YAML.partition("ego:")
    yaml = before + INS_SIGNALS + after[after.index("sensors:") :]
    config, log = small_car.written(tmp_path, yaml), tmp_path / "drive.log"
    assert main(["simulate", "turning_ego", str(config), "-o", str(log)]) == 0
    out = tmp_path / "found.yaml"
    dbcs = [str(tmp_path / "car.dbc"), str(tmp_path / "ins.dbc")]
    assert main(["init", *dbcs, "--log", str(log), "-o", str(out)]) == 0
    found, expected = load_config(out).config.ego, load_config(config).config.ego
    assert isinstance(found, InsSettings)
    assert isinstance(expected, InsSettings)
    assert found.signals == expected.signals


def test_dbc_files_without_own_motion_are_named(tmp_path: Path) -> None:
    small_car.written(tmp_path, dbc=small_car.DBC.replace("SPEED : 0|16", "V1 : 0|16").replace("YAW_RATE", "V2"))
    out = tmp_path / "found.yaml"
    assert main(["init", str(tmp_path / "car.dbc"), "-o", str(out)]) == 0
    assert "no signals of own motion found in car.dbc: give the DBC file of the car or INS" in out.read_text()


def test_a_table_of_values_tells_objects_without_a_log(tmp_path: Path) -> None:
    table = 'VAL_ 1025 STATUS 0 "No target" 1 "New" 2 "Measured" 3 "Signal not available" ;\n'
    small_car.written(tmp_path, dbc=small_car.DBC + table)
    out = tmp_path / "found.yaml"
    assert main(["init", str(tmp_path / "car.dbc"), "-o", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert (
        "- {signal: STATUS, in: [1, 2]} # guess: by the DBC's table of values, which has 0 No target, 3 Signal not"
        in text
    )
    assert "new:\n        - {signal: STATUS, in: [1]} # guess: by the DBC's table of values" in text
    objects = load_config(out).config.sensors["front"].objects
    assert [condition.values for condition in (*objects.valid, *objects.new)] == [(1.0, 2.0), (1.0,)]


def test_a_table_of_special_values_tells_nothing_of_slots(tmp_path: Path) -> None:
    table = 'VAL_ 1025 DIST_LONG 4095 "invalid" 4094 "init" ;\n'
    small_car.written(tmp_path, dbc=small_car.DBC + table)
    out = tmp_path / "found.yaml"
    assert main(["init", str(tmp_path / "car.dbc"), "-o", str(out)]) == 0
    objects = load_config(out).config.sensors["front"].objects
    assert not objects.valid
    assert not objects.new


@pytest.mark.parametrize("logged", [False, True])
def test_a_state_is_taken_and_no_deviation_or_probability(logged: bool, tmp_path: Path) -> None:
    """ARS408: deviations and the probability of existence have the value `invalid`, too."""
    log, out = tmp_path / "drive.log", tmp_path / "found.yaml"
    if logged:
        assert main(["simulate", "turning_ego", "ars408", "-o", str(log)]) == 0
    dbcs = [str(ROOT / "dbc" / name) for name in ("ars408.dbc", "oxts.dbc")]
    assert main(["init", *dbcs, *(["--log", str(log)] if logged else []), "-o", str(out)]) == 0
    objects = load_config(out).config.sensors["front"].objects
    (valid,) = objects.valid
    assert valid.signal == "Obj_MeasState"
    assert set(valid.values or ()) <= {1.0, 2.0, 5.0}
    assert valid.values
    assert {each.signal for each in objects.new} <= {"Obj_MeasState"}
    assert "Obj_DistLong_rms" not in out.read_text(encoding="utf-8")


def test_a_table_of_values_tells_objects_where_no_slot_of_the_log_is_empty(tmp_path: Path) -> None:
    tracks = [
        f"BO_ {1040 + k} TRACK_{k}: 8 CAR\n"
        ' SG_ STATUS : 0|3@1+ (1,0) [0|7] "" CAR\n'
        ' SG_ LONG_DIST : 8|12@1+ (0.0625,0) [0|255] "m" CAR\n'
        ' SG_ LAT_DIST : 20|12@1- (0.03125,0) [-64|63] "m" CAR\n'
        ' SG_ REL_SPEED : 32|12@1- (0.0625,0) [-128|127] "m/s" CAR\n'
        ' SG_ COUNT : 48|4@1+ (1,0) [0|15] "" CAR\n'
        for k in range(4)
    ]
    tables = [f'VAL_ {1040 + k} STATUS 0 "empty" 1 "new" 2 "measured" 3 "coasted" ;\n' for k in range(4)]
    text = small_car.YAML.replace("[{message: OBJECT, id_signal: INDEX}]", '["TRACK_{slot}"]').replace(
        "slots: 16", "slots: 4"
    )
    text = text.replace(
        "{close: header, message: HEADER, count: COUNT, counter: COUNTER}", "{close: counter, signal: COUNT}"
    )
    text = text.replace("DIST_LONG", "LONG_DIST").replace("DIST_LAT", "LAT_DIST")
    before, _, after = small_car.DBC.partition("BO_ 1024")
    dbc = before + "".join(tracks) + after[after.index("BO_ 1026") :] + "".join(tables)
    config, log, out = small_car.written(tmp_path, text, dbc), tmp_path / "drive.log", tmp_path / "found.yaml"
    scene = (ROOT / "config" / "scenarios" / "traffic_town.yaml").read_text(encoding="utf-8")
    (tmp_path / "scene.yaml").write_text(re.sub(r"duration: \d+", "duration: 8", scene), encoding="utf-8")
    assert main(["simulate", str(tmp_path / "scene.yaml"), str(config), "-o", str(log)]) == 0
    assert main(["init", str(tmp_path / "car.dbc"), "--log", str(log), "-o", str(out)]) == 0
    objects = load_config(out).config.sensors["front"].objects
    assert [condition.values for condition in (*objects.valid, *objects.new)] == [(1.0, 2.0), (1.0,)]


@pytest.mark.parametrize("suffix", ["asc", "blf", "trc", "csv", "pcapng"])
def test_a_log_of_any_format_is_taken(suffix: str, tmp_path: Path) -> None:
    config, recorded = small_car.written(tmp_path), tmp_path / "drive.log"
    log, out = tmp_path / f"drive.{suffix}", tmp_path / "found.yaml"
    assert main(["simulate", "turning_ego", str(config), "-o", str(recorded)]) == 0
    assert main(["convert", str(recorded), str(log)]) == 0
    assert main(["init", str(tmp_path / "car.dbc"), "--log", str(log), "-o", str(out)]) == 0
    (bus,) = load_config(out).config.buses.values()
    assert bus.names_in_logs == {"csv": ("can0", "none"), "pcapng": ("can0",)}.get(suffix, ("can0", "0"))
    assert main(["replay", str(out), str(log)]) == 0


@pytest.mark.parametrize("logged", [False, True])
@pytest.mark.parametrize(
    ("length", "speed", "x", "rate"),
    [
        ("m", "m/s", 1.0, 1.0),
        ("ft", "ft/s", 0.3048, 0.3048),
        ("m", "cm/s", 1.0, 0.01),
        ("furlong", "furlong/week", 1.0, 1.0),
    ],
)
def test_what_init_writes_of_any_unit_can_be_used(
    logged: bool, length: str, speed: str, x: float, rate: float, tmp_path: Path
) -> None:
    config, log, out = small_car.written(tmp_path), tmp_path / "drive.log", tmp_path / "found.yaml"
    assert main(["simulate", "turning_ego", str(config), "-o", str(log)]) == 0
    lines = small_car.DBC.splitlines(keepends=True)
    ours = [re.sub('"m"', f'"{length}"', line) if "DIST" in line else line for line in lines]
    ours = [re.sub('"m/s"', f'"{speed}"', line) if "REL_SPEED" in line else line for line in ours]
    small_car.written(tmp_path, dbc="".join(ours))
    words = ["--log", str(log)] if logged else []
    assert main(["init", str(tmp_path / "car.dbc"), *words, "-o", str(out)]) == 0
    bindings = {each.quantity: each for each in bind(load_config(out)).sensors[0].reader.bindings}
    if not logged:  # a log shows that the unit is wrong, as it is here
        assert (bindings["x"].gain, bindings["range_rate"].gain) == pytest.approx((x, rate))


@pytest.mark.parametrize("long", ["1024 HEADER", "1025 OBJECT", "1026 MOTION"])
def test_a_bus_of_long_messages_is_can_fd_without_a_log(long: str, tmp_path: Path) -> None:
    header = small_car.DBC.replace(" SG_ COUNT :", " SG_ ROLLING_COUNT_OF_OBJECTS :")
    dbc = header.replace(f"BO_ {long}: 8", f"BO_ {long}: 16")
    assert dbc != header
    small_car.written(tmp_path, dbc=dbc)
    out = tmp_path / "found.yaml"
    assert main(["init", str(tmp_path / "car.dbc"), "-o", str(out)]) == 0
    bound = bind(load_config(out))
    assert isinstance(bound.sensors[0].settings.scan, HeaderScan)
    assert bound.ego is not None
    assert bound.buses[bound.sensors[0].bus].settings.fd == ("MOTION" not in long)
    assert bound.buses[bound.ego.bus].settings.fd == ("MOTION" in long)


def test_a_list_whose_numbers_are_places_is_closed_by_counts_that_add_up(tmp_path: Path) -> None:
    """ARS408 in cluster mode: the header counts near and far ones, and a cluster's number is its place in the list."""
    log, out = tmp_path / "drive.log", tmp_path / "found.yaml"
    assert main(["simulate", "traffic_town", "ars408_clusters", "-o", str(log)]) == 0
    dbcs = [str(ROOT / "dbc" / name) for name in ("ars408_clusters.dbc", "oxts.dbc")]
    assert main(["init", *dbcs, "--log", str(log), "-o", str(out)]) == 0
    sensor = load_config(out).config.sensors["front"]
    assert sensor.objects.identity is False
    assert isinstance(sensor.scan, HeaderScan)
    assert sensor.scan.count == ("Cluster_NofClustersNear", "Cluster_NofClustersFar")
    assert sensor.scan.counter == "Cluster_MeasCounter"


SIGNALS = "BO_ {number} OBJ{slot}: 8 RADAR\n{signals}"


def told_by_names(folder: Path, *signals: str, tables: str = "") -> str:
    """Return what `init` writes of four objects with these signals, without a log; it can be used."""
    lines = "".join(f" SG_ {signal} CAR\n" for signal in signals)
    messages = [SIGNALS.format(number=600 + slot, slot=slot, signals=lines) for slot in range(4)]
    (folder / "own.dbc").write_text(HEAD + "".join(messages) + tables, encoding="utf-8")
    found = folder / "found.yaml"
    assert main(["init", str(folder / "own.dbc"), "-o", str(found), "--yes"]) == 0
    bind(load_config(found))
    return found.read_text(encoding="utf-8")


ASIDE = 'Angle : 16|16@1- (0.01,0) [-90|90] "deg"'
AHEAD = 'DistX : 0|16@1+ (0.01,0) [0|0] "m"', 'DistY : 16|16@1- (0.01,0) [0|0] "m"'


def test_a_distance_ahead_beside_a_direction_is_a_guess(tmp_path: Path) -> None:
    told = told_by_names(tmp_path, 'LongDist : 0|16@1+ (0.01,0) [0|300] "m"', ASIDE)
    assert "range: LongDist # guess: by name; called a distance ahead" in told


def test_values_that_are_no_measurement_by_the_table_are_not_known(tmp_path: Path) -> None:
    tables = "".join(f'VAL_ {600 + slot} DistX 65535 "Invalid" 65534 "SNA" 7 "near" ;\n' for slot in range(4))
    told = told_by_names(tmp_path, *AHEAD, tables=tables)
    assert "x: {signal: DistX, unknown_raw: [65535, 65534]} # by name; not known where the DBC's table says" in told


@pytest.mark.parametrize(
    ("name", "told"),
    [("SinAzimuth", "{signal: SinAzimuth, form: sine}"), ("TanAngle", "{signal: TanAngle, form: slope}")],
)
def test_sine_and_slope_are_told_by_the_name(tmp_path: Path, name: str, told: str) -> None:
    cosine = 'CosAzimuth : 48|16@1- (0.0001,0) [0|0] ""'
    signals = cosine, 'Range : 0|16@1+ (0.01,0) [0|0] "m"', f'{name} : 16|16@1- (0.0001,0) [0|0] ""'
    assert f"azimuth: {told} # guess" in told_by_names(tmp_path, *signals)


def test_of_two_speeds_the_relative_one_is_taken(tmp_path: Path) -> None:
    absolute = 'AbsVelX : 32|16@1- (0.01,0) [0|0] "m/s"'
    both = told_by_names(tmp_path, *AHEAD, absolute, 'RelVelX : 48|16@1- (0.01,0) [0|0] "m/s"')
    assert "vx: RelVelX" in both
    assert "absolute" not in both
    found = tmp_path / "found.yaml"
    found.unlink()
    alone = told_by_names(tmp_path, *AHEAD, absolute)
    assert "vx: AbsVelX" in alone
    assert "rates: absolute # guess: by its name" in alone


def test_units_as_volkswagen_writes_them_are_known(tmp_path: Path) -> None:
    speed = 'VelX : 32|16@1- (0.01,0) [0|0] "Unit_KiloMeterPerHour"'
    told = told_by_names(tmp_path, *(each.replace('"m"', '"Unit_Centimeter"') for each in AHEAD), speed)
    assert "x: DistX #" in told
    assert "vx: VelX #" in told
    of = bind(load_config(tmp_path / "found.yaml"))
    gains = {each.quantity: each.gain for each in of.sensors[0].reader.bindings}
    assert gains == pytest.approx({"x": 0.01, "y": 0.01, "vx": 1 / 3.6})


@pytest.mark.parametrize(
    ("unit", "known"),
    [
        ("Unit_MeterPerSeconSquar", "m/s^2"),
        ("Meter per second squared", "m/s^2"),
        ("Unit_DegreOfArcPerSecon", "deg/s"),
        ("Unit_KiloMeter", "km"),
        ("Unit_MilliSecon", "ms"),
        ("Unit_PerCent", "%"),
        ("1 per meter", "1/m"),
    ],
)
def test_units_in_words_are_known(unit: str, known: str) -> None:
    assert UNITS[normalised_unit(unit)] == UNITS[known]


def test_one_of_several_objects_in_a_message_is_a_guess(tmp_path: Path) -> None:
    (tmp_path / "meb.dbc").write_bytes((ROOT / "dbc" / "volkswagen_meb.dbc").read_bytes())
    assert main(["init", str(tmp_path / "meb.dbc"), "-o", str(tmp_path / "found.yaml"), "--yes"]) == 0
    told = (tmp_path / "found.yaml").read_text(encoding="utf-8")
    assert "front: # guess: MEB_Distance_01 seems to hold 6 objects, of which Same_Lane_01_Long_Distance is one" in told
