"""A car that backs out: what stands stays where it is, where the gear tells which way the wheels turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.cli.main import main
from candaemon.cli.status import sheets
from candaemon.config.load import load_config
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.status.fault_log import FaultLogger
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.tracking.obstacles import CONFIRMED
from tests.support.served import Served
from tests.support.small_car import YAML, written

GEAR_BOX = 1027
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


def backing_with_a_silent_gear(of: Binding) -> list[Frame]:
    """Return the frames of a drive whose gear falls silent in reverse, from time 0 on."""
    frames = list(simulate(Scenario.model_validate(BACKS), of, 1).frames())
    frames = [frame._replace(time_ns=frame.time_ns - frames[0].time_ns) for frame in frames]
    return [frame for frame in frames if frame.can_id != GEAR_BOX or frame.time_ns < 5e9]


def test_a_gear_that_falls_silent_is_told_of_a_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = written(tmp_path), tmp_path / "drive.log"
    frames = backing_with_a_silent_gear(bind(load_config(path)))
    lines = [f"({each.time_ns * 1e-9:.6f}) can0 {each.can_id:03X}#{each.data.hex()}\n" for each in frames]
    log.write_text("".join(lines), encoding="utf-8")
    assert main(["replay", str(path), str(log)]) == 0
    told = capsys.readouterr().err
    assert "the signal that tells reverse was silent in " in told
    assert "raise ego.reverse_age_limit" in told
    path.write_text(YAML.replace("  signals:", "  reverse_age_limit: 8\n  signals:", 1), encoding="utf-8")
    assert main(["replay", str(path), str(log)]) == 0
    assert "tells reverse" not in capsys.readouterr().err


def test_a_gear_that_falls_silent_is_told_by_the_service(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    of = bind(load_config(written(tmp_path, YAML.replace("{channel: can0", "{interface: virtual, channel: gear"))))
    meter = ServiceMonitor(of.settings.service.metrics)
    with caplog.at_level("WARNING"), Served(of, [meter, FaultLogger()]) as served:
        served.feed(backing_with_a_silent_gear(of))
        status = meter.wait_for_snapshot(5.0)
    assert "own motion's signal of reverse: silent, speeds count as ahead" in caplog.messages
    assert status.own_motion.samples["direction_assumed"] > 50
    (sheet,) = (each for each in sheets(status.tree()) if each.title == "own motion's signal of reverse")
    assert sheet.rows[0][1] == f"{status.own_motion.samples['direction_assumed']}"


def test_check_says_what_tells_that_we_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(tmp_path))]) == 0
    assert "backwards  GEAR_BOX.GEAR in 7" in capsys.readouterr().out


def test_a_gear_that_the_dbc_does_not_have_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(tmp_path, YAML.replace("in: [7]", "in: [17]")))]) == 2
    assert "car.yaml:7: ego.signals.reverse: 'GEAR' can have none of these values" in capsys.readouterr().err
