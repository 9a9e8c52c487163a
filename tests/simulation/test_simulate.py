from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from candaemon.arrays import Booleans, Floats
from candaemon.binding.bound import Binding
from candaemon.dbc.bits import sendable_values
from candaemon.ego.factory import make_ego
from candaemon.ego.motion import EgoMotion
from candaemon.errors import ConfigError
from candaemon.evaluation.tables import TRUTH_COLUMNS, TrackWriter, read_truth
from candaemon.files.outputs import OutputFile
from candaemon.frames.bodies import CLASSES
from candaemon.frames.frame import Frame
from candaemon.objects.reader import SPEEDS
from candaemon.objects.signals import SignalBinding
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.schedule import start_ns
from candaemon.simulation.simulate import Simulation, simulate
from candaemon.simulation.slot_reports import SlotReport
from candaemon.simulation.truth import Truth
from tests.support.bound import binding as bound
from tests.support.paths import ROOT

CONFIGS = ("esr_ins", "gm_lrr", "tesla_continental", "ars408", "toyota_rav4", "toyota_rav4_ins", "volkswagen_meb")


def drive(name: str, **changes: Any) -> Scenario:
    """Return one of the project's scenarios with some of its settings changed."""
    settings = load_scenario(ROOT / "config" / "scenarios" / f"{name}.yaml").model_dump()
    for key, value in changes.items():
        settings[key] = settings[key] | value if isinstance(value, dict) else value
    return Scenario.model_validate(settings)


def scans(frames: Iterator[Frame], binding: Binding) -> list[Scan]:
    """Read the first sensor's frames back."""
    sensor = binding.sensors[0]
    assembler = make_assembler(sensor)
    found: list[Scan | None] = []
    for frame in frames:
        if frame.bus != sensor.bus:
            continue
        if frame.time_ns >= assembler.deadline_ns:
            found.append(assembler.expire(frame.time_ns))
        receive, part, slot = assembler.routes[frame.can_id]
        found.append(receive(part, slot, frame.data, frame.time_ns))
    found.append(assembler.flush())
    return [scan for scan in found if scan is not None]


def followed(ego: EgoMotion, frames: list[Frame], binding: Binding) -> None:
    """Let own motion take the frames that are for it."""
    assert binding.ego is not None
    for frame in frames:
        message = binding.ego.messages.get(frame.can_id)
        if frame.bus == binding.ego.bus and message is not None:
            values = message.decode(frame.data)
            assert values is not None
            ego.update(frame.time_ns, message.quantities, values)


@pytest.mark.parametrize("name", CONFIGS)
def test_what_a_sensor_reports_is_what_its_frames_say(name: str) -> None:
    binding = bound(name)
    simulation = simulate(drive("highway", duration=4.0), binding)
    reports = list(simulation.reports(0))
    read = scans(simulation.frames(), binding)
    reader, form = binding.sensors[0].reader, binding.sensors[0].settings.objects
    packed = form.identity is not None and not form.multiplexed
    numbered = int(packed or name == "volkswagen_meb")  # an identity that is a signal of its own is never 0
    rows = [reports[0][1].quantities.index(quantity) for quantity in reader.quantities]
    step = np.array([[abs(b.gain * b.signal.scale)] for b in reader.bindings])
    assert len(read) == len(reports) > 50
    assert sum(len(report.slot) for _, report in reports) > 100
    for scan, (time_ns, report) in zip(read, reports, strict=True):
        assert scan.complete
        assert scan.time_ns == pytest.approx(time_ns, abs=1000)
        limits = np.array([[_limits(b.quantity, b.signal, b.gain, b.bias)] for b in reader.bindings])[:, 0]
        exact = np.clip(report.values[rows], limits[:, :1], limits[:, 1:])
        ends = np.stack([_at_an_end(b, each) for b, each in zip(reader.bindings, exact, strict=True)])
        held = report.slot + numbered
        assert scan.object_id.tolist() == held.tolist()
        assert scan.slot.tolist() == (list(range(len(held))) if packed else report.slot.tolist())
        if form.new:
            assert scan.new.tolist() == report.new.tolist()
        assert np.isnan(scan.values[ends]).all()
        exact = np.where(ends, 0.0, exact)
        assert np.all(np.abs(np.nan_to_num(scan.values) - exact) <= 0.5001 * step + 1e-9)  # a size of 0 is none


