"""A process or a machine that slept is no clock that was set."""

from __future__ import annotations

import math

import pytest

from candaemon.daemon.clock_step import ClockStepDetector, since_boot_ns
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.frames.frame import Frame, Tick
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding

SECOND_NS = 1_000_000_000
TURN_NS = SECOND_NS // 100


class Clocks:
    """Two clocks: one that can be set, and a steady one."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000 * SECOND_NS
        self.steady_ns = 50 * SECOND_NS

    def pass_by(self, ns: int) -> None:
        self.now_ns += ns
        self.steady_ns += ns


def test_a_sleep_is_not_a_clock_that_was_set() -> None:
    clocks = Clocks()
    watch = ClockStepDetector(lambda: clocks.steady_ns)
    for ns in (TURN_NS, TURN_NS, 3600 * SECOND_NS, TURN_NS):
        clocks.pass_by(ns)
        assert not watch.was_set(clocks.now_ns)


@pytest.mark.parametrize("step_s", [-3600, 2])
def test_a_clock_that_was_set_is_remembered_while_frames_may_wait(step_s: int) -> None:
    clocks = Clocks()
    watch = ClockStepDetector(lambda: clocks.steady_ns)
    assert not watch.was_set(clocks.now_ns)
    clocks.now_ns += step_s * SECOND_NS
    assert watch.was_set(clocks.now_ns)
    clocks.pass_by(5 * SECOND_NS)
    assert watch.was_set(clocks.now_ns)
    clocks.pass_by(6 * SECOND_NS)
    assert not watch.was_set(clocks.now_ns)


def test_a_clock_that_is_slewed_was_not_set() -> None:
    clocks = Clocks()
    watch = ClockStepDetector(lambda: clocks.steady_ns)
    for _ in range(1000):  # to 2 s apart
        clocks.pass_by(TURN_NS)
        clocks.now_ns += 2 * SECOND_NS // 1000
        assert not watch.was_set(clocks.now_ns)


def test_the_steady_clock_goes_on() -> None:
    before_ns = since_boot_ns()
    assert since_boot_ns() >= before_ns


class Turned:
    """A daemon without traffic whose buses give what a test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clocks = Clocks()
        self.daemon = Daemon(binding("demo"), clock=lambda: self.clocks.now_ns, steady=lambda: self.clocks.steady_ns)
        self.come: list[Frame] = []
        self.taken: list[Frame | Tick] = []
        monkeypatch.setattr(self.daemon.buses, "read", lambda _timeout_s, _coalescing_s=0.0: self.come)
        monkeypatch.setattr(self.daemon, "_process", self.taken.extend)

    def turn(self, *ages_ns: int) -> None:
        """Take a turn in which frames of these ages have come."""
        self.clocks.pass_by(TURN_NS)
        self.come = [Frame(self.clocks.now_ns - age_ns, 0, 0x500, bytes(8)) for age_ns in ages_ns]
        self.daemon.step(0.01)

    @property
    def steps(self) -> int:
        return self.daemon.sequence.forward_steps + self.daemon.sequence.backward_steps


@pytest.fixture
def turned(monkeypatch: pytest.MonkeyPatch) -> Turned:
    turned = Turned(monkeypatch)
    turned.turn(0)
    turned.turn()
    return turned


def test_time_passes_while_the_process_sleeps(turned: Turned) -> None:
    before_ns = turned.taken[-1][0]
    turned.clocks.pass_by(20 * SECOND_NS)
    turned.turn(20 * SECOND_NS, 20 * SECOND_NS - TURN_NS)  # what waited in the receive buffer
    turned.turn(0)
    assert turned.steps == 0
    assert turned.taken[-1][0] - before_ns == pytest.approx(20 * SECOND_NS, abs=5 * TURN_NS)


def test_a_clock_that_is_set_between_two_frames_does_not_let_time_pass(turned: Turned) -> None:
    before_ns = turned.taken[-1][0]
    turned.clocks.now_ns += 3600 * SECOND_NS
    turned.turn(0)
    turned.turn()
    assert turned.daemon.sequence.forward_steps == turned.steps == 1
    assert turned.taken[-1][0] - before_ns < SECOND_NS


def test_a_frame_from_the_future_does_not_let_time_pass(turned: Turned) -> None:
    before_ns = turned.taken[-1][0]
    turned.turn(-3600 * SECOND_NS)
    assert turned.taken[-1][0] - before_ns < SECOND_NS


class Latencies(Observer):
    """Keeps the latencies of cycles whose frames were sent."""

    def __init__(self) -> None:
        self.found: list[float] = []

    def on_cycle(self, completed: CompletedCycle) -> None:
        if completed.cycle.frames:
            self.found.append(completed.latency)


def test_frames_that_came_before_the_clock_was_set_have_no_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    of, clocks, told = binding("demo"), Clocks(), Latencies()
    daemon = Daemon(of, clock=lambda: clocks.now_ns, steady=lambda: clocks.steady_ns, observers=[told])
    scenario = Scenario.model_validate({"duration": 3.0, "actors": [{"name": "ahead", "start": {"x": 30.0, "y": 0.0}}]})
    waiting = list(simulate(scenario, of, 1).frames())
    clocks.now_ns = waiting[0].time_ns
    set_at_ns = waiting[len(waiting) // 2].time_ns

    def read(_timeout_s: float, _coalescing_s: float = 0.0) -> list[Frame]:
        clocks.pass_by(TURN_NS)
        come = [frame for frame in waiting if frame.time_ns <= clocks.now_ns]
        del waiting[: len(come)]
        if come and come[-1].time_ns >= set_at_ns:
            clocks.now_ns += 7200 * SECOND_NS  # while they waited to be used
        return come

    monkeypatch.setattr(daemon.buses, "read", read)
    monkeypatch.setattr(daemon.buses, "send", lambda _bus, frames: len(frames))
    while waiting:
        daemon.step(0.01)
    known = [latency for latency in told.found if not math.isnan(latency)]
    assert len(known) > 20
    assert len(known) < len(told.found)
    assert max(known) < 0.1
