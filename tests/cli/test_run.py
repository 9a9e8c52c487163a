"""`candaemon run` as a process: what a signal does, what a supervisor is told, and how fast it ends."""

from __future__ import annotations

import gc
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from candaemon.cli.main import main
from candaemon.cli.serve import ServeRequest, serve
from candaemon.daemon.process_signals import ServiceSignals
from candaemon.errors import ConfigError
from tests.support.paths import ROOT

PATIENCE_S = 30.0


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Return a configuration one of whose buses there is not."""
    text = (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("interface: virtual, channel: ins", "interface: socketcan, channel: nosuch9"))
    return path


class Service:
    """A service of this process's."""

    def __init__(self, config: Path, folder: Path) -> None:
        self.manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.manager.bind(str(folder / "notify"))
        self.manager.settimeout(PATIENCE_S)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "candaemon", "run", "--status", "0.2", str(config)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "200000"},
        )

    def wait_for(self, field: str) -> dict[str, str]:
        """Return the next message to the supervisor with a field."""
        while True:
            message = dict(line.split("=", 1) for line in self.manager.recv(4096).decode().splitlines())
            if field in message:
                return message

    def hears_more(self) -> bool:
        """Take the next message, if one comes within the time."""
        try:
            self.manager.recv(4096)
        except (TimeoutError, BlockingIOError):
            return False
        return True

    def stop(self, number: signal.Signals = signal.SIGTERM) -> tuple[str, str, float]:
        """Return what it said on both outputs and how long it took to end, s."""
        asked = time.monotonic()
        self.process.send_signal(number)
        out, talk = self.process.communicate(timeout=PATIENCE_S)
        return out, talk, time.monotonic() - asked


@pytest.fixture
def service(config: Path, tmp_path: Path) -> Iterator[Service]:
    service = Service(config, tmp_path)
    with service.manager, service.process:
        yield service
        service.process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_run_is_ready_without_a_bus_and_stops_on_a_signal(service: Service, number: signal.Signals) -> None:
    ready = service.wait_for("READY")
    assert ready["STATUS"] == "0 obstacles, 0 of 1 sensors, ego unknown, 0 lost; down: ins"
    service.wait_for("WATCHDOG")
    out, talk, seconds = service.stop(number)
    assert service.process.returncode == 0
    assert seconds < 1.5  # a second, and the interpreter's own end
    assert service.wait_for("STOPPING")
    assert out == ""
    assert re.search(r"bus 'ins': .*nosuch9", talk)
    assert "Traceback" not in talk


def test_sighup_loads_the_file_again_or_refuses_it(service: Service, config: Path) -> None:
    service.wait_for("READY")
    pid = service.process.pid
    good = config.read_text(encoding="utf-8")
    for text, expected in ((good.replace("Demo", "Other"), ""), (good + "more: 1\n", "reload refused"), (good, "")):
        config.write_text(text, encoding="utf-8")
        service.process.send_signal(signal.SIGHUP)
        assert int(service.wait_for("RELOADING")["MONOTONIC_USEC"]) > 0
        assert expected in service.wait_for("READY")["STATUS"]
    service.process.send_signal(signal.SIGUSR1)  # of no effect without a recording
    service.wait_for("WATCHDOG")
    _, talk, _ = service.stop()
    assert (service.process.pid, service.process.returncode) == (pid, 0)
    assert re.findall("reload refused|reloaded", talk) == ["reloaded", "reload refused", "reloaded"]
    assert re.search(r"mine\.yaml:\d+: more: found an unknown key|mine\.yaml:\d+: .*unknown key 'more'", talk)


@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGHUP])
def test_a_flood_of_signals_neither_ends_nor_holds_the_service(service: Service, number: signal.Signals) -> None:
    service.wait_for("READY")
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        for _ in range(1000):
            service.process.send_signal(number)
    assert service.wait_for("WATCHDOG")
    _, talk, _ = service.stop()
    assert service.process.returncode == 0
    assert "stopped; since the start" in talk
    assert "Traceback" not in talk


