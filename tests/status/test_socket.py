"""The status socket: who connects is told, who does not read holds nobody up."""

from __future__ import annotations

import json
import logging
import os
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TextIO

import pytest

from candaemon.binding.bound import Binding
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.socket_paths import is_listening, running_instances, socket_path
from candaemon.status.status_socket import MOST_CLIENTS, StatusSocket
from tests.support.served import Served, bound, drive, wait_until


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder that systemd would give the unit."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{tmp_path / 'run' / 'mine'}:/another")
    return tmp_path / "run" / "mine"


@pytest.fixture
def binding(tmp_path: Path) -> Binding:
    return bound(tmp_path)


def socket_of(binding: Binding) -> tuple[ServiceMonitor, StatusSocket]:
    meter = ServiceMonitor(binding.settings.service.metrics)
    return meter, StatusSocket(meter)


@contextmanager
def connected(path: Path) -> Iterator[TextIO]:
    wait_until(lambda: is_listening(path))
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        connection.connect(str(path))
        with connection.makefile("r") as stream:
            yield stream


def told(stream: TextIO) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads(stream.readline())
    return tree


def test_a_client_is_told_at_once_and_then_every_second(binding: Binding, runtime: Path) -> None:
    with Served(binding, socket_of(binding)) as served, connected(runtime / "status.sock") as stream:
        first, began_s = told(stream), time.monotonic()
        served.feed(drive(binding, 0.5))
        second, third = told(stream), told(stream)
        assert 0.8 < time.monotonic() - began_s < 3.0
    assert first["cycles"]["told"] == 0
    assert third["buses"]["radar"]["received"] > 500
    assert third["service"]["uptime"] - second["service"]["uptime"] == pytest.approx(1.0, abs=0.2)


def test_every_user_may_connect_and_the_end_leaves_nothing(binding: Binding, runtime: Path) -> None:
    path = runtime / "status.sock"
    with Served(binding, socket_of(binding)), connected(path) as stream:
        told(stream)
        assert stat.S_IMODE(path.stat().st_mode) == 0o666
    assert not runtime.exists()


def test_a_client_that_never_reads_is_dropped_and_holds_nobody_up(binding: Binding, runtime: Path) -> None:
    now_s = 0.0
    meter = ServiceMonitor(binding.settings.service.metrics)
    told_by = StatusSocket(meter, clock=lambda: now_s)
    daemon = Served(binding, []).daemon
    meter.on_start(daemon)
    told_by.on_start(daemon)
    with socket.socket(socket.AF_UNIX) as deaf, connected(runtime / "status.sock") as stream:
        deaf.connect(str(runtime / "status.sock"))
        longest_s = 0.0
        for _ in range(300):
            now_s += 1.0
            began_s = time.monotonic()
            told_by.on_iteration(daemon)
            longest_s = max(longest_s, time.monotonic() - began_s)
            assert told(stream)["service"]["instance"] == "mine"
        received = 0
        while chunk := deaf.recv(1 << 16):
            received += len(chunk)
    assert longest_s < 0.5
    assert received < 1 << 20
    told_by.on_stop(daemon)


def test_clients_are_bounded_and_one_too_many_is_told_so(binding: Binding, runtime: Path) -> None:
    path = runtime / "status.sock"
    with Served(binding, socket_of(binding)), ExitStack() as clients:
        for _ in range(MOST_CLIENTS):
            assert "service" in told(clients.enter_context(connected_once(path)))
        with connected_once(path) as stream:
            assert "served already" in told(stream)["error"]
            assert stream.readline() == ""


@contextmanager
def connected_once(path: Path) -> Iterator[TextIO]:
    """Connect without asking first whether somebody answers, which would take a place too."""
    wait_until(path.exists)
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        wait_until(lambda: connection.connect_ex(str(path)) == 0)
        with connection.makefile("r") as stream:
            yield stream


def test_what_a_killed_instance_left_makes_room(binding: Binding, runtime: Path) -> None:
    runtime.mkdir(parents=True)
    left = runtime / "status.sock"
    code = f"import os, socket; s = socket.socket(socket.AF_UNIX); s.bind({str(left)!r}); s.listen(); os._exit(9)"
    subprocess.run([sys.executable, "-c", code], check=False)
    assert left.is_socket()
    assert not is_listening(left)
    with Served(binding, socket_of(binding)), connected(left) as stream:
        assert told(stream)["service"]["pid"] == os.getpid()


@pytest.mark.parametrize("kind", ["live", "file", "long", "unwritable"])
def test_where_it_cannot_be_made_the_service_goes_on(
    kind: str, binding: Binding, runtime: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    if kind == "long":
        monkeypatch.setenv("RUNTIME_DIRECTORY", f"{runtime}/{'x' * 120}")
    elif kind == "unwritable":
        monkeypatch.setenv("RUNTIME_DIRECTORY", "/proc/nothing")
    else:
        runtime.mkdir(parents=True)
    meter, status = socket_of(binding)
    with socket.socket(socket.AF_UNIX) as other, caplog.at_level(logging.WARNING):
        if kind == "live":
            other.bind(str(runtime / "status.sock"))
            other.listen()
        if kind == "file":
            (runtime / "status.sock").write_text("somebody's")
        with Served(binding, [meter, status]) as served:
            served.feed(drive(binding, 0.2))
            assert meter.wait_for_snapshot(5.0).cycles.told > 0
            assert status.path is None
        assert (runtime / "status.sock").exists() == (kind in {"live", "file"})
    assert "no status socket" in caplog.text


def test_without_a_place_there_is_none(binding: Binding, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    assert socket_path(Path("/etc/candaemon/van.yaml")) is None
    with Served(binding, socket_of(binding)) as served:
        served.feed(drive(binding, 0.2))


def test_a_user_has_a_place_by_the_configurations_name(binding: Binding, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    base = binding.loaded.path.parent / "user"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    assert socket_path(Path("/etc/candaemon/van.yaml")) == base / "candaemon" / "van" / "status.sock"
    assert "mine" not in running_instances()
    with Served(binding, socket_of(binding)) as served:
        served.feed(drive(binding, 0.1))
        assert running_instances()["mine"] == base / "candaemon" / "mine" / "status.sock"
    assert "mine" not in running_instances()
