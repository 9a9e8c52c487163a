"""A simulated radar without identities lists what it sees by distance: a slot is somebody else's when order changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.radar.assembler_factory import make_assembler
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT

OVERTAKING = {
    "duration": 4,
    "ego": {"start": {"speed": 20}},
    "actors": [
        {"name": "slow", "reflections": 1, "start": {"x": 50, "y": 0, "vx": 20, "vy": 0}},
        {"name": "fast", "reflections": 1, "start": {"x": 30, "y": 4, "vx": 30, "vy": 0}},
    ],
    "measurement": {"clutter": 0, "detection_probability": 1},
}


@pytest.mark.parametrize("shape", ["esr_ins", "ars408"])
def test_slots_follow_the_distance(tmp_path: Path, shape: str) -> None:
    text = (ROOT / "config" / f"{shape}.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(("new:", "identity:"))]
    sensor, path = lines.index("sensors:"), tmp_path / "vehicle.yaml"
    slots = next(k for k in range(sensor, len(lines)) if lines[k].lstrip().startswith("slots:"))
    lines.insert(slots, "      identity: false")
    path.write_text("\n".join(lines), encoding="utf-8")
    binding = bind(load_config(path))
    drive = simulate(Scenario.model_validate(OVERTAKING), binding, seed=1)
    owners = [dict(zip(each.object_id.tolist(), each.source.tolist(), strict=True)) for each in drive.origins()]
    assert owners[0] == {0: 2, 1: 1}
    assert owners[-1] == {0: 1, 1: 2}

    assembler, reader = make_assembler(binding.sensors[0]), binding.sensors[0].reader
    for frame in drive.frames():
        if frame.bus != binding.sensors[0].bus or frame.can_id not in assembler.routes:
            continue
        receive, part, slot = assembler.routes[frame.can_id]
        scan = receive(part, slot, frame.data, frame.time_ns)
        if scan is not None and len(scan.slot) == 2:
            values = dict(zip(reader.quantities, scan.values, strict=True))
            distance = values["range"] if "range" in values else np.hypot(values["x"], values["y"])
            assert distance[0] <= distance[1] + 0.5
