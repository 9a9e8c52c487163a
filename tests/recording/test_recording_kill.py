"""A recording survives `kill -9` up to the last second, over UDP multicast with the service as a process of its own."""

from __future__ import annotations

import signal
import socket
import time
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Any

import can
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.python_can import to_message
from candaemon.config.load import load_config
from candaemon.frames.frame import Frame
from candaemon.playback.recording_files import logs_in
from tests.beds.service import Service, config_on
from tests.support.recorded import highway, replayed

pytest.importorskip("msgpack", reason="udp_multicast needs msgpack")

GROUP = "239.74.163.2"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Write the demo's configuration for UDP multicast, each bus with a port of its own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]

    def onto_multicast(settings: dict[str, Any]) -> None:
        for k, bus in enumerate(settings["buses"].values()):
            bus |= {"interface": "udp_multicast", "options": {"port": port + k}}
        settings["service"] = {"recording": {"file_seconds": 0.7, "flush": 0.2}}

    path = config_on("demo", tmp_path, {}, onto_multicast)
    text = path.read_text(encoding="utf-8")
    for k, name in enumerate(("radar", "ins", "obstacles")):
        text = text.replace(f"channel: {name}\n", f"channel: 239.74.163.{k + 2}\n")
    path.write_text(text, encoding="utf-8")
    try:
        with bus(bind(load_config(path)), 0):
            return path
    except OSError as error:
        pytest.skip(f"no multicast on this machine: {error}")


@contextmanager
def bus(of: Binding, index: int) -> Iterator[can.BusABC]:
    settings = of.buses[index].settings
    port = settings.options["port"]
    with can.Bus(interface=settings.interface, channel=settings.channel, port=port, ignore_config=True) as opened:
        yield opened


class Heard:
    """What the output told, and when."""

    def __init__(self) -> None:
        self.frames: list[str] = []
        self._times: list[float] = []

    def take(self, message: can.Message) -> None:
        self._times.append(time.monotonic())
        self.frames.append(f"{message.arbitration_id:03X}#{bytes(message.data).hex().upper()}")

    def until(self, moment: float) -> list[str]:
        return self.frames[: bisect_right(self._times, moment)]


@contextmanager
def heard(of: Binding) -> Iterator[Heard]:
    """Listen to the output while the context lasts."""
    found, ended = Heard(), Event()

    def listen() -> None:
        while not ended.is_set():
            message = opened.recv(0.1)
            if message is not None:
                found.take(message)

    with bus(of, 2) as opened:
        thread = Thread(target=listen)
        thread.start()
        try:
            yield found
            time.sleep(0.2)
        finally:
            ended.set()
            thread.join()


def play(of: Binding, frames: Sequence[Frame]) -> None:
    """Send frames at the times that they have."""
    with bus(of, 0) as radar, bus(of, 1) as ins:
        began = time.monotonic()
        for frame in frames:
            time.sleep(max((frame.time_ns - frames[0].time_ns) * 1e-9 - (time.monotonic() - began), 0.0))
            (radar, ins)[frame.bus].send(to_message(frame))


@contextmanager
def start(config: Path, folder: Path, log: Path) -> Iterator[Service]:
    """Run the service while the context lasts."""
    service = Service(config, "--record", str(folder), "--status", "0.2", log=log)
    try:
        service.wait_for("frames/s")
        yield service
    finally:
        service.close()


def told(log: bytes) -> list[str]:
    return [line.split()[2] for line in log.decode().splitlines()]


def test_a_recording_survives_sigkill_and_continues(config: Path, tmp_path: Path) -> None:
    of, folder = bind(load_config(config)), tmp_path / "ring"
    frames = highway(of, 2.0)
    with heard(of) as killed, start(config, folder, tmp_path / "log") as service:
        play(of, frames)
        service.signal(signal.SIGKILL)
        killed_s = time.monotonic()
        service.process.wait(5.0)
    assert len(logs_in(folder)) >= 3
    told_before = told(replayed(of, folder))
    assert told_before == killed.frames[: len(told_before)]
    assert len(told_before) >= len(killed.until(killed_s - 1.0)) > 100
    with heard(of) as stopped, start(config, folder, tmp_path / "log") as service:
        play(of, frames)
        assert service.stop()[0] == 0
    assert told(replayed(of, folder)) == told_before + stopped.frames
