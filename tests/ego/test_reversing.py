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
from tests.support.small_car import YAML, written

BACKS = {
    "duration": 10,
    "ego": {"start": {"speed": 0}, "segments": [{"until": 3}, {"duration": 2, "speed": -4}]},
    "actors": [{"name": "parked", "start": {"x": 25, "y": 3, "speed": 0}}],
}


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
