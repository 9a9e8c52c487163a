"""Sensors that tell no identity: slots that change from scan to scan mean nothing, place and speed everything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candaemon.arrays import Integers
from candaemon.binding.bind import bind
from candaemon.config.estimators import ImmEstimatorSettings
from candaemon.config.load import load_config
from candaemon.config.tracker import TrackerSettings
from candaemon.errors import ConfigError
from candaemon.estimation.measurement import Projection
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.detections import Detections
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import CONFIRMED
from candaemon.tracking.tracker import Tracker
from tests.support.builders import HandFedVehicles, Seen, car, detections, pose, times
from tests.support.paths import ROOT

POINTS = TrackerSettings(estimator=ImmEstimatorSettings())
LANES = ((20.0, 0.0), (20.0, 6.0), (45.0, -3.5), (70.0, 0.0))


@pytest.mark.parametrize("identified", [False, True])
def test_slots_that_change_places_leave_the_obstacles_alone(identified: bool) -> None:
    tracker, random = Tracker(POINTS), np.random.default_rng(3)
    for k in range(60):
        t, slots = 0.05 * k, random.permutation(len(LANES))
        at = pose(t)
        scan = detections(
            at,
            [car(int(slot), t, *place) for slot, place in zip(slots, LANES, strict=True)],
            sensor=0,
            noise=(0.1,) * 3,
        )
        obstacles = tracker.step(replace(scan, identified=identified), at)
    assert sorted(obstacles.id) == [1, 2, 3, 4]
    assert (obstacles.state == CONFIRMED).all()
    jumps = tracker.counts.slot_jumps
    assert jumps > 20 if identified else jumps == 0  # identities that do not hold cost a gate each


def test_an_id_that_another_sensor_tells_stays() -> None:
    tracker = Tracker(POINTS)
    for k in range(40):
        at = pose(0.05 * k)
        scan = detections(at, [car(7, 0.05 * k, 30.0)], sensor=k % 2, noise=(0.1,) * 3)
        tracker.step(replace(scan, identified=k % 2 == 0), at)
    assert len(tracker) == 1
    assert tracker.state.tracks.row_of == {(0, 7): 0}
    assert tracker.state.tracks.reflections.object_id.tolist() == [7]


@pytest.mark.parametrize("velocities", [False, True])
@pytest.mark.parametrize(("braking", "hidden"), [(1.5, 0.5), (2.5, 0.3), (2.5, 1.0), (4.0, 0.7)])
def test_a_car_that_brakes_out_of_sight_is_itself(braking: float, hidden: float, velocities: bool) -> None:
    """A lorry hides it for a while: it is slower then than nearly all who drove on as it had."""
    assert _obstacles_of_one_that_brakes(HandFedVehicles(), braking, hidden, velocities=velocities) == 1


def test_modes_that_are_less_probable_than_asked_for_are_not_looked_for() -> None:
    assert _obstacles_of_one_that_brakes(HandFedVehicles(association={"least_mode": 0.1}), 2.5, 0.3) == 2


def _obstacles_of_one_that_brakes(
    fed: HandFedVehicles, braking: float, hidden: float, *, velocities: bool = False
) -> int:
    """Return how many obstacles a car has become that brakes, m/s², from 3 s on, when it is hidden for a time, s."""
    for k, t in enumerate(times(1, 100)):
        braked = max(t - 3.0, 0.0)
        vx, x = 10.0 - braking * braked, 30.0 + 10.0 * t - 0.5 * braking * braked**2
        shown = [] if 3.0 < t < 3.0 + hidden else [Seen(k % 7, x, 0.0, vx)]
        fed.tracker.step(_unnamed(t, shown, velocities=velocities), pose(t))
    return fed.tracker.counts.obstacles


@pytest.mark.parametrize(
    ("rated", "mode_time", "followed"),
    [(False, 0.5, False), (False, 5.0, True), (True, 0.5, False)],
    ids=["by its place", "not asked for", "by its speed"],
)
def test_what_is_hidden_for_long_is_not_where_a_post_is_seen(rated: bool, mode_time: float, followed: bool) -> None:
    """It may have turned off so far, but a sensor that tells places alone sees the post for the first time."""
    fed = HandFedVehicles(association={"mode_time": mode_time})
    for t in times(1, 110):
        x = 30.0 + 15.0 * t
        shown = [Seen(1, x, 0.0, 15.0, rated=rated)] if t < 3.0 else []
        if t > 4.9:
            shown = [Seen(2, 30.0 + 15.0 * 4.95 - 2.0, 8.0, 0.0, rated=rated)]
        obstacles = fed.tracker.step(_unnamed(t, shown, velocities=False), pose(t))
        told = obstacles.y[obstacles.id == 1]
        if t > 4.9:
            break
    assert (len(told) > 0 and told[0] > 3.0) == followed


@pytest.mark.parametrize("identified", [False, True])
def test_all_reflections_of_a_car_that_braked_out_of_sight_are_its_own(identified: bool) -> None:
    """Hidden for so long that one of them is left; the sensor's ids for them are what they were."""
    fed = HandFedVehicles()
    for t in times(1, 100):
        braked = max(t - 3.0, 0.0)
        vx, x = 10.0 - 2.5 * braked, 30.0 + 10.0 * t - 1.25 * braked**2
        shown = [Seen(1, x, 0.0, vx), Seen(2, x + 2.5, 0.5, vx), Seen(3, x + 5.0, 0.3, vx)]
        scan = detections(pose(t), [] if 3.0 < t < 4.0 else shown, sensor=0, noise=(0.2, 0.2, 0.1))
        obstacles = fed.tracker.step(replace(scan, identified=identified), pose(t))
        assert t < 1.0 or 3.0 < t < 4.0 or obstacles.id.tolist() == [1]
    assert fed.tracker.counts.slot_jumps == 0


