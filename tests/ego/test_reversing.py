"""A car that backs out: what stands stays where it is, where the gear tells which way the wheels turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import CONFIRMED

DBC = """VERSION ""
BU_: CAR
BO_ 1024 HEADER: 8 CAR
 SG_ COUNT : 0|5@1+ (1,0) [0|16] "" CAR
 SG_ COUNTER : 8|8@1+ (1,0) [0|255] "" CAR
BO_ 1025 OBJECT: 8 CAR
 SG_ INDEX : 0|4@1+ (1,0) [0|15] "" CAR
 SG_ STATUS : 4|2@1+ (1,0) [0|2] "" CAR
 SG_ DIST_LONG : 8|12@1+ (0.0625,0) [0|255] "m" CAR
 SG_ DIST_LAT : 20|12@1- (0.03125,0) [-64|63] "m" CAR
 SG_ REL_SPEED : 32|12@1- (0.0625,0) [-128|127] "m/s" CAR
BO_ 1026 MOTION: 8 CAR
 SG_ SPEED : 0|16@1+ (0.01,0) [0|300] "km/h" CAR
 SG_ YAW_RATE : 16|16@1- (0.01,0) [-300|300] "deg/s" CAR
BO_ 1027 GEAR_BOX: 2 CAR
 SG_ GEAR : 0|4@1+ (1,0) [0|15] "" CAR
"""
YAML = """buses:
  car: {channel: can0}
ego:
  kind: odometry
  bus: car
  dbc: car.dbc
  signals: {speed: MOTION.SPEED, yaw_rate: MOTION.YAW_RATE, reverse: {signal: GEAR_BOX.GEAR, in: [7]}}
sensors:
  front:
    bus: car
    dbc: car.dbc
    mount: {x: 3.6}
    cycle_time: 0.05
    timeout: 0.03
    objects:
      messages: [{message: OBJECT, id_signal: INDEX}]
      slots: 16
      valid: [{signal: STATUS, in: [1, 2]}]
      new: [{signal: STATUS, in: [1]}]
    scan: {close: header, message: HEADER, count: COUNT, counter: COUNTER}
    signals: {x: DIST_LONG, y: DIST_LAT, range_rate: REL_SPEED}
    noise: {x: 0.15, y: 0.25, range_rate: 0.12}
    field_of_view: {range: 160, azimuth_deg: 45}
"""
BACKS = {
    "duration": 10,
    "ego": {"start": {"speed": 0}, "segments": [{"until": 3}, {"duration": 2, "speed": -4}]},
    "actors": [{"name": "parked", "start": {"x": 25, "y": 3, "speed": 0}}],
}


def written(folder: Path, yaml: str = YAML) -> Path:
    (folder / "car.dbc").write_text(DBC, encoding="utf-8")
    path = folder / "car.yaml"
    path.write_text(yaml, encoding="utf-8")
    return path


def speeds_of_what_stands(simulated: Path, tracked: Path) -> list[float]:
    """Return the speeds of the confirmed obstacle beside our way while we back, m/s."""
    of, found = bind(load_config(tracked)), list[float]()
    drive = simulate(Scenario.model_validate(BACKS), bind(load_config(simulated)), 1)
    for cycle in Pipeline(of).run(drive.frames()):
        if cycle.time_ns * 1e-9 - 1.7e9 > 6.0:
            told = cycle.obstacles
            there = (told.state == CONFIRMED) & (np.abs(told.y - 3.0) < 2.0)
            found += np.hypot(told.vx, told.vy)[there].tolist()
    return found


def test_what_stands_stays_while_we_back(tmp_path: Path) -> None:
    path = written(tmp_path)
    told = speeds_of_what_stands(path, path)
    assert len(told) > 50
    assert max(told) < 0.5


def test_without_the_gear_it_seems_to_come_towards_us(tmp_path: Path) -> None:
    (tmp_path / "without").mkdir()
    without = written(tmp_path / "without", YAML.replace(", reverse: {signal: GEAR_BOX.GEAR, in: [7]}", ""))
    assert np.median(speeds_of_what_stands(written(tmp_path), without)) == pytest.approx(8.0, abs=0.5)


def test_check_says_what_tells_that_we_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(tmp_path))]) == 0
    assert "backwards  GEAR_BOX.GEAR in 7" in capsys.readouterr().out


def test_a_gear_that_the_dbc_does_not_have_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(tmp_path, YAML.replace("in: [7]", "in: [17]")))]) == 2
    assert "car.yaml:7: ego.signals.reverse: 'GEAR' can have none of these values" in capsys.readouterr().err
