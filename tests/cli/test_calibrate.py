"""`candaemon calibrate` on simulated drives, and on the recorded one."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from candaemon.binding.bind import bind
from candaemon.calibration.proposals import STATED
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.config.sensors import SensorSettings
from candaemon.objects.signals import SignalBinding
from candaemon.playback.calibrating import calibrate
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.playback.summary import summarise
from tests.support.paths import DATA, ROOT
from tests.support.rav4 import OF_POINTS

CONFIGS = ROOT / "config"
DRIVE = DATA / "rav4_drive" / "drive.log.gz"
SCENE = """
duration: {seconds}
seed: {seed}
ego:
  start: {{speed: 18}}
  segments: [{{until: 3}}, {{until: 7, acceleration: -1.5}}, {{until: 11, yaw_rate_deg: 6}}, {{until: 15, yaw_rate_deg: -6}}, {{until: 19, acceleration: 1.5}}, {{until: 22}}, {{until: 25, acceleration: -2}}, {{until: 29, yaw_rate_deg: -8}}, {{until: 33, yaw_rate_deg: 8}}, {{until: 36, acceleration: 2}}, {{until: 40, acceleration: -2}}, {{until: 44, acceleration: 2}}]
stationary:
  rails: [{{begin: {{x: 0, y: 12}}, end: {{x: 900, y: 50}}, spacing: 9}}, {{begin: {{x: 0, y: -12}}, end: {{x: 900, y: -20}}, spacing: 9}}, {{begin: {{x: 0, y: 100}}, end: {{x: 900, y: 100}}, spacing: 15}}]
