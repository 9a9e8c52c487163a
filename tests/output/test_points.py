"""Several obstacles in one message: written whole each cycle, and read back to what they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.output.decoder import DecodedCycle, OutputDecoder
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT
from tests.support.simulated import scenario

SIGNALS = (
    ("State", 0, 8, "+ (1,0)", ""),
    ("Id", 8, 16, "+ (1,0)", ""),
    ("X", 24, 16, "- (0.01,0)", "m"),
    ("Y", 40, 16, "- (0.01,0)", "m"),
    ("Vx", 56, 16, "- (0.01,0)", "m/s"),
    ("Vy", 72, 16, "- (0.01,0)", "m/s"),
)
POINTS, MESSAGES = 5, 4
OUTPUT = """\
output:
  bus: obstacles
  dbc: lists.dbc
  objects:
    messages: ["OBSTACLES_{slot}"]
    slots: 20
    first: 1
    points: 5
    valid: [{signal: "State_{object}", in: [1, 2, 3]}]
  signals:
    {id: "Id_{object}", state: "State_{object}", x: "X_{object}", y: "Y_{object}", vx: "Vx_{object}",
     vy: "Vy_{object}"}
  status: {message: STATUS, signals: {Cycle: cycle}}
"""


def dbc() -> str:
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: CANDAEMON", "BO_ 100 STATUS: 8 CANDAEMON",
             ' SG_ Cycle : 0|16@1+ (1,0) [0|65535] "" CANDAEMON']  # fmt: skip
    for k in range(MESSAGES):
        lines.append(f"BO_ {101 + k} OBSTACLES_{k + 1}: 64 CANDAEMON")
        for point in range(POINTS):
            lines += [
                f' SG_ {name}_{1 + POINTS * k + point} : {96 * point + at}|{bits}@1{rest} [0|0] "{unit}" CANDAEMON'
                for name, at, bits, rest, unit in SIGNALS
            ]
    return "\n".join(lines)


def test_obstacles_side_by_side_in_a_message_are_read_as_they_were_sent(tmp_path: Path) -> None:
    text = (ROOT / "config" / "ars408.yaml").read_text(encoding="utf-8")
    text = text[: text.index("output:")].replace("../dbc", str(ROOT / "dbc"))
    (tmp_path / "lists.dbc").write_text(dbc(), encoding="utf-8")
    path = tmp_path / "vehicle.yaml"
    path.write_text(text.replace("{channel: can3}", "{channel: can3, fd: true}") + OUTPUT, encoding="utf-8")
    binding = bind(load_config(path))
    assert binding.output is not None
    decoder, sent = OutputDecoder(binding.output), []
    read: list[DecodedCycle] = []
    drama = scenario("highway").model_copy(update={"duration": 3.0})
    for cycle in Pipeline(binding).run(simulate(drama, binding, 1).frames()):
        frames = list(cycle.frames)
        assert len(frames) == 1 + MESSAGES
        for frame in frames:
            read += decoder.push(frame.can_id, frame.data)
        sent.append(cycle.obstacles)
    read += decoder.flush()
    assert len(read) == len(sent) > 20
    count = 0
    for told, obstacles in zip(read, sent, strict=True):
        sure = {int(number): row for row, number in enumerate(obstacles.id) if obstacles.state[row] > 0}
        numbers = told.quantities["id"].astype(int).tolist()
        assert sorted(numbers) == sorted(sure)
        rows = [sure[number] for number in numbers]
        for name in ("x", "y", "vx", "vy"):
            assert told.quantities[name] == pytest.approx(getattr(obstacles, name)[rows], abs=0.006)
        count += len(numbers)
    assert count > 60
    assert np.unique([len(each.quantities["id"]) for each in read]).size > 1
