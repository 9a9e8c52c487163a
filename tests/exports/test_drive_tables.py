"""Rows of a drive's tables: what is not known is not told."""

from __future__ import annotations

from candaemon.exports.drive_tables import cycle_row
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding

PLACE = ("east", "north", "heading", "latitude", "longitude")


def test_while_own_motion_is_lost_its_place_on_earth_is_not_known_either() -> None:
    of, silent = binding("esr_ins_fd"), [{"quantity": "velocity_north", "begin": 1.0, "end": 12.5}]
    told = {"duration": 13.0, "ego": {"start": {"speed": 20.0}, "own_motion": {"silent": silent}}}
    pipeline, names = Pipeline(of), [sensor.name for sensor in of.sensors]
    frames = simulate(Scenario.model_validate(told), of, 1).frames()
    rows = [cycle_row(cycle, pipeline, names) for cycle in pipeline.run(frames)]
    lost = [[row.get(name) for name in PLACE] for row in rows if row["ego"] == "lost"]
    assert len(lost) > 10
    assert not any(value is not None for row in lost for value in row)
    assert all(None not in [row.get(name) for name in PLACE] for row in rows if row["ego"] == "dead_reckoning")
    assert all(row["time"] == int(str(row["time_ns"])) / 10**9 for row in rows)
