"""Frames in, obstacles and frames out: silence, gaps, noise on the bus, and the same again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import chain
from operator import itemgetter

import cantools
import numpy as np
import pytest

from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoStatus
from candaemon.frames.frame import EXTENDED, Frame, Tick
from candaemon.frames.frame_block import block_of
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.pipeline_state import Schedule
from candaemon.radar.assembly import BUNCH
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.simulate import simulate
from candaemon.tracking.obstacles import COASTING, CONFIRMED
from tests.support.bound import binding
from tests.support.builders import assert_sane, ns
from tests.support.paths import ROOT

CONFIGS = ("toyota_rav4", "toyota_rav4_ins", "demo", "esr_ins", "gm_lrr", "tesla_continental", "ars408")
CYCLE_NS = 50_000_000


@cache
def simulated(config: str, scenario: str, duration: float, loss: float) -> tuple[Frame, ...]:
    told = load_scenario(ROOT / "config" / "scenarios" / f"{scenario}.yaml").model_dump()
    told["duration"] = duration
    told["frames"]["loss"] = loss
    return tuple(simulate(Scenario.model_validate(told), binding(config)).frames())


def drive(config: str, scenario: str = "highway", duration: float = 6.0, *, loss: float = 0.0) -> list[Frame]:
    """Return the frames of a scenario's beginning."""
    return list(simulated(config, scenario, duration, loss))


def without_output(config: str) -> Pipeline:
    return Pipeline(replace(binding(config), output=None))


def essence(cycles: Iterable[Cycle]) -> list[tuple[object, ...]]:
    """Return what must be the same when the same is run again."""
    return [
        (
            cycle.time_ns,
            cycle.obstacles.time_ns,
            cycle.obstacles.id.tobytes(),
            cycle.obstacles.state.tobytes(),
            cycle.obstacles.x.tobytes(),
            cycle.obstacles.vy.tobytes(),
            cycle.obstacles.sx.tobytes(),
            tuple(cycle.frames),
        )
        for cycle in cycles
    ]


@cache
def status_message() -> cantools.database.can.Message:
    """Return the status message as cantools has it; its parser takes longer than most of the tests here."""
    database = cantools.database.load_file(ROOT / "dbc" / "obstacles.dbc")
    assert isinstance(database, cantools.database.can.Database)
    return database.get_message_by_name("OBSTACLE_STATUS")


def status(cycle: Cycle) -> dict[str, int]:
    """Decode a cycle's status message with cantools."""
    message = status_message()
    (data,) = (frame.data for frame in cycle.frames if frame.can_id & ~EXTENDED == message.frame_id)
    decoded = message.decode_simple(data, decode_choices=False)
    return {name: int(decoded[name]) for name in ("Occupied", "Ego", "Health", "Drops")}  # type: ignore[arg-type]  # plain numbers without choices


def ticks(first_ns: int, last_ns: int, step_ns: int = 10_000_000) -> Iterator[Tick]:
    return (Tick(time_ns) for time_ns in range(first_ns, last_ns, step_ns))


@pytest.mark.parametrize("config", CONFIGS)
def test_a_drive_gives_a_cycle_a_scan_and_finds_the_lead(config: str) -> None:
    pipeline = Pipeline(binding(config))
    cycles = list(pipeline.run(drive(config)))
    cycle_time = binding(config).sensors[0].settings.cycle_time
    assert len(cycles) == pytest.approx(6.0 / cycle_time, abs=3)
    assert pipeline.counts.cycles == len(cycles)
    assert pipeline.counts.coasting_cycles == pipeline.counts.without_ego == 0
    assert pipeline.counts.sent == sum(len(cycle.frames) for cycle in cycles)
    for cycle in cycles:
        assert_sane(cycle.obstacles)
        assert cycle.obstacles.time_ns <= cycle.time_ns
        assert cycle.pose.time_ns == cycle.obstacles.time_ns
        assert cycle.pose.status in {EgoStatus.VALID, EgoStatus.INITIALISING}
    told = cycles[-1].obstacles
    ahead = (told.state == CONFIRMED) & (np.abs(told.y) < 1.5) & (np.abs(told.x - 60) < 6)
    assert ahead.sum() == 1
    assert told.vx[ahead][0] == pytest.approx(30.0, abs=0.5)
    assert (status(cycles[-1])["Ego"], status(cycles[-1])["Health"], status(cycles[-1])["Drops"]) == (2, 0, 0)


