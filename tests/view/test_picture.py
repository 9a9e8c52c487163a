"""A picture holds what the cycle does, and says it as JSON."""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.tracking.body_modes import MODE_NAMES
from candaemon.view.painter import Painter, stage_of
from candaemon.view.picture import COLUMNS, Picture
from tests.support.paths import ROOT
from tests.support.recorded import highway
from tests.support.viewing import demo_binding, demo_pictures


def painted(config: Path, seconds: float = 2.0) -> list[tuple[Cycle, Picture, tuple[list[int], list[float]]]]:
    """Return cycles of a simulated drive with their pictures, and ids and NIS of the detections that were used."""
    binding = bind(load_config(config))
    pipeline = Pipeline(binding)
    painter, found = Painter(pipeline), []
    for cycle in chain(pipeline.run(highway(binding, seconds)), pipeline.finish()):
        used: tuple[list[int], list[float]] = ([], [])
        if cycle.update is not None:
            used = cycle.obstacles.id[cycle.obstacles.used_row].tolist(), cycle.update.nis.tolist()
        found.append((cycle, painter.paint(cycle), used))
    return found


def test_a_picture_holds_the_obstacles_of_its_cycle() -> None:
    for cycle, picture, (ids, nis) in painted(ROOT / "config" / "demo.yaml"):
        obstacles = cycle.obstacles
        assert set(picture.columns) == set(COLUMNS)
        for name in ("id", "state", "x", "y", "vx", "vy", "sx", "length", "center_x"):
            np.testing.assert_array_equal(picture.columns[name], getattr(obstacles, name))
        np.testing.assert_array_equal(picture.columns["sxy"], obstacles.covariance[:, 0, 1])
        assert picture.time_ns == obstacles.time_ns
        for row, identity in enumerate(obstacles.id.tolist()):
            own = [value for each, value in zip(ids, nis, strict=True) if each == identity and np.isfinite(value)]
            ratio = picture.columns["nis"][row]
            assert np.isfinite(ratio) == bool(own)
            assert not own or ratio * 2 <= sum(own) <= ratio * 8 * len(own)  # 2 to 8 degrees of freedom each


def test_innovations_are_what_the_sensor_errs_by() -> None:
    rows = [picture.columns for _, picture, _ in painted(ROOT / "config" / "demo.yaml", 4.0)[30:]]
    errors = np.concatenate([columns["innovation_x"] for columns in rows])
    errors = errors[np.isfinite(errors)]
    assert len(errors) > 100
    assert 0.05 < np.sqrt(np.mean(errors**2)) < 1.0  # the radar's noise is 0.25 m


def test_a_picture_is_json_without_what_json_does_not_have() -> None:
    for picture in demo_pictures():
        tree = json.loads(picture.encoded(), parse_constant=pytest.fail)
        assert tree["t"] == pytest.approx(picture.time, abs=1e-4)
        assert tree["obstacles"]["id"] == picture.columns["id"].tolist()
        assert tree["obstacles"]["x"] == pytest.approx(picture.columns["x"].tolist(), abs=6e-4)
        assert {len(values) for values in tree["obstacles"].values()} == {len(picture)}
        for sensor, ids, xs, ys in tree["scans"]:
            assert sensor == 0
            assert len(ids) == len(xs) == len(ys)


def test_health_comes_once_a_second_and_counts_what_the_pipeline_counts() -> None:
    told = [picture.health for picture in demo_pictures() if picture.health]
    assert len(told) == 2
    assert told[-1]["sensors"]["front"]["rate"] == pytest.approx(20, abs=2)
    assert told[-1]["buses"]["radar"]["received"] > told[0]["buses"]["radar"]["received"] > 0


@pytest.mark.parametrize("config", ["esr_ins", "toyota_rav4_ins"])
def test_probabilities_of_the_models_sum_to_one(config: str) -> None:
    found = [
        (picture, cycle)
        for cycle, picture, _ in painted(ROOT / "config" / f"{config}.yaml", 1.0)
        if cycle.tracker is not None and len(picture)
    ]
    assert found
    for picture, _ in found:
        assert picture.modes.shape == (len(picture), len(MODE_NAMES))
        np.testing.assert_allclose(picture.modes.sum(axis=1), 1.0, atol=1e-9)


def test_the_stage_names_what_numbers_mean() -> None:
    stage = stage_of(demo_binding())
    (sensor,) = stage["sensors"]
    assert (sensor["name"], sensor["x"]) == ("front", 3.6)
    assert sensor["views"][0]["far"] == 174
    assert sensor["views"][0]["half"] == pytest.approx(np.pi / 4)
    assert stage["states"] == ["tentative", "confirmed", "coasting"]
    json.dumps(stage, allow_nan=False)
