"""What the tests of the recording share: a daemon on virtual buses, stepped by hand with the drive's own clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import can

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.python_can import to_message
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.frames.frame import Frame
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT

TICK_NS = 10_000_000


class Sent(Observer):
    """Notes the frames that were handed to the bus."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def on_cycle(self, completed: CompletedCycle) -> None:
        self.frames += completed.cycle.frames


class Driven:
    """A daemon that is stepped by hand."""

    def __init__(self, of: Binding, sides: Sequence[can.BusABC], observers: Sequence[Observer]) -> None:
        self.now_ns = 0
        self.sent = Sent()
        self.observers = (*observers, self.sent)
        self.daemon = Daemon(of, clock=lambda: self.now_ns, observers=self.observers)
        self._sides = sides
        self.fed = 0

    def feed(self, frames: Sequence[Frame]) -> None:
        """Let frames come over the buses; a tick in each pause of 10 ms and more."""
        for frame in frames:
            while self.now_ns and frame.time_ns - self.now_ns > TICK_NS:
                self.silence(TICK_NS * 1e-9)
            self._sides[frame.bus].send(to_message(frame))
            self.now_ns = frame.time_ns
            self.fed += 1
            while self.daemon.received < self.fed:
                self.daemon.step(5.0)
                self._turned()

    def silence(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 1e9) // TICK_NS):
            self.now_ns += TICK_NS
            self.daemon.step(0.0)
            self._turned()

    def stop(self) -> None:
        """Stop as SIGTERM would."""
        self.daemon.finish()
        for observer in self.observers:
            observer.on_stop(self.daemon)

    def _turned(self) -> None:
        for observer in self.observers:
            observer.on_iteration(self.daemon)


@contextmanager
def driven(of: Binding, *observers: Observer) -> Iterator[Driven]:
    """Run a daemon on virtual buses, whose other sides are fed."""
    with ExitStack() as closing:
        sides = [
            closing.enter_context(
                can.Bus(channel=bus.settings.channel, interface="virtual", preserve_timestamps=True, ignore_config=True)
            )
            for bus in of.buses
        ]
        runs = Driven(of, sides, observers)
        closing.enter_context(runs.daemon)
        for observer in runs.observers:
            observer.on_start(runs.daemon)
        yield runs


def highway(of: Binding, seconds: float) -> list[Frame]:
    """Simulate a drive."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    return list(simulate(scenario.model_copy(update={"duration": seconds}), of, 5).frames())


def as_log(of: Binding, frames: Sequence[Frame]) -> bytes:
    """Return frames as a replay writes them."""
    return candump_text(frames, [bus.settings.log_channel or bus.settings.channel for bus in of.buses])


def replayed(of: Binding, log: Path, *, fresh: bool = False) -> bytes:
    """Return what a replay sends."""
    output = log.with_name(f"{log.name}.out") if log.is_dir() else log.with_suffix(".out")
    replay(of, ReplayRequest(log, output.with_suffix(".sent.log"), fresh=fresh))
    return output.with_suffix(".sent.log").read_bytes()
