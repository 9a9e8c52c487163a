"""AUTOSAR end-to-end profiles: the specification's examples, a round trip of each, settings that do not fit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from e2e.p05 import e2e_p05_check
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from candaemon.binding.bind import bind
from candaemon.binding.bind_protection import bind_frame_monitor
from candaemon.binding.bind_writer import bind_writer
from candaemon.binding.bound import Binding
from candaemon.binding.location import SettingLocation
from candaemon.config.load import load_config
from candaemon.config.protection import E2eSettings, InputProtectionSettings
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.database import load_database
from candaemon.dbc.types import MessageSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.protection.e2e import E2eProtector
from candaemon.protection.monitor import FrameFaults, FrameMonitor
from tests.pipeline.test_pipeline import drive
from tests.support.effort import examples
from tests.support.paths import ROOT

ADAPTER: TypeAdapter[Any] = TypeAdapter(E2eSettings)
IDS = bytes(range(1, 17))
PROFILES: dict[int, dict[str, Any]] = {
    1: {"profile": 1, "data_id": 0x123},
    2: {"profile": 2, "data_id_list": tuple(IDS)},
    5: {"profile": 5, "data_id": 0x1234},
    11: {"profile": 11, "data_id": 0x123},
}
SHIFTED = {number: settings | {"offset": 1} for number, settings in PROFILES.items() if number != 2}
VARIANTS = [
    *PROFILES.values(),
    *SHIFTED.values(),
    *({**PROFILES[1], "data_id_mode": mode} for mode in ("alternating", "low", "nibble")),
    {**PROFILES[11], "data_id_mode": "nibble"},
]


def protector(given: dict[str, Any], length: int = 8) -> E2eProtector:
    message = MessageSpec(name="M", can_id=7, length=length, signals=())
    return E2eProtector(ADAPTER.validate_python(given), [message], [0])


@pytest.mark.parametrize(
    ("profile", "more", "length", "expected"),
    [
        (1, {}, 8, "cc00000000000000"),
        (1, {"data_id_mode": "alternating"}, 8, "ce00000000000000"),
        (1, {"data_id_mode": "low"}, 8, "ce00000000000000"),
        (1, {"data_id_mode": "nibble"}, 8, "2a10000000000000"),
        (5, {}, 8, "1cca000000000000"),
        (5, {"offset": 8}, 16, "00000000000000002891000000000000"),
        (11, {}, 8, "cc00000000000000"),
        (11, {"data_id_mode": "nibble"}, 8, "2a10000000000000"),
        (11, {"data_id_mode": "nibble", "offset": 8}, 16, "00000000000000007d10000000000000"),
    ],
)
def test_the_specification_s_examples(profile: int, more: dict[str, Any], length: int, expected: str) -> None:
    of = protector(PROFILES[profile] | more, length)
    assert of.seal(7, bytes(length)).hex() == expected
    assert of.verify(7, bytes.fromhex(expected))
    assert not of.verify(7, bytes.fromhex(expected)[:-1])


def test_profile_2_takes_its_data_id_by_the_counter() -> None:
    payload = bytes.fromhex("0002020304050607")
    of = protector({"profile": 2, "data_id_list": tuple(range(16))})
    assert of.seal(7, payload).hex() == "bc02020304050607"
    assert protector({"profile": 2, "data_id_list": (9, 9, 2, *[9] * 13)}).seal(7, payload) == of.seal(7, payload)
    assert protector({"profile": 2, "data_id_list": (0, 1, 9, *[0] * 13)}).seal(7, payload) != of.seal(7, payload)


@pytest.mark.parametrize("given_", VARIANTS, ids=str)
@settings(deadline=None, max_examples=examples(40))
@given(payload=st.binary(min_size=8, max_size=8), bit=st.integers(0, 63), count=st.integers(0, 14))
def test_one_changed_bit_is_found(given_: dict[str, Any], payload: bytes, bit: int, count: int) -> None:
    of = protector(given_)
    counter = given_.get("offset", 0) + of.header.counter_byte
    mask = (1 << of.header.counter_bits) - 1
    sealed = of.seal(7, payload[:counter] + bytes((payload[counter] & ~mask | count,)) + payload[counter + 1 :])
    assert of.verify(7, sealed)
    assert of.counter(sealed) == count
    damaged = bytearray(sealed)
    damaged[bit // 8] ^= 1 << bit % 8
    assert not of.verify(7, bytes(damaged))


DBC = """VERSION ""
BU_: A
BO_ 16 Thing_0: 8 A
 SG_ Crc : 0|{crc}@1+ (1,0) [0|0] "" A
 SG_ Count : {count}@1+ (1,0) [0|0] "" A
 SG_ X : 32|16@1+ (0.1,0) [0|0] "m" A
 SG_ Y : 48|16@1- (0.1,0) [0|0] "m" A
