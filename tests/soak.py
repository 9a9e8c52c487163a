"""Serves traffic of many hours as fast as it goes, and watches memory: `python -m tests.soak --hours 2`.

All of `candaemon run` but its signals is at work: live buses, sequencer, pipeline, recording, metrics, status. Only
the ports are the test's own: they hand over the 64 slots of an ESR and an INS at 100 Hz, in the drive's own time. Which
vehicles there are changes every two seconds, so that obstacles come and go.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import cycle, groupby
from pathlib import Path
from typing import Any

from candaemon.binding.bind import bind
from candaemon.can_io.open_port import PORTS
from candaemon.can_io.port import Controller, PortCounts, PortRequest
from candaemon.config.load import load_config
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import DaemonView, Observer
from candaemon.frames.frame import Frame
from candaemon.recording.recorder import Recorder
from candaemon.status.health_summary import StatusLogger
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.status_socket import StatusSocket
from tests.beds.service import config_on
from tests.vcan.drives import LAP_S, lap

STEP_NS = 20_000_000
SAMPLES = 20
_PAGE = resource.getpagesize()
_OWN_RATE = 100.0
_LANES = (-7.0, -3.5, 0.0, 3.5, 7.0)
_VEHICLES = (20, 12, 16, 8, 14)
"""Of each lap, the other slots are empty. Each begins a row farther than the one before: none stays in its place."""


class Played:
    """A port whose frames are put in by hand; a `Port`.

    Args:
        counts: what is left in it at its end is counted there.
    """

    controller: Controller = "active"

    def __init__(self, counts: PortCounts) -> None:
        self._counts = counts
        self._coming: list[Frame] = []
        self._readable = os.eventfd(0, os.EFD_NONBLOCK)

    def put(self, frames: Sequence[Frame]) -> None:
        """Let frames come."""
        if frames and not self._coming:
            os.eventfd_write(self._readable, 1)
        self._coming += frames

    def fileno(self) -> int:
        """Return what is readable while there are frames."""
        return self._readable

    def receive(self, limit: int) -> list[Frame]:
        """Return the frames that have come."""
        frames, self._coming = self._coming[:limit], self._coming[limit:]
        if not self._coming:
            os.eventfd_read(self._readable)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Take all."""
        return len(frames)

    def check(self) -> None:
        """Be there."""

    def close(self) -> None:
        """Go; count what nobody has read."""
        self._counts.unread += len(self._coming)
        os.close(self._readable)


class Road(Observer):
    """Lets time pass, and with it the frames come; stops the daemon after so many of them.

    A turn takes 20 ms of the drive, or some more where nothing comes: nothing waits for time to pass.

    Args:
        laps: played one after another, over and over.
        count: frames.

    Attributes:
        now_ns: the time.
        put: frames so far.
        memory: frames so far, bytes resident and objects alive, at even distances.
        ports: by the buses' indices.
    """

    def __init__(self, laps: Sequence[Sequence[Frame]], count: int) -> None:
        self.now_ns = self.put = 0
        self.memory: list[tuple[int, int, int]] = []
        self.ports: dict[int, Played] = {}
        self._steps = _endless(laps)
        self._count = count
        self._sample_at = 0

    def open(self, request: PortRequest) -> Played:
        """Open a port, as `PORTS` has it."""
        port = self.ports[request.index] = Played(request.counts)
        return port

    def on_iteration(self, daemon: DaemonView) -> None:
        """Go on by a step."""
        self.now_ns, frames = next(self._steps)
        self.put += len(frames)
        for index, port in self.ports.items():
            port.put([frame for frame in frames if frame.bus == index])
        if self.put >= self._sample_at:
            self._sample_at += self._count // SAMPLES
            self.memory.append((self.put, resident(), len(gc.get_objects())))
            print(f"{self.put:>12,} frames {self.memory[-1][1] / 1e6:8.3f} MB", file=sys.stderr, flush=True)
        if self.put >= self._count:
            daemon.stop()


def resident() -> int:
    """Return the bytes that this process has in memory, garbage aside."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE


def soak(count: int) -> dict[str, Any]:
    """Serve so many frames; return what came of it."""
    with tempfile.TemporaryDirectory() as folder:
        config = config_on("esr_ins", Path(folder), {}, _served)
        binding = bind(load_config(config))
        road = Road(
            [lap(binding, _places(number, row), own_rate=_OWN_RATE) for row, number in enumerate(_VEHICLES)], count
        )
        PORTS["virtual"] = road.open
        os.environ["RUNTIME_DIRECTORY"] = folder
        recording = Recorder(binding.settings.service.recording, Path(folder, "recording"), binding)
        meter = ServiceMonitor(binding.settings.service.metrics, recording=recording.counts)
        observers = [recording, meter, StatusSocket(meter), StatusLogger(None, meter), road]
        began_s = time.monotonic()
        with Daemon(binding, clock=lambda: road.now_ns, observers=observers) as daemon:
            daemon.run()
            told = meter.snapshot(daemon).tree()
    return {
        "frames": road.put,
        "hours": road.now_ns / 3.6e12,
        "seconds": time.monotonic() - began_s,
        "memory": road.memory,
        "received": sum(bus["received"] for bus in told["buses"].values()),
        "dropped": sum(sum(bus["dropped"].values()) for bus in told["buses"].values()),
        "losses": {kind: count for kind, count in told["losses"].items() if count},
        "obstacles": told["tracking"]["obstacles"],
        "cycles": told["cycles"]["told"],
        "cycle_p50": told["cycle_time"]["p50"],
        "cycle_p99": told["cycle_time"]["p99"],
        "recording": told["recording"],
    }


def _served(settings: dict[str, Any]) -> None:
    """Put the configuration on the test's ports, with a ring that turns over once a minute."""
    for bus in settings["buses"].values():
        bus["interface"] = "virtual"
    settings["service"] = {"recording": {"minutes": 1, "file_seconds": 10}}


def _places(number: int, row: int) -> list[tuple[float, float]]:
    """Return places of some vehicles in five lanes, from one row on."""
    return [(12.0 + 11.0 * (row + k // len(_LANES)), _LANES[k % len(_LANES)]) for k in range(number)]


def _endless(laps: Sequence[Sequence[Frame]]) -> Iterator[tuple[int, list[Frame]]]:
    """Yield step by step the time and the frames that have come by then."""
    begin_ns = 0
    for each in cycle(laps):
        for step, frames in groupby(each, key=lambda frame: frame.time_ns // STEP_NS):
            shifted = [Frame(begin_ns + time_ns, bus, can_id, data) for time_ns, bus, can_id, data, _ in frames]
            yield begin_ns + (step + 1) * STEP_NS, shifted
        begin_ns += round(LAP_S * 1e9)


def main() -> None:
    """Read the command line, serve, print what came of it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=float, help="how many; default: those of the hours")
    parser.add_argument("--hours", type=float, default=2.0, help="length of the drive")
    given = parser.parse_args()
    a_second = 64 * 20 + 4 * _OWN_RATE
    print(json.dumps(soak(int(given.frames or given.hours * 3600 * a_second))))


if __name__ == "__main__":
    main()