def _at_an_end(signal: SignalBinding, exact: Floats) -> Booleans:
    """Return which values (n,) a signal of a speed tells as one of its ends: they may be beyond it."""
    if signal.quantity not in SPEEDS:
        return np.zeros(len(exact), dtype=np.bool_)
    step = abs(signal.gain * signal.signal.scale)
    ends = [signal.gain * each + signal.bias for each in sendable_values(signal.signal)]
    return np.asarray(np.any([np.abs(exact - end) <= 0.5 * step for end in ends if end != 0.0], axis=0))


def _limits(quantity: str, signal: Any, gain: float, bias: float) -> tuple[float, float]:
    """Return what a quantity saturates at."""
    low = -math.inf if signal.minimum is None else signal.minimum
    high = math.inf if signal.maximum is None else signal.maximum
    ends = sorted((gain * low + bias, gain * high + bias))
    return ends[0], ends[1]


def test_the_same_seed_gives_the_same_bytes_and_another_others() -> None:
    binding, scenario = bound("esr_ins"), drive("highway", duration=2.0, frames={"loss": 0.02, "jitter": 0.001})
    first, again = (list(simulate(scenario, binding, 7).frames()) for _ in range(2))
    assert first == again
    assert first != list(simulate(scenario, binding, 8).frames())
    times = [frame.time_ns for frame in first]
    assert times == sorted(times)
    assert all(time % 1000 == 0 for time in times)


def test_clutter_changes_neither_noise_nor_misses() -> None:
    binding = bound("esr_ins")

    def real(clutter: float) -> list[list[float]]:
        scenario = drive("turning_ego", duration=5.0, measurement={"clutter": clutter})
        found = []
        for _, report in simulate(scenario, binding).reports(0):
            mine = report.owner >= 0
            order = np.argsort(report.owner[mine], kind="stable")
            found.append(report.values[:, mine][:, order].ravel().tolist())
        return found

    assert real(0.0) == real(4.0)


def test_detections_clutter_and_noise_are_as_asked() -> None:
    scenario = drive("automotive_cruise", duration=200.0, actors=(_point(60.0, 2.0, 15.0),), measurement={
        "detection_probability": 0.9, "clutter": 0.7, "noise": {"range": 0.3, "azimuth_deg": 0.4, "range_rate": 0.2},
    })  # fmt: skip
    reports = [report for _, report in simulate(scenario, bound("esr_ins")).reports(0)]
    lead = np.array([report.values[:3, report.owner == 0][:, 0] for report in reports if 0 in report.owner])
    false = sum(np.count_nonzero(report.owner < 0) for report in reports)
    truth = np.array([math.hypot(56.4, 2.0), math.atan2(2.0, 56.4), 0.0])
    assert len(lead) / len(reports) == pytest.approx(0.9, abs=0.02)
    assert false / len(reports) == pytest.approx(0.7, abs=0.06)
    assert (lead - truth).mean(axis=0) == pytest.approx(0.0, abs=0.03)
    assert (lead - truth).std(axis=0) == pytest.approx([0.3, math.radians(0.4), 0.2], rel=0.06)


def _point(x: float, y: float, vx: float, **more: Any) -> dict[str, Any]:
    start = {"x": x, "y": y, "vx": vx, "vy": 0.0}
    return {"name": f"at {x:g}", "size": {"length": 0.0, "width": 0.0}, "start": start, **more}


