"""Binding settings to DBC files: what does not fit is told, what fits reads back as it was written."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.binding.bind import bind
from candaemon.binding.bind_sensor import bind_sensor_writer
from candaemon.binding.bind_signal import bind_signal, normalised_unit
from candaemon.binding.bus_load import Traffic, bus_load, frame_time
from candaemon.binding.compile_condition import compile_condition
from candaemon.binding.location import SettingLocation
from candaemon.config.base import Condition, SignalRef
from candaemon.config.load import load_config
from candaemon.dbc.bits import as_decoded, sendable_values
from candaemon.dbc.types import SignalSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED
from tests.support.bound import binding
from tests.support.paths import ROOT

CONFIGS = sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))


def broken(folder: Path, name: str, *changes: tuple[str, str]) -> str:
    """Bind a changed copy of a configuration and return what is told."""
    text = (ROOT / "config" / f"{name}.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "vehicle.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        bind(load_config(path))
    assert caught.value.exit_code == 2
    return str(caught.value)


@pytest.mark.parametrize(("length", "cure"), [(50, "give it 64"), (66, "give it 64 at most")])
def test_a_message_that_no_can_fd_frame_carries_is_refused(length: int, cure: str, tmp_path: Path) -> None:
    text = (ROOT / "dbc" / "obstacles_fd.dbc").read_text(encoding="utf-8")
    dbc = tmp_path / "mine.dbc"
    dbc.write_text(re.sub(r"(BO_ \d+ OBSTACLE_07: )48", rf"\g<1>{length}", text), encoding="utf-8")
    told = broken(tmp_path, "esr_ins_fd", (str(ROOT / "dbc" / "obstacles_fd.dbc"), str(dbc)))
    assert f"message 'OBSTACLE_07' has {length} bytes, which no CAN FD frame carries; {cure} in the DBC" in told


def line_of(folder: Path, text: str) -> int:
    lines = (folder / "vehicle.yaml").read_text().splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


@pytest.mark.parametrize("name", CONFIGS)
def test_configurations_bind_without_warning(name: str) -> None:
    assert binding(name).warnings == ()
    assert all(bus.load + bus.output_load < 1 for bus in binding(name).buses)


def test_a_dbc_that_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "pipe.link").symlink_to("pipe")
    (tmp_path / "loop").symlink_to("loop")
    esr = str(ROOT / "dbc" / "esr.dbc")
    for path in ("pipe", "pipe.link", "loop", ".", "/dev/zero", "x" * 256):
        assert "cannot be read (" in broken(tmp_path, "esr_ins", (esr, path))


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("esr_ins", "esr.dbc", "es.dbc", "no DBC file"),
        ("esr_ins", "CAN_TX_TRACK_RANGE,", "CAN_TX_TRACK_RANG,", "did you mean 'CAN_TX_TRACK_RANGE'"),
        ("esr_ins", "Target{slot}", "Targt{slot}", "has no message 'Targt1'; did you mean 'Target1'"),
        ("esr_ins", "slots: 64", "slots: 65", "no message 'Target65'; it has 'Target1' to 'Target64': set first: 1"),
        ("esr_ins", "      first: 1\n", "", "it has 'Target1' to 'Target64': set first: 1 and slots: 64"),
        ("esr_ins", "slots: 64\n      first: 1\n", "slots: 4\n", "'Target1' to 'Target64': set first: 1 and slots: 64"),
        ("esr_ins", "      first: 1\n", "      first: 900\n", "'Target1' to 'Target64': set first: 1 and slots: 64"),
        ("esr_ins", "CAN_TX_TRACK_ROLLING_COUNT", "Target1.CAN_TX_TRACK_ROLLING_COUNT", "mean 'CAN_TX_TRACK_ROLLING_"),
        ("esr_ins", "Velocity.VelNorth", "Velocity.VelNort", "did you mean 'VelNorth'"),
        ("esr_ins", "Velocity.VelNorth", "VelNorth", "expected MESSAGE.SIGNAL; did you mean 'Velocity.VelNorth'?"),
        ("esr_ins", "in: [1, 2, 3, 5]", "in: [9]", "can have none of these values; it goes from 0 to 7 by 1"),
        ("esr_ins", "signal: CAN_TX_TRACK_ROLLING_COUNT", "signal: COUNT", "has no signal 'COUNT'"),
        ("esr_ins", "empty: {CAN_TX_TRACK_STATUS: 0}", "empty: {CAN_TX_TRACK_STATE: 0}", "mean 'CAN_TX_TRACK_STATUS'"),
        ("esr_ins", "CAN_TX_TRACK_WIDTH}", "CAN_TX_TRACK_RANGE}", "is range already"),
        ("esr_ins", "width: CAN_TX_TRACK_WIDTH", "width: CAN_TX_TRACK_ANGLE", "has the unit 'deg' (angle) by the DBC"),
        ("toyota_rav4", "checksum: CHECKSUM", "checksum: CHECKSUMM", "has no signal 'CHECKSUMM'"),
        ("toyota_rav4", ", kind: toyota", "", "checksum and kind go together"),
        ("gm_lrr", "count: FLRRNumValidTargets", "count: Valid", "has no signal 'Valid'"),
        ("ars408", "identity: Obj_ID", "identity: Obj_Id", "did you mean 'Obj_ID'"),
        ("demo", "Cycle: cycle", "Cycl: cycle", "message 'OBSTACLE_STATUS' has no signal 'Cycl'; did you mean 'Cycle'"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told_with_line_and_key(
    tmp_path: Path, name: str, old: str, new: str, expected: str
) -> None:
    told = broken(tmp_path, name, (old, new))
    assert expected in told
    assert f"{tmp_path / 'vehicle.yaml'}:" in told


def test_every_wrong_signal_is_told_at_once(tmp_path: Path) -> None:
    told = broken(tmp_path, "toyota_rav4", ("x: LONG_DIST", "x: LONG"), ("-LAT_DIST", "-LAT"), (".YAW_RATE", ".YAW"))
    lines = told.splitlines()
    place = tmp_path / "vehicle.yaml"
    assert lines[0].startswith(f"{place}:{line_of(tmp_path, 'KINEMATICS.YAW')}: ego.signals.yaw_rate: ")
    assert lines[1].startswith(f"{place}:{line_of(tmp_path, 'x: LONG')}: sensors.front.signals.x: ")
    assert lines[2].startswith(f"{place}:{line_of(tmp_path, 'x: LONG')}: sensors.front.signals.y: ")


def test_an_identifier_has_one_owner_on_a_bus(tmp_path: Path) -> None:
    text = (ROOT / "config" / "esr_ins.yaml").read_text()
    start, end = text.index("  front:"), text.index("output:")
    second = text[start:end].replace("front:", "left:").replace("../dbc", str(ROOT / "dbc"))
    told = broken(tmp_path, "esr_ins", ("output:", second + "output:"))
    assert f":{line_of(tmp_path, 'left:')}: sensors.left: on bus 'radar' id 0x500 (and 63 more)" in told
    assert "belongs to sensor 'front' already" in told


def test_output_keeps_clear_of_known_identifiers(tmp_path: Path) -> None:
    told = broken(tmp_path, "ars408_to_esr", ("bus: obstacles", "bus: radar"), ("ars408.dbc", "esr.dbc"))
    assert "has no message 'Obj_1_General'" in told
    told = broken(tmp_path, "esr_to_ars408", ("bus: obstacles", "bus: ins"))
    assert "id 0x60A belongs to ego already" in told
    told = broken(tmp_path, "esr_to_ars408", ("bus: obstacles", "bus: ins"), ("curvature: -Tr", "yaw_rate: -Tr"))
    assert "yaw_rate" in told


def test_can_fd_frames_need_a_can_fd_bus(tmp_path: Path) -> None:
    parts = ", ".join(f'"OBSTACLE_{{slot:02d}}_{letter}"' for letter in "ABCD")
    changes = (
        ("obstacles.dbc", "obstacles_fd.dbc"),
        (f"[{parts}]", '["OBSTACLE_{slot:02d}"]'),
        ("unknown: 140", "unknown: 127.5"),
    )
    assert "CAN FD frame but bus 'obstacles' is classic; give the bus fd: true" in broken(tmp_path, "esr_ins", *changes)
    text = (tmp_path / "vehicle.yaml").read_text().replace("channel: can3", "channel: can3, fd: true")
    (tmp_path / "vehicle.yaml").write_text(text)
    output = bind(load_config(tmp_path / "vehicle.yaml")).output
    assert output is not None
    assert len(output.fd_ids) >= 32


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("empty: {CAN_TX_TRACK_STATUS: 0}", "empty: {CAN_TX_TRACK_STATUS: 3}", "passes all conditions of 'valid'"),
        ("fixed: {CAN_TX_TRACK_STATUS: 3}", "fixed: {CAN_TX_TRACK_STATUS: 6}", "6 does not pass the conditions"),
        ("fixed: {CAN_TX_TRACK_STATUS: 3}", "fixed: {CAN_TX_TRACK_STATUS: 9}", "goes from 0 to 7"),
        ("fixed: {CAN_TX_TRACK_STATUS: 3}", "fixed: {CAN_TX_TRACK_RANGE: 3}", "carries range"),
        ("[{signal: CAN_TX_TRACK_STATUS, in: [1]}]", "[{signal: CAN_TX_TRACK_STATUS, in: [0]}]", "object is new"),
    ],
)
def test_a_sensor_that_cannot_be_written_is_only_warned_of(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = (ROOT / "config" / "esr_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    assert old in text
    path = tmp_path / "vehicle.yaml"
    path.write_text(text.replace(old, new))
    bound = bind(load_config(path))
    assert expected in bound.warnings[0]
    with pytest.raises(ConfigError):
        bind_sensor_writer(bound.sensors[0])


@pytest.mark.parametrize(
    ("unit", "quantity", "gain"),
    [
        ("meters", "x", 1.0),
        ("meters/sec", "vx", 1.0),
        ("meters/sec/sec", "ax", 1.0),
        ("kph", "speed", 1 / 3.6),
        ("km/h", "range_rate", 1 / 3.6),
        ("MPH", "speed", 0.44704),
        ("deg", "azimuth", 0.017453292519943295),
        ("Degrees", "heading", 0.017453292519943295),
        ("°/s", "yaw_rate", 0.017453292519943295),
        ("rad/s", "yaw_rate", 1.0),
        ("cm", "y", 0.01),
        ("%", "score", 0.01),
        ("", "score", 1.0),
        ("", "vx", 1.0),
        ("class", "state", 1.0),
        ("[m/s²]", "ax", 1.0),
    ],
)
def test_units_as_vendors_write_them(unit: str, quantity: str, gain: float) -> None:
    signal = SignalSpec(name="S", start=0, length=8, unit=unit)
    bound = bind_signal(quantity, SignalRef(signal="S", scale=-2.0, offset=3.0), signal, SettingLocation())
    assert bound.gain == pytest.approx(-2 * gain)
    assert bound.bias == pytest.approx(3 * gain)


@pytest.mark.parametrize(
    ("unit", "quantity", "told"),
    [
        ("", "azimuth", "no unit in the DBC and azimuth is an angle; expected deg or rad"),
        ("", "yaw_rate", "expected deg/s or rad/s"),
        ("m", "vx", "unit 'm' (length) by the DBC, expected m/s"),
        ("parsec", "x", "unit 'parsec' by the DBC, expected m"),
    ],
)
def test_units_that_do_not_fit(unit: str, quantity: str, told: str) -> None:
    signal = SignalSpec(name="S", start=0, length=8, unit=unit)
    with pytest.raises(ConfigError) as caught:
        bind_signal(quantity, SignalRef(signal="S"), signal, SettingLocation())
    assert told in caught.value.message
    assert "unit: …" in caught.value.message
    assert normalised_unit(" Meters / Sec ") == "meter/s"


@settings(deadline=None)
@given(
    scale=st.sampled_from([1.0, 0.1, 0.01, -0.25, 0.0625]),
    offset=st.sampled_from([0.0, -12.8, 3.3]),
    raw=st.integers(0, 255),
    other=st.integers(0, 255),
)
def test_conditions_hold_for_numbers_as_one_writes_them(scale: float, offset: float, raw: int, other: int) -> None:
    signal = SignalSpec(name="S", start=0, length=8, scale=scale, offset=offset)
    decoded, bound = raw * scale + offset, round(other * scale + offset, 6)

    def holds(**test: object) -> bool:
        condition = Condition.model_validate({"signal": "S", **test})
        return bool(compile_condition(condition, signal, SettingLocation()).passes(decoded))

    rising = scale > 0
    assert holds(**{"in": [bound]}) == (raw == other)
    assert holds(min=bound) == (raw >= other if rising else raw <= other)
    assert holds(max=bound) == (raw <= other if rising else raw >= other)
    assert holds(above=bound) == (raw > other if rising else raw < other)
    assert holds(below=bound) == (raw < other if rising else raw > other)
    assert holds(min=bound, max=bound) == (raw == other)
    assert as_decoded(signal, bound) == other * scale + offset


def test_limits_are_the_tighter_of_range_and_bits() -> None:
    assert sendable_values(SignalSpec("S", 0, 8, scale=0.5, minimum=-10, maximum=100)) == (0.0, 100.0)
    assert sendable_values(SignalSpec("S", 0, 8, scale=-1.0)) == (-255.0, 0.0)


def test_load_of_a_bus() -> None:
    assert 1 / frame_time(Traffic(1, 8), 500_000, 1) == pytest.approx(4250, rel=0.002)
    assert 1 / frame_time(Traffic(1, 8), 1_000_000, 1) == pytest.approx(8500, rel=0.002)
    assert 1 / frame_time(Traffic(1, 64, fd=True), 500_000, 5_000_000) == pytest.approx(5800, rel=0.05)
    assert frame_time(Traffic(1, 8), 1_000_000, 1, stuffing=0) == pytest.approx(111e-6)
    assert frame_time(Traffic(1, 8, extended=True), 500_000, 1) > frame_time(Traffic(1, 8), 500_000, 1)
    assert bus_load([Traffic(64 * 20, 8), Traffic(64 * 20, 8)], 500_000) == pytest.approx(0.6, abs=0.005)
    assert bus_load([Traffic(1, 8, bool(0x18FF0000 & EXTENDED))], 500_000) > 0


def test_full_bus_is_warned_of(tmp_path: Path) -> None:
    text = (ROOT / "config" / "esr_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    path = tmp_path / "vehicle.yaml"
    path.write_text(text.replace("bus: obstacles", "bus: radar").replace("  obstacles: {channel: can3}\n", ""))
    (warning,) = bind(load_config(path)).warnings
    assert warning.startswith("bus 'radar': with every slot occupied the output adds 61% to 30% of 500 kbit/s")


def test_dubious_ranges_are_warned_of(tmp_path: Path, vendor_dbc: Path) -> None:
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    path = tmp_path / "vehicle.yaml"
    path.write_text(text.replace(str(ROOT / "dbc" / "toyota_rav4_radar.dbc"), str(vendor_dbc / "toyota_adas.dbc")))
    warnings = [warning for warning in bind(load_config(path)).warnings if "LAT_DIST" in warning]
    assert any("range [-50|50] in the DBC but its 11 bits reach from -40.96 to 40.92" in each for each in warnings)
    assert all("toyota_adas.dbc:" in each for each in warnings)


def test_own_motion_is_bound_to_its_messages() -> None:
    ego = binding("toyota_rav4").ego
    assert ego is not None
    assert set(ego.messages) == {0x24, 0xAA, 0x3BC}
    wheels = ego.messages[0xAA]
    assert sorted(wheels.quantities) == ["left_wheels", "left_wheels", "right_wheels", "right_wheels"]
    still = (0x1A6F).to_bytes(2, "big")  # 67.67 km/h over the signal's offset
    assert wheels.decode(still * 4) == pytest.approx([0.0] * 4, abs=1e-12)
    assert wheels.decode((0x1A6F + 360).to_bytes(2, "big") * 4) == pytest.approx([1.0] * 4)
    assert wheels.decode(bytes(7)) is None
    assert ego.count("left_wheels") == 2
    ins = binding("esr_ins").ego
    assert ins is not None
    heading = ins.messages[0x607]
    assert heading.quantities == ("heading",)
    values = heading.decode(bytes.fromhex("282300000000"))
    assert values is not None
    assert values[0] == pytest.approx(1.5707963)
