"""Modes of fusion of a group: central, federated, tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.estimation.federated import FederatedTracks
from candaemon.estimation.intersection import IntersectionTracks
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import LinearModel
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT

ORIGIN = np.zeros(2)


def two_lidars(folder: Path, group: dict[str, Any]) -> Path:
    """Write a configuration with two lidars, whose measurements are linear, in a group."""
    tree = yaml.safe_load((ROOT / "config" / "radar_lidar.yaml").read_text(encoding="utf-8"))
    lidar = tree["sensors"]["lidar"]
    tree["sensors"] = {"left": lidar | {"bus": "radar", "mount": {"x": 3.7, "y": 0.5}}, "right": lidar}
    tree["groups"] = {"ahead": {"sensors": ["left", "right"]} | group}
    del tree["tracker"]
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    path = folder / f"{group.get('fusion', 'mine')}.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


def bound(folder: Path, group: dict[str, Any]) -> Binding:
    return bind(load_config(two_lidars(folder, group)))


def motions(of: Binding) -> list[tuple[list[int], Floats]]:
    """Return the obstacles' identities, motion and deviations in each cycle of a drive."""
    braking = ({"until": 1.0}, {"until": 3.0, "acceleration": -2.0})
    actors = (
        {"name": "ahead", "start": {"x": 25.0, "y": 0.0, "speed": 12.0}, "segments": braking},
        {"name": "beside", "start": {"x": 15.0, "y": 3.5, "speed": 13.0}},
    )
    told = {"duration": 3.0, "ego": {"start": {"speed": 12.0}}, "actors": actors}
    drive = Scenario.model_validate(told)
    found = []
    for cycle in Pipeline(of).run(simulate(drive, of).frames()):
        seen = cycle.obstacles
        columns = (seen.east, seen.north, seen.ve, seen.vn, seen.ax, seen.ay, seen.sx, seen.sy, seen.svx, seen.svy)
        found.append((seen.id.tolist(), np.array(columns)))
    return found


@pytest.mark.parametrize("kind", ["cv", "ca"])
def test_federated_and_central_agree_through_the_whole_daemon(kind: str, tmp_path: Path) -> None:
    tracker = {"estimator": {"kind": kind, "noise": 5.0}}
    of = bound(tmp_path, {"tracker": tracker, "fusion": "federated"})
    assert isinstance(Pipeline(of).trackers[0]._tracks.estimator, FederatedTracks)  # type: ignore[union-attr]  # of points
    central = motions(bound(tmp_path, {"tracker": tracker}))
    federated = motions(of)
    assert len(central) > 100
    assert max(len(ids) for ids, _ in central) >= 2
    assert [ids for ids, _ in central] == [ids for ids, _ in federated]
    for (_, one), (_, other) in zip(central, federated, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)


def test_tracks_are_fused_by_intersection_and_not_taken_for_new_information(tmp_path: Path) -> None:
    of = bound(tmp_path, {"fusion": "tracks"})
    assert isinstance(Pipeline(of).trackers[0]._tracks.estimator, IntersectionTracks)  # type: ignore[union-attr]  # of points
    deviations = motions(of)[-1][1][6:8]
    central = motions(bound(tmp_path, {"tracker": {"estimator": {"kind": "ca", "noise": 5.0}}}))[-1][1][6:8]
    assert (deviations[:, :2] > 1.2 * central[:, :2]).all()
    assert (deviations[:, :2] < 0.2).all()  # 0.1 m of each sensor


def test_an_error_that_lasts_leaves_the_intersection_unsure_of_it() -> None:
    """Fifty times the same error of one standard deviation: a Kalman filter would state a seventh of it."""
    filter_ = IntersectionTracks(LinearModel(1, (0.0, 0.0)), acceleration=0.0, turn_rate=0.0, jerk=0.0)
    error, spread = np.array([[1.0, 0.0]]), np.eye(2)[None]
    filter_.spawn(error, spread, np.zeros((1, 2)), 0.01 * np.eye(2)[None])
    for _ in range(50):
        filter_.predict(0.05, np.array([[1.0, 0.0]]))
        filter_.update(np.array([0]), Measurement(error, spread, ORIGIN, ORIGIN))
    mean, covariance = filter_.combined()
    assert covariance[0, 0, 0] >= 0.9
    assert abs(mean[0, 0]) <= 1.01 * np.sqrt(covariance[0, 0, 0]) * 1.1


def test_two_independent_tracks_are_worth_more_than_either() -> None:
    filter_ = IntersectionTracks(LinearModel(1, (0.0, 0.0)), acceleration=0.0, turn_rate=0.0, jerk=0.0)
    flat = np.diag([1.0, 0.01])[None]
    filter_.spawn(np.zeros((1, 2)), flat, np.zeros((1, 2)), 1e-4 * np.eye(2)[None])
    filter_.update(np.array([0]), Measurement(np.zeros((1, 2)), flat[:, ::-1, ::-1], ORIGIN, ORIGIN))
    _, covariance = filter_.combined()
    assert covariance[0, 0, 0] + covariance[0, 1, 1] < 0.05  # each alone has 1.01


@pytest.mark.parametrize(
    ("group", "problem"),
    [
        ({"fusion": "federated", "tracker": {"estimator": {"kind": "imm"}}}, r"found imm, but fusion: federated"),
        ({"fusion": "tracks", "tracker": {"estimator": {"kind": "vehicle"}}}, r"found vehicle, but fusion: tracks"),
        ({"fusion": "fedrated"}, r"groups\.ahead\.fusion: found 'fedrated'.*federated"),
        ({"sensors": ["left", "rihgt"]}, r"found sensor 'rihgt'.*did you mean 'right'"),
    ],
)
def test_a_group_that_cannot_be_is_an_error_with_its_line(group: dict[str, Any], problem: str, tmp_path: Path) -> None:
    path = two_lidars(tmp_path, group)
    with pytest.raises(ConfigError, match=problem) as error:
        load_config(path)
    assert error.value.line is not None
    line = path.read_text(encoding="utf-8").splitlines()[error.value.line - 1]
    assert any(word in line for word in ("estimator", "fusion", "rihgt", "kind"))


def test_a_sensor_in_two_groups_is_an_error_with_its_line(tmp_path: Path) -> None:
    path = two_lidars(tmp_path, {})
    path.write_text(path.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    text = path.read_text(encoding="utf-8").replace("groups:\n", "groups:\n  other: {sensors: [left]}\n")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match="sensor 'left' is in group 'other' already") as error:
        load_config(path)
    assert error.value.line is not None
    assert "left" in text.splitlines()[error.value.line - 1]
