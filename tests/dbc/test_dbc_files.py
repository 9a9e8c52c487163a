"""The project's DBC files: strict, commented, clear of each other, and in agreement with the vendors' own."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database, Message, Signal
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.frames.bodies import CLASSES
from tests.support.effort import examples
from tests.support.paths import ROOT

DBC = ROOT / "dbc"
OUTPUTS = ("obstacles", "obstacles_fd")
VENDOR_FILES = {
    "toyota_rav4_radar": "toyota_adas",
    "toyota_rav4_car": "toyota_nodsu_pt_generated",
    "esr": "ESR",
    "oxts": "oxts_rt_subset",
    "gm_lrr": "gm_global_a_object",
    "tesla_continental": "tesla_radar_continental_generated",
    "acura_ilx_radar": "acura_ilx_2016_nidec",
    "mando_radar": "hyundai_kia_mando_front_radar_generated",
}
LIBRARY = (
    "lidar",
    "ford_mrr",
    "ford_mrr_fd",
    "volkswagen_meb",
    "chrysler_pacifica",
    "multiplexed_radar",
    "smartmicro_umrr",
    "mazda_radar",
    "near_far_radar",
    "unnumbered_list",
    "ars408_clusters",
    "compensated_radar",
    "surround",
)
FILES = (*OUTPUTS, *VENDOR_FILES, "ars408", *LIBRARY)
SLOTS = 32
UDS_IDS = {0x7DF, *range(0x7E0, 0x7F0)}
SLOT_SIGNALS = {
    "A": ["Id", "State", "X", "Y", "Vx"],
    "B": ["Id", "Vy", "Ax", "Ay"],
    "C": ["Id", "SdX", "SdY", "SdVx", "SdVy", "Existence", "Age", "Sensors"],
    "D": ["Heading", "YawRate", "Length", "Width", "Class", "ClassLikelihood", "CenterDx", "CenterDy"],
    "E": ["Lead", "TimeToCollision", "SeenBy"],
}
PROTECTION = [("Crc", 0, 8), ("CrcHigh", 8, 8), ("Counter", 16, 8)]


def load(path: Path, *, strict: bool = True) -> Database:
    database = cantools.database.load_file(path, strict=strict)
    assert isinstance(database, Database)
    return database


@pytest.fixture(scope="module")
def ours() -> dict[str, Database]:
    return {name: load(DBC / f"{name}.dbc") for name in FILES}


def slot_message(database: Database, slot: int, letter: str) -> Message:
    return database.get_message_by_name(f"OBSTACLE_{slot:02d}_{letter}")


def test_every_file_is_tested() -> None:
    assert {path.stem for path in DBC.glob("*.dbc")} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_any_tool_reads_the_text(name: str) -> None:
    # DBC has no declared encoding: only ASCII reads alike everywhere
    assert (DBC / f"{name}.dbc").read_bytes().isascii()


@pytest.mark.parametrize("name", FILES)
def test_everything_is_explained(name: str, ours: dict[str, Database]) -> None:
    messages = ours[name].messages
    said_once = {signal.name for message in messages for signal in message.signals if signal.comment}
    assert [message.name for message in messages if not message.comment] == []
    assert {signal.name for message in messages for signal in message.signals} - said_once == set()


@pytest.mark.parametrize("name", OUTPUTS)
def test_every_output_signal_has_its_own_comment(name: str, ours: dict[str, Database]) -> None:
    for message in ours[name].messages:
        assert [signal.name for signal in message.signals if not signal.comment] == []
        assert message.cycle_time == 50
        assert message.senders == ["CANDAEMON"]


@pytest.mark.parametrize("name", FILES)
def test_ranges_fit_the_bits(name: str, ours: dict[str, Database]) -> None:
    for message in ours[name].messages:
        for signal in message.signals:
            low = -(1 << signal.length - 1) if signal.is_signed else 0
            high = low + (1 << signal.length) - 1
            assert signal.minimum is not None
            assert signal.maximum is not None
            assert signal.minimum < signal.maximum
            slack = abs(signal.scale) * 1e-6
            assert signal.minimum >= low * signal.scale + signal.offset - slack
            assert signal.maximum <= high * signal.scale + signal.offset + slack


def test_slots_are_complete(ours: dict[str, Database]) -> None:
    expected = {f"OBSTACLE_{slot:02d}_{letter}" for slot in range(SLOTS) for letter in SLOT_SIGNALS}
    assert {message.name for message in ours["obstacles"].messages} == expected | {"OBSTACLE_STATUS"}
    expected = {f"OBSTACLE_{slot:02d}{part}" for slot in range(SLOTS) for part in ("", "_E")}
    assert {message.name for message in ours["obstacles_fd"].messages} == expected | {"OBSTACLE_STATUS"}


def test_each_message_of_a_slot_carries_what_it_is_for(ours: dict[str, Database]) -> None:
    for slot in range(SLOTS):
        for letter, names in SLOT_SIGNALS.items():
            signals = slot_message(ours["obstacles"], slot, letter).signals
            assert [signal.name for signal in signals[3:]] == names


@pytest.mark.parametrize("name", OUTPUTS)
def test_first_three_bytes_are_kept_for_protection(name: str, ours: dict[str, Database]) -> None:
    for message in ours[name].messages:
        by_start = sorted(message.signals, key=lambda signal: signal.start)
        assert [(signal.name, signal.start, signal.length) for signal in by_start[:3]] == PROTECTION
        assert by_start[3].start >= 24
        assert all(signal.byte_order == "little_endian" for signal in message.signals)


def test_frame_formats(ours: dict[str, Database]) -> None:
    assert {(message.length, message.is_fd) for message in ours["obstacles"].messages} == {(8, False)}
    fd = ours["obstacles_fd"]
    assert all(message.is_fd for message in fd.messages)
    assert {message.length for message in fd.messages if re.fullmatch(r"OBSTACLE_\d+", message.name)} == {48}
    assert {message.length for message in fd.messages if message.name.endswith("_E")} == {8}


def test_urgent_frames_win_arbitration(ours: dict[str, Database]) -> None:
    database = ours["obstacles"]
    order = ["OBSTACLE_STATUS", *(f"OBSTACLE_{slot:02d}_{letter}" for letter in SLOT_SIGNALS for slot in range(SLOTS))]
    ids = [database.get_message_by_name(name).frame_id for name in order]
    assert ids == sorted(ids)
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("name", OUTPUTS)
def test_obstacle_ids_are_clear_of_sensors_and_diagnosis(name: str, ours: dict[str, Database]) -> None:
    taken = {message.frame_id for other in FILES if other not in OUTPUTS for message in ours[other].messages}
    reserved = UDS_IDS | set(range(0x200, 0x230)) | set(range(0x410, 0x541)) | set(range(0x600, 0x60E))
    assert {message.frame_id for message in ours[name].messages} & (taken | reserved) == set()


@pytest.mark.parametrize("name", OUTPUTS)
def test_obstacle_ids_are_clear_of_vendor_files(name: str, ours: dict[str, Database], vendor_dbc: Path) -> None:
    taken = {m.frame_id for path in vendor_dbc.glob("*.dbc") for m in load(path, strict=False).messages}
    assert {message.frame_id for message in ours[name].messages} & taken == set()


@pytest.mark.parametrize("name", OUTPUTS)
def test_obstacle_ids_are_clear_of_the_recorded_buses(name: str, ours: dict[str, Database], drive: Path) -> None:
    with gzip.open(drive / "drive.log.gz", "rt") as lines:
        recorded = {int(line.split()[2].partition("#")[0], 16) for line in lines}
    assert len(recorded) > 100
    assert {message.frame_id for message in ours[name].messages} & recorded == set()


def test_id_states_its_width(ours: dict[str, Database]) -> None:
    signals = [s for name in OUTPUTS for m in ours[name].messages for s in m.signals if s.name == "Id"]
    assert len(signals) == 4 * SLOTS
    for signal in signals:
        stated = re.search(r"modulo (\d+) \((\d+) bits\)", signal.comment or "")
        assert stated is not None
        assert int(stated[1]) == 2**signal.length
        assert int(stated[2]) == signal.length


def choices(signal: Signal) -> dict[int, str]:
    return {value: str(text) for value, text in (signal.choices or {}).items()}


def test_value_tables(ours: dict[str, Database]) -> None:
    states = {0: "empty", 1: "tentative", 2: "confirmed", 3: "coasting"}
    for name in OUTPUTS:
        signals = [s for m in ours[name].messages for s in m.signals if s.name == "State"]
        assert len(signals) == SLOTS
        assert all(choices(signal) == states for signal in signals)
        bodies = [s for m in ours[name].messages for s in m.signals if s.name == "Class"]
        assert len(bodies) == SLOTS
        kinds = {code: kind.replace("-", "_") for code, kind in enumerate(CLASSES)}
        assert all(choices(signal) == kinds for signal in bodies)
        status = ours[name].get_message_by_name("OBSTACLE_STATUS")
        ego = choices(status.get_signal_by_name("Ego"))
        assert ego == {0: "invalid", 1: "dead_reckoning", 2: "valid", 3: "initialising"}
        health = choices(status.get_signal_by_name("Health"))
        assert health == {0: "ok", 1: "degraded", 2: "sensor_lost", 3: "fault"}


def test_fd_frames_say_the_same_at_least_as_finely(ours: dict[str, Database]) -> None:
    classic = {s.name: s for letter in SLOT_SIGNALS for s in slot_message(ours["obstacles"], 0, letter).signals}
    parts = [ours["obstacles_fd"].get_message_by_name(f"OBSTACLE_00{part}") for part in ("_E", "")]
    fd = {s.name: s for message in parts for s in message.signals}
    assert set(fd) == set(classic) | {"Latitude", "Longitude"}
    for name, signal in ((name, fd[name]) for name in classic):
        assert signal.unit == classic[name].unit
        assert signal.scale <= classic[name].scale
        assert signal.length >= classic[name].length
    both = [ours[name].get_message_by_name("OBSTACLE_STATUS") for name in OUTPUTS]
    first, second = ([(s.name, s.start, s.length, s.scale, s.comment) for s in m.signals] for m in both)
    assert first == second


@settings(deadline=None, max_examples=examples(50))
@given(data=st.data(), name=st.sampled_from(OUTPUTS))
def test_obstacles_come_back_within_half_a_quantum(ours: dict[str, Database], data: st.DataObject, name: str) -> None:
    message = data.draw(st.sampled_from(ours[name].messages))
    sent = {}
    for signal in message.signals:
        low, high = signal.minimum or 0, signal.maximum or 0
        whole = signal.scale == 1
        sent[signal.name] = data.draw(st.integers(int(low), int(high)) if whole else st.floats(low, high))
    got = message.decode_simple(message.encode(sent), decode_choices=False)
    for signal in message.signals:
        value = got[signal.name]
        assert isinstance(value, int | float)
        assert value == pytest.approx(sent[signal.name], abs=signal.scale * 0.5001)


@pytest.mark.parametrize("name", VENDOR_FILES)
def test_decodes_as_the_vendor_file_does(name: str, ours: dict[str, Database], vendor_dbc: Path) -> None:
    vendor = load(vendor_dbc / f"{VENDOR_FILES[name]}.dbc", strict=False)
    random = np.random.default_rng(0)
    for message in ours[name].messages:
        theirs = vendor.get_message_by_frame_id(message.frame_id)
        assert message.length == theirs.length
        assert message.name == theirs.name
        shared = {signal.name for signal in message.signals}
        assert shared <= {signal.name for signal in theirs.signals}
        for payload in random.bytes(12 * message.length), b"\xff" * message.length, bytes(message.length):
            for start in range(0, len(payload), message.length):
                frame = payload[start : start + message.length]
                mine = message.decode_simple(frame, decode_choices=False)
                assert mine == {
                    n: v for n, v in theirs.decode_simple(frame, decode_choices=False).items() if n in shared
                }


def test_recorded_frames_too_short_for_their_message(ours: dict[str, Database], drive: Path) -> None:
    lengths = {message.frame_id: message.length for message in ours["toyota_rav4_car"].messages}
    short: dict[int, int] = {}
    with gzip.open(drive / "drive.log.gz", "rt") as lines:
        for line in lines:
            _, channel, frame = line.split()[:3]
            can_id, _, payload = frame.partition("#")
            if channel == "can0" and len(payload) < 2 * lengths.get(int(can_id, 16), 0):
                short[int(can_id, 16)] = short.get(int(can_id, 16), 0) + 1
    assert short == {0x262: 1499, 0x3F6: 60}


@settings(deadline=None)
@given(b=st.binary(min_size=8, max_size=8))
def test_ars408_fields_by_their_documented_bytes(ours: dict[str, Database], b: bytes) -> None:
    database = ours["ars408"]
    # Object list of the ARS 404/408: fields big-endian, packed without gaps, as shifts and masks of bytes.
    fields = {
        "Obj_0_Status": {
            "Obj_NofObjects": b[0],
            "Obj_MeasCounter": b[1] << 8 | b[2],
            "Obj_InterfaceVersion": b[3] >> 4,
        },
        "Obj_1_General": {
            "Obj_ID": b[0],
            "Obj_DistLong": (b[1] << 5 | b[2] >> 3) * 0.2 - 500,
            "Obj_DistLat": ((b[2] & 7) << 8 | b[3]) * 0.2 - 204.6,
            "Obj_VrelLong": (b[4] << 2 | b[5] >> 6) * 0.25 - 128,
            "Obj_VrelLat": ((b[5] & 63) << 3 | b[6] >> 5) * 0.25 - 64,
            "Obj_DynProp": b[6] & 7,
            "Obj_RCS": b[7] * 0.5 - 64,
        },
        "Obj_2_Quality": {
            "Obj_ID": b[0],
            "Obj_DistLong_rms": b[1] >> 3,
            "Obj_DistLat_rms": (b[1] & 7) << 2 | b[2] >> 6,
            "Obj_VrelLong_rms": b[2] >> 1 & 31,
            "Obj_VrelLat_rms": (b[2] & 1) << 4 | b[3] >> 4,
            "Obj_ArelLong_rms": (b[3] & 15) << 1 | b[4] >> 7,
            "Obj_ArelLat_rms": b[4] >> 2 & 31,
            "Obj_Orientation_rms": (b[4] & 3) << 3 | b[5] >> 5,
            "Obj_ProbOfExist": b[6] >> 5,
            "Obj_MeasState": b[6] >> 2 & 7,
        },
        "Obj_3_Extended": {
            "Obj_ID": b[0],
            "Obj_ArelLong": (b[1] << 3 | b[2] >> 5) * 0.01 - 10,
            "Obj_ArelLat": ((b[2] & 31) << 4 | b[3] >> 4) * 0.01 - 2.5,
            "Obj_Class": b[3] & 7,
            "Obj_OrientationAngle": (b[4] << 2 | b[5] >> 6) * 0.4 - 180,
            "Obj_Length": b[6] * 0.2,
            "Obj_Width": b[7] * 0.2,
        },
    }
    for name, expected in fields.items():
        message = database.get_message_by_name(name)
        decoded = message.decode_simple(b[: message.length], decode_choices=False)
        assert decoded == pytest.approx(expected, abs=1e-9)
