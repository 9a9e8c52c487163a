"""A daemon that serves in a thread, on virtual buses fed with a simulated drive in the drive's own time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from itertools import groupby, islice
from pathlib import Path
from threading import Thread
from types import TracebackType
from typing import Self

import can

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.python_can import to_message
from candaemon.config.load import load_config
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import Observer
from candaemon.frames.frame import Frame
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT


def demo_config(folder: Path, service: str = "", name: str = "mine") -> Path:
    """Write the demo's configuration with settings of the service, a line each."""
    text = (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    path = folder / f"{name}.yaml"
    path.write_text(text + (f"service:\n{service}" if service else ""), encoding="utf-8")
    return path


@cache
def _demo() -> Binding:
    return bind(load_config(ROOT / "config" / "demo.yaml"))


def bound(folder: Path, service: str = "", name: str = "mine") -> Binding:
    """Bind that configuration; what the service's settings do not change is bound once for all tests."""
    return replace(_demo(), loaded=load_config(demo_config(folder, service, name)))


def drive(binding: Binding, seconds: float) -> list[Frame]:
    """Return the frames of a drive that begins at time 0, where the daemon's clock stands before it is fed."""
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    frames = list(simulate(scenario.model_copy(update={"duration": seconds}), binding, 5).frames())
    return [frame._replace(time_ns=frame.time_ns - frames[0].time_ns) for frame in frames]


_AT_ONCE = 50
"""Frames sent before the daemon's are waited for; the least queue that a test gives it holds more."""


def wait_until(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it did not come about in time"
        time.sleep(0.002)


class Served:
    """A context: the daemon serves while it lasts. Between two `feed`s its clock stands."""

    def __init__(self, binding: Binding, observers: Sequence[Observer]) -> None:
        self.now_ns = 0
        self.sent = 0
        self.daemon = Daemon(binding, clock=lambda: self.now_ns, observers=observers)
        self._channels = [bus.settings.channel for bus in binding.buses]
        self._closing = ExitStack()
        self._thread = Thread(target=self.daemon.run)

    def __enter__(self) -> Self:
        self._sides = [
            self._closing.enter_context(
                can.Bus(channel=channel, interface="virtual", preserve_timestamps=True, ignore_config=True)
            )
            for channel in self._channels
        ]
        self._closing.enter_context(self.daemon)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.daemon.stop()
        self._thread.join(5.0)
        self._closing.close()
        assert not self._thread.is_alive()

    def feed(self, frames: Sequence[Frame]) -> None:
        """Send frames, those of one bus at a time, so that the daemon sees them in order; wait until it has."""
        for bus, burst in groupby(frames, key=lambda frame: frame.bus):
            while piece := list(islice(burst, _AT_ONCE)):
                for frame in piece:
                    self._sides[bus].send(to_message(frame))
                    self.now_ns = frame.time_ns
                self.sent += len(piece)
                wait_until(lambda: self.daemon.received >= self.sent, 30.0)