@pytest.mark.parametrize("name", ["esr_ins", "ars408"])
def test_rates_are_the_derivatives_of_positions_in_the_turning_axes(name: str) -> None:
    exact = {"range": 0.0, "azimuth_deg": 0.0, "range_rate": 0.0, "x": 0.0, "y": 0.0, "vx": 0.0, "vy": 0.0}
    quiet = {"noise": exact, "detection_probability": 1.0, "clutter": 0.0, "cycle_jitter": 0.0}
    binding = bound(name)
    scenario = drive("turning_ego", duration=12.0, measurement=quiet, stationary={"posts": ()})
    cycle = binding.sensors[0].settings.cycle_time
    reports = [report for _, report in simulate(scenario, binding).reports(0)]
    lead = np.array([report.values[:, report.owner == 0][:, 0] for report in reports])
    row = {quantity: k for k, quantity in enumerate(reports[0].quantities)}
    for place, rate in (("range", "range_rate"), ("x", "vx"), ("y", "vy")):
        if place in row:
            slope = (lead[2:, row[place]] - lead[:-2, row[place]]) / (2 * cycle)
            error = np.abs(slope - lead[1:-1, row[rate]])
            assert np.median(error) < 0.002
            assert np.count_nonzero(error > 0.02) <= 12, "only where one of the bends begins or ends"


def test_a_car_hides_the_one_before_it_and_truth_says_so() -> None:
    cars = tuple(
        {"name": name, "start": {"x": x, "y": 0.0, "vx": 15.0, "vy": 0.0}}
        for name, x in (("near", 30.0), ("far", 60.0))
    )
    scenario = drive("automotive_cruise", duration=3.0, actors=cars)
    simulation = simulate(scenario, bound("esr_ins"))
    assert all(1 not in report.owner for _, report in simulation.reports(0))
    assert all(cycle.columns["state"].tolist() == ["actor", "hidden"] for cycle in simulation.truth())
    seen = simulate(
        drive("automotive_cruise", duration=3.0, actors=cars, measurement={"occlusion": False}), bound("esr_ins")
    )
    assert all(1 in report.owner for _, report in seen.reports(0))


def test_what_a_car_behind_us_hides_is_hidden_on_both_sides_of_where_angles_begin_anew() -> None:
    """Straight behind, angles jump from 180 to -180 degrees."""
    sensor = bound("esr_ins").sensors[0].settings
    round_about = sensor.field_of_view.model_copy(update={"azimuth_deg": 180.0})
    for ahead in (1.0, -1.0):
        cars = tuple(
            {"name": name, "start": {"x": ahead * x, "y": y, "vx": 15.0, "vy": 0.0}, "reflections": 1}
            for name, x, y in (("near", 30.0, 0.0), ("left", 60.0, 0.4), ("right", 60.0, -0.4))
        )
        scene = Scene(drive("automotive_cruise", duration=1.0, actors=cars))
        truth = Truth(scene, [sensor.model_copy(update={"field_of_view": round_about})], occlusion=True)
        assert truth.visible(next(scene.states(np.array([0.5])))).tolist() == [True, False, False]


def test_truth_sees_what_a_turned_sensor_sees() -> None:
    sensor = bound("esr_ins").sensors[0].settings
    places = {name: 40.0 * np.exp(1j * np.radians(angle)) for name, angle in (("right", -43.5), ("left", 46.5))}
    cars = tuple(
        {"name": name, "start": {"x": sensor.mount.x + place.real, "y": place.imag, "speed": 15.0}, "reflections": 1}
        for name, place in places.items()
    )
    assert sensor.field_of_view.azimuth_deg == 45.0
    still = {"clutter": 0.0, "detection_probability": 1.0, "turned_deg": 3.0, "occlusion": False}
    scenario = drive("automotive_cruise", duration=0.5, actors=cars, measurement=still)
    simulation = simulate(scenario, bound("esr_ins"))
    seen = {int(owner) for _, report in simulation.reports(0) for owner in report.owner}
    assert seen & {0, 1} == {1}
    assert all(cycle.columns["state"].tolist()[:2] == ["hidden", "actor"] for cycle in simulation.truth())


