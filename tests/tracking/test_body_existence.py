"""Life cycle of bodies: by existence what nothing can see is not missed; by hits it is deleted once it is silent."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from candaemon.config.load import load_config
from candaemon.config.tracker import TrackerSettings
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import sensor_views
from candaemon.tracking.body_existence import BodyExistence
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import COASTING, CONFIRMED, TENTATIVE, Obstacles
from candaemon.tracking.vehicle_tracker import VehicleTracker
from tests.support.builders import CYCLE, Seen, assert_sane, detections, pose
from tests.support.paths import ROOT

FRONT = load_config(ROOT / "config" / "esr_ins.yaml").config.sensors["front"]
SPEED, DRIFT = 20.0, -2.0  # m/s of all vehicles ahead, of the car across
LORRY, CAR = (11.0, 2.5), (4.5, 1.8)
HIDDEN = 2.0  # m to either side of the lorry's course


def _tracker(identities: Identities | None = None, **lifecycle: Any) -> VehicleTracker:
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": lifecycle})
    return VehicleTracker(settings, {0: FRONT}, identities, views=list(sensor_views(FRONT, 0).values()))


def _scan(time: float, seen: dict[int, tuple[float, float, float]]) -> Detections:
    """Return a scan of vehicles: place ahead of us, to the left, and speed to the left, by the sensor's id."""
    at = pose(time, east=SPEED * time, ve=SPEED)
    objects = [Seen(key, SPEED * time + x, y, SPEED, vy) for key, (x, y, vy) in seen.items()]
    sizes = np.array([LORRY if key == 1 else CAR for key in seen]).reshape(-1, 2)
    return replace(
        detections(at, objects, sensor=0, noise=(0.2, 0.2, 0.1)),
        length=sizes[:, 0],
        width=sizes[:, 1],
        heading=np.zeros(len(seen)),
    )


def _behind_a_lorry(tracker: VehicleTracker, first: int = 0, last: int = 150) -> Iterator[tuple[float, Obstacles]]:
    """Yield where a car is that crosses behind a lorry, and the obstacles; its object has another id afterwards."""
    for k in range(first, last):
        time = k * CYCLE
        across = 7.0 + DRIFT * time
        seen = {1: (25.0, 0.0, 0.0)}
        if abs(across) > HIDDEN:
            seen[2 if across > 0 else 3] = (60.0, across, DRIFT)
        at = pose(time, east=SPEED * time, ve=SPEED)
        obstacles = tracker.step(_scan(time, seen), at)
        assert_sane(obstacles)
        yield across, obstacles


def _of_the_car(obstacles: Obstacles) -> list[int]:
    sure = (obstacles.state != TENTATIVE) & (obstacles.x > 45.0)
    return [int(each) for each in obstacles.id[sure]]


def test_a_car_that_comes_out_from_behind_a_lorry_gets_its_id_back() -> None:
    cycles = list(_behind_a_lorry(_tracker(coast=0.5)))
    before = next(_of_the_car(told) for across, told in cycles if across < HIDDEN + 0.2)
    assert len(before) == 1
    assert _of_the_car(cycles[-1][1]) == before
    assert all(len(_of_the_car(told)) <= 1 for _, told in cycles)
    hidden = next(told for across, told in cycles if across < 1.0)
    assert hidden.state[hidden.x > 45.0].tolist() == [COASTING]


def test_by_hits_it_is_another_one() -> None:
    cycles = list(_behind_a_lorry(_tracker(coast=0.5, by="hits")))
    before = next(_of_the_car(told) for across, told in cycles if across < HIDDEN + 0.2)
    after = _of_the_car(cycles[-1][1])
    assert len(before) == len(after) == 1
    assert before != after
    assert not any(_of_the_car(told) for across, told in cycles if -0.5 < across < 0.5)


def test_what_is_in_sight_and_not_detected_is_reported_for_the_coasting_time_only() -> None:
    tracker = _tracker(coast=0.5)
    last_reported = 0.0
    for k in range(60):
        time = k * CYCLE
        seen = {4: (60.0, 5.0, 0.0)} if k < 30 else {}
        at = pose(time, east=SPEED * time, ve=SPEED)
        obstacles = tracker.step(_scan(time, seen), at)
        if len(obstacles):
            last_reported = time
            existence = obstacles.existence[0]
    assert 0.25 < last_reported - 29 * CYCLE <= 0.55
    assert existence < 0.999