def test_the_same_frames_give_the_same_again() -> None:
    frames = drive("toyota_rav4", loss=0.02)
    first = essence(Pipeline(binding("toyota_rav4")).run(frames))
    assert first == essence(Pipeline(binding("toyota_rav4")).run(iter(frames)))
    assert len(first) > 100


def test_what_lies_at_the_end_of_its_signal_is_no_vehicle_and_is_counted() -> None:
    """A lateral place that ends at 32 m told each post farther aside as an obstacle that drives along that edge."""
    beside = {"name": "beside", "start": {"x": 105, "y": 36, "speed": 20}}
    scenario = {"duration": 2, "ego": {"start": {"speed": 20}}, "actors": [beside], "measurement": {}}
    vehicles = binding("acura_ilx")
    imm = TrackerSettings.model_validate({"estimator": {"kind": "imm"}})
    config = vehicles.settings.model_copy(update={"tracker": imm})
    points = replace(vehicles, loaded=replace(vehicles.loaded, config=config))
    frames = list(simulate(Scenario.model_validate(scenario), vehicles).frames())
    tracked, as_points = Pipeline(vehicles), Pipeline(points)
    assert not any((np.abs(cycle.obstacles.y - 32) < 0.5).any() for cycle in tracked.run(frames))
    assert tracked.assemblers[0].counts.at_end >= 36
    assert all((np.abs(cycle.obstacles.y - 32) < 0.5).any() for cycle in list(as_points.run(frames))[10:])
    assert as_points.assemblers[0].counts.at_end == 0


@pytest.mark.parametrize("config", ["toyota_rav4", "demo", "ars408", "tesla_continental"])
def test_ticks_between_frames_change_nothing(config: str) -> None:
    """What the service does with a tick, a log without ticks does by its next frame."""
    frames = drive(config, loss=0.05)
    plain = essence(Pipeline(binding(config)).run(frames))
    last_ns = frames[-1].time_ns
    ticking = ticks(frames[0].time_ns, last_ns, 1_700_000)
    dense: list[Frame | Tick] = sorted([*frames, *ticking], key=itemgetter(0))
    assert essence(Pipeline(binding(config)).run(dense)) == plain


def on_wire(frames: Iterable[Frame], gap_ns: int) -> Iterator[Frame]:
    """Yield frames no closer on a bus than it can carry them."""
    free_ns: dict[int, int] = {}
    for frame in frames:
        time_ns = max(frame.time_ns, free_ns.get(frame.bus, 0))
        free_ns[frame.bus] = time_ns + gap_ns
        yield frame._replace(time_ns=time_ns)


@pytest.mark.parametrize("config", CONFIGS)
def test_no_cycle_comes_while_frames_may_wait_and_most_of_the_time_they_may(config: str) -> None:
    """The shortest frame of all these radars has 8 bytes: 111 bits without stuff bits, at 500 kbit/s."""
    pipeline, quiet_ns, cycles, waits = without_output(config), 0, 0, []
    for frame in sorted(on_wire(drive(config), 222_000), key=itemgetter(0)):
        come = len(list(pipeline.run([frame])))
        assert not come or frame.time_ns >= quiet_ns
        cycles += come
        quiet_ns = pipeline.quiet_until_ns(frame.time_ns)
        waits.append(quiet_ns - frame.time_ns)
    assert cycles > 50
    assert max(waits) > 1_000_000