@pytest.mark.parametrize("identified", [False, True])
def test_a_car_that_turns_off_out_of_sight_is_itself(identified: bool) -> None:
    """Nothing sees it for 1.5 s from the start of the bend on; a sensor's own id for it is another then."""
    fed = HandFedVehicles()
    ids = set[int]()
    for t in times(1, 120):
        heading = 0.3 * min(max(t - 3.0, 0.0), 3.0)
        on = max(t - 6.0, 0.0)
        x = 30.0 + 10.0 * min(t, 3.0) + np.sin(heading) / 0.03 + 10.0 * on * np.cos(heading)
        y = (1.0 - np.cos(heading)) / 0.03 + 10.0 * on * np.sin(heading)
        seen = Seen(
            1 if t < 3.5 else 2, float(x), float(y), 10.0 * float(np.cos(heading)), 10.0 * float(np.sin(heading))
        )
        scan = detections(pose(t), [] if 3.0 < t < 4.5 else [seen], sensor=0, noise=(0.2, 0.2, 0.1))
        obstacles = fed.tracker.step(replace(scan, identified=identified), pose(t))
        ids |= set(obstacles.id[obstacles.state == CONFIRMED].tolist())
    assert ids == {1}


def test_a_post_does_not_drive_off_with_what_passes() -> None:
    """It is not detected any more, and a car passes that was not seen before."""
    fed = HandFedVehicles()
    for k, t in enumerate(times(1, 90)):
        shown = [Seen(1, 30.0, 5.0, 0.0)] if t < 3.0 else []
        if t > 3.5:
            shown = [Seen(k % 7, 30.5 + 4.0 * (t - 3.5), 4.5, 4.0)]
        obstacles = fed.tracker.step(_unnamed(t, shown, velocities=False), pose(t))
    (driving,) = np.flatnonzero(obstacles.vx > 2.0)
    assert obstacles.id[driving] == 2


@pytest.mark.parametrize(("association", "reflections"), [({}, 1), ({"velocity_gate": 16.0}, 2)])
def test_velocities_have_a_gate_of_their_own(association: dict[str, float], reflections: int) -> None:
    """Of a young obstacle, which is not told by its modes: .9 m/s between two scans."""
    fed = HandFedVehicles(association=association)
    for t, vx in zip((0.05, 0.1, 0.15), (10.0, 10.0, 9.1), strict=True):
        fed.tracker.step(_unnamed(t, [Seen(1, 30.0 + 10.0 * t, 0.0, vx)], velocities=True), pose(t))
    assert len(fed.tracker.state.tracks.reflections) == reflections


def _unnamed(t: float, shown: Sequence[Seen], *, velocities: bool) -> Detections:
    """Return a scan of a sensor without identities, of range rates or of velocities."""
    scan = replace(detections(pose(t), shown, sensor=0, noise=(0.2, 0.2, 0.1)), identified=False)
    if not velocities:
        return scan
    n, speed = len(shown), np.array([each.vx for each in shown])
    told = tuple(
        Projection(np.tile(axis, (n, 1)), value, np.full(n, 0.01))
        for axis, value in (((1.0, 0.0), speed), ((0.0, 1.0), np.zeros(n)))
    )
    return replace(
        scan, measurement=replace(scan.measurement, range_rate=None, range_rate_variance=None, projections=told)
    )


def _without_identity(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return ESR's configuration with slots that say nothing."""
    text = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("new:")]
    text = "\n".join(lines).replace("      slots: 64", "      slots: 64\n      identity: false")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_drive_without_identities_is_tracked(tmp_path: Path) -> None:
    binding = bind(load_config(_without_identity(tmp_path)))
    assert not binding.sensors[0].settings.identified
    drive = simulate(load_scenario(ROOT / "config" / "scenarios" / "highway.yaml"), binding, seed=2)
    pipeline = Pipeline(binding)
    longest: dict[int, float] = {}
    for k, cycle in enumerate(pipeline.run(drive.frames())):
        assert cycle.detections is None or not cycle.detections.identified
        longest |= dict(zip(cycle.obstacles.id.tolist(), cycle.obstacles.age.tolist(), strict=True))
        if k == 160:
            break
    assert max(longest.values()) > 7.0
    state = pipeline.trackers[0].state.tracks
    assert state.row_of == {}
    unnamed: Integers = np.full_like(state.reflections.object_id, -1)
    assert (state.reflections.object_id == unnamed).all()


def test_new_says_nothing_without_an_identity(tmp_path: Path) -> None:
    path = _without_identity(tmp_path, ("identity: false", "identity: false\n      new: [{signal: X, in: [1]}]"))
    with pytest.raises(ConfigError, match="identity is false, so no slot keeps its object"):
        load_config(path)


@pytest.mark.parametrize(
    "tracker",
    [
        "tracker: {association: {method: id}}",
        "groups: {ahead: {sensors: [front], tracker: {association: {method: id}}}}",
    ],
)
def test_identities_cannot_be_associated_where_there_are_none(tmp_path: Path, tracker: str) -> None:
    path = _without_identity(tmp_path, ("output:\n", f"{tracker}\noutput:\n"))
    with pytest.raises(ConfigError, match=r"association.method: sensor 'front' tells no identity"):
        load_config(path)
