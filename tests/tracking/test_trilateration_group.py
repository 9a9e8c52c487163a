"""Sensors of ranges alone: `fusion: trilateration`, from the tracker to the whole daemon."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.config.directions import AlongAcross
from candaemon.config.estimators import CvEstimatorSettings, MlkfEstimatorSettings
from candaemon.config.load import load_config
from candaemon.config.sensors import FieldOfView, Mount
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.errors import ConfigError
from candaemon.estimation.measurement import Measurement
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state.codec import decoded, encoded
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking import range_association
from candaemon.tracking.obstacles import CONFIRMED, Obstacles
from candaemon.tracking.range_association import UnpairedRanges
from candaemon.tracking.tracker import Tracker, TrackerState
from tests.support.paths import ROOT

RANGE, RATE, ANGLE = 0.075, 0.1, np.radians(1.0)  # the noise of the front pair of config/surround.yaml
FRONT = ((3.55, 0.8), (3.55, -0.8))
WIDE = ((3.55, 3.3), (3.55, -3.3))
STEP = 0.025  # s between two scans: each sensor has one every 0.05 s, the other one's in the middle
NOISE = 0.1
CV = CvEstimatorSettings(kind="cv", noise=AlongAcross(along=NOISE, across=NOISE))
Path2 = Callable[[float], tuple[float, float, float, float]]
"""Place and velocity relative to the vehicle, which drives straight on, at a time."""


def ahead(time: float) -> tuple[float, float, float, float]:
    del time
    return 15.0, 0.5, 0.0, 0.0


def passing(time: float) -> tuple[float, float, float, float]:
    return 5.0 + 5.0 * time, 3.5, 5.0, 0.0


def closing(time: float) -> tuple[float, float, float, float]:
    return 32.0 - 6.0 * time, -3.5, -6.0, 0.0


def tracker_of(mounts: Sequence[tuple[float, float]], *, ranging: bool = True, **told: Any) -> Tracker:
    field = FieldOfView(range=30.0, min_range=0.2, azimuth_deg=70.0)
    views = [SensorView(Mount(x=x, y=y), field, k) for k, (x, y) in enumerate(mounts)]
    return Tracker(
        TrackerSettings(**({"estimator": CV} | told)),
        cycle_time=0.05,
        slack_ns=75_000_000,
        views=views,
        ranging=ranging,
    )


def scan(
    number: int, sensor: int, place: tuple[float, float], seen: Sequence[tuple[float, float, float, float]], *,
    random: np.random.Generator, angle: float | None = None, speed: float = 15.0,
) -> tuple[Detections, EgoPose]:  # fmt: skip
    """Return the noisy detections of points relative to the vehicle; without an angle straight ahead of the sensor."""
    time_ns = 10**18 + round(number * STEP * 1e9)
    pose = EgoPose(time_ns, speed * number * STEP, 0.0, 0.0, speed, 0.0, 0.0, 0.0, EgoStatus.VALID)
    origin, velocity = pose.place(*place)
    points = np.array(seen).reshape(-1, 4)
    offset, n = points[:, :2] - place, len(points)
    exact = np.hypot(offset[:, 0], offset[:, 1])
    distance = exact + RANGE * random.standard_normal(n)
    rate = (offset * points[:, 2:]).sum(axis=1) / exact + RATE * random.standard_normal(n)
    azimuth = np.zeros(n)
    if angle is not None:
        azimuth = np.arctan2(offset[:, 1], offset[:, 0]) + angle * random.standard_normal(n)
    sight = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    across = np.column_stack([-sight[:, 1], sight[:, 0]])
    spread = ((angle or 1.0) * distance)[:, None, None] ** 2
    noise = RANGE**2 * sight[:, :, None] * sight[:, None] + spread * across[:, :, None] * across[:, None]
    position = origin + distance[:, None] * sight
    measurement = Measurement(position, noise, origin, velocity, rate, np.full(n, RATE**2), (), sensor)
    x, y = pose.to_vehicle(position).T
    ids = np.arange(n)
    return Detections(time_ns, sensor, ids, ids < 0, measurement, x, y, identified=False), pose


def drive(
    tracker: Tracker, mounts: Sequence[tuple[float, float]], paths: Sequence[Path2], scans: int, seed: int, *,
    angle: float | None = None,
) -> list[Obstacles]:  # fmt: skip
    random, found = np.random.default_rng(seed), []
    for number in range(scans):
        sensor = number % len(mounts)
        seen = [each(number * STEP) for each in paths]
        found.append(tracker.step(*scan(number, sensor, mounts[sensor], seen, random=random, angle=angle)))
    return found


def off(found: Obstacles, true: tuple[float, ...]) -> float:
    """Return how far the nearest confirmed obstacle is from where it should be, m."""
    sure = found.state >= CONFIRMED
    return float(np.hypot(found.x[sure] - true[0], found.y[sure] - true[1]).min(initial=np.inf))


def rmse(mounts: Sequence[tuple[float, float]], path: Path2, angle: float | None, runs: int, scans: int) -> float:
    """Return the error of the position after the first second, m."""
    errors = []
    for seed in range(runs):
        found = drive(tracker_of(mounts, ranging=angle is None), mounts, [path], scans, seed, angle=angle)
        errors += [off(each, path(k * STEP)) for k, each in enumerate(found) if k * STEP >= 1.0]
    return float(np.sqrt(np.mean(np.square(errors))))


def bound(mounts: Sequence[tuple[float, float]], path: Path2, angle: float | None, scans: int) -> float:
    """Return the posterior Cramér-Rao bound of the same, m: information of each scan at the true state."""
    information = np.diag([1e-9, 1e-9, 25.0**-2, 5.0**-2])
    variances = []
    move = np.eye(4) + STEP * np.eye(4, k=2)
    block = NOISE * np.array([[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]])
    for number in range(scans):
        x, y, vx, vy = path(number * STEP)
        offset = np.array([x, y]) - mounts[number % len(mounts)]
        distance = np.hypot(*offset)
        sight = offset / distance
        across = np.array([-sight[1], sight[0]])
        rows = [np.r_[sight, 0.0, 0.0] / RANGE, np.r_[across * (across @ (vx, vy)) / distance, sight] / RATE]
        if angle is not None:
            rows.append(np.r_[across, 0.0, 0.0] / (angle * distance))
        covariance = np.linalg.inv(information)
        if number:
            covariance = move @ covariance @ move.T + np.kron(block, np.eye(2))
        information = np.linalg.inv(covariance) + np.array(rows).T @ np.array(rows)
        covariance = np.linalg.inv(information)
        if number * STEP >= 1.0:
            variances.append(covariance[0, 0] + covariance[1, 1])
    return float(np.sqrt(np.mean(variances)))


def test_two_ranges_give_a_place_and_how_surely_it_is_known() -> None:
    """Across the line of sight as far as the baseline tells: √2 · 0.075 m · 12 m / 1.6 m a pair of scans."""
    tracker = tracker_of(FRONT)
    first, second = drive(tracker, FRONT, [ahead], 2, 3)
    assert len(first.x) == 0
    assert len(second.x) == 1
    assert abs(second.sx[0] - RANGE / np.sqrt(2)) < 0.01
    assert abs(second.sy[0] - np.sqrt(2) * RANGE * 11.45 / 1.6) < 0.06
    assert np.hypot(second.x[0] - 15.0, second.y[0] - 0.5) < 2.5
    later = drive(tracker_of(FRONT), FRONT, [ahead], 80, 3)[-1]
    assert later.state.tolist() == [CONFIRMED]
    assert 0.1 < later.sy[0] < 0.3
    assert off(later, ahead(0.0)) < 4 * later.sy[0]


@pytest.mark.parametrize(
    "kind", [{"estimator": MlkfEstimatorSettings(kind="mlkf")}, {}, {"estimator": {"kind": "imm"}}]
)
def test_any_filter_of_points_follows_what_closes_in(kind: dict[str, Any]) -> None:
    found = drive(tracker_of(FRONT, **kind), FRONT, [closing], 80, 1)
    assert off(found[-1], closing(79 * STEP)) < 1.0
    assert abs(found[-1].vx[0] - 9.0) < 0.5  # over ground


def test_what_two_targets_mix_up_to_is_no_obstacle() -> None:
    """The ranges of the left sensor to the right target and so on meet too, but no one thing has these range rates."""
    paths: list[Path2] = [
        lambda time: (12.0 - 3.0 * time, 4.0, -3.0, 0.0),
        lambda time: (12.0 + 1.0 * time, -4.0, 1.0, 0.0),
    ]
    found = drive(tracker_of(FRONT), FRONT, paths, 60, 2)
    for number in range(20, 60):
        sure = found[number].state >= CONFIRMED
        assert np.count_nonzero(sure) == 2
        assert max(off(found[number], path(number * STEP)) for path in paths) < 1.5
    assert sum(len(each.x) > 2 for each in found) == 0


def test_posts_at_equal_distances_are_told_apart_by_standing_still() -> None:
    """Two posts left and right of the road: crossed ranges meet in front, where what stands closes in faster."""
    paths: list[Path2] = [
        lambda time: (20.0 - 15.0 * time, 6.0, -15.0, 0.0),
        lambda time: (20.3 - 15.0 * time, -6.0, -15.0, 0.0),
    ]
    found = drive(tracker_of(FRONT), FRONT, paths, 32, 4)
    assert max(off(found[-1], path(31 * STEP)) for path in paths) < 1.0
    assert np.count_nonzero(found[-1].state >= CONFIRMED) == 2


def test_one_sensor_goes_on_where_the_other_does_not_see() -> None:
    tracker, random = tracker_of(FRONT), np.random.default_rng(5)
    for number in range(60):
        sensor = number % 2
        seen = [ahead(0.0)] if sensor == 0 or number < 40 else []
        found = tracker.step(*scan(number, sensor, FRONT[sensor], seen, random=random))
    assert found.state.tolist() == [CONFIRMED]
    assert off(found, ahead(0.0)) < 1.0


def test_a_range_that_a_single_sensor_sees_is_no_obstacle_but_counted() -> None:
    tracker, random = tracker_of(FRONT), np.random.default_rng(6)
    for number in range(20):
        sensor = number % 2
        seen = [ahead(0.0)] if sensor == 0 else []
        found = tracker.step(*scan(number, sensor, FRONT[sensor], seen, random=random))
    assert len(found.x) == 0
    assert (tracker.counts.detections, tracker.counts.used) == (10, 0)


def test_ranges_that_meet_nowhere_are_left_over() -> None:
    tracker, random = tracker_of(FRONT), np.random.default_rng(7)
    for number in range(8):
        seen = [(10.0, 0.0, 0.0, 0.0)] if number % 2 else [(20.0, 0.0, 0.0, 0.0)]
        found = tracker.step(*scan(number, number % 2, FRONT[number % 2], seen, random=random))
    assert len(found.x) == 0
    assert {sensor: len(ranges) for sensor, ranges in tracker.state.unpaired.items()} == {0: 1, 1: 1}


def test_three_sensors_see_one_thing() -> None:
    mounts = ((2.9, 0.9), (1.3, 0.9), (-0.3, 0.9))
    found = drive(tracker_of(mounts), mounts, [lambda time: (9.0 - time, 3.0, -1.0, 0.0)], 60, 3)[-1]
    assert found.state.tolist() == [CONFIRMED]
    assert off(found, (9.0 - 59 * STEP, 3.0)) < 0.5
    assert found.sensors.tolist() == [0b111]


def test_so_many_ranges_are_paired(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(range_association, "MOST_RANGES", 3)
    posts: list[Path2] = [lambda _, k=k: (12.0 + 4.5 * k, 0.3, 0.0, 0.0) for k in range(4)]  # type: ignore[misc]
    at_limit = drive(tracker_of(FRONT), FRONT, posts[:3], 2, 1)[-1]
    beyond = drive(tracker_of(FRONT), FRONT, posts, 2, 1)[-1]
    assert len(at_limit.x) == len(beyond.x) == 3  # the nearest
    assert beyond.x.max() < 23.0
    later = drive(tracker_of(FRONT), FRONT, posts, 8, 1)[-1]
    assert len(later.x) == 4  # what has a track is not paired any more


def test_what_is_left_over_is_part_of_the_saved_state() -> None:
    """A tracker that goes on from it pairs the second sensor's range with the first one's."""
    first = tracker_of(FRONT)
    drive(first, FRONT, [ahead], 1, 3)
    data = encoded(first.state)
    successor = tracker_of(FRONT)
    successor.state = decoded(TrackerState, data, successor.state)
    random = np.random.default_rng(8)
    found = successor.step(*scan(1, 1, FRONT[1], [ahead(0.0)], random=random))
    assert len(found.x) == 1


@pytest.mark.parametrize(
    "ranges",
    [
        {7: UnpairedRanges()},
        {0: UnpairedRanges(0, np.array([9.0]), np.array([-1.0]), np.zeros(1), np.ones(1))},
        {0: UnpairedRanges(0, np.array([np.inf]), np.ones(1), np.zeros(1), np.ones(1))},
        {0: UnpairedRanges(0, np.array([9.0]), np.ones(2), np.zeros(1), np.ones(1))},
    ],
)
def test_a_state_that_cannot_be_is_refused(ranges: dict[int, UnpairedRanges]) -> None:
    forged = tracker_of(FRONT)
    forged.state.unpaired.update(ranges)
    data = encoded(forged.state)
    successor = tracker_of(FRONT)
    with pytest.raises(ValueError, match=r"range|shape|no number"):
        successor.state = decoded(TrackerState, data, successor.state)


@pytest.mark.slow
@pytest.mark.parametrize("path", [ahead, passing, closing])
def test_the_place_is_found_as_well_as_the_baseline_allows(path: Path2) -> None:
    ranges, least = rmse(FRONT, path, None, 12, 120), bound(FRONT, path, None, 120)
    with_angle, least_with_angle = rmse(FRONT, path, ANGLE, 12, 120), bound(FRONT, path, ANGLE, 120)
    assert ranges < 1.4 * least
    assert with_angle < 1.1 * least_with_angle
    assert least > 2.9 * least_with_angle  # whoever filters: 1.6 m are too short for half as much again


def test_ranges_are_as_good_as_angles_on_a_baseline_that_is_long_enough() -> None:
    ranges, with_angle = (rmse(WIDE, passing, angle, 4, 120) for angle in (None, ANGLE))
    assert bound(WIDE, passing, None, 120) < 1.35 * bound(WIDE, passing, ANGLE, 120)
    assert ranges < 1.5 * with_angle


def test_the_bound_of_one_pair_of_scans_is_that_of_the_guide() -> None:
    """2 σ_r / (b σ_α): with 0.075 m, 1.6 m and 1° it is 5.4."""
    information: list[Floats] = []
    for angle in (None, ANGLE):
        part = np.zeros((2, 2))
        for place in FRONT:
            offset = np.array([33.55, 0.0]) - place
            distance = np.hypot(*offset)
            sight = offset / distance
            across = np.array([-sight[1], sight[0]])
            part += np.outer(sight, sight) / RANGE**2
            part += 0.0 if angle is None else np.outer(across, across) / (angle * distance) ** 2
        information.append(part)
    deviation = [np.sqrt(np.linalg.inv(each)[1, 1]) for each in information]
    assert abs(deviation[0] / deviation[1] - 2 * RANGE / (1.6 * ANGLE)) < 0.15


def surround(folder: Path, change: Callable[[dict[str, Any]], None] = lambda _: None) -> Path:
    """Write config/surround.yaml with its front pair alone, as sensors of ranges in a group."""
    tree = yaml.safe_load((ROOT / "config" / "surround.yaml").read_text(encoding="utf-8"))
    names = ("front_left", "front_right")
    tree["sensors"] = {name: json.loads(json.dumps(tree["sensors"][name])) for name in names}
    tree["buses"] = {name: tree["buses"][name] for name in ("front", "ins", "obstacles")}
    for sensor in tree["sensors"].values():
        del sensor["signals"]["azimuth"], sensor["noise"]["azimuth_deg"]
    del tree["tracker"]
    tree["groups"] = {"front": {"sensors": list(names), "fusion": "trilateration"}}
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    change(tree)
    path = folder / "front.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


def test_ranges_become_obstacles_through_the_whole_daemon(tmp_path: Path) -> None:
    of = bind(load_config(surround(tmp_path)))
    point = {"length": 0, "width": 0}
    actors = (
        {"name": "left", "size": point, "start": {"x": 16.0, "y": 4.0, "speed": 12.0}},
        {"name": "right", "size": point, "start": {"x": 15.0, "y": -3.0, "speed": 16.0}},
    )
    told = {"duration": 2.0, "ego": {"start": {"speed": 15.0}}, "actors": actors}
    simulated = simulate(Scenario.model_validate(told), of)
    truth = {each.time_ns: each.columns for each in simulated.truth()}
    pipeline, checked = Pipeline(of), 0
    for cycle in pipeline.run(simulated.frames()):
        true, seen = truth.get(cycle.obstacles.time_ns), cycle.obstacles
        if true is None or (checked == 0 and len(seen.x) < 2):
            continue
        checked += 1
        if checked > 30:
            for x, y in zip(true["x"][:2], true["y"][:2], strict=True):
                assert off(seen, (float(x), float(y))) < 1.8
    assert checked > 50
    assert pipeline.trackers[0].counts.confirmed == 2


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda tree: tree.pop("groups"), r"sensors\.front_left\.signals: no direction; give azimuth"),
        (lambda tree: tree["groups"]["front"].update(fusion="central"), r"no direction; give azimuth"),
        (
            lambda tree: (
                tree["sensors"]["front_left"]["signals"].update(azimuth="Azimuth"),
                tree["sensors"]["front_left"]["noise"].update(azimuth_deg=1.0),
            ),
            r"groups\.front\.sensors\[0\]: sensor 'front_left' tells azimuth, which fusion: trilateration does not use",
        ),
        (
            lambda tree: (
                tree["sensors"]["front_left"]["signals"].pop("range_rate"),
                tree["sensors"]["front_left"]["noise"].pop("range_rate"),
            ),
            r"front_left\.signals: trilateration needs range_rate",
        ),
        (lambda tree: tree["sensors"]["front_left"].update(mount={"x": 3.55, "y": -0.8}), r"sensors at two places"),
        (
            lambda tree: tree["groups"]["front"].update(tracker={"estimator": {"kind": "vehicle"}}),
            r"groups\.front\.tracker\.estimator.*found vehicle, but fusion: trilateration",
        ),
        (
            lambda tree: tree["groups"]["front"].update(tracker={"association": {"method": "id"}}),
            r"groups\.front\.tracker\.association\.method: found id",
        ),
        (lambda tree: tree["sensors"]["front_left"].update(range_rates="absolute"), r"range_rates: found absolute"),
    ],
)  # fmt: skip
def test_what_ranges_cannot_do_is_an_error_with_its_line(
    change: Callable[[dict[str, Any]], None], problem: str, tmp_path: Path
) -> None:
    path = surround(tmp_path, change)
    with pytest.raises(ConfigError, match=problem) as error:
        load_config(path)
    assert f"{path}:" in str(error.value)
