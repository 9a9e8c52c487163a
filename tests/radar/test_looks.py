"""Looks in turn: whoever says which one a scan is, it reaches the scan, and nothing is expected out of its sight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.config.sensors import MOST_LOOKS
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import CONFIRMED
from candaemon.tracking.sensor_visibility import LEAST_PROBABILITY, Visibility

DBC = """\
VERSION ""
NS_ :
BS_:
BU_: RADAR

BO_ 1024 HEAD: 8 RADAR
 SG_ COUNT : 0|5@1+ (1,0) [0|16] "" RADAR
 SG_ LOOK : 8|2@1+ (1,0) [0|3] "" RADAR

BO_ 1025 POINT: 8 RADAR
 SG_ INDEX : 0|4@1+ (1,0) [0|15] "" RADAR
 SG_ VALID : 4|1@1+ (1,0) [0|1] "" RADAR
 SG_ POINT_LOOK : 5|2@1+ (1,0) [0|3] "" RADAR
 SG_ RANGE : 8|12@1+ (0.0625,0) [0|255] "m" RADAR
 SG_ ANGLE : 20|12@1- (0.0625,0) [-90|90] "deg" RADAR
 SG_ RATE : 32|12@1- (0.0625,0) [-128|127] "m/s" RADAR
"""
YAML = """\
buses: {{radar: {{channel: can0}}}}
ego: {{kind: static}}
sensors:
  front:
    bus: radar
    dbc: points.dbc
    cycle_time: 0.05
    timeout: 0.03
    objects:
      messages: [{{message: POINT, id_signal: INDEX}}]
      slots: 16
      identity: false
      valid: [{{signal: VALID, in: [1]}}]
    scan: {scan}
    looks:
      signal: {signal}
      fields_of_view:
        0: {{range: 60, azimuth_deg: 60}}
        1: {{range: 160, azimuth_deg: 12}}
        2: {{range: 60, azimuth_deg: 30, yaw_deg: 45}}
        3: {{range: 60, azimuth_deg: 30, yaw_deg: -45}}
    signals: {{range: RANGE, azimuth: ANGLE, range_rate: RATE}}
    noise: {{range: 0.2, azimuth_deg: 0.3, range_rate: 0.1}}