measurement: {{turned_deg: {turned}{more}}}
frames: {{latency: {latency}}}
"""  # noqa: E501 - a scene reads best with a line a thing


def _drive(
    folder: Path,
    config: str,
    *,
    seed: int = 1,
    seconds: float = 24,
    turned: float = 0.0,
    latency: float = 0.0,
    more: str = "",
) -> Path:
    scene, log = folder / "scene.yaml", folder / f"{config}_{seed}.log"
    scene.write_text(
        SCENE.format(seed=seed, seconds=seconds, turned=turned, latency=latency, more=more), encoding="utf-8"
    )
    assert main(["simulate", str(scene), str(CONFIGS / f"{config}.yaml"), "-o", str(log)]) == 0
    return log


def _patch(folder: Path, config: Path, *logs: Path) -> dict[str, Any]:
    path = folder / "patch.yaml"
    assert main(["calibrate", str(config), *map(str, logs), "-o", str(path)]) == 0
    found: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return found


def _patched(folder: Path, config: str, changes: Mapping[str, Any]) -> Path:
    """Write a configuration with other settings in place of its own."""
    text = (CONFIGS / f"{config}.yaml").read_text(encoding="utf-8").replace("../dbc/", f"{ROOT / 'dbc'}/")
    tree = yaml.safe_load(text)
    _merge(tree, changes)
    path = folder / f"{config}_patched.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


def _merge(tree: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping):
            _merge(tree.setdefault(key, {}), value)
        else:
            tree[key] = value


def test_a_late_and_turned_sensor_is_found_and_found_no_more_once_it_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = _drive(tmp_path, "demo", seconds=20, turned=2.0, latency=0.1)
    changes = _patch(tmp_path, CONFIGS / "demo.yaml", log)
    front = changes["sensors"]["front"]
    assert front["latency"] == pytest.approx(0.1, abs=0.02)
    assert front["mount"]["yaw_deg"] == pytest.approx(2.0, abs=0.3)
    told = _patched(tmp_path, "demo", changes)
    capsys.readouterr()
    again = _patch(tmp_path, told, log)
    assert again == {}
    assert "not enough" not in capsys.readouterr().out.replace("noise.walk", "")


def test_a_log_without_standing_things_has_not_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "cruise.log"
    scene = tmp_path / "cruise.yaml"
    scene.write_text(
        "duration: 5\nego: {start: {speed: 20}}\nactors: [{name: ahead, start: {x: 40, y: 0, speed: 20}}]\n",
        encoding="utf-8",
    )
    assert main(["simulate", str(scene), str(CONFIGS / "demo.yaml"), "-o", str(log)]) == 0
    capsys.readouterr()
    assert _patch(tmp_path, CONFIGS / "demo.yaml", log) == {}
    told = capsys.readouterr()
    rows = [line for line in told.out.splitlines() if "front." in line]
    assert len(rows) == 7
    assert all("not enough" in row for row in rows)
    assert "nothing can be told: a minute or more of returns that stand is needed" in told.err


def test_a_log_without_own_motion_is_told_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, radar = tmp_path / "drive.log", tmp_path / "radar.log"
    assert main(["simulate", "highway", "esr_ins", "-o", str(log), "--seed", "1"]) == 0
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    radar.write_text("".join(line for line in lines if " can2 " not in line), encoding="utf-8")
    capsys.readouterr()
    assert main(["calibrate", "esr_ins", str(radar)]) == 0
    told = capsys.readouterr().err
    assert f"{radar}: own motion was never known: latitude, longitude, velocity" in told


def test_a_static_ego_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = _patched(tmp_path, "demo", {})
    tree = yaml.safe_load(config.read_text(encoding="utf-8"))
    config.write_text(yaml.safe_dump(tree | {"ego": {"kind": "static"}}), encoding="utf-8")
    assert main(["calibrate", str(config), str(tmp_path / "none.log")]) == 2
    assert "ego is static" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("radar", ["demo", "toyota_rav4", "tesla_continental"])
def test_a_walk_is_proposed_where_another_is_given_and_left_to_the_tracker_where_none_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], radar: str
) -> None:
    walks = "{own_filter: {white: 0.1, walk: 0.2, walk_along: 0.05, slides: 0}, correlation: {near: 0, far: 0}}"
    log = _drive(tmp_path, radar, seed=3, seconds=30, more=f", traffic: {walks}")
    config = _patched(tmp_path, radar, {})
    tree = yaml.safe_load(config.read_text(encoding="utf-8"))
    tree["tracker"] = {"estimator": {"kind": "vehicle"}}
    config.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    for sensor in _patch(tmp_path, config, log).get("sensors", {}).values():
        assert "walk" not in sensor["noise"]
    (told,) = [line for line in capsys.readouterr().out.splitlines() if ".noise.walk.across" in line]
    assert float(told.split()[3]) == pytest.approx(0.2, rel=0.2)
    assert told.endswith("learnt by the tracker")
    (given,) = tree["sensors"].values()
    given["noise"]["walk"] = {"along": 0.3, "across": 0.02}
    config.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    changes = _patch(tmp_path, config, log)
    (sensor,) = changes["sensors"].values()
    assert sensor["noise"]["walk"]["across"] == pytest.approx(0.2, rel=0.2)
    assert sensor["noise"]["walk"]["along"] == pytest.approx(0.05, rel=0.2)
    _merge(tree, changes)
    config.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    assert _patch(tmp_path, config, log) == {}


@pytest.mark.slow
@pytest.mark.skipif(not DRIVE.exists(), reason="the recorded drive is not here")
@pytest.mark.parametrize(
    ("settings", "allowance"), [({}, 1.02), (OF_POINTS, 1.0)], ids=["obstacles are vehicles", "obstacles are points"]
)
def test_what_the_recorded_drive_proposes_meets_its_bounds(
    tmp_path: Path, settings: dict[str, Any], allowance: float
) -> None:
    """Without an INS; what is proposed of the noise makes the predictions of vehicles no better."""
    config = _patched(tmp_path, "toyota_rav4", settings)
    tree = yaml.safe_load(config.read_text(encoding="utf-8"))
    _merge(tree, _patch(tmp_path, config, DRIVE))
    config.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    figures = summarise(replay(bind(load_config(config)), ReplayRequest(DRIVE)))
    soon, later = figures["predictions"]
    assert soon["x"] < 0.20 * allowance
    assert later["x"] < 0.30 * allowance
    assert soon["y"] < 0.27 * allowance
    assert later["y"] < 0.37 * allowance
    assert figures["stationary"]["vx"] < 0.27
    assert figures["stationary"]["speed"] < 0.45


@pytest.mark.slow
@pytest.mark.skipif(not DRIVE.exists(), reason="the recorded drive is not here")
def test_what_the_recorded_drive_proposes_it_proposes_once(tmp_path: Path) -> None:
    changes = _patch(tmp_path, CONFIGS / "toyota_rav4.yaml", DRIVE)
    assert changes["sensors"]["front"]["noise"].keys() == {"x", "y", "range_rate"}
    assert _patch(tmp_path, _patched(tmp_path, "toyota_rav4", changes), DRIVE) == {}


@pytest.mark.slow
@pytest.mark.skipif(not DRIVE.exists(), reason="the recorded drive is not here")
@pytest.mark.parametrize("yaw_deg", [5.0, -3.0])
def test_a_mounting_that_is_obviously_turned_is_told_though_not_to_a_third_of_a_degree(
    tmp_path: Path, yaw_deg: float
) -> None:
    """The drive goes straight on most of the time: one standard deviation is 0.38°."""
    turned = _patched(tmp_path, "toyota_rav4", {"sensors": {"front": {"mount": {"yaw_deg": yaw_deg}}}})
    found = _patch(tmp_path, turned, DRIVE)["sensors"]["front"]["mount"]["yaw_deg"]
    assert found == pytest.approx(0.0, abs=0.8)


def _simulated(settings: SensorSettings, binding: SignalBinding) -> float:
    """Return the noise of a simulated quantity, SI: the configured one, and the rounding to steps of its signal."""
    name = binding.quantity
    configured = getattr(settings.noise, "azimuth_deg" if name == "azimuth" else name, None) or 0.0
    drawn = np.radians(configured) if name == "azimuth" else configured
    return float(np.hypot(drawn, abs(binding.signal.scale * binding.gain) / np.sqrt(12.0)))


RADARS = ("demo", "toyota_rav4", "mando", "gm_lrr", "acura_ilx", "tesla_continental", "ars408")


@pytest.mark.slow
@pytest.mark.parametrize("config", RADARS if os.environ.get("CANDAEMON_THOROUGH") else RADARS[1:2])
def test_calibration_of_many_drives_is_as_sure_as_it_says(tmp_path: Path, config: str) -> None:
    drives = 50 if os.environ.get("CANDAEMON_THOROUGH") else 4
    random = np.random.default_rng(5)
    binding = bind(load_config(CONFIGS / f"{config}.yaml"))
    sensor = binding.sensors[0]
    expected = {each.quantity: _simulated(sensor.settings, each) for each in sensor.reader.bindings}
    within: list[bool] = []
    for seed in range(drives):
        latency, turned = round(random.uniform(0.0, 0.25), 3), round(random.uniform(-4.0, 4.0), 2)
        log = _drive(tmp_path, config, seed=seed, seconds=30, turned=turned, latency=latency)
        found = calibrate(binding, [log], {})[sensor.name]
        error = found.estimate.mean[:2] - (latency, np.radians(turned))
        within += (np.abs(error) < STATED * found.estimate.deviation[:2]).tolist()
        assert abs(error[0]) < 0.02
        assert abs(error[1]) < np.radians(0.3)
        log.unlink()
        for name, parts in found.noise.items():
            assert parts is not None
            assert parts.deviation == pytest.approx(expected[name], rel=0.2)
    assert np.mean(within) >= 0.9 if drives == 50 else np.mean(within) > 0.6