def test_a_scan_that_lacks_frames_is_awaited_for_as_long_as_all_but_a_bunch_take() -> None:
    pipeline = without_output("esr_ins")
    radar = [frame for frame in drive("esr_ins") if frame.bus == 0]
    list(pipeline.run(radar[:64]))
    for lacking in (60, 2, 1):
        list(pipeline.run(radar[64 : 128 - lacking]))
        now_ns = radar[127 - lacking].time_ns
        expected = max(now_ns + (lacking - BUNCH) * 222_000, radar[0].time_ns + CYCLE_NS // 2)
        assert pipeline.quiet_until_ns(now_ns) == expected
        pipeline = without_output("esr_ins")
        list(pipeline.run(radar[:64]))


def test_finishing_closes_the_open_scan() -> None:
    frames = [frame for frame in drive("toyota_rav4") if frame.time_ns]
    radar = binding("toyota_rav4").sensors[0].bus
    last = max(k for k, frame in enumerate(frames) if frame.bus == radar)
    pipeline = Pipeline(binding("toyota_rav4"))
    before = len(list(pipeline.run(frames[: last - 3])))
    assert len(list(pipeline.finish())) == 1
    assert len(list(pipeline.finish())) == 0
    assert pipeline.counts.cycles == before + 1


def test_a_silent_sensor_coasts_and_ends() -> None:
    frames = drive("toyota_rav4")
    radar, start_ns = binding("toyota_rav4").sensors[0].bus, frames[0].time_ns
    silence_ns = start_ns + ns(4.0)
    heard = [frame for frame in frames if frame.bus != radar or frame.time_ns < silence_ns]
    pipeline = Pipeline(binding("toyota_rav4"))
    cycles = [cycle for cycle in pipeline.run(heard) if cycle.time_ns >= silence_ns + CYCLE_NS]
    assert all(cycle.detections is None for cycle in cycles)
    assert np.abs(np.diff([cycle.time_ns for cycle in cycles]) - CYCLE_NS).max() == 0
    expected = (heard[-1].time_ns - silence_ns) / CYCLE_NS
    assert pipeline.counts.coasting_cycles == len(cycles) == pytest.approx(expected, abs=3)
    before = {identity for cycle in cycles[:1] for identity in cycle.obstacles.id.tolist()}
    assert len(before) >= 2
    for cycle in cycles:
        assert_sane(cycle.obstacles)
        assert set(cycle.obstacles.id.tolist()) <= before
        told = cycle.obstacles
        assert (told.state[told.age > 1.0] == COASTING).all()
    assert len(cycles[10].obstacles) >= 2
    assert len(cycles[-1].obstacles) == 0
    assert status(cycles[-1])["Health"] == 3
    assert status(cycles[-1])["Occupied"] == 0


def test_a_lost_scan_leaves_a_cycle_between_its_neighbours() -> None:
    """What coasts is as far behind the clock as what is measured, so that no scan comes later than it."""
    frames = drive("toyota_rav4")
    radar, lost_ns = binding("toyota_rav4").sensors[0].bus, frames[0].time_ns + ns(4.0)
    heard = [frame for frame in frames if frame.bus != radar or not lost_ns <= frame.time_ns < lost_ns + CYCLE_NS]
    cycles = list(Pipeline(binding("toyota_rav4")).run(heard))
    (k,) = [k for k, cycle in enumerate(cycles) if cycle.detections is None]
    before, between, after = (cycle.obstacles.time_ns for cycle in cycles[k - 1 : k + 2])
    assert between - before == pytest.approx(1.5 * CYCLE_NS, abs=1)
    assert after - before == pytest.approx(2.0 * CYCLE_NS, abs=0.2 * CYCLE_NS)
    assert before < between < after


def test_a_late_scan_does_not_turn_back_the_time_of_what_coasts() -> None:
    schedule = Schedule()
    schedule.track(ns(10.0), ns(10.02))
    assert schedule.lag_ns == ns(0.02)
    schedule.track(ns(9.9), ns(10.05))
    assert schedule.lag_ns == ns(0.05)
    schedule.track(ns(3.0), ns(3.02))  # the clock was set back
    assert schedule.lag_ns == ns(0.02)


def test_a_silent_ins_is_dead_reckoned_and_tracks_go_on() -> None:
    bound = binding("toyota_rav4_ins")
    assert bound.ego is not None
    frames = drive("toyota_rav4_ins")
    silence_ns = frames[0].time_ns + ns(3.0)
    heard = [frame for frame in frames if frame.bus != bound.ego.bus or frame.time_ns < silence_ns]
    cycles = list(Pipeline(bound).run(heard))
    late = [cycle for cycle in cycles if cycle.obstacles.time_ns > silence_ns + ns(bound.ego.settings.age_limit)]
    assert len(late) > 40
    assert {cycle.pose.status for cycle in late} == {EgoStatus.DEAD_RECKONING}
    assert {(status(cycle)["Ego"], status(cycle)["Health"]) for cycle in late[::10]} == {(1, 1)}
    early = next(cycle for cycle in cycles if cycle.time_ns > silence_ns)
    lead = {
        identity
        for identity, x, y in zip(early.obstacles.id.tolist(), early.obstacles.x, early.obstacles.y, strict=True)
        if abs(y) < 1.5 and abs(x - 60) < 6
    }
    assert len(lead) == 1
    told = late[-1].obstacles
    row = told.id.tolist().index(lead.pop())
    assert told.state[row] == CONFIRMED
    assert told.vx[row] == pytest.approx(30.0, abs=1.0)


def test_before_own_motion_is_known_scans_are_counted() -> None:
    bound = binding("toyota_rav4")
    radar = [frame for frame in drive("toyota_rav4", duration=1.0) if frame.bus == bound.sensors[0].bus]
    pipeline = Pipeline(bound)
    cycles = list(chain(pipeline.run(radar), pipeline.finish()))
    assert pipeline.counts.without_ego == len(cycles) == pytest.approx(20, abs=1)
    assert [len(cycle.obstacles) for cycle in cycles] == [0] * len(cycles)
    assert {status(cycle)["Ego"] for cycle in cycles} == {EgoStatus.LOST}


def test_the_status_is_told_though_no_sensor_ever_speaks() -> None:
    pipeline = Pipeline(binding("toyota_rav4"))
    cycles = list(pipeline.run(Tick(ns(1.7e9 + 0.01 * k)) for k in range(300)))
    assert len(cycles) == pytest.approx(40, abs=2)
    assert {(status(cycle)["Ego"], status(cycle)["Health"]) for cycle in cycles} == {(0, 3)}


def test_a_lost_ins_frame_costs_one_sample_and_turns_nothing() -> None:
    bound = binding("toyota_rav4_ins")
    assert bound.ego is not None
    own = [frame for frame in drive("toyota_rav4_ins", "turning_ego") if frame.bus == bound.ego.bus]
    velocities = [frame for frame in own if frame.can_id == 0x603]
    whole, lossy = Pipeline(bound), Pipeline(bound)
    for pipeline, frames in ((whole, own), (lossy, [frame for frame in own if frame is not velocities[20]])):
        assert all(len(cycle.obstacles) == 0 for cycle in pipeline.run(frames))
    assert abs(whole.ego.known_until_ns - velocities[-1].time_ns) < CYCLE_NS
    for k in range(30, len(velocities) - 1):
        expected, found = whole.ego.pose(velocities[k].time_ns), lossy.ego.pose(velocities[k].time_ns)
        assert expected is not None
        assert found is not None
        assert (found.heading, found.ve, found.vn) == (expected.heading, expected.ve, expected.vn)


def test_every_frame_is_counted_somewhere() -> None:
    bound = binding("toyota_rav4")
    assert bound.ego is not None
    frames = drive("toyota_rav4", duration=2.0)
    radar, car = bound.sensors[0].bus, bound.ego.bus
    spare = next(iter(bound.ego.database.by_id.keys() - bound.ego.messages.keys()))
    foreign, own = 0x7A5 | EXTENDED, next(iter(bound.ego.messages))
    now = frames[-1].time_ns
    noise = [
        *(Frame(now, radar, foreign, bytes(8)) for _ in range(3)),
        *(Frame(now, car, spare, bytes(8)) for _ in range(5)),
        *(Frame(now, car, spare, b"") for _ in range(4)),
        *(Frame(now, car, own, b"\x01") for _ in range(7)),
        *(Frame(now, -1, own, bytes(8)) for _ in range(2)),
    ]
    pipeline = Pipeline(bound)
    list(chain(pipeline.run([*frames, *noise]), pipeline.finish()))
    assert (pipeline.counts.buses[radar].unknown, pipeline.counts.buses[car].unknown) == (3, 0)
    assert pipeline.counts.buses[car].spare == 5 + 4
    assert (pipeline.counts.buses[car].spare_short, pipeline.counts.buses[car].short) == (4, 7)
    for bus in (radar, car):
        assert pipeline.counts.buses[bus].frames == sum(frame.bus == bus for frame in [*frames, *noise])
    assert pipeline.assemblers[0].counts.frames == pipeline.counts.buses[radar].used
    assert pipeline.drops == 7


def test_fd_frames_of_a_bus_without_fd_are_counted_one_by_one_and_in_blocks() -> None:
    bound = binding("toyota_rav4")
    frames = drive("toyota_rav4", duration=1.0)
    odd = [frame._replace(fd=k % 3 == 0) for k, frame in enumerate(frames)]
    expected = [sum(frame.fd for frame in odd if frame.bus == bus.index) for bus in bound.buses]
    one_by_one, in_blocks = Pipeline(bound), Pipeline(bound)
    list(one_by_one.run(odd))
    list(in_blocks.run_blocks([block_of(odd)]))
    assert sum(expected) == -(-len(frames) // 3)
    for pipeline in (one_by_one, in_blocks):
        assert [each.fd_unset for each in pipeline.counts.buses] == expected


@pytest.mark.parametrize("gap", [3600.0, 86_400.0, 30 * 86_400.0])
@pytest.mark.parametrize("ends_with", ["tick", "frames"])
def test_a_long_gap_is_bounded(gap: float, ends_with: str) -> None:
    frames = drive("toyota_rav4", duration=2.0)
    pipeline = Pipeline(binding("toyota_rav4"))
    list(pipeline.run(frames))
    cycles_before, later = pipeline.counts.cycles, frames[-1].time_ns + ns(gap)
    if ends_with == "tick":
        cycles = list(pipeline.run([Tick(later)]))
    else:
        shift = later - frames[0].time_ns
        cycles = list(pipeline.run(frame._replace(time_ns=frame.time_ns + shift) for frame in frames))
        told = cycles[-1].obstacles
        assert (told.state == CONFIRMED).sum() >= 2
        assert np.abs(told.x).max() < 300
    assert len(cycles) < 400
    assert pipeline.counts.cycles == cycles_before + len(cycles)
    for cycle in cycles:
        assert_sane(cycle.obstacles)


def test_a_clock_that_steps_back_breaks_nothing() -> None:
    frames = drive("toyota_rav4", duration=3.0)
    pipeline = Pipeline(binding("toyota_rav4"))
    list(pipeline.run(frames))
    stepped = [frame._replace(time_ns=frame.time_ns - ns(60.0)) for frame in frames]
    for cycle in pipeline.run(stepped):
        assert_sane(cycle.obstacles)
