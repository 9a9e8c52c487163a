"""The file in which a service keeps what it learnt."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from candaemon.binding.bound import Binding
from candaemon.calibration import kept
from candaemon.calibration.kept import LONGEST_FILE, begin, write
from candaemon.calibration.parameters import Estimate
from candaemon.daemon.observer import DaemonView
from candaemon.errors import InputError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.status.calibration_keeper import INTERVAL_S, CalibrationKeeper
from tests.support.bound import binding

LEARNT = Estimate(np.array([0.08, -0.03, 0.001, 0.0]), np.diag([1e-5, 1e-6, 1e-6, 1e-9]))


def _with(of: Binding, **settings: Any) -> Binding:
    calibration = of.settings.calibration.model_copy(update=settings)
    return replace(of, loaded=replace(of.loaded, config=of.settings.model_copy(update={"calibration": calibration})))


def _pipeline(of: Binding | None = None) -> Pipeline:
    return Pipeline(_with(of or binding("demo"), apply=True))


def _written(path: Path) -> Pipeline:
    pipeline = _pipeline()
    assert pipeline.calibrator is not None
    pipeline.calibrator.begin_with(0, LEARNT)
    write(path, pipeline.calibrator, pipeline.binding)
    return pipeline


def test_a_restart_begins_with_what_was_learnt(tmp_path: Path) -> None:
    path = tmp_path / kept.NAME
    _written(path)
    again = _pipeline()
    assert again.calibrator is not None
    assert begin(path, again.calibrator, again.binding).used == ("front",)
    np.testing.assert_allclose(again.calibrator.state.sensors[0].mean, LEARNT.mean)
    np.testing.assert_allclose(again.calibrator.state.sensors[0].covariance, LEARNT.covariance)
    assert again.calibrator.latency_ns(0) == 80_000_000
    assert again.calibrator.yaw(0) == pytest.approx(-0.03)


def test_without_a_file_it_begins_with_nothing(tmp_path: Path) -> None:
    pipeline = _pipeline()
    assert pipeline.calibrator is not None
    assert begin(tmp_path / "none", pipeline.calibrator, pipeline.binding).used == ()
    assert not pipeline.calibrator.is_known(0)


def test_what_was_learnt_of_other_settings_is_not_used(tmp_path: Path) -> None:
    path = tmp_path / kept.NAME
    of = _written(path).binding
    sensor = of.settings.sensors["front"].model_copy(update={"latency": 0.05})
    config = of.settings.model_copy(update={"sensors": {"front": sensor}})
    other = replace(of, loaded=replace(of.loaded, config=config), sensors=(replace(of.sensors[0], settings=sensor),))
    pipeline = _pipeline(other)
    assert pipeline.calibrator is not None
    begun = begin(path, pipeline.calibrator, pipeline.binding)
    assert (begun.used, begun.changed) == ((), ("front",))
    assert pipeline.calibrator.latency_ns(0) == 0


@pytest.mark.parametrize(
    ("of", "value", "message"),
    [
        ("mean", [0.1, 0.0, 0.0], "at least 4"),
        ("mean", [9.0, 0.0, 0.0, 0.0], "beyond what is ever estimated"),
        ("covariance", np.full((4, 4), -1.0).tolist(), "covariance is none"),
        ("covariance", np.ones((4, 4)).tolist(), "covariance is none"),
        ("of", 5, "string"),
    ],
)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, of: str, value: object, message: str) -> None:
    path = tmp_path / kept.NAME
    _written(path)
    content = json.loads(path.read_text(encoding="utf-8"))
    content["sensors"]["front"][of] = value
    path.write_text(json.dumps(content), encoding="utf-8")
    pipeline = _pipeline()
    assert pipeline.calibrator is not None
    with pytest.raises(InputError, match=rf"calibration\.json.*is damaged .*{message}"):
        begin(path, pipeline.calibrator, pipeline.binding)
    assert not pipeline.calibrator.is_known(0)


def test_a_file_that_is_too_long_is_refused(tmp_path: Path) -> None:
    path = tmp_path / kept.NAME
    pipeline = _written(path)
    assert pipeline.calibrator is not None
    content = path.read_text(encoding="utf-8")
    path.write_text(content.ljust(LONGEST_FILE), encoding="utf-8")
    assert begin(path, pipeline.calibrator, pipeline.binding).used == ("front",)
    path.write_text(content.ljust(LONGEST_FILE + 1), encoding="utf-8")
    with pytest.raises(InputError, match="1,048,576 bytes"):
        begin(path, pipeline.calibrator, pipeline.binding)


def _daemon(pipeline: Pipeline) -> DaemonView:
    return cast("DaemonView", SimpleNamespace(pipeline=pipeline, binding=pipeline.binding))


def test_a_service_keeps_it_every_so_often_and_goes_on_without(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / kept.NAME
    pipeline, now = _written(path), [0.0]
    keeper = CalibrationKeeper(tmp_path, clock=lambda: now[0])
    path.write_text("{broken", encoding="utf-8")
    with caplog.at_level(logging.ERROR):
        keeper.on_start(_daemon(fresh := _pipeline()))
    assert fresh.calibrator is not None
    assert str(path) in caplog.text
    assert not fresh.calibrator.is_known(0)
    keeper.on_iteration(_daemon(pipeline))
    assert path.read_text(encoding="utf-8") == "{broken"
    now[0] = INTERVAL_S
    keeper.on_iteration(_daemon(pipeline))
    assert json.loads(path.read_text(encoding="utf-8"))["sensors"]["front"]["mean"] == LEARNT.mean.tolist()
    path.unlink()
    keeper.on_stop(_daemon(fresh))  # it knows nothing
    assert not path.exists()
    keeper.on_stop(_daemon(pipeline))
    assert path.exists()