"""
HEADER, TRIGGER = "{close: header, message: HEAD, count: COUNT}", "{close: trigger, message: HEAD}"
TIMEOUT = "{close: timeout}"
PLACES = {"near": (25.0, 6.0), "far": (110.0, 0.0), "left": (15.0, 20.0)}
SCENARIO = {
    "duration": 4,
    "ego": {"start": {"speed": 0}},
    "measurement": {"clutter": 0, "detection_probability": 1},
    "actors": [
        {"name": name, "reflections": 1, "start": {"x": x, "y": y, "vx": 0, "vy": 0}} for name, (x, y) in PLACES.items()
    ],
}


ALL = {0, 1, 2, 3}


def bound(folder: Path, scan: str = HEADER, signal: str = "LOOK", *changes: tuple[str, str], bits: int = 2) -> Binding:
    database = DBC.replace(" SG_ LOOK : 8|2@1+ (1,0) [0|3]", f" SG_ LOOK : 8|{bits}@1+ (1,0) [0|{2**bits - 1}]")
    (folder / "points.dbc").write_text(database, encoding="utf-8")
    text = YAML.format(scan=scan, signal=signal)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    return bind(load_config(path))


def frames(binding: Binding) -> list[Frame]:
    return list(simulate(Scenario.model_validate(SCENARIO), binding, seed=3).frames())


def scans(binding: Binding, sent: list[Frame]) -> tuple[list[Scan], int]:
    """Return the scans that frames make, and how many had an unknown look."""
    assembler = make_assembler(binding.sensors[0])
    found = []
    for frame in sent:
        found.append(assembler.expire(frame.time_ns))
        receive, part, slot = assembler.routes[frame.can_id]
        found.append(receive(part, slot, frame.data, frame.time_ns))
    found.append(assembler.flush())
    return [scan for scan in found if scan is not None], assembler.counts.unknown_look


@pytest.mark.parametrize(
    ("scan", "signal"),
    [(HEADER, "LOOK"), (HEADER, "HEAD.LOOK"), (TRIGGER, "LOOK"), (HEADER, "POINT_LOOK"), (TIMEOUT, "POINT.POINT_LOOK")],
)
def test_the_look_of_each_scan_is_read(tmp_path: Path, scan: str, signal: str) -> None:
    binding = bound(tmp_path, scan, signal)
    found, unknown = scans(binding, frames(binding))
    looks = [each.look for each in found if len(each.slot)]
    assert len(found) > 50
    assert set(looks) == {0, 1, 2}  # nothing is to the right
    reach = {0: 60.0, 1: 160.0, 2: 60.0}
    row = binding.sensors[0].reader.quantities.index("range")
    assert all(each.values[row].max() < reach[each.look] for each in found if len(each.slot))
    assert unknown == 0
    if scan == HEADER and "POINT" not in signal:  # that comes with scans without objects too
        assert [each.look for each in found[:8]] == [0, 1, 2, 3] * 2


def test_a_look_that_is_none_of_those_configured_is_counted(tmp_path: Path) -> None:
    sent = frames(bound(tmp_path))
    found, unknown = scans(bound(tmp_path, HEADER, "LOOK", ("        2: ", "        # ")), sent)
    assert unknown == sum(scan.look == -1 for scan in found) == pytest.approx(len(found) / 4, abs=1)


def test_a_scan_whose_header_was_lost_has_no_look(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    found, unknown = scans(binding, [frame for frame in frames(binding) if frame.can_id != 1024])
    assert {scan.look for scan in found} == {-1}
    assert unknown == len(found)


@pytest.mark.parametrize("kind", ["imm", "vehicle"])
def test_obstacles_live_on_through_the_looks_that_do_not_see_them(tmp_path: Path, kind: str) -> None:
    binding = bound(tmp_path, HEADER, "LOOK", ("sensors:", f"tracker: {{estimator: {{kind: {kind}}}}}\nsensors:"))
    ids = []
    for cycle in Pipeline(binding).run(frames(binding)):
        obstacles = cycle.obstacles
        if cycle.detections is not None:
            sure = obstacles.state == CONFIRMED
            ids.append((sorted(obstacles.id[sure].tolist()), obstacles.existence[sure]))
    settled = ids[len(ids) // 2 :]
    assert len(settled) > 30
    assert {tuple(each) for each, _ in settled} == {tuple(settled[0][0])}
    assert len(settled[0][0]) == 3
    assert min(existence.min() for _, existence in settled) > 0.8


def test_nothing_is_expected_where_the_present_look_cannot_see(tmp_path: Path) -> None:
    visibility = Visibility({0: bound(tmp_path).sensors[0].settings})
    place = np.array([[25.0, 2.0], [110.0, 0.0], [15.0, 20.0], [15.0, -20.0]])
    bare, none = np.full(4, np.nan), np.full((4, 2), np.nan)

    def found(look: int) -> Floats:
        return visibility.detection_probability(0, *visibility.in_sight(place, place, none, bare, bare, 0, look))

    expected = {look: (found(look) > 0.5).tolist() for look in (*sorted(ALL), -1, 9)}
    assert expected == {
        0: [True, False, True, True],
        1: [True, True, False, False],
        2: [False, False, True, False],
        3: [False, False, False, True],
        -1: [False] * 4,
        9: [False] * 4,
    }
    assert found(-1) == pytest.approx(LEAST_PROBABILITY)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("        3: ", "        7: ", r"look 7 cannot be, signal 'LOOK' holds 0 to 3"),
        ("signal: LOOK", "signal: LOKO", r"no signal 'LOKO' in 'POINT'"),
        ("    signals: {", "    field_of_view: {range: 9}\n    signals: {", r"looks give a field of view each"),
        ("        3: ", "        -3: ", r"-3"),
        ("        3: ", "        three: ", r"three"),
    ],
)
def test_looks_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        bound(tmp_path, HEADER, "LOOK", (old, new))


def test_a_sensor_has_so_many_looks(tmp_path: Path) -> None:
    def with_looks(count: int) -> Binding:
        further = "".join(f"        {look}: {{range: 60}}\n" for look in range(4, count))
        return bound(tmp_path, HEADER, "LOOK", ("    signals:", f"{further}    signals:"), bits=8)

    assert len(with_looks(MOST_LOOKS).sensors[0].settings.views) == MOST_LOOKS
    with pytest.raises(ConfigError, match=f"at most {MOST_LOOKS}"):
        with_looks(MOST_LOOKS + 1)


def test_check_tells_the_looks_and_that_there_is_no_identity(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    bound(tmp_path)
    assert main(["check", str(tmp_path / "vehicle.yaml")]) == 0
    lines = {words[0]: " ".join(words[1:]) for line in capsys.readouterr().out.splitlines() if (words := line.split())}
    assert lines["identity"] == "none"
    assert lines["looks"].startswith(
        "by LOOK; 0: 1 to 60 m, +0 ± 60°; 1: 1 to 160 m, +0 ± 12°; 2: 1 to 60 m, +45 ± 30°"
    )