def test_truth_sees_a_second_reflection_as_far_as_the_sensor_does() -> None:
    car = {"name": "beside", "start": {"x": 90.0, "y": 6.0, "speed": 15.0}, "reflections": 2, "reflections_range": 60.0}
    ahead = {"name": "ahead", "size": {"length": 12.0, "width": 2.5}, "start": {"x": 70.0, "y": 4.4, "speed": 15.0}}
    scenario = drive("automotive_cruise", duration=0.5, actors=(car, ahead), measurement={"clutter": 0.0})
    simulation = simulate(scenario, bound("esr_ins"))
    seen = {int(owner) for _, report in simulation.reports(0) for owner in report.owner}
    told = {cycle.columns["state"][0] for cycle in simulation.truth()}
    assert told == ({"actor"} if 0 in seen else {"hidden"})


CARS = (
    {"name": "lead", "start": {"x": 40.0, "y": 0.0, "vx": 15.0, "vy": 0.0}},
    {"name": "oncoming", "start": {"x": 90.0, "y": 3.5, "speed": 10.0, "heading_deg": 180.0}},
    {"name": "crossing", "size": {"length": 12.0, "width": 2.5},
     "start": {"x": 60.0, "y": -8.0, "speed": 5.0, "heading_deg": 90.0}},
    {"name": "point", "size": {"length": 0.0, "width": 0.0}, "start": {"x": 30.0, "y": 9.0, "vx": 1.0, "vy": 0.0}},
)  # fmt: skip


def test_the_reference_point_is_the_ellipses_nearest_point() -> None:
    ego = {"start": {"speed": 0.0, "heading_deg": 45.0}}
    first = next(simulate(drive("automotive_turn", actors=CARS, ego=ego), bound("esr_ins")).truth()).columns
    angle = np.linspace(0.0, 2 * np.pi, 100_000)
    for k, (half_length, half_width) in enumerate([(2.25, 0.9), (2.25, 0.9), (1.25, 6.0)]):
        centre = np.array([first["center_x"][k], first["center_y"][k]])
        outline = centre[:, None] + np.stack([half_length * np.cos(angle), half_width * np.sin(angle)])
        nearest = outline[:, np.argmin(np.hypot(*outline))]
        assert (first["x"][k], first["y"][k]) == pytest.approx(nearest, abs=0.01)
    assert (first["x"][3], first["y"][3]) == pytest.approx((30.0, 9.0))
    assert first["vx"] == pytest.approx([15.0, -10.0, 0.0, 1.0], abs=1e-9)
    assert first["ve"][0] == pytest.approx(15.0 * math.sin(math.radians(45.0)))


def test_the_truth_tells_the_body() -> None:
    ego = {"start": {"speed": 0.0, "heading_deg": 45.0}}
    first = next(simulate(drive("automotive_turn", actors=CARS, ego=ego), bound("esr_ins")).truth()).columns
    assert first["heading"] == pytest.approx([0.0, math.pi, math.pi / 2, math.nan], abs=1e-9, nan_ok=True)
    assert first["length"].tolist() == [4.5, 4.5, 12.0, 0.0]
    assert first["width"].tolist() == [1.8, 1.8, 2.5, 0.0]
    assert first["center_x"] == pytest.approx([40.0, 90.0, 60.0, 30.0])
    assert first["center_y"] == pytest.approx([0.0, 3.5, -8.0, 9.0])
    assert first["class"].tolist() == ["car", "car", "truck", "unknown"]
    assert first["yaw_rate"] == pytest.approx([0.0, 0.0, 0.0, math.nan], abs=1e-12, nan_ok=True)


def test_sides_count_where_their_extent_can_be_judged() -> None:
    def box(name: str, x: float, y: float, heading: float) -> dict[str, Any]:
        return {"name": name, "start": {"x": x, "y": y, "speed": 0.0, "heading_deg": heading}}

    cars = (
        box("askew", 30.0, -6.0, 30.0),
        box("straight ahead", 40.0, 0.0, 0.0),
        box("behind it", 55.0, 0.5, 30.0),
        box("behind us", -30.0, 0.0, 0.0),
    )
    scenario = drive("automotive_turn", actors=cars, ego={"start": {"speed": 0.0}})
    assert next(simulate(scenario, bound("esr_ins")).truth()).columns["sides"].tolist() == [2, 1, 0, 0]


