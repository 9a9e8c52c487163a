"""Another configuration in a running pipeline's place: what goes on, and what begins anew."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
import yaml

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.frames.frame import Frame
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.handover import Kept, hand_over
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.vehicle_tracker import VehicleTracker
from tests.support.paths import ROOT

Tree: TypeAlias = dict[str, Any]

SECONDS = 3.0


def configuration(folder: Path, change: Callable[[Tree], None] = lambda _tree: None) -> Binding:
    """Bind the demo's configuration with a second sensor, changed by the test."""
    tree: Tree = yaml.safe_load((ROOT / "config" / "demo.yaml").read_text(encoding="utf-8"))
    tree["buses"]["side"] = {"interface": "virtual", "channel": "side"}
    tree["sensors"]["side"] = tree["sensors"]["front"] | {"bus": "side", "mount": {"x": 3.6, "y": 0.5, "yaw_deg": 5.0}}
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    change(tree)
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return bind(load_config(path))


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Binding:
    return configuration(tmp_path_factory.mktemp("before"))


@pytest.fixture(scope="module")
def frames(before: Binding) -> list[Frame]:
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    return list(simulate(scenario.model_copy(update={"duration": SECONDS}), before, 3).frames())


class Drive:
    """A drive in two halves, the second by the pipeline of another configuration."""

    def __init__(self, before: Binding, after: Binding, frames: list[Frame]) -> None:
        first, second = Pipeline(before), Pipeline(after)
        half = len(frames) // 2 + 7  # amidst a scan
        names = {bus.index: bus.name for bus in before.buses}
        index = {bus.name: bus.index for bus in after.buses}
        self.earlier = list(first.run(frames[:half]))
        self.kept: Kept = hand_over(first, second)
        self.later = list(
            second.run(f._replace(bus=index[names[f.bus]]) for f in frames[half:] if names[f.bus] in index)
        )
        self.pipeline = second

    @property
    def before_and_after(self) -> tuple[set[int], set[int]]:
        """Identities of the confirmed obstacles last told before the change, and first told after it."""
        return confirmed(self.earlier[-1]), confirmed(self.later[0])


def confirmed(cycle: Cycle) -> set[int]:
    return set(cycle.obstacles.id[cycle.obstacles.state > 0].tolist())


def wire(cycles: list[Cycle]) -> list[Frame]:
    return [frame for cycle in cycles for frame in cycle.frames]


def test_the_same_configuration_changes_no_byte(before: Binding, frames: list[Frame], tmp_path: Path) -> None:
    alone = list(Pipeline(before).run(frames))
    drive = Drive(before, configuration(tmp_path), frames)
    assert wire(drive.earlier) + wire(drive.later) == wire(alone)
    assert drive.kept.ended == 0
    assert drive.kept.obstacles >= 3
    assert str(drive.kept).startswith("unchanged: front, side, own motion, output; ")
    assert drive.pipeline.counts.cycles == sum(cycle.reported is not None for cycle in alone)


def test_another_life_cycle_keeps_the_obstacles(before: Binding, frames: list[Frame], tmp_path: Path) -> None:
    after = configuration(tmp_path, lambda tree: tree.update(tracker={"lifecycle": {"coast": 3.0}}))
    ids = Drive(before, after, frames).before_and_after
    assert len(ids[0]) >= 3
    assert ids[0] == ids[1]


def test_another_filter_begins_anew_with_identities_never_given(
    before: Binding, frames: list[Frame], tmp_path: Path
) -> None:
    after = configuration(tmp_path, lambda tree: tree.update(tracker={"estimator": {"kind": "cv", "noise": 1.0}}))
    drive = Drive(before, after, frames)
    told = [identity for cycle in drive.later for identity in cycle.obstacles.id.tolist()]
    assert drive.kept.obstacles == 0
    assert told
    assert min(told) > max(identity for cycle in drive.earlier for identity in cycle.obstacles.id.tolist())


def test_another_own_motion_begins_anew(before: Binding, frames: list[Frame], tmp_path: Path) -> None:
    drive = Drive(before, configuration(tmp_path, lambda tree: tree["ego"].update(age_limit=0.3)), frames)
    assert not drive.kept.ego_motion
    assert drive.kept.obstacles == 0  # the level frame is another
    assert confirmed(drive.later[-1])


def test_a_changed_sensor_begins_anew_and_the_others_hold_the_obstacles(
    before: Binding, frames: list[Frame], tmp_path: Path
) -> None:
    """Its totals go on: what counts since the start never falls."""
    alone = Pipeline(before)
    assert list(alone.run(frames))

    def change(tree: Tree) -> None:
        tree["sensors"]["side"]["mount"]["yaw_deg"] = 5.5

    drive = Drive(before, configuration(tmp_path, change), frames)
    old, new = drive.before_and_after
    assert drive.kept.sensors == ("front",)
    assert len(old & new) >= 3
    for after, without in zip(drive.pipeline.assemblers, alone.assemblers, strict=True):
        assert after.counts.used == pytest.approx(without.counts.used, abs=64)  # a scan was open at the change
        assert after.counts.scans == pytest.approx(without.counts.scans, abs=1)
    assert drive.pipeline.trackers[0].counts.detections > 0.9 * alone.trackers[0].counts.detections


