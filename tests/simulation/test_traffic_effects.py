"""Each effect of traffic shows in what a sensor reports."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.simulate import simulate
from candaemon.simulation.slot_reports import SlotReport, SlotReporter
from tests.support.bound import binding as bound

MOUNT = 3.6  # m, of the radars of `config/`
CALM: dict[str, Any] = {"swaps": 0.0, "coasting": 0.0, "ghosts": {"double_bounce": 0.0, "mirrored": 0.0}}
ONE = {"fewest": 1, "most": 1, "renewal": 1000.0}


def scene(actors: list[dict[str, Any]], traffic: dict[str, Any] | None, **more: Any) -> Scenario:
    """Return a scenario without clutter in which nothing is missed, with some effects only."""
    measurement: dict[str, Any] = {"detection_probability": 1.0, "clutter": 0.0, "cycle_jitter": 0.0}
    measurement |= more.pop("measurement", {})
    if traffic is not None:
        measurement["traffic"] = CALM | traffic
    settings = {"duration": 20.0, "ego": {"start": {"speed": 0.0}, "own_motion": {"noise": 0.0}}} | more
    return Scenario.model_validate({**settings, "actors": tuple(actors), "measurement": measurement})


def car(x: float, y: float, speed: float = 0.0, heading: float = 0.0, **more: Any) -> dict[str, Any]:
    return {"name": f"{x:g} {y:g}", "start": {"x": x, "y": y, "speed": speed, "heading_deg": heading}, **more}


def point(x: float, y: float) -> dict[str, Any]:
    return car(x, y, size={"length": 0.0, "width": 0.0})


def posts(count: int) -> dict[str, Any]:
    return {"posts": tuple({"x": 30.0 + 2.0 * k, "y": 10.0 * (-1) ** k} for k in range(count))}


def reports(scenario: Scenario, name: str = "ars408", seed: int = 1) -> Iterator[SlotReport]:
    return (report for _, report in simulate(scenario, bound(name), seed).reports(0))


def places(report: SlotReport) -> np.ndarray[Any, np.dtype[np.complex128]]:
    rows = dict(zip(report.quantities, report.values, strict=True))
    return np.asarray(rows["x"] + 1j * rows["y"] + MOUNT)


def paths(scenario: Scenario, name: str = "ars408", seed: int = 1) -> np.ndarray[Any, np.dtype[np.complex128]]:
    """Return the places of objects that are there in all scans, each alone in its origin, shape (scans, objects)."""
    rows = []
    for report in reports(scenario, name, seed):
        order = np.argsort(report.owner)
        assert len(np.unique(report.owner)) == len(report.owner)
        rows.append(places(report)[order])
    return np.array(rows)


def correlation(series: Floats, lag: int) -> float:
    """Return the mean correlation of series in columns with themselves, `lag` rows later."""
    series = series - series.mean(axis=0)
    return float(np.mean(series[:-lag] * series[lag:]) / np.mean(series**2))


def test_noise_has_a_slow_part_that_is_larger_far_away() -> None:
    white, traffic = scene([], None, stationary=posts(60)), scene([], {}, stationary=posts(60))
    assert abs(correlation(paths(white).real, 1)) < 0.05
    across = paths(traffic)
    near, far = across[:, 0].real.mean(), across[:, -1].real.mean()
    assert (near, far) == (pytest.approx(30.0, abs=0.5), pytest.approx(148.0, abs=0.5))
    keep = math.exp(-0.072 / 0.3)
    assert correlation(across[:, :10].imag, 1) == pytest.approx(0.43 * keep, abs=0.08)
    assert correlation(across[:, -25:].imag, 1) == pytest.approx(0.7 * keep, abs=0.08)
    assert across.imag.std(axis=0).mean() == pytest.approx(0.3, rel=0.05)  # as the configuration says


def test_a_radar_that_filters_shows_a_walk_and_slides() -> None:
    """The spread of what stands grows 9 to 40 times from one scan to a second, that of white noise does not."""

    def ratio(scenario: Scenario, name: str, cycle: float) -> float:
        path, second = paths(scenario, name).imag, round(1 / cycle)
        return float(np.var(path[second:] - path[:-second]) / np.var(path[1:] - path[:-1]))

    own: dict[str, Any] = {"own_filter": {}}
    for name, cycle in (("ars408", 0.072), ("toyota_rav4", 0.05)):
        ego = {} if name == "ars408" else {"ego": {"start": {"speed": 0.0}}}
        near = {"posts": tuple({"x": 30.0 + 5 * k, "y": 2.0 * (-1) ** k} for k in range(14))}
        assert 9 < ratio(scene([], own, stationary=near, duration=30.0, **ego), name, cycle) < 40
        assert ratio(scene([], None, stationary=near, duration=30.0, **ego), name, cycle) < 2.5


def test_slides_are_sudden_sideways_and_metres_long() -> None:
    slides = {"walk": 0.0, "walk_along": 0.0, "white": 0.001, "return_time": 1000.0, "slides": 0.1}
    path = paths(scene([], {"own_filter": slides}, stationary=posts(40)))
    speed = np.abs(np.diff(path.imag, axis=0)) / 0.072
    sliding = speed > 1.0
    assert 0.002 < sliding.mean() < 0.2
    assert (
        np.abs(np.diff(path.real, axis=0)).max() / 0.072 < 3.0
    )  # across the sight: some of it along x far to the side
    whole = speed[1:-1][sliding[1:-1] & sliding[:-2] & sliding[2:]]
    assert 2.0 < whole.min() < whole.max() < 7.5
    assert 1.0 < np.abs(path.imag - path.imag[0]).max() < 12.0


def test_reflections_come_and_go_on_the_visible_outline_and_cover_it() -> None:
    lorry = car(40.0, 0.0, heading=90.0, size={"length": 12.0, "width": 2.5})
    exact = {"x": 0.0, "y": 0.0, "vx": 0.0, "vy": 0.0}
    scenario = scene([lorry], {"reflections": {"depth": 0.0}}, measurement={"noise": exact}, duration=60.0)
    found = [places(report) for report in reports(scenario)]
    counts = {len(each) for each in found}
    all_places = np.concatenate(found)
    assert min(counts) >= 1
    assert len(counts) >= 2
    assert np.abs(all_places.real - 38.75).max() < 0.3  # the side that faces us, or the mean of two
    assert all_places.imag.min() < -4.5
    assert all_places.imag.max() > 4.5
    slots = [tuple(report.slot.tolist()) for report in reports(scenario)]
    assert len(set(slots)) >= 5


def test_reflections_slide_and_a_new_one_has_its_own_slot() -> None:
    exact = {"x": 0.0, "y": 0.0, "vx": 0.0, "vy": 0.0}
    one = {"reflections": ONE | {"depth": 0.0}}
    path = paths(scene([car(30.0, 0.0)], one, measurement={"noise": exact}))[:, 0]
    step = np.abs(np.diff(path.imag))
    assert 0.05 < path.imag.std() < 0.6
    assert 0.001 < step.mean() < 0.2
    renewed = scene([car(30.0, 0.0)], {"reflections": ONE | {"renewal": 1.0}})
    new = sum(int(report.new.sum()) for report in reports(renewed))
    assert 8 < new < 40


def test_close_reflections_of_a_body_merge_and_part() -> None:
    def mean_count(merging: float) -> float:
        effects = {"reflections": {"fewest": 4, "most": 4, "merging": merging}}
        return float(np.mean([len(report.slot) for report in reports(scene([car(20.0, 0.0)], effects))]))

    assert mean_count(3.0) == 1.0
    assert 1.3 < mean_count(0.6) < mean_count(0.0)
    assert mean_count(0.0) == pytest.approx(1 + 3 * 2 / 3, abs=0.4)


def test_neighbours_swap_slots_in_silence() -> None:
    def changes(swaps: float) -> int:
        effects = {"swaps": swaps, "reflections": ONE}
        both = list(reports(scene([point(30.0, -1.0), point(30.0, 1.0)], effects)))
        assert not any(report.new.any() for report in both[1:])
        found = [dict(zip(report.slot.tolist(), report.owner.tolist(), strict=True)) for report in both]
        assert all(sorted(each) == [0, 1] for each in found)
        return sum(a != b for a, b in pairwise(found))

    assert changes(0.0) == 0
    assert 3 <= changes(0.5) <= 25


def test_the_radar_coasts_what_it_misses() -> None:
    def share(coasting: float) -> float:
        missed = {"detection_probability": 0.5}
        found = list(reports(scene([point(30.0, 0.0)], {"coasting": coasting}, measurement=missed)))
        return float(np.mean([len(report.slot) for report in found]))

    assert share(0.0) == pytest.approx(0.5, abs=0.1)
    assert share(1.0) > 0.8


def test_a_radar_that_tells_no_identity_coasts_nothing() -> None:
    missed = scene([point(30.0, 0.0)], {"coasting": 1.0}, measurement={"detection_probability": 0.5})
    sensor = bound("ars408").sensors[0].settings
    blind = sensor.model_copy(update={"objects": sensor.objects.model_copy(update={"identity": False})})

    def share(settings: SensorSettings) -> float:
        world = Scene(missed)
        reporter = SlotReporter(world, settings, missed, seed=1, source=0)
        return float(np.mean([len(reporter.report(each).slot) for each in world.states(np.arange(200.0) / 14)]))

    assert share(sensor) > 0.8
    assert share(blind) == pytest.approx(0.5, abs=0.15)


def test_a_sensor_that_tells_no_rates_coasts_nothing() -> None:
    """It has nothing to move an object on by, and does not repeat where that was."""
    missed = scene([point(30.0, 1.0)], {"coasting": 1.0, "swaps": 0.0}, measurement={"detection_probability": 0.5})
    lidar = next(each.settings for each in bound("radar_lidar").sensors if each.name == "lidar")
    reporter, world = SlotReporter(Scene(missed), lidar, missed, seed=1, source=0), Scene(missed)
    told = [len(reporter.report(each).slot) for each in world.states(np.arange(200.0) / 25)]
    assert float(np.mean(told)) == pytest.approx(0.5, abs=0.15)


def test_ghosts_move_with_what_they_are_of() -> None:
    cars = [car(20.0, 2.0, heading=0.0)]
    rail = {"rails": ({"begin": {"x": 0.0, "y": 6.0}, "end": {"x": 100.0, "y": 6.0}, "spacing": 90.0},)}
    quiet = {"noise": {"x": 0.01, "y": 0.01, "vx": 0.01, "vy": 0.01}}

    def ghosts(**kinds: float) -> np.ndarray[Any, np.dtype[np.complex128]]:
        effects = {"ghosts": {"double_bounce": 0.0, "mirrored": 0.0, "time": 2.0} | kinds, "reflections": ONE}
        found = reports(scene(cars, effects, measurement=quiet, stationary=rail))
        return np.concatenate([places(report)[report.owner < 0] for report in found])

    assert len(ghosts()) == 0
    double, mirrored = ghosts(double_bounce=0.5), ghosts(mirrored=0.5)
    assert 20 < len(double) < 270
    assert np.abs(double - MOUNT - 2 * (17.9 - MOUNT + 1j * 2)).max() < 4.0
    assert 20 < len(mirrored) < 270
    assert mirrored.imag == pytest.approx(10.0, abs=0.1)
    assert mirrored.real == pytest.approx(20.0, abs=0.1)


def test_sizes_are_reported_with_noise() -> None:
    found = []
    for report in reports(scene([car(30.0, 0.0)], {"reflections": ONE | {"renewal": 1.0}}, duration=60.0)):
        rows = dict(zip(report.quantities, report.values, strict=True))
        found.append((rows["length"][0], rows["width"][0]))
    sizes = np.array(found) / (4.5, 1.8)
    assert sizes.mean() == pytest.approx(1.0, abs=0.1)
    assert sizes.std() == pytest.approx(0.15, abs=0.05)


def test_bridges_drains_and_parked_cars_stand() -> None:
    stationary = {
        "bridges": ({"begin": {"x": 100.0, "y": -6.0}, "end": {"x": 100.0, "y": 6.0}},),
        "drains": ({"x": 90.0, "y": 1.0},),
        "parked": ({"begin": {"x": 60.0, "y": 5.0}, "end": {"x": 73.0, "y": 5.0}},),
    }
    ego = {"start": {"speed": 20.0}, "own_motion": {"noise": 0.0}}
    scenario = scene([], {}, stationary=stationary, ego=ego, duration=6.0)
    seen: dict[int, list[float]] = {}
    for report in reports(scenario):
        for owner, place in zip(report.owner.tolist(), places(report), strict=True):
            seen.setdefault(owner, []).append(float(abs(place - MOUNT)))
    parked, bridge, drain = range(9), range(9, 14), 14
    assert seen.keys() == {*parked, *bridge, drain}
    assert all(min(seen[k]) > 38 for k in bridge)
    assert max(seen[drain]) < 42
    assert len(seen[drain]) < 0.75 * len(seen[0])
    truth = next(simulate(scenario, bound("ars408")).truth()).columns
    assert set(truth["class"].tolist()) == {"standing"}


def frames_of(faults: dict[str, Any], **more: Any) -> list[int]:
    """Return the times of the radar's frames, ns, of a drive in which several things are seen."""
    scenario = scene(
        [point(30.0, 2.0 * k) for k in range(-3, 4)], None, frames={"faults": faults, "burst": 0.01} | more
    )
    binding = bound("esr_ins")
    bus = binding.sensors[0].bus
    return [frame.time_ns for frame in simulate(scenario, binding).frames() if frame.bus == bus]