BO_ 17 Thing_1: 8 A
 SG_ Crc : 0|{crc}@1+ (1,0) [0|0] "" A
 SG_ Count : {count}@1+ (1,0) [0|0] "" A
 SG_ X : 32|16@1+ (0.1,0) [0|0] "m" A
 SG_ Y : 48|16@1- (0.1,0) [0|0] "m" A
"""
FORM = ObjectFormat.model_validate({"messages": ["Thing_{slot}"], "slots": 2})


@pytest.mark.parametrize("profile", PROFILES)
def test_what_is_written_goes_on_for_the_reader(profile: int, tmp_path: Path) -> None:
    """Over several turns of the counter, each message with a data id of its own."""
    path = tmp_path / "things.dbc"
    crc, count = (16, "16|8") if profile == 5 else (8, "8|4")
    path.write_text(DBC.format(crc=crc, count=count))
    database = load_database(path)
    more = {} if profile == 2 else {"step": 3}
    protection = InputProtectionSettings.model_validate(
        {"counter": "Count", "checksum": "Crc", "e2e": PROFILES[profile] | more, "max_step": 1}
    )
    writer = bind_writer(FORM, {}, database, protection)
    plan = bind_frame_monitor(writer.layouts[0].messages, protection, SettingLocation(), cycle_time=0.05)
    assert plan is not None
    monitor = FrameMonitor(plan, FrameFaults())
    for cycle in range(600):
        frames = writer.write(np.arange(2), {}, np.ones(2, np.bool_), counter=cycle)
        assert [can_id for can_id, _ in frames] == [16, 17]
        for can_id, data in frames:
            assert monitor.admits(can_id, data, cycle * 50_000_000)
    assert monitor.faults == FrameFaults()
    (_, first), (_, second) = frames
    assert (first == second) == (profile == 2)
    assert not plan.protector or plan.protector.verify(17, first) == (profile == 2)


def configured(tmp_path: Path, protection: str, config: str = "toyota_rav4_ins") -> Binding:
    """Bind a configuration whose output is protected otherwise."""
    text = (ROOT / "config" / f"{config}.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    plain = "protection: {counter: Counter, checksum: Crc, kind: crc8_sae_j1850}"
    assert text.count(plain) == 1
    path = tmp_path / "protected.yaml"
    path.write_text(text.replace(plain, f"protection: {protection}"))
    return bind(load_config(path))


def test_profile_5_protects_every_obstacle_frame(tmp_path: Path) -> None:
    """Checked by the library itself, data ids and counters as a receiver would expect them."""
    bound = configured(tmp_path, "{counter: Counter, checksum: Crc, e2e: {profile: 5, data_id: 0x1000, step: 1}}")
    assert bound.output is not None
    assert bound.output.status is not None
    order = [message.can_id for part in bound.output.writer.layouts for message in part.messages]
    order.append(bound.output.status.message.can_id)
    counters: dict[int, int] = {}
    sent: list[Frame] = [frame for cycle in Pipeline(bound).run(drive("toyota_rav4_ins")) for frame in cycle.frames]
    for frame in sent:
        assert e2e_p05_check(bytearray(frame.data), 0x1000 + order.index(frame.can_id))
        assert frame.data[2] == (counters.get(frame.can_id, -1) + 1) % 256
        counters[frame.can_id] = frame.data[2]
    assert len(sent) > 500
    assert order[-1] in counters


WRONG = [
    ("{e2e: {profile: 5, data_id: 1}}", "profile 5 sends a counter; name its signal"),
    ("{counter: Cycle, e2e: {profile: 5, data_id: 1}}", r"no signal 'Cycle' in|has no signal 'Cycle'"),
    ("{counter: Counter, e2e: {profile: 1, data_id: 1}}", "profile 1 at offset 0 has it from bit 8 with 4 bits"),
    ("{counter: Counter, checksum: CrcHigh, e2e: {profile: 5, data_id: 1}}", "from bit 0 with 8 or 16 bits"),
    ("{counter: Counter, e2e: {profile: 5, data_id: [1, 2]}}", "found 2 data ids, expected one for each message"),
    ("{counter: Counter, e2e: {profile: 5, data_id: 1, offset: 6}}", "at offset 6 has it from bit 64"),
    ("{e2e: {profile: 2, data_id_list: [1, 2]}}", "at least 16"),
    ("{e2e: {profile: 1, data_id: 0x1234, data_id_mode: nibble}}", "up to 0xFFF"),
    ("{e2e: {profile: 5, data_id: [1, 2], step: 1}}", "one of step and a list"),
    ("{kind: xor, checksum: Crc, e2e: {profile: 5, data_id: 1}}", "both make the checksum"),
]


@pytest.mark.parametrize(("protection", "message"), WRONG)
def test_what_does_not_fit_is_said(protection: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        configured(tmp_path, protection)
    assert "protected.yaml:" in str(caught.value)


def test_without_the_library_it_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "e2e.p05", None)
    with pytest.raises(ConfigError, match=r"pip install 'candaemon\[e2e\]'"):
        configured(tmp_path, "{counter: Counter, e2e: {profile: 5, data_id: 1}}")
