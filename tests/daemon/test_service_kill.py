"""A killed service is back to tracking within 2 s: over UDP multicast, started again as the shipped unit has it."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from threading import Event, Thread
from typing import Any

import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.live_buses import LiveBuses
from candaemon.config.load import load_config
from candaemon.errors import BusError
from candaemon.output.decoder import OutputDecoder
from candaemon.tracking.obstacles import CONFIRMED
from tests.beds.service import config_on
from tests.support.paths import ROOT
from tests.support.recorded import highway

pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

BACK_S = 2.0
"""Goal, from the kill to the first obstacle on the bus: the median of all kills, on a machine without other work."""
BUSY = 5.0
"""How many times the goal a busy machine may take: caches and the disk are shared, which no clock leaves out."""
KILLS = 3
PATIENCE_S = 40.0
UNIT = ROOT / "config" / "systemd" / "candaemon@.service"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Write the demo's configuration for UDP multicast, each bus with a port of its own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]

    def onto_multicast(settings: dict[str, Any]) -> None:
        for k, bus in enumerate(settings["buses"].values()):
            bus |= {
                "interface": "udp_multicast",
                "channel": f"239.74.164.{k + 2}",
                "options": {"port": port + k},
            }

    path = config_on("demo", tmp_path, {}, onto_multicast)
    try:
        with others(bind(load_config(path))):
            return path
    except BusError as error:
        pytest.skip(f"no multicast on this machine: {error}")


@contextmanager
def others(of: Binding) -> Iterator[LiveBuses]:
    """Open the buses as the sensors and who takes the obstacles have them."""
    ids = {bus.name: frozenset[int]() for bus in of.buses[:2]}
    with LiveBuses(of.settings.buses, clock=time.time_ns, ids=ids) as buses:
        buses.open()
        yield buses


@contextmanager
def playing(of: Binding, buses: LiveBuses) -> Iterator[None]:
    """Play a drive again and again while the context lasts."""
    frames, ended = highway(of, 5.0), Event()

    def play() -> None:
        began_s, first_ns = time.monotonic(), frames[0].time_ns
        while not ended.is_set():
            for frame in frames:
                if ended.wait(max((frame.time_ns - first_ns) * 1e-9 - (time.monotonic() - began_s), 0.0)):
                    return
                buses.send(frame.bus, [frame])
            began_s = time.monotonic()

    thread = Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Supervised:
    """What systemd does with the unit: starts the service, and starts it again some time after its end.

    Args:
        config: of the service.
        log: the file for what it says.
    """

    def __init__(self, config: Path, log: Path) -> None:
        self._command = [sys.executable, "-m", "candaemon", "run", str(config)]
        self._log = log
        pause = re.search(r"^RestartSec=(\d+)ms$", UNIT.read_text(encoding="utf-8"), re.MULTILINE)
        assert pause is not None
        self._pause_s = int(pause[1]) / 1000
        self.start()

    def start(self) -> None:
        """Start the service."""
        with self._log.open("ab") as file:
            self.process = subprocess.Popen(self._command, stderr=file)

    def kill(self) -> None:
        """Kill it, and start it again."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        time.sleep(self._pause_s)
        self.start()

    def waited_s(self) -> float:
        """Return how long it has been ready to run while other processes had the processors, s."""
        _, waited_ns, _ = Path("/proc", str(self.process.pid), "schedstat").read_text(encoding="ascii").split()
        return int(waited_ns) * 1e-9


@pytest.fixture
def service(config: Path, tmp_path: Path) -> Iterator[Supervised]:
    service = Supervised(config, tmp_path / "log")
    try:
        yield service
    finally:
        service.process.kill()
        service.process.wait()
        print((tmp_path / "log").read_text(encoding="utf-8"))


def wait_for_an_obstacle(of: Binding, buses: LiveBuses) -> None:
    """Return as soon as a confirmed obstacle is told."""
    assert of.output is not None
    receiver, end_s = OutputDecoder(of.output), time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        for frame in buses.read(0.05):
            for told in receiver.push(frame.can_id, frame.data):
                if (told.columns()["state"] == CONFIRMED).any():
                    return
    raise AssertionError(f"no obstacle in {PATIENCE_S:g} s")


def forget(buses: LiveBuses) -> None:
    """Throw away what has come so far."""
    while buses.read(0.0):
        pass


@pytest.mark.benchmark
@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the kernel does not tell how long one waits")
def test_a_killed_service_is_back_to_tracking_soon(
    config: Path, service: Supervised, record_property: Callable[[str, object], None]
) -> None:
    of, took_s = bind(load_config(config)), []
    with others(of) as buses, others(of) as sensors, playing(of, sensors):
        wait_for_an_obstacle(of, buses)
        for _ in range(KILLS):
            killed_s = time.monotonic()
            service.kill()
            forget(buses)
            wait_for_an_obstacle(of, buses)
            took_s.append(time.monotonic() - killed_s - service.waited_s())
    told = f"killed service back after {', '.join(f'{each:.2f} s' for each in took_s)}; goal {BACK_S:g} s, the median"
    record_property("benchmark", told)
    assert median(took_s) <= BUSY * BACK_S, told
