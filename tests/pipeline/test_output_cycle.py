"""Obstacles of several sensors go out every so often, with all that was used since."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from candaemon.config.settings import Config
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.output_cycle import OutputCycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import Obstacles, no_obstacles
from tests.support.bound import binding
from tests.support.builders import ns

SECONDS = 1.5


def configured(cycle_time: float | None) -> Config:
    config = binding("surround").settings
    assert config.output is not None
    return config.model_copy(update={"output": config.output.model_copy(update={"cycle_time": cycle_time})})


def used_by(sensor: int, *identities: int) -> Obstacles:
    """Return the obstacles 7 and 3, in this order, of which a sensor has detected some."""
    rows = np.array([(7, 3).index(each) for each in identities], dtype=np.int64)
    sensors, objects = np.full(len(rows), sensor), np.full(len(rows), 40)
    return replace(no_obstacles(0), id=np.array([7, 3]), used_row=rows, used_sensor=sensors, used_object=objects)


def outputs(of: OutputCycle, times: list[float]) -> list[float]:
    return [time for time in times if of.reported(no_obstacles(0), ns(time)) is not None]


def test_the_default_is_each_scan_of_one_sensor_and_twenty_a_second_of_several() -> None:
    assert binding("demo").settings.output_cycle_time == 0.0
    assert configured(None).output_cycle_time == 0.05
    assert configured(0.2).output_cycle_time == 0.2


def test_each_scan_is_an_output_where_that_is_asked_for() -> None:
    each = OutputCycle(configured(0.0))
    found = used_by(0, 7)
    assert each.reported(found, 5) is found
    assert each.reported(found, 6) is found


def test_the_raster_stays_even_whatever_the_jitter_of_the_scans() -> None:
    random = np.random.default_rng(1)
    times = (100.0 + np.sort(np.arange(0, 10, 0.05) + random.normal(0, 0.004, 200))).tolist()
    assert len(outputs(OutputCycle(configured(0.1)), times)) == pytest.approx(100, abs=1)
    single = configured(0.05)
    single = single.model_copy(update={"sensors": {"front_left": single.sensors["front_left"]}})
    assert outputs(OutputCycle(single), times) == times


def test_after_a_pause_the_raster_begins_anew() -> None:
    of = OutputCycle(configured(0.05))
    assert outputs(of, [1.0, 1.02, 1.05, 3.0, 3.02, 3.049, 3.051]) == [1.0, 1.05, 3.0, 3.049]


def test_a_time_far_ahead_does_not_silence_the_output() -> None:
    of = OutputCycle(configured(0.05))
    of.state.due_ns = 1 << 60
    assert outputs(of, [1.0, 1.02]) == [1.0]


def test_an_output_has_the_detections_since_the_one_before() -> None:
    of = OutputCycle(configured(0.05))
    assert of.reported(used_by(0, 7), ns(1.0)) is not None
    assert of.reported(used_by(1, 7, 3), ns(1.01)) is None
    gone = replace(used_by(2, 7), id=np.array([7, 5]))
    assert of.reported(gone, ns(1.02)) is None
    last = of.reported(used_by(3, 3), ns(1.05))
    assert last is not None
    assert sorted(zip(last.id[last.used_row].tolist(), last.used_sensor.tolist(), strict=True)) == [
        (3, 1), (3, 3), (7, 1), (7, 2),
    ]  # fmt: skip
    again = of.reported(used_by(4, 7), ns(1.1))
    assert again is not None
    assert again.used_sensor.tolist() == [4]


def test_detections_of_obstacles_that_are_gone_are_left_out() -> None:
    of = OutputCycle(configured(0.05))
    of.reported(no_obstacles(0), ns(1.0))
    assert of.reported(used_by(1, 7), ns(1.01)) is None
    last = of.reported(no_obstacles(0), ns(1.05))
    assert last is not None
    assert len(last.used_row) == 0


def test_a_state_with_unequal_columns_is_refused() -> None:
    state = OutputCycle(configured(0.05)).state
    state.identity = np.array([1])
    with pytest.raises(ValueError, match="one row each"):
        state.validate()


@cache
def surrounded() -> tuple[Cycle, ...]:
    """Return the cycles of twelve radars, one vehicle ahead and one beside."""
    actors = (
        {"name": "ahead", "start": {"x": 15.0, "y": 0.0, "speed": 10.0}},
        {"name": "beside", "start": {"x": 3.0, "y": 4.0, "speed": 10.0}},
    )
    told = {"duration": SECONDS, "ego": {"start": {"speed": 10.0}}, "actors": actors}
    of = binding("surround")
    return tuple(Pipeline(of).run(simulate(Scenario.model_validate(told), of).frames()))


def reported() -> Iterator[Cycle]:
    return (cycle for cycle in surrounded() if cycle.reported is not None)


def test_twelve_radars_send_twenty_outputs_a_second() -> None:
    times = np.array([cycle.time_ns for cycle in reported()]) * 1e-9
    assert len(surrounded()) > 11 * SECONDS / 0.05
    assert len(times) == pytest.approx(SECONDS / 0.05, abs=1)
    assert np.abs(np.diff(times) - 0.05).max() < 0.01
    assert all(not cycle.frames for cycle in surrounded() if cycle.reported is None)
    last = list(reported())[-1]
    assert last.reported is not None
    assert last.frames
    assert len(set(last.reported.used_sensor.tolist())) > 3  # of one scan it would be one


def test_twelve_radars_leave_room_on_the_bus() -> None:
    of = binding("surround")
    assert of.output is not None
    assert of.output.writer.slots == 32
    assert of.settings.buses["obstacles"].bitrate == 1_000_000
    assert of.buses[of.output.bus].output_load <= 0.6
    assert not of.warnings
