"""That the experiments measure: a small share of each, whose figures hold by a wide margin."""

from __future__ import annotations

import math

import pytest

from tests.accuracy.experiments.__main__ import main
from tests.accuracy.experiments.finding import Effort, Finding
from tests.accuracy.experiments.on_cost import run as costs
from tests.accuracy.experiments.on_lidar_and_radar import EXERCISE, course_findings
from tests.accuracy.experiments.on_own_filters import run as later_words
from tests.accuracy.experiments.on_recorded_drive import drive_findings
from tests.accuracy.experiments.on_ring import run as around
from tests.accuracy.experiments.on_unidentified import run as unidentified
from tests.support.paths import ROOT

VEHICLE = (("estimator.kind", "vehicle"),)


def figures(findings: list[Finding]) -> dict[str, float]:
    """Return the figures by name."""
    return {one.name: one.value for one in findings}


def test_a_figure_tells_whether_it_is_what_it_should_be() -> None:
    assert Finding("a", 1.0, most=1.0).met
    assert not Finding("a", 1.1, most=1.0).met
    assert not Finding("a", math.nan, most=1.0).met
    assert Finding("a", math.nan).met
    assert Finding("a", 2.0, "", 1.0, 3.0).row() == ("a", "2", "", "1 to 3", "met")
    assert Finding("a", math.nan, most=1.0).as_json() == {
        "name": "a", "unit": "m", "value": None, "least": None, "most": 1.0, "met": False,
    }  # fmt: skip


@pytest.mark.usefixtures("drive")
def test_the_recorded_drive_is_predicted() -> None:
    found = figures(list(drive_findings(ROOT / "config" / "toyota_rav4_ins.yaml", (), 150)))
    assert 0.0 < found["0.5 s ahead, along"] < found["1 s ahead, along"] < 1.0
    assert found["duplicates"] < 5.0


@pytest.mark.usefixtures("drive")
@pytest.mark.parametrize("config", ["toyota_rav4", "toyota_rav4_ins"])
def test_the_recorded_drive_is_told_within_its_bounds(config: str) -> None:
    """Its predictions, and what stands, with all defaults."""
    found = list(drive_findings(ROOT / "config" / f"{config}.yaml", (), None))
    bounded = [one for one in found if "ahead" in one.name or "stands" in one.name]
    assert len(bounded) == 6
    assert [one.name for one in bounded if not one.met] == []


def test_a_car_is_one_obstacle_of_twelve_radars() -> None:
    """Where it comes into the view of others, its speed across is hardly known yet."""
    found = figures(list(around(Effort((5, 9), VEHICLE, seconds=2.2), numbers=(12,))))
    assert found["12: laps in which the id changes"] == 0
    assert found["12: cycles with duplicates"] == 0


def test_a_car_is_one_obstacle_of_two_radars() -> None:
    found = figures(list(around(Effort((1,), VEHICLE, seconds=3.0), numbers=(2,))))
    assert found["2: error in the first radar's view"] < 2.5
    assert found["2: laps in which the id changes"] == 0
    assert found["2: cycles with duplicates"] == 0


def test_lidar_and_radar_are_fused() -> None:
    found = figures(list(course_findings(EXERCISE, Effort((1,), VEHICLE, seconds=6.0))))
    references = {name[0]: value for name, value in found.items() if name[2:6] == " EKF"}
    assert all(0.0 < references[axis] < EXERCISE.lidar for axis in "xy")
    assert found["position, lidar and radar"] < EXERCISE.lidar < found["position, radar alone"]


def test_the_later_word_of_a_radar_that_filters_is_compared() -> None:
    found = figures(list(later_words(Effort((1,), VEHICLE, seconds=4.0), (0.4,), ("ars408",), ("traffic_town",))))
    name = "ars408, walk 0.4 m²/s: 0.5 s ahead"
    # what walks so stays no better in place than its walk
    assert found[f"{name}, across, holding"] > 0.2
    assert 0.0 < found[f"{name}, along"] < 2.0
    assert 0.0 < found[f"{name}, across"] < 3.0


def test_detections_without_identity_are_tracked() -> None:
    found = figures(list(unidentified(Effort((1,), VEHICLE, seconds=2.5), ("traffic_country_road",))))
    assert found["position"] < 2.0
    assert found["missed"] < 50.0


def test_what_a_cycle_costs_is_told() -> None:
    found = figures(list(costs(Effort((1,), seconds=0.3))))
    assert len(found) == 5
    assert all(0.0 < value < 1e4 for value in found.values())


def test_wrong_words_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in ((["nothing"], "invalid choice"), (["drive", "--tracker", "confirm"], "expected KEY=VALUE")):
        with pytest.raises(SystemExit):
            main(words)
        assert said in capsys.readouterr().err
