"""A live service on multicast buses: signals, clients and broken datagrams at any moment while frames come.

The service lives on from one input to the next, until one asks it to stop. What was sent to it must be received or
counted as lost, and nothing that it says may be a traceback.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from atexit import register
from collections import Counter
from contextlib import ExitStack, suppress
from functools import cache
from itertools import cycle, islice
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import msgpack

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.frames.frame import EXTENDED, Frame
from tests.beds.service import Service, config_on
from tests.beds.waiting import wait_until
from tests.support.recorded import highway

from .drawn import Drawn
from .fuzz_configuration import YAML_WORDS
from .fuzz_datagrams import fuzz_datagrams

_PATIENCE_S = 60.0
_DRIVE_S = 2.0
_MOST = 12
_MARKS = 200
_GROUPS = ("239.74.166.2", "239.74.166.3", "239.74.166.4")


def fuzz_signals(data: bytes) -> Counter[str]:
    """Do to the service what the bytes say."""
    drawn = Drawn(data)
    bench = _bench()
    if bench is None:
        return Counter(without_multicast=1)
    try:
        done = bench.disturb(drawn)
    except BaseException:
        bench.end()
        raise
    return done


class _Bench:
    """A service, the other side of its buses, and its configuration."""

    def __init__(self) -> None:
        self.folder = Path(mkdtemp(prefix="candaemon-signals-"))
        register(rmtree, self.folder, ignore_errors=True)
        register(self.end)
        ports = _free_ports(len(_GROUPS) + 1)
        self.metrics = ports[-1]

        def onto_multicast(settings: dict[str, Any]) -> None:
            for bus, group, port in zip(settings["buses"].values(), _GROUPS, ports, strict=False):
                bus |= {"interface": "udp_multicast", "channel": group, "options": {"port": port}}
            settings["service"] = {"metrics": {"port": self.metrics}, "recording": {"minutes": 0.05, "file_seconds": 1}}

        self.config = config_on("demo", self.folder, {}, onto_multicast)
        self.sound = self.config.read_bytes()
        binding = bind(load_config(self.config))
        self.frames = cycle(highway(binding, _DRIVE_S))
        self.sides = [_sender(group, port) for group, port in zip(_GROUPS, ports, strict=False)]
        self.service: Service | None = None
        self.sent = 0
        self.comparable = True

    def disturb(self, drawn: Drawn) -> Counter[str]:
        """Do what the bytes say, and hold what must be true afterwards."""
        service, done = self.served(), Counter[str]()
        stop, actions = drawn.integer(0, 7) == 7, 0
        with ExitStack() as clients:
            while drawn and actions < _MOST:
                actions += 1
                self._act(drawn, service, clients, done)
            if stop:
                self._stop(service)
                return done + Counter(stopped=1)
        self._settle()
        self._hold_said()
        if not self.comparable:
            self._stop(service)
        return +done

    def _act(self, drawn: Drawn, service: Service, clients: ExitStack, done: Counter[str]) -> None:
        match drawn.integer(0, 9):
            case 0 | 1 | 2:
                self._send(drawn.integer(1, 80), done)
            case 3:
                for _ in range(drawn.integer(1, 20)):
                    self.sides[drawn.integer(0, 1)].send(drawn.taken(drawn.integer(0, 30)))
                    self.sent += 1
                    done["broken datagrams"] += 1
            case 4:
                for _ in range(drawn.integer(1, _MARKS)):
                    service.signal(signal.SIGUSR1)
                    done["marks"] += 1
            case 5:
                self._reload(drawn, service)
                done["reloads"] += 1
            case 6:
                with suppress(OSError):
                    idle = clients.enter_context(socket.socket(socket.AF_UNIX))
                    idle.settimeout(1.0)
                    idle.connect(os.fspath(self.socket))
                    idle.send(drawn.taken(20))
                done["idle clients"] += 1
            case 7:
                with suppress(OSError):
                    half = clients.enter_context(socket.create_connection(("127.0.0.1", self.metrics), 1.0))
                    half.send(drawn.taken(40))
                done["half-open connections"] += 1
            case _:
                time.sleep(drawn.integer(0, 100) / 1000)

    def _send(self, count: int, done: Counter[str]) -> None:
        for frame in islice(self.frames, count):
            self.sides[frame.bus].send(msgpack.packb(_message(frame)))
        self.sent += count
        done["frames"] += count

    def _reload(self, drawn: Drawn, service: Service) -> None:
        """Ask for a reload, of the same configuration or of one that is changed; the sound one comes back."""
        form = drawn.integer(0, 3)
        if form > 1:
            text = drawn.edited(self.sound, YAML_WORDS) if form == 2 else drawn.taken(60)
            self.config.write_bytes(text)
            self.comparable &= form == 3  # one that is taken may begin to count anew
        service.signal(signal.SIGHUP)
        time.sleep(drawn.integer(0, 50) / 1000)
        self.config.write_bytes(self.sound)

    def _settle(self) -> None:
        """Wait until all that was sent is counted."""
        figures: dict[str, Any] = {}

        def settled() -> bool:
            assert self.service is not None
            assert self.service.process.poll() is None, f"it ended:\n{self.service.said}"
            figures.clear()
            figures.update(self._figures())
            return not self.comparable or _counted(figures) == self.sent

        wait_until(settled, _PATIENCE_S, lambda: f"{self.sent} sent, {_counted(figures)} counted: {figures['buses']}")

    def _figures(self) -> dict[str, Any]:
        """Return what the status socket sends; nothing while other clients have it."""
        with suppress(OSError, ValueError), socket.socket(socket.AF_UNIX) as client:
            client.settimeout(2.0)
            client.connect(os.fspath(self.socket))
            with client.makefile() as stream:
                tree: dict[str, Any] = json.loads(stream.readline())
                if "buses" in tree:
                    return tree
        return {"buses": {}}

    def _hold_said(self) -> None:
        assert self.service is not None
        assert "Traceback" not in self.service.said, self.service.said[-3000:]

    def served(self) -> Service:
        """Return the service; it is started where there is none."""
        if self.service is None:
            self.config.write_bytes(self.sound)
            arguments = ("--record", str(self.folder / "recording"), "--status", "1")
            environment = {"XDG_RUNTIME_DIR": str(self.folder)}
            self.service = Service(self.config, *arguments, log=self.folder / "log", environment=environment)
            self.sent, self.comparable = 0, True
            self.socket = self.folder / "candaemon" / self.config.stem / "status.sock"
            wait_until(lambda: self._figures()["buses"] != {}, _PATIENCE_S, lambda: f"a service:\n{self._said()}")
        return self.service

    def _said(self) -> str:
        return "" if self.service is None else self.service.said

    def _stop(self, service: Service) -> None:
        service.signal(signal.SIGTERM)
        status = service.process.wait(_PATIENCE_S)
        assert status == 0, f"exit status {status}:\n{service.said[-3000:]}"
        self._hold_said()
        self.service = None

    def end(self) -> None:
        """End the service for good."""
        if self.service is not None:
            self.service.close()
            self.service = None


def _counted(figures: dict[str, Any]) -> int:
    """Return the frames that were received or are counted as lost."""
    causes = ("kernel_lost", "queue_full", "malformed")
    return sum(bus["received"] + sum(bus["dropped"][cause] for cause in causes) for bus in figures["buses"].values())


def _message(frame: Frame) -> dict[str, Any]:
    """Return a frame as the map that python-can packs."""
    return {
        "timestamp": 0.0,
        "arbitration_id": frame.can_id & 0x1FFF_FFFF,
        "is_extended_id": bool(frame.can_id & EXTENDED),
        "is_remote_frame": False,
        "is_error_frame": False,
        "channel": None,
        "dlc": len(frame.data),
        "data": frame.data,
        "is_fd": frame.fd,
        "bitrate_switch": frame.fd,
        "error_state_indicator": False,
    }


def _sender(group: str, port: int) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect((group, port))
    return sender


def _free_ports(count: int) -> list[int]:
    """Return ports that are free at this moment."""
    with ExitStack() as held:
        found = [held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in found:
            each.bind(("", 0))
        return [int(each.getsockname()[1]) for each in found]


@cache
def _bench() -> _Bench | None:
    """Return the bench; None where this machine has no multicast."""
    return None if fuzz_datagrams(b"\1")["without_multicast"] else _Bench()
