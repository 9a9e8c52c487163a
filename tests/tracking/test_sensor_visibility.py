"""What a sensor should see: field of view, occlusion, detection rates and clutter that are learnt."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.arrays import Booleans, Floats
from candaemon.config.load import load_config
from candaemon.config.sensors import FieldOfView, Mount, SensorSettings
from candaemon.tracking.sensor_visibility import GREATEST_PROBABILITY, LEAST_PROBABILITY, Visibility
from tests.support.builders import ns
from tests.support.paths import ROOT

FRONT = load_config(ROOT / "config" / "esr_ins.yaml").config.sensors["front"]
CAR = (4.5, 1.8)


def _settings(**changes: object) -> SensorSettings:
    view = FieldOfView(range=150.0, azimuth_deg=45.0)
    return FRONT.model_copy(update={"mount": Mount(), "field_of_view": view, **changes})


def _detection(
    visibility: Visibility,
    centre: Floats,
    near: Floats,
    heading: Floats,
    length: Floats,
    width: Floats,
    missed: Booleans | None = None,
) -> Floats:
    """Return the probability that a scan of sensor 0 holds each of some boxes."""
    axis = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    share, distance = visibility.in_sight(centre, near, axis, length, width, 0)
    return visibility.detection_probability(0, share, distance, missed)


def _probability(visibility: Visibility, centres: list[tuple[float, float]], size: tuple[float, float] = CAR) -> Floats:
    """Return the probability of detection of boxes along the vehicle's x axis, their nearest points facing it."""
    centre = np.array(centres)
    k = len(centre)
    length, width = np.full(k, size[0]), np.full(k, size[1])
    near = 0.0 if np.isnan(size[0]) else size[0] / 2
    return _detection(visibility, centre, centre - [near, 0.0], np.zeros(k), length, width)


def test_what_is_in_view_is_expected_and_what_is_not_is_not() -> None:
    visibility = Visibility({0: _settings()})
    found = _probability(visibility, [(50.0, 0.0), (50.0, 70.0), (-30.0, 0.0), (200.0, -30.0), (120.0, -90.0)])
    assert found == pytest.approx([0.95] + 3 * [LEAST_PROBABILITY] + [0.95], abs=0.01)


def test_a_field_of_view_ends_softly_in_angle_and_range() -> None:
    visibility = Visibility({0: _settings()})
    angles = np.radians([44.0, 44.8, 45.0, 45.2, 46.0])
    point = (float("nan"), float("nan"))
    across = [_probability(visibility, [(100 * np.cos(a), 100 * np.sin(a))], point)[0] for a in angles]
    assert across == sorted(across, reverse=True)
    assert across[2] == pytest.approx(0.95 / 2, abs=0.02)
    assert [across[0], across[4]] == pytest.approx([0.95, LEAST_PROBABILITY], abs=0.01)
    along = [_probability(visibility, [(x, 0.0)], point)[0] for x in (148.0, 150.0, 152.0)]
    assert along == pytest.approx([0.95, 0.95 / 2, LEAST_PROBABILITY], abs=0.01)


@pytest.mark.parametrize("azimuth", [45.0, 180.0])
@pytest.mark.parametrize("heading", [0.0, 180.0])
def test_a_nearer_box_hides_what_is_behind_it(heading: float, azimuth: float) -> None:
    mount = Mount(yaw_deg=heading)
    visibility = Visibility({0: _settings(mount=mount, field_of_view=FieldOfView(range=150.0, azimuth_deg=azimuth))})
    ahead = -1.0 if heading else 1.0
    # a truck, a car behind it, one beside that, and one nearer than the truck
    centre = np.array([[20.0, 0.0], [40.0, 0.3], [40.0, 9.0], [10.0, -4.0]]) * [ahead, 1.0]
    length, width = np.array([8.0, 4.5, 4.5, 4.5]), np.array([2.5, 1.8, 1.8, 1.8])
    near = centre - np.column_stack([ahead * length / 2, np.zeros(4)])
    found = _detection(visibility, centre, near, np.zeros(4), length, width)
    assert found == pytest.approx([0.95, LEAST_PROBABILITY, 0.95, 0.95], abs=0.01)


@pytest.mark.parametrize("side", [0.05, -0.05])
def test_a_box_hides_across_the_back_of_a_sensor_that_sees_all_around(side: float) -> None:
    visibility = Visibility({0: _settings(field_of_view=FieldOfView(range=150.0, azimuth_deg=180.0))})
    centre = np.array([[-20.0, side], [-60.0, -3 * side]])
    near = centre + np.array([2.25, 0.0])
    found = _detection(visibility, centre, near, np.zeros(2), np.full(2, 4.5), np.full(2, 1.8))
    assert found == pytest.approx([0.95, LEAST_PROBABILITY], abs=0.02)


def test_sizes_that_are_no_sizes_are_those_of_a_point() -> None:
    visibility = Visibility({0: _settings()})
    centre = np.array([[30.0, 0.0], [60.0, 10.0], [60.0, -10.0], [90.0, 0.0]])
    bad = np.array([np.nan, -3.0, 0.0, 2.0])
    found = _detection(visibility, centre, centre, np.full(4, np.nan), bad, bad)
    assert found[:3] == pytest.approx(0.95)
    assert LEAST_PROBABILITY <= found[3] < 0.1


