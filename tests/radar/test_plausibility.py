"""Values that cannot be true are refused and counted; whatever a real drive tells is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.binding.bind import bind
from candaemon.binding.bind_sensor import bind_sensor
from candaemon.binding.bound import BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.config.load import load_config
from candaemon.config.protection import MotionPlausibilitySettings, PlausibilitySettings
from candaemon.dbc.types import SignalSpec
from candaemon.ego.motion_plausibility import MotionFaults, MotionPlausibility
from candaemon.objects.signals import SignalBinding, dbc_range
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.plausibility import ObjectPlausibility
from candaemon.radar.scan import ScanCounts
from tests.support.bound import binding
from tests.support.builders import ns
from tests.support.effort import examples
from tests.support.paths import ROOT

CYCLE = 0.05


def signal(length: int = 8, **given: Any) -> SignalBinding:
    return SignalBinding("x", SignalSpec(name="S", start=0, length=length, **given), 1.0, 0.0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, None),
        ({"minimum": 0.0, "maximum": 0.0}, None),
        ({"minimum": 0.0, "maximum": 255.0}, None),
        ({"minimum": -10.0, "maximum": 300.0}, None),
        ({"minimum": 500.0, "maximum": 600.0}, None),
        ({"minimum": 0.0, "maximum": 100.0}, (-0.5, 100.5)),
        ({"minimum": 0.0, "maximum": 100.0, "scale": 0.5}, (-0.25, 100.25)),
        ({"minimum": -100.0, "maximum": 0.0, "scale": -1.0}, (-100.5, 0.5)),
    ],
)
def test_a_range_counts_where_it_excludes_something(given: dict[str, Any], expected: tuple[float, float]) -> None:
    assert dbc_range(signal(**given)) == expected


def test_a_range_is_that_of_the_quantity() -> None:
    bound = replace(signal(minimum=0.0, maximum=100.0), gain=-radians(1.0), bias=1.0)
    assert dbc_range(bound) == pytest.approx((1.0 - radians(100.5), 1.0 + radians(0.5)))


def judged(kind: str = "toyota_rav4", **settings: Any) -> tuple[ObjectPlausibility, ScanCounts, BoundSensor]:
    """Make what judges a sensor's objects, ranges left out unless asked for."""
    sensor = binding(kind).sensors[0]
    chosen = PlausibilitySettings.model_validate({"ranges": False} | settings)
    counts = ScanCounts()
    sensor = replace(sensor, settings=sensor.settings.model_copy(update={"plausibility": chosen}))
    return ObjectPlausibility(sensor, counts), counts, sensor


def refused(
    of: tuple[ObjectPlausibility, ScanCounts, BoundSensor],
    places: Sequence[float],
    *,
    new: Sequence[int] = (),
    slots: Sequence[int] = (),
) -> list[bool]:
    """Tell one object's places ahead, scan by scan; return in which scans it was refused."""
    plausibility, _, sensor = of
    found = []
    for k, place in enumerate(places):
        values = np.zeros((len(sensor.reader.quantities), 1))
        values[sensor.reader.quantities.index("x")] = place
        slot = np.array([slots[k] if slots else 4])
        kept = plausibility.keep(ns(CYCLE * k), slot, slot, np.array([k in new]), values)
        found.append(kept is not None)
        assert kept is None or not len(kept)
    return found


def test_an_outlier_is_refused_and_the_object_goes_on() -> None:
    of = judged()
    assert refused(of, [50, 49, 80, 47, 46]) == [False, False, True, False, False]
    assert of[1].impossible == 1


def test_an_object_reported_there_again_is_accepted() -> None:
    of = judged()
    assert refused(of, [50, 49, 80, 79, 78]) == [False, False, True, False, False]


def test_a_slot_that_says_it_is_new_may_be_anywhere() -> None:
    assert not any(refused(judged(), [50, 49, 80, 20], new=(2, 3)))


def test_another_slot_is_another_object() -> None:
    assert not any(refused(judged(), [50, 80, 20], slots=(3, 4, 5)))


def test_the_limit_is_a_speed() -> None:
    assert refused(judged(max_speed=40.0), [50, 51.9, 54.1]) == [False, False, True]
    assert not any(refused(judged(max_speed=None), [50, 10, 150]))


