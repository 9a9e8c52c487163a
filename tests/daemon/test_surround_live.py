"""Twelve radars live over local datagrams: every frame arrives, and obstacles go out."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from candaemon.binding.bind import bind
from candaemon.can_io.live_buses import LiveBuses
from candaemon.config.load import load_config
from candaemon.daemon.daemon import Daemon
from candaemon.errors import BusError
from candaemon.frames.frame import Frame
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.beds.service import config_on

pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

SECONDS = 1.5
PATIENCE_S = 120.0


def onto_multicast(settings: dict[str, Any]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    for k, bus in enumerate(settings["buses"].values()):
        bus |= {"interface": "udp_multicast", "channel": f"239.74.165.{k + 2}", "options": {"port": port + k}}
        bus["receive_buffer"] = 60.0  # as much as the kernel allows: other tests may hold the daemon up for seconds


def play(buses: LiveBuses, frames: list[Frame]) -> None:
    """Send frames as fast as they came."""
    began_s, first_ns = time.monotonic(), frames[0].time_ns
    for frame in frames:
        time.sleep(max((frame.time_ns - first_ns) * 1e-9 - (time.monotonic() - began_s), 0.0))
        if not buses.send(frame.bus, [frame]):
            buses.read(0.001)  # it waits: an object that comes behind it would take its place


@pytest.mark.slow
def test_twelve_radars_lose_nothing_over_local_datagrams(tmp_path: Path) -> None:
    of = bind(load_config(config_on("surround", tmp_path, {}, onto_multicast)))
    actors = tuple(
        {"name": f"car {k}", "start": {"x": 12.0 * (k % 4) - 15.0, "y": 3.5 * (k // 4) - 3.5, "speed": 15.0}}
        for k in range(12)
        if (k % 4, k // 4) != (1, 1)
    )
    told = {"duration": SECONDS, "ego": {"start": {"speed": 15.0}}, "actors": actors}
    frames = list(simulate(Scenario.model_validate(told), of).frames())
    with Daemon(of) as daemon, LiveBuses(of.settings.buses, clock=time.time_ns) as sensors:
        try:
            sensors.open()
        except BusError as error:
            pytest.skip(f"no multicast on this machine: {error}")
        sender = Thread(target=play, args=(sensors, frames))
        sender.start()
        deadline_s = time.monotonic() + PATIENCE_S
        while (sender.is_alive() or daemon.received < len(frames)) and time.monotonic() < deadline_s:
            daemon.step(0.01)
        sender.join()
        daemon.finish()
        losses = {bus.name: daemon.buses[bus.index].counts for bus in of.buses}
        unsent = [(each.counts.sent, each.counts.send_dropped, each.counts.send_failed) for each in sensors]
    counts = daemon.pipeline.counts
    assert sum(sent for sent, _, _ in unsent) == len(frames), unsent
    assert daemon.received == len(frames)
    assert all(each.kernel_lost == each.queue_full == each.malformed == 0 for each in losses.values())
    assert sum(assembler.counts.scans for assembler in daemon.pipeline.assemblers) >= 0.95 * 12 * SECONDS / 0.05
    assert counts.cycles >= 0.8 * SECONDS / 0.05
    assert counts.sent > 0
