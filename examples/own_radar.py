"""Your own radar in ten lines of YAML: a configuration, checked, simulated and replayed.

`python examples/own_radar.py` works in a temporary folder. The DBC files are the Toyota's that come with candaemon: put
yours in their place, and your signals' names into the YAML.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from candaemon import (
    ReplayRequest,
    bind,
    load_config,
    load_scenario,
    record,
    replay,
    shared_folder,
    simulate,
    summarise,
)

SHARED = shared_folder()
YAML = """
buses: {car: {channel: can0}, radar: {channel: can1}}
ego: {kind: odometry, bus: car, dbc: car.dbc, signals: {speed: SPEED.SPEED, yaw_rate: KINEMATICS.YAW_RATE}}
sensors:
  front: {
    bus: radar, dbc: radar.dbc, cycle_time: 0.05, mount: {x: 3.6},
    objects: {messages: ["TRACK_A_{slot}"], slots: 16, valid: [{signal: VALID, in: [1]}]},
    scan: {close: counter, signal: COUNTER},
    signals: {x: LONG_DIST, y: -LAT_DIST, range_rate: REL_SPEED},
    noise: {x: 0.15, y: 0.25, range_rate: 0.12},
  }
"""

with TemporaryDirectory() as folder:
    path, log = Path(folder, "my_radar.yaml"), Path(folder, "drive.log")
    for name in ("car", "radar"):
        shutil.copy(SHARED / "dbc" / f"toyota_rav4_{name}.dbc", Path(folder, f"{name}.dbc"))
    path.write_text(YAML, encoding="utf-8")
    binding = bind(load_config(path))  # every name is checked: an error names file and line
    scenario = load_scenario(SHARED / "config" / "scenarios" / "highway.yaml")
    record(simulate(scenario, binding, seed=1), binding, log)
    figures = summarise(replay(binding, ReplayRequest(log)))
    print(f"{figures['sensors']['front']['scans']} scans, {figures['tracks']['confirmed']} obstacles confirmed")
    print(f"NIS {figures['nis']['mean']:.2f}, expected {figures['nis']['expected']:.2f}")