def test_obstacles_outlive_a_sensor_and_a_bus_put_before_theirs(
    before: Binding, frames: list[Frame], tmp_path: Path
) -> None:
    def change(tree: Tree) -> None:
        tree["buses"] = {"more": {"interface": "virtual", "channel": "more"}} | tree["buses"]
        tree["sensors"] = {"rear": tree["sensors"]["front"] | {"bus": "more"}} | tree["sensors"]

    drive = Drive(before, configuration(tmp_path, change), frames)
    old, new = drive.before_and_after
    assert old == new
    assert drive.kept.sensors == ("front", "side")
    # bit 1 is the front sensor's from here on, and nobody has been seen by the one at bit 0
    assert set(np.bitwise_or.reduce(drive.later[-1].obstacles.sensors, keepdims=True).tolist()) == {0b110}
    assert drive.pipeline.counts.buses[0].frames == 0
    assert sum(bus.frames for bus in drive.pipeline.counts.buses) == len(frames)


def test_what_only_a_lost_sensor_has_seen_ends(before: Binding, frames: list[Frame], tmp_path: Path) -> None:
    def change(tree: Tree) -> None:
        del tree["sensors"]["side"], tree["buses"]["side"]

    after = configuration(tmp_path, change)
    drive = Drive(before, after, frames)
    seen_by = dict(
        zip(drive.earlier[-1].obstacles.id.tolist(), drive.earlier[-1].obstacles.sensors.tolist(), strict=True)
    )
    first = set(drive.later[0].obstacles.id.tolist())
    assert {identity for identity, sensors in seen_by.items() if sensors == 0b10}.isdisjoint(first)
    assert {identity for identity in first if identity in seen_by} <= {i for i, s in seen_by.items() if s & 1}


@pytest.mark.parametrize(
    "estimator",
    [
        {"kind": "cv", "noise": 1.0, "measurement_noise": {"kind": "variational"}},
        {"kind": "federated"},
    ],
    ids=["variational", "federated"],
)
def test_what_is_known_of_each_sensor_follows_its_number(estimator: Tree, frames: list[Frame], tmp_path: Path) -> None:
    def with_estimator(tree: Tree) -> None:
        tree["tracker"] = {"estimator": estimator}

    def turned(tree: Tree) -> None:
        with_estimator(tree)
        tree["sensors"] = dict(reversed(tree["sensors"].items()))

    before = configuration(tmp_path, with_estimator)
    alone = list(Pipeline(before).run(frames))
    drive = Drive(before, configuration(tmp_path, turned), frames)
    cycles = drive.earlier + drive.later
    assert [cycle.obstacles.id.tolist() for cycle in cycles] == [cycle.obstacles.id.tolist() for cycle in alone]
    for one, other in zip(cycles, alone, strict=True):
        np.testing.assert_allclose(one.obstacles.x, other.obstacles.x, rtol=1e-9)
        np.testing.assert_allclose(one.obstacles.sx, other.obstacles.sx, rtol=1e-9)


def test_another_output_begins_anew(before: Binding, frames: list[Frame], tmp_path: Path) -> None:
    def change(tree: Tree) -> None:
        tree["output"]["objects"]["slots"] = 8
        tree["output"].setdefault("path_half_width", 2.5)

    drive = Drive(before, configuration(tmp_path, change), frames)
    assert not drive.kept.output
    assert drive.before_and_after[0] == drive.before_and_after[1]
    assert len(drive.later[0].frames) <= 1 + 4 * 8


def vehicles(tree: Tree) -> None:
    tree["tracker"] = {"estimator": {"kind": "vehicle"}}


def test_vehicles_change_no_byte_by_the_same_configuration(frames: list[Frame], tmp_path: Path) -> None:
    of = configuration(tmp_path, vehicles)
    alone = list(Pipeline(of).run(frames))
    drive = Drive(of, of, frames)
    assert wire(drive.earlier) + wire(drive.later) == wire(alone)
    assert drive.kept.obstacles >= 3


def test_vehicles_outlive_sensors_that_come_go_and_change(frames: list[Frame], tmp_path: Path) -> None:
    def change(tree: Tree) -> None:
        vehicles(tree)
        sensors = tree["sensors"]
        sensors["side"]["mount"]["yaw_deg"] = 5.5
        tree["buses"] = {"more": {"interface": "virtual", "channel": "more"}} | tree["buses"]
        tree["sensors"] = {"rear": sensors["front"] | {"bus": "more"}} | sensors

    (tmp_path / "before").mkdir()
    drive = Drive(configuration(tmp_path / "before", vehicles), configuration(tmp_path, change), frames)
    old, new = drive.before_and_after
    assert drive.kept.sensors == ("front",)
    assert len(old & new) >= 3
    (tracker,) = drive.pipeline.trackers
    assert isinstance(tracker, VehicleTracker)
    assert list(tracker.state.noise.sensors) == [0, 1, 2]
    (tmp_path / "after").mkdir()
    back = hand_over(drive.pipeline, Pipeline(configuration(tmp_path / "after", vehicles)))
    assert back.obstacles >= 3


def test_obstacles_keep_their_slots_where_little_of_the_output_changes(
    before: Binding, frames: list[Frame], tmp_path: Path
) -> None:
    """Which obstacles come first matters only where slots run short."""
    alone = list(Pipeline(before).run(frames))
    drive = Drive(before, configuration(tmp_path, lambda tree: tree["output"].update(path_half_width=3.5)), frames)
    assert not drive.kept.output
    assert drive.kept.obstacles >= 3
    assert wire(drive.earlier) + wire(drive.later) == wire(alone)
