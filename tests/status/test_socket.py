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
from candaemon.status import status_socket
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


def test_idle_clients_make_room_and_are_counted(
    binding: Binding, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status_socket, "_LINE_S", 0.1)
    path = runtime / "status.sock"
    meter, status = socket_of(binding)
    with Served(binding, [meter, status]), ExitStack() as clients:
        reading = clients.enter_context(connected_once(path))
        for _ in range(2 * MOST_CLIENTS):  # connected, and silent
            clients.enter_context(idle(path))
            for _ in range(3):  # so that it is seen to read
                assert "service" in told(reading)
        with connected_once(path) as another:
            tree = told(another)
        assert "service" in told(reading)
        assert tree["losses"]["status_clients"] == MOST_CLIENTS + 2


def test_of_clients_that_all_read_the_first_makes_room_and_is_told_so(binding: Binding, runtime: Path) -> None:
    path = runtime / "status.sock"
    with Served(binding, socket_of(binding)), ExitStack() as clients:
        readers = [clients.enter_context(connected_once(path)) for _ in range(MOST_CLIENTS)]
        for each in readers:
            assert "service" in told(each)
        newest = clients.enter_context(connected_once(path))
        assert "service" in told(newest)
        lines = [json.loads(line) for line in readers[0]]
        assert "more than 8 clients came" in lines[-1]["error"]
        assert "service" in told(readers[1])


@contextmanager
def idle(path: Path) -> Iterator[socket.socket]:
    """Connect and read nothing."""
    with socket.socket(socket.AF_UNIX) as connection:
        wait_until(lambda: connection.connect_ex(str(path)) == 0)
        yield connection


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


def test_a_link_to_what_a_killed_instance_left_elsewhere_stays(
    binding: Binding, runtime: Path, caplog: pytest.LogCaptureFixture
) -> None:
    runtime.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(runtime / "elsewhere"))
    (runtime / "status.sock").symlink_to(runtime / "elsewhere")
    meter, status = socket_of(binding)
    with Served(binding, [meter, status]):
        meter.wait_for_snapshot(5.0)
        assert status.path is None
    assert "no status socket" in caplog.text
    assert (runtime / "status.sock").is_symlink()
    assert (runtime / "elsewhere").is_socket()


def test_the_end_leaves_what_another_instance_has_made_there_since(binding: Binding, runtime: Path) -> None:
    path = runtime / "status.sock"
    with Served(binding, socket_of(binding)), socket.socket(socket.AF_UNIX) as other:
        wait_until(lambda: is_listening(path))
        path.unlink()
        other.bind(str(path))
    assert path.is_socket()


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
