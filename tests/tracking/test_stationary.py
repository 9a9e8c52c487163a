"""What the detections of stationary obstacles teach of the speed's factor, on simulated drives along guard rails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.ego.odometry import OdometryMotion
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from tests.support.paths import ROOT

Learnt = tuple[float, float]
"""The speed's factor and its standard deviation."""

WHEELS = {
    "kind": "odometry",
    "bus": "ins",
    "dbc": str(ROOT / "dbc/toyota_rav4_car.dbc"),
    "signals": {
        "left_wheels": ["WHEEL_SPEEDS.WHEEL_SPEED_FL", "WHEEL_SPEEDS.WHEEL_SPEED_RL"],
        "right_wheels": ["WHEEL_SPEEDS.WHEEL_SPEED_FR", "WHEEL_SPEEDS.WHEEL_SPEED_RR"],
        "yaw_rate": "KINEMATICS.YAW_RATE",
    },
    "noise": {"speed": 0.05},
}
RAILS = [
    {"begin": {"x": 20, "y": -5}, "end": {"x": 1000, "y": -5}, "spacing": 12},
    {"begin": {"x": 26, "y": 9}, "end": {"x": 1000, "y": 9}, "spacing": 16},
]


@pytest.fixture
def learnt(tmp_path: Path) -> Callable[..., Learnt]:
    """Return what learns the speed's factor on a drive of 15 s with a radar whose range rates are made absolute."""

    def of(ego: dict[str, Any], range_rates: str, latency: float = 0.0) -> Learnt:
        config = yaml.safe_load((ROOT / "config/compensated_radar.yaml").read_text(encoding="utf-8"))
        for section in (*config["buses"].values(), *config["sensors"].values(), config["output"]):
            section.update({"dbc": str(ROOT / "dbc" / Path(section["dbc"]).name)} if "dbc" in section else {})
        config["ego"] = WHEELS
        for sensor in config["sensors"].values():
            sensor.update(range_rates=range_rates, latency=latency)
        path = tmp_path / "config.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        binding = bind(load_config(path))
        told = {"duration": 15, "ego": ego, "stationary": {"rails": RAILS}, "measurement": {"clutter": 0}}
        pipeline = Pipeline(binding)
        for _ in pipeline.run(Simulation(Scenario.model_validate(told), binding, 1).frames()):
            pass
        assert isinstance(pipeline.ego, OdometryMotion)
        bias = pipeline.ego.bias
        return bias.scale, bias.state.covariance[0][0] ** 0.5

    return of


def test_stationary_objects_tell_the_speeds_factor_where_range_rates_are_relative(
    learnt: Callable[..., Learnt],
) -> None:
    scale, deviation = learnt({"start": {"speed": 22}, "own_motion": {"speed_factor": 1.03}}, "relative")
    assert scale == pytest.approx(1 / 1.03, abs=4 * deviation)
    assert deviation < 0.002


def test_a_radar_that_adds_the_own_speed_itself_says_nothing_of_its_factor(learnt: Callable[..., Learnt]) -> None:
    scale, deviation = learnt({"start": {"speed": 22}, "own_motion": {"speed_factor": 1.03}}, "absolute")
    assert scale == 1.0
    assert deviation == pytest.approx(0.02)


@pytest.mark.parametrize(("speed", "acceleration"), [(8, 2.5), (35, -2.5)])
def test_the_speed_is_that_of_the_measurement_not_the_latest(
    speed: float, acceleration: float, learnt: Callable[..., Learnt]
) -> None:
    """At 2.5 m/s² what was measured 0.2 s ago was measured at 0.5 m/s less, or more."""
    ego = {
        "start": {"speed": speed},
        "segments": [{"until": 1}, {"duration": 10, "acceleration": acceleration}],
        "own_motion": {"speed_factor": 1.0},
    }
    scale, deviation = learnt(ego, "relative", latency=0.2)
    assert scale == pytest.approx(1.0, abs=4 * deviation)