@pytest.mark.parametrize(("slots", "least", "most"), [(64, 0.9, 1.1), (1, 2.9, 3.1)])
def test_what_a_full_list_has_no_room_for_is_not_missed(slots: int, least: float, most: float) -> None:
    """It is reported as what nothing can see: for `coast_share` of the time that it was seen, not for `coast` s."""
    front = FRONT.model_copy(update={"objects": FRONT.objects.model_copy(update={"slots": slots})})
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}})
    tracker = VehicleTracker(settings, {0: front}, views=list(sensor_views(front, 0).values()))
    reported = []
    for k in range(200):
        time = k * CYCLE
        seen = {1: (25.0, 0.0, 0.0), 2: (60.0, 4.0, 0.0)} if time < 5.0 else {1: (25.0, 0.0, 0.0)}
        obstacles = tracker.step(_scan(time, seen), pose(time, east=SPEED * time, ve=SPEED))
        if np.any((obstacles.x > 40.0) & (obstacles.state != TENTATIVE)):
            reported.append(time)
    assert least < max(reported) - 5.0 < most


def test_what_was_given_up_for_lost_and_comes_again_exists_as_what_is_detected_first() -> None:
    tracker = _tracker(first_existence=0.2)
    for k in range(100):
        time = k * CYCLE
        seen = {4: (60.0, 5.0, 0.0)} if k < 60 or k >= 90 else {}
        obstacles = tracker.step(_scan(time, seen), pose(time, east=SPEED * time, ve=SPEED))
        if k == 89:
            assert not len(obstacles)
        elif k >= 90:
            assert obstacles.id.tolist() == [1]
            assert obstacles.existence[0] >= 0.2


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_what_was_seen_for_a_short_time_coasts_for_a_share_of_it(share: float) -> None:
    tracker, last_reported = _tracker(coast_share=share), 0.0
    for k in range(40):
        time = k * CYCLE
        seen = {4: (60.0, 5.0, 0.0)} if k <= 12 else {}
        if len(tracker.step(_scan(time, seen), pose(time, east=SPEED * time, ve=SPEED))):
            last_reported = time
    assert last_reported - 12 * CYCLE == pytest.approx(share * 12 * CYCLE, abs=1.01 * CYCLE)


@pytest.mark.parametrize(("by", "confirm"), [("existence", 3), ("existence", 6), ("hits", 3), ("hits", 6)])
def test_as_many_detections_in_succession_confirm_as_the_settings_say(by: str, confirm: int) -> None:
    tracker, states = _tracker(by=by, confirm=confirm), []
    for k in range(confirm):
        time = k * CYCLE
        at = pose(time, east=SPEED * time, ve=SPEED)
        states.append(int(tracker.step(_scan(time, {4: (60.0, 5.0, 0.0)}), at).state[0]))
    assert states == [TENTATIVE] * (confirm - 1) + [CONFIRMED]


def _confirmed_after(tracker: VehicleTracker, first: int) -> int:
    """Return how many detections in succession confirm a car."""
    for k in range(first, first + 20):
        time = k * CYCLE
        told = tracker.step(_scan(time, {4: (60.0, 5.0, 0.0)}), pose(time, east=SPEED * time, ve=SPEED))
        if (told.state[told.x < 61.0] != TENTATIVE).any():
            return k - first + 1
    return 0


@pytest.mark.parametrize(
    ("false", "lasting", "lifecycle", "needed"),
    [
        (0, 0, {}, 3),
        (3, 1, {}, 3),
        (3, 3, {}, 5),
        (0, 0, {"confirm": 5}, 5),
        (0, 0, {"confirm": 8, "confirm_early": 4}, 4),
        (0, 0, {"confirm": 2}, 2),
    ],
)
def test_a_sensor_without_clutter_that_comes_again_confirms_early(
    false: int, lasting: int, lifecycle: dict[str, Any], needed: int
) -> None:
    """False detections stay where they are for some scans, and others come a while later."""
    tracker, rng = _tracker(**lifecycle), np.random.default_rng(3)
    places: dict[int, tuple[float, float, float]] = {}
    for k in range(400):
        time = k * CYCLE
        if lasting and k % (lasting + 4) == 0:
            places = {10 + n: (70.0 + 20.0 * n, float(rng.uniform(-20.0, 20.0)), 0.0) for n in range(false)}
        elif lasting and k % (lasting + 4) == lasting:
            places = {}
        tracker.step(_scan(time, places), pose(time, east=SPEED * time, ve=SPEED))
    assert _confirmed_after(tracker, 400) == needed