def test_none_has_no_probability() -> None:
    none = np.zeros(0)
    found = _detection(Visibility({0: _settings()}), none.reshape(0, 2), none.reshape(0, 2), none, none, none)
    assert found.shape == (0,)


def test_a_rate_is_learnt_for_its_range_and_for_what_was_missed_before() -> None:
    visibility = Visibility({0: _settings()})
    random = np.random.default_rng(4)
    near, far = np.full(20, 10.0), np.full(20, 140.0)
    for _ in range(100):
        visibility.learn(0, np.ones(20), np.ones(20, dtype=bool), near)
        visibility.learn(0, np.ones(20), random.random(20) < 0.6, far)
        visibility.learn(0, np.ones(20), np.zeros(20, dtype=bool), far, np.ones(20, dtype=bool))
    found = _probability(visibility, [(12.0, 0.0), (130.0, 60.0)])
    assert found == pytest.approx([GREATEST_PROBABILITY, 0.6], abs=0.05)
    centre = np.array([[142.0, 0.0]])
    again = _detection(visibility, centre, centre, np.zeros(1), np.ones(1), np.ones(1), np.ones(1, dtype=bool))
    assert again[0] < 0.05


def test_what_is_half_hidden_teaches_nothing() -> None:
    visibility = Visibility({0: _settings()})
    for _ in range(100):
        visibility.learn(0, np.full(5, 0.5), np.zeros(5, dtype=bool), np.full(5, 20.0))
    assert _probability(visibility, [(20.0, 0.0)]) == pytest.approx(0.95)


def test_a_list_that_is_full_has_no_room_for_what_is_farther() -> None:
    """Nor has it for a while after: what the sensor has lost keeps its slot."""
    objects = FRONT.objects.model_copy(update={"slots": 3})
    visibility = Visibility({0: _settings(objects=objects, mount=Mount(x=3.0))})
    listed, obstacles = np.array([10.0, 33.0, 20.0]), np.array([5.0, 29.9, 30.1])

    def room(time: float, count: int) -> list[float] | None:
        found = visibility.room(0, ns(time), listed[:count], np.zeros(count), obstacles)
        return None if found is None else list(found)

    assert room(0.0, 2) is None
    assert room(0.1, 3) == [1.0, 1.0, 0.1]
    assert room(0.5, 2) == [1.0, 1.0, 0.1]
    assert room(0.7, 2) is None
    assert room(0.7, 0) is None


def test_clutter_is_learnt_and_forgotten() -> None:
    visibility = Visibility({0: _settings()})
    prior = visibility.clutter_density(0)
    for _ in range(500):
        visibility.learn_clutter(0, 3)
    area = np.pi / 4 * (150.0**2 - 1.0)
    assert visibility.clutter_density(0) == pytest.approx(3 / area, rel=0.1)
    for _ in range(10_000):
        visibility.learn_clutter(0, 0)
    assert prior / 100 <= visibility.clutter_density(0) < prior


def test_whether_clutter_comes_again_is_learnt() -> None:
    visibility = Visibility({0: _settings()})
    for _ in range(500):
        visibility.learn_clutter(0, 2, again=3)
    begun, persistence = visibility.false_beginnings(0)
    assert begun == pytest.approx(2.0, rel=0.1)
    assert persistence == pytest.approx(0.6, abs=0.01)


def test_what_is_learnt_stays_bounded_however_much_comes_at_once() -> None:
    visibility = Visibility({0: _settings()})
    crowd = 100_000
    for _ in range(3):
        visibility.learn(0, np.ones(crowd), np.ones(crowd, dtype=bool), np.full(crowd, 10.0))
        visibility.learn_clutter(0, 10**9, 10**6)
    visibility.state.sensors[0].validate()
    assert LEAST_PROBABILITY <= _probability(visibility, [(10.0, 0.0)])[0] <= GREATEST_PROBABILITY


def test_a_state_goes_on_elsewhere_and_a_wrong_one_is_refused() -> None:
    first, second = Visibility({3: _settings()}), Visibility({3: _settings()})
    first.learn(3, np.ones(50), np.zeros(50, dtype=bool), np.full(50, 10.0))
    second.state = first.state
    assert second.state.sensors[3].expected.sum() == pytest.approx(50.0)
    with pytest.raises(ValueError, match="other sensors"):
        Visibility({0: _settings()}).state = first.state
    first.state.sensors[3].detected[0, 0] = 60.0
    with pytest.raises(ValueError, match="cannot be"):
        second.state = first.state


def test_what_was_learnt_follows_a_sensors_number() -> None:
    visibility = Visibility({0: _settings(), 1: _settings()})
    visibility.learn_clutter(1, 900)
    found = visibility.clutter_density(1)
    visibility.renumber_sensors({1: 5})
    assert visibility.state.sensors.keys() == {5}
    assert visibility.clutter_density(5) == found