def catches(process: subprocess.Popen[str], number: signal.Signals) -> bool:
    """Return whether a process has a handler for a signal."""
    status = Path("/proc", str(process.pid), "status").read_text(encoding="ascii")
    caught = re.search(r"SigCgt:\s*(\w+)", status)
    return caught is not None and bool(int(caught[1], 16) >> (number - 1) & 1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_during_the_start_ends_it_with_a_message(service: Service, number: signal.Signals) -> None:
    while not catches(service.process, signal.SIGUSR1):
        assert service.process.poll() is None
    out, talk, _ = service.stop(number)
    assert (service.process.returncode, out) == (0, "")
    assert talk == f"candaemon: stopped by {number.name} before the service was ready\n"
    service.manager.setblocking(False)
    assert not service.hears_more()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, on which nothing can be written")
def test_a_signal_during_the_start_ends_it_whatever_catches_errors() -> None:
    within_try = """
import os, signal
from candaemon.daemon.process_signals import ServiceSignals
with ServiceSignals():
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except OSError:
        pass
    print("goes on")
"""
    with Path("/dev/full").open("wb") as full:
        told = subprocess.run([sys.executable, "-c", within_try], stdout=subprocess.PIPE, stderr=full, check=False)
    assert (told.returncode, told.stdout) == (0, b"")


def test_signals_during_the_start_are_looked_at_when_the_service_is_ready(service: Service) -> None:
    while not catches(service.process, signal.SIGUSR1):
        assert service.process.poll() is None
    for number in (signal.SIGHUP, signal.SIGUSR1, signal.SIGHUP):
        service.process.send_signal(number)
    service.wait_for("READY")
    service.wait_for("RELOADING")
    assert "reload" not in service.wait_for("READY")["STATUS"]
    _, talk, _ = service.stop()
    assert service.process.returncode == 0
    assert talk.count("reloaded:") == 1


def test_a_stopped_process_does_not_feed_the_watchdog(service: Service) -> None:
    service.wait_for("READY")
    service.wait_for("WATCHDOG")
    service.process.send_signal(signal.SIGSTOP)
    service.manager.settimeout(0.5)
    while service.hears_more():
        pass
    service.process.send_signal(signal.SIGCONT)
    service.manager.settimeout(PATIENCE_S)
    assert service.wait_for("WATCHDOG")


@pytest.mark.usefixtures("logging_as_it_was")
def test_an_unknown_interface_fails_before_a_bus_is_opened(config: Path) -> None:
    config.write_text(config.read_text(encoding="utf-8").replace("interface: socketcan", "interface: virtuel"))
    with pytest.raises(ConfigError, match=r"mine\.yaml:6: .*virtuel.*socketcan"):
        serve(ServeRequest(config), ServiceSignals())


def test_garbage_is_not_collected_while_it_starts_and_is_after_a_start_that_fails(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collects: list[bool] = []

    def failing(_request: ServeRequest, _signals: object) -> None:
        collects.append(gc.isenabled())
        raise ConfigError("wrong", file=config)

    monkeypatch.setattr("candaemon.cli.serve.serve", failing)
    assert main(["run", str(config)]) == 2
    assert collects == [False]
    assert gc.isenabled()


def test_a_wrong_configuration_reaches_the_journal_as_an_error(config: Path, tmp_path: Path) -> None:
    config.write_text("buses: none\n", encoding="utf-8")
    with (tmp_path / "journal").open("w+") as journal:
        found = os.fstat(journal.fileno())
        environment = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        command = [sys.executable, "-m", "candaemon", "run", str(config)]
        done = subprocess.run(command, stderr=journal, env=environment, timeout=PATIENCE_S, check=False)
        journal.seek(0)
        lines = journal.read().splitlines()
    assert done.returncode == 2
    assert lines
    assert all(line.startswith("<3>") for line in lines)
    assert lines[0].startswith(f"<3>error: {config}:1: buses")


@pytest.mark.usefixtures("logging_as_it_was")
def test_a_recording_without_a_folder_is_refused(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with config.open("a", encoding="utf-8") as file:
        file.write("service: {recording: {enabled: true}}\n")
    with pytest.raises(ConfigError, match=r"no folder to record into; .*--record DIR"):
        serve(ServeRequest(config), ServiceSignals())