def test_sensors_share_the_false_obstacles_that_are_let_through() -> None:
    """Twelve that show clutter need more detections each than one; eleven beside it that show none change nothing."""
    needed = []
    for sensors, cluttered in ((1, 1), (12, 1), (12, 12)):
        existence = BodyExistence(TrackerSettings().lifecycle, dict.fromkeys(range(sensors), FRONT), [])
        for scan in range(2000):
            ended = [0b11] if scan % 40 == 0 else [0b1] if scan % 10 == 0 else []
            for sensor in range(cluttered):
                existence.learn_clutter(sensor, np.array(ended, dtype=np.int64))
        needed.append(existence.confirming(0))
    assert 3.0 <= needed[0] == needed[1] < needed[2] - 0.5


def test_what_is_in_the_field_of_view_at_one_end_only_is_reported() -> None:
    """A lorry whose rear is beside the field of view and whose front is in it is not detected for a while."""
    tracker = _tracker()
    for k in range(60):
        time = k * CYCLE
        at = pose(time, east=SPEED * time, ve=SPEED)
        scan = _scan(time, {1: (6.0, 9.0, 0.0)} if k < 52 else {})
        told = tracker.step(scan, at)
    assert told.state.tolist() == [COASTING]
    assert not sensor_views(FRONT, 0)[-1].sees(np.stack([told.x, told.y], axis=1)).any()


def test_an_obstacle_remembered_is_reported_again_after_a_state_was_saved() -> None:
    whole = [told for _, told in _behind_a_lorry(_tracker(coast=0.5))]
    identities = Identities()
    tracker = _tracker(identities, coast=0.5)
    for _ in _behind_a_lorry(tracker, last=70):
        pass
    successor = _tracker(identities, coast=0.5)
    successor.state = deepcopy(tracker.state)
    rest = [told for _, told in _behind_a_lorry(successor, first=70)]
    for before, after in zip(whole[70:], rest, strict=True):
        np.testing.assert_array_equal(before.id, after.id)
        np.testing.assert_array_equal(before.existence, after.existence)


@pytest.mark.parametrize(
    ("name", "value"), [("existence", 1.5), ("existence", np.nan), ("in_sight", -0.1), ("unseen", -1.0)]
)
def test_a_state_that_cannot_be_is_refused(name: str, value: float) -> None:
    tracker = _tracker()
    for _ in _behind_a_lorry(tracker, last=20):
        pass
    state = deepcopy(tracker.state)
    getattr(state.tracks.obstacles, name)[0] = value
    with pytest.raises(ValueError, match="existence"):
        _tracker().state = state


def test_what_was_learnt_of_a_sensor_goes_to_its_other_number() -> None:
    tracker = _tracker()
    for _ in _behind_a_lorry(tracker, last=40):
        pass
    learnt = tracker.state.visibility.sensors[0]
    assert learnt.expected.sum() > 20
    tracker.renumber_sensors({0: 3})
    assert tracker.state.visibility.sensors == {3: learnt}


def test_what_stands_beside_the_way_of_a_lost_runner_is_somebody_else() -> None:
    """Places of one body's reflections differ by metres, their speeds do not."""
    settings = TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}, "lifecycle": {"confirm": 4}})
    tracker = VehicleTracker(settings, {})
    ids: dict[int, int] = {}
    for k in range(90):
        time, seen = k * CYCLE, []
        if k < 60:
            seen.append(Seen(1, 50.0 + 3.0 * time, 2.0, 3.0))
        elif k >= 66:
            seen.append(Seen(2, 61.5, 3.2))
        at = pose(time, east=5.0 * time, ve=5.0)
        obstacles = tracker.step(detections(at, seen, sensor=0, noise=(0.1, 0.1, 0.1)), at)
        ids |= dict(zip(obstacles.used_object.tolist(), obstacles.id[obstacles.used_row].tolist(), strict=True))
    assert obstacles.state[obstacles.id == ids[2]] == [CONFIRMED]
    assert ids[1] != ids[2]