def test_a_sensor_that_tells_neither_identity_nor_novelty_is_not_watched() -> None:
    _, counts, sensor = judged()
    silent = {"objects": sensor.settings.objects.model_copy(update={"new": ()})}
    settings = sensor.settings.model_copy(update=silent)
    sensor = bind_sensor(settings, sensor.index, sensor.name, sensor.bus, sensor.database, SettingLocation())
    assert not any(refused((ObjectPlausibility(sensor, counts), counts, sensor), [50, 49, 80, 20]))


@settings(deadline=None, max_examples=examples(50))
@given(st.data())
def test_plausible_motion_is_never_rejected(data: st.DataObject) -> None:
    """In any mix of slots, polar or not."""
    kind = data.draw(st.sampled_from(["toyota_rav4", "esr_ins"]))
    plausibility, counts, sensor = judged(kind)
    quantities = sensor.reader.quantities
    first = quantities.index("range" if "range" in quantities else "x")
    speed = data.draw(st.floats(-150, 150))
    for k in range(6):
        slots = np.array(sorted(data.draw(st.sets(st.integers(0, 9), max_size=10))), np.int64)
        values = np.zeros((len(quantities), len(slots)))
        values[first] = 100 + 10 * slots + speed * CYCLE * k
        assert plausibility.keep(ns(CYCLE * k), slots, slots, np.zeros(len(slots), np.bool_), values) is None
    assert counts.impossible == 0


def test_values_outside_the_range_are_refused() -> None:
    """The RAV4's score goes up to 100 % by its DBC, its bits to 127 %; its message is optional."""
    plausibility, counts, sensor = judged(ranges=True)
    values = np.zeros((len(sensor.reader.quantities), 4))
    values[sensor.reader.quantities.index("score")] = [0.5, 1.01, 1.0, np.nan]
    slot = np.arange(4)
    kept = plausibility.keep(0, slot, slot, np.ones(4, np.bool_), values)
    assert kept is not None
    assert kept.tolist() == [0, 2, 3]
    assert counts.out_of_range == 1


def motion(**given: Any) -> tuple[MotionPlausibility, MotionFaults]:
    """Make what judges the velocities of the INS."""
    ego = binding("toyota_rav4_ins").ego
    assert ego is not None
    own = next(each for each in ego.messages.values() if "velocity_north" in each.quantities)
    faults = MotionFaults()
    return MotionPlausibility(own, MotionPlausibilitySettings.model_validate(given), faults), faults


def test_own_speed_does_not_jump() -> None:
    of, faults = motion(max_acceleration=50.0)
    told = [20.0, 20.1, 60.0, 20.2, 60.0, 60.0, 60.0]
    used = [of.admits(ns(0.05 * k), [north, 0.0]) for k, north in enumerate(told)]
    assert used == [True, True, False, True, False, True, True]
    assert faults == MotionFaults(impossible=2)


def test_own_motion_is_a_finite_number() -> None:
    of, faults = motion()
    assert not of.admits(0, [float("nan"), 0.0])
    assert not of.admits(1, [float("inf"), 0.0])
    assert of.admits(2, [1.0, 0.0])
    assert (faults.not_finite, faults.out_of_range, faults.refused) == (1, 1, 2)


@pytest.mark.slow
def test_a_real_drive_loses_nothing_to_every_check(drive: Path, tmp_path: Path) -> None:
    """Counter, rate, time-out, ranges and jumps at 70 m/s; of 38,400 radar frames each one is used."""
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    plain = "kind: toyota}"
    strict = "kind: toyota, max_step: 1, timeout: 0.2, max_rate: 1.5, max_failed: 0}\n    plausibility: {max_speed: 70}"
    path = tmp_path / "strict.yaml"
    path.write_text(text.replace(plain, strict))
    bound = bind(load_config(path))
    pipeline = Pipeline(bound)
    channels = {bus.settings.channel: bus.index for bus in bound.buses}
    frames = read_log(drive / "drive_with_ins.log.gz", channels, LogCounts())
    cycles = sum(1 for _ in pipeline.run(frames))
    (assembler,) = pipeline.assemblers
    assert assembler.counts == ScanCounts(used=38_400, scans=1200)
    assert pipeline.counts.ego_motion == MotionFaults()
    assert cycles == 1200
    assert assembler.valid_share == 1.0
