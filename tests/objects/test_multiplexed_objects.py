"""Objects that a multiplexer leaves without a signal are counted; those that lack an optional message are used."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config

DBC = """VERSION ""
BU_: R
BO_ 256 A_0: 8 R
 SG_ X : 0|16@1+ (0.1,0) [0|0] "m" R
 SG_ Y : 16|16@1- (0.1,0) [0|0] "m" R
BO_ 257 A_1: 8 R
 SG_ X : 0|16@1+ (0.1,0) [0|0] "m" R
 SG_ Y : 16|16@1- (0.1,0) [0|0] "m" R
BO_ 272 B_0: 8 R
 SG_ MODE M : 0|2@1+ (1,0) [0|3] "" R
 SG_ QUALITY m1 : 8|8@1+ (1,0) [0|255] "" R
 SG_ SPEED m1 : 16|16@1- (0.01,0) [0|0] "m/s" R
BO_ 273 B_1: 8 R
 SG_ MODE M : 0|2@1+ (1,0) [0|3] "" R
 SG_ QUALITY m1 : 8|8@1+ (1,0) [0|255] "" R
 SG_ SPEED m1 : 16|16@1- (0.01,0) [0|0] "m/s" R
"""
YAML = """buses: {r: {channel: can0}}
ego: {kind: static}
sensors:
  s:
    bus: r
    dbc: r.dbc
    cycle_time: 0.05
    objects:
      messages: ["A_{slot}", {message: "B_{slot}", optional: true}]
      slots: 2
      valid: [{signal: QUALITY, min: 1}]
    scan: {close: timeout}
    signals: {x: X, y: Y, range_rate: SPEED}
    noise: {x: 0.1, y: 0.1, range_rate: 0.1}
    field_of_view: {range: 100, azimuth_deg: 60}
"""
PLACE = bytes([100, 0, 10, 0, 0, 0, 0, 0])


@pytest.fixture
def bound(tmp_path: Path) -> Binding:
    (tmp_path / "r.dbc").write_text(DBC, encoding="utf-8")
    (tmp_path / "r.yaml").write_text(YAML, encoding="utf-8")
    return bind(load_config(tmp_path / "r.yaml"))


@pytest.mark.parametrize(
    ("second", "valid", "left_out"),
    [
        (bytes([1, 9, 0, 0, 0, 0, 0, 0]), True, False),
        (bytes([1, 0, 0, 0, 0, 0, 0, 0]), False, False),
        (bytes([0, 9, 0, 0, 0, 0, 0, 0]), False, True),
        (None, True, False),
    ],
    ids=["as it should be", "not valid", "of another mode", "missing"],
)
def test_what_a_mode_leaves_out_is_counted_and_what_is_missing_is_not(
    bound: Binding, second: bytes | None, valid: bool, left_out: bool
) -> None:
    objects = bound.sensors[0].reader.read([[PLACE] * 2, [second] * 2])
    assert objects.valid.tolist() == [valid] * 2
    assert objects.not_finite is not None
    assert objects.not_finite.tolist() == [left_out] * 2


def test_what_only_some_frames_carry_is_told_be_it_a_quantity_or_what_makes_an_object_valid(bound: Binding) -> None:
    named = [warning for warning in bound.warnings if "is there only where MODE is 1" in warning]
    assert len(named) == 2
    assert "r.dbc:12: signal 'SPEED' of 'B_0' is" in named[0]
    assert "r.dbc:11: signal 'QUALITY' of 'B_0' is" in named[1]