def test_truth_is_a_table_that_evaluate_reads(tmp_path: Path) -> None:
    simulation = simulate(drive("guard_rail", duration=1.0), bound("esr_ins"))
    with OutputFile(tmp_path / "truth.csv") as file, TrackWriter(file, TRUTH_COLUMNS) as writer:
        for cycle in simulation.truth():
            writer.write_cycle(cycle.time_ns, cycle.columns)
    table = read_truth(tmp_path / "truth.csv")
    assert len(np.unique(table.time_ns)) == 20
    assert np.unique(table.id[table.state == 3]).tolist() == [1]
    still = table.state == 5
    assert np.count_nonzero(still) > 20 * 50
    assert not table.vx[still].any()
    assert np.isnan(table.heading[still]).all()
    assert {CLASSES[code] for code in table.kind[still]} == {"standing"}
    assert set(table.sides[table.state == 3].tolist()) <= {0.0, 1.0, 2.0}
    assert np.isfinite(table.heading[table.state == 3]).all()


@pytest.mark.parametrize("name", ["esr_ins", "gm_lrr", "ars408", "tesla_continental"])
def test_the_origin_of_each_object_is_known_by_its_scans_time_and_its_id(name: str) -> None:
    binding = bound(name)
    simulation = simulate(drive("highway", duration=3.0, frames={"loss": 0.05, "jitter": 0.002}), binding)
    origins = {scan.time_ns: scan for scan in simulation.origins()}
    truth = {cycle.time_ns: cycle.columns for cycle in simulation.truth()}
    mount, far, found = binding.sensors[0].settings.mount, 0, 0
    for scan in scans(simulation.frames(), binding):
        if scan.time_ns not in origins:  # of an incomplete scan, closed before its last frames came
            continue
        origin, row = origins[scan.time_ns], dict(zip(scan.object_id.tolist(), range(len(scan.object_id)), strict=True))
        columns = truth[origin.measured_ns]
        for number, source in zip(origin.object_id.tolist(), origin.source.tolist(), strict=True):
            if source == 0 or number not in row:
                continue
            k = int(np.flatnonzero(columns["id"] == source)[0])
            values = dict(zip(binding.sensors[0].reader.quantities, scan.values[:, row[number]], strict=True))
            if "range" in values:
                x, y = values["range"] * np.cos(values["azimuth"]), values["range"] * np.sin(values["azimuth"])
            else:
                x, y = values["x"], values["y"]
            found += 1
            far += math.hypot(x + mount.x - columns["x"][k], y + mount.y - columns["y"][k]) > 8.0
    assert found > 60
    assert far == 0


def _moved(name: str, scenario: Scenario) -> tuple[EgoMotion, Simulation]:
    binding = bound(name)
    simulation = simulate(scenario, binding)
    ego = make_ego(binding.ego)
    followed(ego, list(simulation.frames()), binding)
    return ego, simulation


def test_an_ins_tells_the_true_motion() -> None:
    scenario = drive("turning_ego", duration=7.0, ego={"own_motion": {"noise": 0.0}})
    ego, _ = _moved("esr_ins", scenario)
    (truth,) = Scene(scenario).states(np.array([6.5]))
    pose = ego.pose(start_ns(scenario) + 6_500_000_000)
    assert pose is not None
    assert complex(pose.ve, pose.vn) == pytest.approx(truth.ego.velocity, abs=0.02)
    assert pose.yaw_rate == pytest.approx(0.2, abs=0.02)
    assert math.remainder(pose.heading - truth.ego.yaw, 2 * math.pi) == pytest.approx(0.0, abs=3e-4)


