"""A car with one radar and little else, by a DBC and a configuration that fit on a page."""

from __future__ import annotations

from pathlib import Path

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
  car: {channel: can0, bitrate: 500000}
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


def written(folder: Path, yaml: str = YAML, dbc: str = DBC) -> Path:
    """Write both files into a folder; return the path of the configuration."""
    (folder / "car.dbc").write_text(dbc, encoding="utf-8")
    path = folder / "car.yaml"
    path.write_text(yaml, encoding="utf-8")
    return path