QUIET = {"bursts": 0.0, "lost_scans": 0.0, "batch": 0.0}


def test_frames_are_lost_in_bursts_and_as_whole_scans() -> None:
    whole = len(frames_of(QUIET))
    assert whole == 400 * 64
    assert len(frames_of(QUIET | {"lost_scans": 0.1})) / whole == pytest.approx(0.9, abs=0.05)
    assert (whole - len(frames_of(QUIET | {"lost_scans": 0.1}))) % 64 == 0
    left = np.array(frames_of(QUIET | {"bursts": 1.0, "burst_time": 0.3, "burst_loss": 1.0}))
    gaps = np.diff(left) / 1e9
    assert 0.5 < len(left) / whole < 0.95
    assert np.count_nonzero(gaps > 0.1) >= 4
    assert gaps.max() > 0.2


def test_stamps_come_in_batches_and_late() -> None:
    times = np.array(frames_of(QUIET | {"batch": 0.01}))
    assert not (times % 10_000_000).any()
    plain, late = frames_of(QUIET), frames_of(QUIET, latency=0.1)
    assert (np.array(late) - np.array(plain) == 100_000_000).all()


def test_an_ins_is_off_jumps_and_falls_silent() -> None:
    faults = {"heading_bias_deg": 2.0, "step_interval": 3.0, "step": 5.0, "gap_interval": 4.0, "gap": 0.5}
    binding = bound("esr_ins")
    assert binding.ego is not None
    read: dict[bool, list[tuple[int, dict[str, float]]]] = {}
    for on in (False, True):
        own = {"noise": 0.0, "faults": faults if on else None}
        scenario = scene([], None, ego={"start": {"speed": 0.0, "heading_deg": 90.0}, "own_motion": own})
        read[on] = []
        for frame in simulate(scenario, binding).frames():
            message = binding.ego.messages.get(frame.can_id)
            if frame.bus == binding.ego.bus and message is not None:
                values = message.decode(frame.data)
                assert values is not None
                read[on].append((frame.time_ns, dict(zip(message.quantities, values, strict=True))))
    heading = [values["heading"] for _, values in read[True] if "heading" in values]
    assert np.degrees(heading) == pytest.approx(92.0, abs=0.05)
    latitude = np.array([values["latitude"] for _, values in read[True] if "latitude" in values]) * 6_371_000
    jumps = np.abs(np.diff(latitude)) > 0.3
    assert 2 <= np.count_nonzero(jumps) <= 15
    assert np.ptp([values["latitude"] for _, values in read[False] if "latitude" in values]) == 0.0
    gaps = np.diff([time_ns for time_ns, _ in read[True]]) / 1e9
    assert 1 <= np.count_nonzero(gaps > 0.1) <= 12


def test_the_same_seed_gives_the_same_traffic() -> None:
    scenario = scene([car(30.0, 0.0), car(40.0, 3.5)], {}, duration=2.0, measurement={"clutter": 1.0})
    first, again, other = (list(simulate(scenario, bound("esr_ins"), seed).frames()) for seed in (3, 3, 4))
    assert first == again
    assert first != other