def test_odometry_tells_speed_and_yaw_rate_with_the_bias_asked_for() -> None:
    scenario = drive("turning_ego", duration=7.0, ego={"own_motion": {"noise": 0.0, "yaw_rate_bias_deg": -0.5}})
    binding = bound("toyota_rav4")
    assert binding.ego is not None
    speeds: list[float] = []
    turns: list[float] = []
    for frame in simulate(scenario, binding).frames():
        message = binding.ego.messages.get(frame.can_id) if frame.bus == binding.ego.bus else None
        if message is None or frame.time_ns < start_ns(scenario) + 5_000_000_000:
            continue
        values = message.decode(frame.data) or ()
        for quantity, value in zip(message.quantities, values, strict=True):
            if quantity != "reverse":
                (turns if quantity == "yaw_rate" else speeds).append(value)
    assert np.mean(speeds) == pytest.approx(12.0, abs=0.01)
    assert np.mean(turns) == pytest.approx(math.radians(11.4592 - 0.5), abs=math.radians(0.13))


def test_frames_are_lost_and_delayed_as_asked() -> None:
    binding = bound("esr_ins")
    whole = list(simulate(drive("dense", duration=5.0), binding).frames())
    thinned = list(simulate(drive("dense", duration=5.0, frames={"loss": 0.1}), binding).frames())
    late = list(simulate(drive("dense", duration=5.0, frames={"jitter": 0.004}), binding).frames())
    assert len(thinned) / len(whole) == pytest.approx(0.9, abs=0.02)
    assert len(late) == len(whole)
    assert 0.001 < (np.mean([f.time_ns for f in late]) - np.mean([f.time_ns for f in whole])) / 1e9 < 0.006


def test_a_missed_object_is_moved_on_if_asked() -> None:
    changes = {"detection_probability": 0.6, "clutter": 0.0, "missing": "coast", "hold": 50, "cycle_jitter": 0.0}
    actors = (_point(80.0, 0.0, 5.0),)
    reports = list(
        simulate(
            drive("automotive_cruise", duration=4.0, actors=actors, measurement=changes), bound("esr_ins")
        ).reports(0)
    )
    after = [report for _, report in reports[20:]]
    assert all(len(report.slot) == 1 for report in after)
    assert np.abs(np.diff([report.values[0, 0] for report in after])).max() < 3.0


def test_slots_are_reused_without_an_empty_cycle_between() -> None:
    reports: list[SlotReport] = [report for _, report in simulate(drive("guard_rail"), bound("gm_lrr")).reports(0)]
    reused = 0
    for before, here in pairwise(reports):
        was = dict(zip(before.slot.tolist(), before.owner.tolist(), strict=True))
        for slot, owner, new in zip(here.slot.tolist(), here.owner.tolist(), here.new.tolist(), strict=True):
            reused += new and slot in was
            assert new or slot not in was or was[slot] == owner
    assert reused > 20


def test_a_static_ego_cannot_drive() -> None:
    binding = bound("esr_ins")
    still = Binding(binding.loaded, binding.buses, binding.sensors, None, None, {}, ())
    with pytest.raises(ConfigError, match="static"):
        simulate(drive("highway"), still)
    assert next(simulate(drive("automotive_turn"), still).frames()).bus == binding.sensors[0].bus


def test_a_simulation_has_so_many_scans_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    binding = bound("esr_ins")
    (cycle,) = [sensor.settings.cycle_time for sensor in binding.sensors]
    scenario = drive("highway", duration=100.0)
    monkeypatch.setattr("candaemon.simulation.simulate.MOST_SCANS", math.ceil(100.0 / cycle))
    simulate(scenario, binding)
    monkeypatch.setattr("candaemon.simulation.simulate.MOST_SCANS", math.ceil(100.0 / cycle) - 1)
    with pytest.raises(ConfigError, match=r"esr_ins\.yaml:\d+: 100 s of the scenario are 2,000 scans of all sensors"):
        simulate(scenario, binding)
