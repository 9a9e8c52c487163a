"""Protection as configured: message by message, in lists, as `check` tells it, and clear of others' identifiers."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from e2e.p01 import e2e_p01_check

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.cli.check import check_report
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from tests.pipeline.test_pipeline import drive
from tests.support.paths import ROOT

PLAIN = "protection: {counter: Counter, checksum: Crc, kind: crc8_sae_j1850}"


def changed(folder: Path, config: str, *changes: tuple[str, str]) -> Binding:
    """Bind a configuration with something in it replaced."""
    text = (ROOT / "config" / f"{config}.yaml").read_text()
    for old, new in (*changes, ("../dbc", str(ROOT / "dbc"))):
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "vehicle.yaml"
    path.write_text(text)
    return bind(load_config(path))


def rows(bound: Binding, title: str) -> dict[str, str]:
    sheet = next(sheet for sheet in check_report(bound) if sheet.title == title)
    return {row[0]: row[1] for row in sheet.rows}


def test_check_tells_how_frames_are_protected(tmp_path: Path) -> None:
    bound = changed(
        tmp_path,
        "toyota_rav4_ins",
        ("kind: toyota}", "kind: toyota, max_step: 2, timeout: 0.5, max_rate: 1.5, max_failed: 0.25}"),
        (PLAIN, "protection: {counter: Counter, e2e: {profile: 5, data_id: 7}}"),
    )
    sensor, output = rows(bound, "radar front"), rows(bound, "output")
    expected = "counter COUNTER, checksum CHECKSUM (toyota), steps up to 2, time-out 0.5 s, rate up to 1.5 × nominal"
    assert sensor["protection"] == expected
    assert sensor["failed frames"] == "over 25% of a scan discard it"
    assert sensor["plausible"] == "within the DBC's ranges, up to 200 m/s from scan to scan"
    assert output["protection"] == "counter Counter, AUTOSAR E2E profile 5"


def test_a_sensor_that_does_not_tell_what_is_new_is_said_to_be_free_to_jump(tmp_path: Path) -> None:
    told = rows(changed(tmp_path, "gm_lrr"), "radar front")["plausible"]
    assert told == "within the DBC's ranges; jumps are not watched, for objects do not say if they are new"


def test_a_message_may_have_a_protection_of_its_own(tmp_path: Path) -> None:
    """TRACK_B of the radar here carries none, and the obstacles' C messages the sum of their bytes."""
    bound = changed(
        tmp_path,
        "toyota_rav4_ins",
        ('{message: "TRACK_B_{slot}", optional: true}', '{message: "TRACK_B_{slot}", optional: true, protection: {}}'),
        (
            '"OBSTACLE_{slot:02d}_C"',
            '{message: "OBSTACLE_{slot:02d}_C", protection: {counter: Counter, checksum: Crc, kind: additive}}',
        ),
    )
    first, second = bound.sensors[0].monitors
    assert first is not None
    assert second is None
    assert rows(bound, "output")["protection of OBSTACLE_{slot:02d}_C"] == "counter Counter, checksum Crc (additive)"
    assert bound.output is not None
    summed = {message.can_id for message in bound.output.writer.layouts[2].messages}
    frames = [frame for cycle in Pipeline(bound).run(drive("toyota_rav4_ins")) for frame in cycle.frames]
    mine = [frame.data for frame in frames if frame.can_id in summed]
    assert len(mine) > 100
    assert all(sum(data[1:]) & 0xFF == data[0] for data in mine)


LISTED = """VERSION ""
BU_: A
BO_ 1024 LISTED: 8 A
 SG_ Crc : 0|8@1+ (1,0) [0|0] "" A
 SG_ Count : 8|4@1+ (1,0) [0|0] "" A
 SG_ Id : 16|8@1+ (1,0) [0|0] "" A
 SG_ X : 24|16@1+ (0.1,-100) [0|0] "m" A
 SG_ Y : 40|16@1- (0.1,0) [0|0] "m" A
"""


def test_where_objects_share_a_message_its_frames_are_counted(tmp_path: Path) -> None:
    """And profile 1 begins again after 14."""
    (tmp_path / "listed.dbc").write_text(LISTED)
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    listed = f"""output:
  bus: obstacles
  dbc: {tmp_path / "listed.dbc"}
  objects: {{messages: [{{message: LISTED, id_signal: Id}}], slots: 16}}
  signals: {{x: X, y: Y}}
  protection: {{counter: Count, e2e: {{profile: 1, data_id: 0x123, data_id_mode: nibble}}}}
"""
    path = tmp_path / "vehicle.yaml"
    path.write_text(text[: text.index("output:")] + listed)
    cycles = list(Pipeline(bind(load_config(path))).run(drive("toyota_rav4_ins")))
    frames = [frame.data for cycle in cycles for frame in cycle.frames]
    assert max(len(cycle.frames) for cycle in cycles) > 1
    assert [data[1] & 0xF for data in frames] == [k % 15 for k in range(len(frames))]
    assert all(e2e_p01_check(bytearray(data), 0x123, data_id_mode=3) for data in frames)


def test_output_keeps_clear_of_what_the_bus_s_own_file_lists(tmp_path: Path) -> None:
    """A file of the whole bus that lists what we send is no clash; another message of that id is."""
    whole = tmp_path / "whole.dbc"
    change = ("obstacles: {channel: can3}", f"obstacles: {{channel: can3, dbc: [{whole}]}}")
    whole.write_text((ROOT / "dbc" / "obstacles.dbc").read_text())
    assert changed(tmp_path, "toyota_rav4_ins", change).output is not None
    whole.write_text((ROOT / "dbc" / "obstacles.dbc").read_text().replace("OBSTACLE_07_B", "BRAKES"))
    with pytest.raises(ConfigError, match=r"id 0x69A belongs to message 'BRAKES' of 'whole\.dbc' already"):
        changed(tmp_path, "toyota_rav4_ins", change)


FLOATS = """VERSION ""
BU_: A
BO_ 16 THING: 8 A
 SG_ X : 0|32@1- (1,0) [0|0] "m" A
 SG_ Y : 32|32@1- (1,0) [0|0] "m" A
SIG_VALTYPE_ 16 X : 1 ;
SIG_VALTYPE_ 16 Y : 1 ;
"""
FLOATING = """
buses: {{a: {{channel: can0}}}}
ego: {{kind: static}}
sensors:
  lidar:
    kind: lidar
    bus: a
    dbc: {dbc}
    cycle_time: 0.05
    objects: {{messages: [THING], slots: 1}}
    scan: {{close: timeout}}
    signals: {{x: X, y: Y}}
    noise: {{x: 0.3, y: 0.3}}
"""


def test_an_object_that_is_no_number_is_refused_and_counted(tmp_path: Path) -> None:
    (tmp_path / "floats.dbc").write_text(FLOATS)
    path = tmp_path / "floating.yaml"
    path.write_text(FLOATING.format(dbc=tmp_path / "floats.dbc"))
    pipeline = Pipeline(bind(load_config(path)))
    places = [(20.0, 1.0), (float("nan"), 1.0), (20.0, float("inf")), (20.0, 1.0)]
    frames = [Frame(50_000_000 * (k + 1), 0, 16, struct.pack("<ff", *place)) for k, place in enumerate(places)]
    cycles = [*pipeline.run(frames), *pipeline.finish()]
    assert [len(cycle.detections) for cycle in cycles if cycle.detections is not None] == [1, 0, 0, 1]
    assert pipeline.assemblers[0].counts.not_finite == 2
