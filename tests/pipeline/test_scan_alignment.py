"""Groups with `align: lagrange`: faster sensors at the instants of the slowest, nothing lost where one fails."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
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
from candaemon.frames.times import NEVER_NS
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.handover import hand_over
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots
from candaemon.pipeline.scan_alignment import MOST_KEPT, KeptScan, ScanAlignment
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.tracker import Tracker
from tests.support.paths import ROOT

RADAR, LIDAR = 0, 1
MS = 1_000_000


def configured(folder: Path, group: dict[str, Any] | None = None, **lidar: Any) -> Path:
    """Write the configuration of a radar and a faster lidar whose scans are aligned."""
    tree = yaml.safe_load((ROOT / "config" / "radar_lidar.yaml").read_text(encoding="utf-8"))
    del tree["tracker"]
    tracker = {"estimator": {"kind": "ca", "noise": 5.0}}
    told = {"sensors": ["radar", "lidar"], "fusion": "federated", "align": "lagrange", "tracker": tracker}
    tree["groups"] = {"ahead": told | (group or {})}
    tree["sensors"]["lidar"] |= {"cycle_time": 0.02} | lidar
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    path = folder / "aligned.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


@cache
def aligned(folder: Path) -> Binding:
    return bind(load_config(configured(folder)))


@pytest.fixture(scope="module")
def of(tmp_path_factory: pytest.TempPathFactory) -> Binding:
    return aligned(tmp_path_factory.mktemp("aligned"))


def alignment(of: Binding) -> ScanAlignment:
    (made,) = Pipeline(of).alignments
    return made


def drive(faults: Sequence[dict[str, Any]] = (), duration: float = 4.0) -> Scenario:
    actors = (
        {"name": "ahead", "start": {"x": 25.0, "y": 0.0, "speed": 12.0}, "segments": ({"acceleration": -1.0},)},
        {"name": "beside", "start": {"x": 15.0, "y": 3.5, "speed": 13.0}},
    )
    told = {"duration": duration, "ego": {"start": {"speed": 12.0}}, "actors": actors, "sensor_faults": tuple(faults)}
    return Scenario.model_validate(told)


def scan(of: Binding, sensor: int, ms: float, x: Floats, ids: Sequence[int] = (3, 7), new: bool = False) -> Scan:
    """Return a scan of objects at some first coordinates, with everything else 1."""
    values = np.ones((len(of.sensors[sensor].reader.quantities), len(ids)))
    values[0] = x
    number = np.array(ids, dtype=np.int64)
    return Scan(round(ms * MS), sensor, number, number, np.full(len(ids), new), values)


def test_a_parabola_is_interpolated_exactly(of: Binding) -> None:
    made = alignment(of)

    def path(ms: float) -> Floats:
        return np.array([20.0, 40.0]) + np.array([3.0, -5.0]) * ms * 1e-3 + np.array([8.0, 2.0]) * (ms * 1e-3) ** 2

    ready = made.take(scan(of, RADAR, 0.0, path(0.0)), 0)
    for ms in (7.0, 26.0, 48.0):
        ready = made.take(scan(of, LIDAR, ms, path(ms)), round(ms * MS))
    assert made.take(scan(of, RADAR, 50.0, path(50.0)), 50 * MS) == []
    ready = made.take(scan(of, LIDAR, 69.0, path(69.0)), 69 * MS)
    assert [each.sensor for each in ready] == [RADAR, LIDAR]
    assert ready[1].time_ns == ready[0].time_ns == 50 * MS
    np.testing.assert_allclose(ready[1].values[0], path(50.0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(ready[1].values[1:], 1.0, rtol=1e-15)


def test_what_was_seen_twice_is_on_a_line_and_what_was_seen_once_waits(of: Binding) -> None:
    made = Pipeline(of)
    (group,) = made.alignments
    group.take(scan(of, RADAR, -60.0, np.zeros(2)), -60 * MS)
    group.take(scan(of, LIDAR, 0.0, np.array([1.0]), [3]), 0)
    group.take(scan(of, LIDAR, 20.0, np.array([2.0, 10.0]), [3, 7], new=True), 20 * MS)
    group.take(scan(of, RADAR, 30.0, np.zeros(2)), 30 * MS)
    ready = group.take(scan(of, LIDAR, 40.0, np.array([4.0, 14.0, 5.0]), [3, 7, 9]), 40 * MS)
    (found,) = [each for each in ready if each.sensor == LIDAR]
    assert found.object_id.tolist() == [3, 7]
    np.testing.assert_allclose(found.values[0], [3.0, 12.0])
    assert found.new.tolist() == [True, True]  # they began after the instant before
    assert made.assemblers[LIDAR].counts.unaligned == 1


def test_angles_go_the_short_way_round(of: Binding) -> None:
    made = alignment(of)
    made._angle[LIDAR] = 1
    made._moving[LIDAR] = np.array([0, 1])
    scans = []
    for ms, angle in ((0.0, np.pi - 0.03), (20.0, np.pi - 0.01), (40.0, 0.01 - np.pi)):
        each = scan(of, LIDAR, ms, np.array([5.0]), [1])
        each.values[1] = angle
        scans.append(each)
    found = made._interpolated(scans, 30 * MS)
    assert float(np.cos(found.values[1, 0])) == pytest.approx(-1.0, abs=1e-9)


def test_what_is_frozen_stays_so_to_the_last_bit(of: Binding) -> None:
    made, chance = alignment(of), np.random.default_rng(5)
    frozen, found = chance.uniform(1.0, 100.0, 2), []
    for k in range(40):
        for ms in (50.0 * k + 3.0, 50.0 * k + 17.3, 50.0 * k + 36.1):
            found += made.take(scan(of, LIDAR, ms, frozen), round(ms * MS))
        found += made.take(scan(of, RADAR, 50.0 * k + 40.0, np.zeros(2)), round((50.0 * k + 40.0) * MS))
    values = {each.values.tobytes() for each in found if each.sensor == LIDAR}
    assert len(found) > 70
    assert len(values) == 1


def test_an_id_that_comes_twice_is_left_out_and_counted(of: Binding) -> None:
    pipeline = Pipeline(of)
    (made,) = pipeline.alignments
    made.take(scan(of, RADAR, -60.0, np.zeros(2)), -60 * MS)
    made.take(scan(of, LIDAR, 0.0, np.array([1.0, 50.0, 7.0]), [3, 3, 4]), 0)
    made.take(scan(of, RADAR, 10.0, np.zeros(2)), 10 * MS)
    ready = made.take(scan(of, LIDAR, 20.0, np.array([1.0, 50.0, 9.0]), [3, 3, 4]), 20 * MS)
    (found,) = [each for each in ready if each.sensor == LIDAR]
    assert found.object_id.tolist() == [4]
    assert found.values[0].tolist() == [8.0]
    assert pipeline.assemblers[LIDAR].counts.unaligned == 2


def test_an_id_that_begins_anew_is_new_however_many_scans_come_between(of: Binding) -> None:
    made = alignment(of)
    made.take(scan(of, RADAR, -1.0, np.zeros(2)), -1 * MS)
    for k in range(6):
        begins = k == 1
        ready = made.take(scan(of, LIDAR, 20.0 * k, np.array([10.0 + 30.0 * (k > 0)]), [3], new=begins), 20 * k * MS)
    assert not [each for each in ready if each.sensor == LIDAR]
    made.take(scan(of, RADAR, 110.0, np.zeros(2)), 110 * MS)
    for ms, new in ((120.0, True), (140.0, False)):
        ready = made.take(scan(of, LIDAR, ms, np.array([40.0]), [3]), round(ms * MS))
        if ms > 130.0:
            made.take(scan(of, RADAR, 150.0, np.zeros(2)), 150 * MS)
            ready = made.take(scan(of, LIDAR, 160.0, np.array([40.0]), [3]), 160 * MS)
        (found,) = [each for each in ready if each.sensor == LIDAR]
        assert found.new.tolist() == [new]


def test_a_clock_that_is_set_back_makes_nothing_wait(of: Binding) -> None:
    made = alignment(of)
    made.take(scan(of, RADAR, 3_600_000.0, np.zeros(2)), 3_600_000 * MS)
    tracked = sum(len(made.take(scan(of, LIDAR, 20.0 * k, np.zeros(2)), 20 * k * MS)) for k in range(100))
    assert tracked > 80


def cycles(of: Binding, faults: Sequence[dict[str, Any]] = ()) -> tuple[list[Cycle], Pipeline, Scenario]:
    pipeline, scenario = Pipeline(of), drive(faults)
    found = list(pipeline.run(simulate(scenario, of, 3).frames()))
    return [*found, *pipeline.finish()], pipeline, scenario


def test_the_fast_sensor_is_tracked_at_the_instants_of_the_slow_one(of: Binding) -> None:
    found, pipeline, _ = cycles(of)
    times: dict[int, list[int]] = {RADAR: [], LIDAR: []}
    for each in found:
        if each.detections is not None:
            times[each.detections.sensor].append(each.detections.time_ns)
    assert len(times[RADAR]) == pytest.approx(80, abs=2)
    assert len(set(times[LIDAR]) & set(times[RADAR])) >= 0.9 * len(times[LIDAR])
    assert len(times[LIDAR]) >= 0.9 * len(times[RADAR])
    assert pipeline.assemblers[LIDAR].counts.scans == pytest.approx(200, abs=3)
    confirmed = [set(each.obstacles.id[each.obstacles.state > 0].tolist()) for each in found[len(found) // 2 :]]
    assert all(each == confirmed[0] and len(each) == 2 for each in confirmed)


@pytest.mark.parametrize(("sensor", "other"), [("radar", LIDAR), ("lidar", RADAR)])
def test_a_silent_sensor_keeps_the_other_from_nothing(sensor: str, other: int, of: Binding) -> None:
    found, pipeline, scenario = cycles(of, [{"sensor": sensor, "kind": "silent", "begin": 2.0, "end": 3.2}])
    begin_ns = round((scenario.start_time + 2.4) * 1e9)
    during = [
        each
        for each in found
        if each.detections is not None
        and begin_ns < each.time_ns < begin_ns + 0.8e9
        and each.detections.sensor == other
    ]
    assert len(during) >= 0.9 * 0.8 / pipeline.binding.sensors[other].settings.cycle_time
    assert max(each.time_ns - each.detections.time_ns for each in during if each.detections) < 0.2e9
    assert {tuple(each.obstacles.id[each.obstacles.state > 0].tolist()) for each in during} == {(1, 2)}
    faults = [each.counts.silent for each in pipeline.trust.state.sensors]
    assert faults[other] == 0
    assert faults[1 - other] == 1


def test_it_goes_on_from_a_stored_state_to_the_byte(of: Binding) -> None:
    frames = list(simulate(drive(duration=1.5), of, 3).frames())
    whole, pipeline, snapshots = Pipeline(of), Pipeline(of), Snapshots(of)
    expected = [frame for each in whole.run(frames) for frame in each.frames]
    found = []
    for k in range(0, len(frames), 211):
        state = snapshots.dump(pipeline)
        pipeline = Pipeline(of)
        snapshots.restore(pipeline, state)
        found += [frame for each in pipeline.run(frames[k : k + 211]) for frame in each.frames]
    assert found == expected
    assert len(expected) > 100


def test_a_state_of_other_sensors_is_refused(of: Binding) -> None:
    made = alignment(of)
    made.state.kept[LIDAR] = [KeptScan.of(scan(of, LIDAR, k, np.zeros(2))) for k in range(MOST_KEPT + 1)]
    with pytest.raises(ValueError, match=f"expected {MOST_KEPT} at most"):
        made.restore(made.state)
    made.state.kept[LIDAR] = [KeptScan.of(scan(of, RADAR, 0, np.zeros(2)))]
    with pytest.raises(ValueError, match="does not fit sensor 1"):
        made.restore(made.state)


def test_a_reload_tracks_what_waits(of: Binding) -> None:
    frames = list(simulate(drive(duration=1.0), of, 3).frames())
    former = Pipeline(of)
    for k in range(len(frames)):
        list(former.run(frames[k : k + 1]))
        if k > len(frames) // 2 and former.alignments[0].deadline_ns < NEVER_NS:
            break
    waiting = former.alignments[0].state.waiting
    assert waiting is not None
    successor = Pipeline(of)
    assert [cycle.obstacles.time_ns for cycle in former.settle(NEVER_NS)][-1] == waiting.scan.time_ns
    kept = hand_over(former, successor)
    assert former.alignments[0].deadline_ns == NEVER_NS
    tracker = successor.trackers[0]
    assert isinstance(tracker, Tracker)
    assert kept.obstacles >= 2
    assert kept.ended == 0
    assert tracker.state.tracks.obstacles.last_ns.max() == waiting.scan.time_ns


@pytest.mark.parametrize(
    ("group", "objects", "problem"),
    [
        ({"sensors": ["radar"]}, {}, r"groups\.ahead\.align: found lagrange, but there is one sensor"),
        ({"align": "lagrnge"}, {}, r"groups\.ahead\.align: found 'lagrnge'"),
        ({}, {"identity": False, "new": []}, r"sensor 'lidar' tells no identity"),
    ],
)
def test_what_cannot_be_aligned_is_an_error(
    group: dict[str, Any], objects: dict[str, Any], problem: str, tmp_path: Path
) -> None:
    path = configured(tmp_path, group)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    tree["sensors"]["lidar"]["objects"] |= objects
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    with pytest.raises(ConfigError, match=problem):
        load_config(path)


def test_a_frozen_sensor_is_noticed_behind_the_alignment(of: Binding) -> None:
    _, pipeline, _ = cycles(of, [{"sensor": "lidar", "kind": "frozen", "begin": 1.5, "end": 3.5}])
    counts = pipeline.trust.counts(LIDAR)
    assert counts.frozen == 1
    assert counts.cut_off > 20
