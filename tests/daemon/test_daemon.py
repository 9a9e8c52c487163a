"""The service on live buses: virtual ones, fed with a simulated drive."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from threading import Thread

import can
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.python_can import to_frame, to_message
from candaemon.cli.demo import DemoDrive
from candaemon.config.load import load_config
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.errors import ConfigError
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.tables import TRACK_COLUMNS, TRUTH_COLUMNS, TrackWriter
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame
from candaemon.output.decoder import DecodedCycle, OutputDecoder
from candaemon.pipeline.cycle import Cycle
from candaemon.simulation.drive_files import write_truth
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import Simulation, simulate
from candaemon.tracking.obstacles import COASTING
from tests.support.paths import ROOT

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def binding() -> Binding:
    return bind(load_config(ROOT / "config" / "demo.yaml"))


def drive(binding: Binding, seconds: float, seed: int = 5) -> Simulation:
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    return simulate(scenario.model_copy(update={"duration": seconds}), binding, seed)


@pytest.fixture
def sides(binding: Binding) -> Iterator[list[can.BusABC]]:
    """Yield the other side of each virtual bus."""
    with ExitStack() as closing:
        yield [
            closing.enter_context(
                can.Bus(channel=bus.settings.channel, interface="virtual", preserve_timestamps=True, ignore_config=True)
            )
            for bus in binding.buses
        ]


def heard(side: can.BusABC) -> list[Frame]:
    frames = []
    while (message := side.recv(0)) is not None:
        frames.append(to_frame(message, 0))
    return frames


class Cycles(Observer):
    """Keeps what is told."""

    def __init__(self, cycles: list[Cycle]) -> None:
        self.cycles = cycles
        self.latencies: list[float] = []

    def on_cycle(self, completed: CompletedCycle) -> None:
        self.cycles.append(completed.cycle)
        self.latencies.append(completed.latency)


class Fed:
    """A daemon that is stepped by hand, with the drive's own clock."""

    def __init__(self, binding: Binding, sides: list[can.BusABC], *, shadow: bool = False) -> None:
        self.now_ns = 0
        self.cycles: list[Cycle] = []
        self.sides = sides
        self.sent = 0
        self.kept = Cycles(self.cycles)
        self.daemon = Daemon(binding, clock=lambda: self.now_ns, observers=[self.kept], shadow=shadow)

    def feed(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.sides[frame.bus].send(to_message(frame))
            self.now_ns = frame.time_ns
            self.sent += 1
            while self.daemon.received < self.sent:
                self.daemon.step(5.0)

    def silence(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.now_ns += SECOND_NS // 100
            self.daemon.step(0.0)


def test_a_drive_through_the_buses_meets_its_truth(binding: Binding, tmp_path: Path) -> None:
    simulation = drive(binding, 5.0)
    with OutputFile(tmp_path / "tracks.csv") as file, TrackWriter(file, TRACK_COLUMNS) as table:
        told = list(DemoDrive(binding, simulation))
        for cycle in told:
            table.write_cycle(cycle.time_ns, cycle.columns())
    with OutputFile(tmp_path / "truth.csv") as file, TrackWriter(file, TRUTH_COLUMNS) as table:
        write_truth(simulation, table)
    judged = evaluate(tmp_path / "tracks.csv", tmp_path / "truth.csv")
    assert [cycle.number for cycle in told] == list(range(100))
    assert judged.time_to_confirm.unconfirmed == 0
    assert judged.id_switches == 0
    assert judged.errors.position < 0.5
    assert judged.errors.velocity < 0.8


def test_a_drive_needs_virtual_buses() -> None:
    other = bind(load_config(ROOT / "config" / "esr_ins.yaml"))
    with pytest.raises(ConfigError, match="virtual"):
        DemoDrive(other, drive(other, 1.0))


def test_a_shadow_tracks_the_same_and_sends_nothing(binding: Binding, sides: list[can.BusABC]) -> None:
    frames = list(drive(binding, 1.0).frames())
    cycles = []
    for shadow in (False, True):
        fed = Fed(binding, sides, shadow=shadow)
        with fed.daemon:
            fed.feed(frames)
            assert sum(bus.counts.sent for bus in fed.daemon.buses) == 0 if shadow else True
        cycles.append(fed.cycles)
        for side in sides:
            while side.recv(0) is not None:
                assert not shadow
    assert [list(cycle.frames) for cycle in cycles[0]] == [list(cycle.frames) for cycle in cycles[1]]
    assert sum(len(cycle.frames) for cycle in cycles[1]) > 10


def test_the_last_frame_of_a_scan_brings_the_obstacles_at_once(binding: Binding, sides: list[can.BusABC]) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        fed.feed(list(drive(binding, 1.0).frames()))
    receiver = OutputDecoder(binding.output) if binding.output is not None else None
    assert receiver is not None
    wire = [cycle for frame in heard(sides[2]) for cycle in receiver.push(frame.can_id, frame.data)]
    assert len(fed.cycles) == 20
    assert isinstance(wire[-1], DecodedCycle)
    assert {int(each) for each in wire[-1].quantities["id"]} <= {int(each) for each in fed.cycles[-1].obstacles.id}
    assert len(wire[-1].quantities["id"]) >= 3
    # Told when the scan is complete, not a cycle or a time-out later.
    delays = [cycle.time_ns - cycle.obstacles.time_ns for cycle in fed.cycles]
    assert max(delays) <= 0.03 * SECOND_NS
    assert fed.daemon.pipeline.drops == 0


def test_frames_that_cannot_complete_a_scan_are_read_together(
    binding: Binding, sides: list[can.BusABC], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scan of the demo's has 64 frames: of its first 60 none wakes the daemon, and its last one does at once."""
    fed = Fed(binding, sides)
    simulated_frames = list(drive(binding, 0.5).frames())
    last = max(k for k, frame in enumerate(simulated_frames) if frame.bus == 0)
    with fed.daemon:
        fed.feed(simulated_frames[: last - 63])
        counted, read = [0], fed.daemon.buses.read

        def reading(timeout_s: float, coalescing_s: float = 0.0) -> list[Frame]:
            counted[0] += 1
            return read(timeout_s, coalescing_s)

        monkeypatch.setattr(fed.daemon.buses, "read", reading)

        def send() -> None:
            for frame in simulated_frames[last - 63 : last + 1]:
                sides[frame.bus].send(to_message(frame))
                time.sleep(222e-6)

        sender = Thread(target=send)
        cycles = len(fed.cycles)
        sender.start()
        while len(fed.cycles) == cycles:
            fed.daemon.step(1.0, 0.01)
        sender.join()
    assert counted[0] < 20
    assert fed.daemon.received == last + 1


def test_silence_lets_obstacles_coast_and_then_go(binding: Binding, sides: list[can.BusABC]) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        fed.feed(list(drive(binding, 1.0).frames()))
        before = len(fed.cycles)
        fed.silence(0.5)
        assert len(fed.cycles) > before
        assert (fed.cycles[-1].obstacles.state == COASTING).any()
        fed.silence(2.0)
        assert not len(fed.cycles[-1].obstacles)
    assert fed.daemon.pipeline.counts.coasting_cycles > 20


def test_a_step_of_the_clock_is_counted_not_obeyed(binding: Binding, sides: list[can.BusABC]) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        frames = list(drive(binding, 2.0).frames())
        middle = len(frames) // 2
        fed.feed(frames[:middle])
        identities = set(fed.cycles[-1].obstacles.id.tolist())
        fed.feed([frame._replace(time_ns=frame.time_ns - 3600 * SECOND_NS) for frame in frames[middle:]])
    assert fed.daemon.sequence.backward_steps == 1
    assert identities & set(fed.cycles[-1].obstacles.id.tolist())
    times = [cycle.time_ns for cycle in fed.cycles]
    assert times == sorted(times)


@pytest.mark.parametrize("hour", [-3600, 3600])
def test_the_clock_set_during_silence_neither_stops_the_cycles_nor_floods(
    hour: int, binding: Binding, sides: list[can.BusABC]
) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        fed.feed(list(drive(binding, 1.0).frames()))
        fed.silence(0.3)
        before = len(fed.cycles)
        fed.now_ns += hour * SECOND_NS
        fed.silence(1.0)
    steps = fed.daemon.sequence.backward_steps, fed.daemon.sequence.forward_steps
    assert steps == ((1, 0) if hour < 0 else (0, 1))
    assert 18 <= len(fed.cycles) - before <= 21  # one each 50 ms
    times = [cycle.time_ns for cycle in fed.cycles]
    assert max(later - earlier for earlier, later in pairwise(times)) <= 0.1 * SECOND_NS


def test_the_latency_is_that_of_a_scan_that_a_frame_closed(binding: Binding, sides: list[can.BusABC]) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        fed.feed(list(drive(binding, 0.5).frames()))
        assert fed.kept.latencies[-1] == 0.0  # the drive's clock stands still while a frame is taken
        fed.silence(0.5)
        assert fed.daemon.pipeline.counts.coasting_cycles
        assert math.isnan(fed.kept.latencies[-1])


def test_the_daemon_runs_in_real_time_and_stops_within_a_second(binding: Binding, sides: list[can.BusABC]) -> None:
    daemon = Daemon(binding)
    frames = list(drive(binding, 1.0).frames())
    with daemon:
        thread = Thread(target=daemon.run)
        thread.start()
        started_ns = time.time_ns()
        for frame in frames:
            due_ns = started_ns + frame.time_ns - frames[0].time_ns
            time.sleep(max(due_ns - time.time_ns(), 0) * 1e-9)
            sides[frame.bus].send(to_message(frame._replace(time_ns=time.time_ns())))
        time.sleep(0.1)
        asked = time.monotonic()
        daemon.stop()
        thread.join(5.0)
        assert not thread.is_alive()
    assert time.monotonic() - asked < 1.0
    assert daemon.received == len(frames)
    assert daemon.pipeline.counts.cycles >= 18
    assert heard(sides[2])
    assert not daemon.sequence.backward_steps
    assert not daemon.sequence.forward_steps


def test_stopping_finishes_the_open_scan(binding: Binding, sides: list[can.BusABC]) -> None:
    fed = Fed(binding, sides)
    with fed.daemon:
        frames = list(drive(binding, 0.5).frames())
        fed.feed(frames[:-20])
        before = len(fed.cycles)
        fed.daemon.finish()
    assert len(fed.cycles) == before + 1
