"""Rates over ground: what a sensor added for its own motion is taken off again."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.detections import Detections
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.paths import ROOT
from tests.support.simulated import scenario


def with_rates(config: str, **rates: str) -> Binding:
    """Return a configuration whose sensor reports its rates otherwise."""
    bound = binding(config)
    (sensor,) = bound.sensors
    settings = sensor.settings.model_copy(update=rates)
    told = bound.settings.model_copy(update={"sensors": {sensor.name: settings}})
    loaded = replace(bound.loaded, config=told)
    return replace(bound, sensors=(replace(sensor, settings=settings),), loaded=loaded)


def detections(bound: Binding) -> list[Detections]:
    """Return what a drive's first scans say once own motion is known."""
    drama = scenario("highway").model_copy(update={"duration": 3.0})
    cycles = Pipeline(bound).run(simulate(drama, bound, 1).frames())
    return list(islice((each.detections for each in cycles if each.detections is not None), 20, 35))


def test_velocities_over_ground_say_what_relative_ones_say() -> None:
    relative, absolute = (
        detections(with_rates("ars408_clusters", rates=rates)) for rates in ("over_ground", "absolute")
    )
    assert sum(map(len, relative)) > 60
    for one, other in zip(relative, absolute, strict=True):
        for here, there in zip(one.measurement.projections, other.measurement.projections, strict=True):
            assert there.value == pytest.approx(here.value, abs=0.45)  # both in steps of 0.25


def test_compensated_range_rates_say_what_relative_ones_say() -> None:
    relative, absolute = (
        detections(with_rates("compensated_radar", range_rates=rates)) for rates in ("relative", "absolute")
    )
    assert sum(map(len, relative)) > 60
    for one, other in zip(relative, absolute, strict=True):
        here, there = one.measurement.range_rate, other.measurement.range_rate
        assert here is not None
        assert there is not None
        assert there == pytest.approx(here, abs=0.3)  # the direction is noisy, and 30 m/s are taken off along it
        assert np.abs(here).max() > 5


def test_a_front_end_measures_no_absolute_rates(tmp_path: Path) -> None:
    text = (ROOT / "config" / "compensated_radar.yaml").read_text(encoding="utf-8")
    path = tmp_path / "wrong.yaml"
    path.write_text(
        text.replace("    range_rates: absolute", "    range_rates: absolute\n    front_end: {kind: lfm_fsk}")
    )
    with pytest.raises(ConfigError, match="said to be absolute"):
        load_config(path)
