"""What systemd is told, read from the other end of its socket."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import DaemonView, Observer
from candaemon.daemon.reload import Reloader
from candaemon.errors import ConfigError
from candaemon.status.sd_notify import SystemdNotifier, SystemdObserver
from candaemon.status.service_monitor import ServiceMonitor
from tests.support.bound import binding


class Manager:
    """The service manager's end."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)

    def heard(self) -> list[dict[str, str]]:
        """Return the messages that have come."""
        messages: list[dict[str, str]] = []
        while True:
            try:
                text = self.socket.recv(4096).decode()
            except BlockingIOError:
                return messages
            messages.append(dict(line.split("=", 1) for line in text.splitlines()))


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(str(tmp_path / "notify"))
    with manager.socket:
        yield manager


@pytest.fixture
def notifier(manager: Manager, tmp_path: Path) -> SystemdNotifier:
    return SystemdNotifier(str(tmp_path / "notify"), watchdog_s=2.0)


def test_a_value_is_no_second_field(notifier: SystemdNotifier, manager: Manager) -> None:
    assert notifier.notify(STATUS="down: a\nWATCHDOG=trigger\udcff\u2028")
    assert manager.heard() == [{"STATUS": r"down: a\nWATCHDOG=trigger\udcff\u2028"}]


class Steps:
    """A daemon turned by hand, and the clock of its supervision."""

    def __init__(self, notifier: SystemdNotifier, reloader: Reloader | None = None) -> None:
        self.now_s = 0.0
        self.supervision = SystemdObserver(notifier, ServiceMonitor(MetricsSettings()), lambda: self.now_s)
        self.daemon = Daemon(binding("demo"), observers=[self.supervision, Stop()], reloader=reloader)

    def turn(self, seconds: float) -> None:
        self.now_s += seconds
        self.supervision.on_iteration(self.daemon)


class Stop(Observer):
    """Stops the daemon when it has turned once."""

    def on_iteration(self, daemon: DaemonView) -> None:
        daemon.stop()


def test_what_systemd_left_in_the_environment_is_taken_out_of_it(tmp_path: Path, manager: Manager) -> None:
    environment = {
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": "3000000",
        "WATCHDOG_PID": str(os.getpid()),
        "HOME": "/",
    }
    notifier = SystemdNotifier.from_environment(environment)
    assert environment == {"HOME": "/"}
    assert notifier.watchdog_s == 3.0
    assert notifier.notify(READY=1, STATUS="12 obstacles")
    assert manager.heard() == [{"READY": "1", "STATUS": "12 obstacles"}]


def test_the_watchdog_of_another_process_is_not_ours() -> None:
    assert SystemdNotifier.from_environment({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}).watchdog_s == 0.0


def test_an_abstract_socket_is_reached() -> None:
    name = f"candaemon-test-{os.getpid()}"
    manager = Manager(f"\0{name}")
    with manager.socket:
        assert SystemdNotifier(f"@{name}").notify(READY=1)
        assert manager.heard() == [{"READY": "1"}]


def test_without_systemd_and_after_it_has_gone_nobody_is_told(tmp_path: Path) -> None:
    assert not SystemdNotifier().notify(READY=1)
    assert not SystemdNotifier(str(tmp_path / "gone")).notify(READY=1)


def test_a_run_is_ready_tells_its_status_and_stops(manager: Manager, notifier: SystemdNotifier) -> None:
    steps = Steps(notifier)
    with steps.daemon:
        steps.daemon.run()
    first, *_, last = manager.heard()
    assert first["READY"] == "1"
    assert first["STATUS"] == "0 obstacles, 0 of 1 sensors, ego unknown, 0 lost"
    assert last["STOPPING"] == "1"


def test_what_finds_the_managers_queue_full_is_told_again(manager: Manager, notifier: SystemdNotifier) -> None:
    steps = Steps(notifier)
    while notifier.notify(STATUS="of another"):
        pass
    steps.supervision.on_start(steps.daemon)
    steps.turn(1.5)  # the watchdog is due
    assert all(message == {"STATUS": "of another"} for message in manager.heard())
    steps.turn(0.01)
    steps.turn(1.0)
    told = manager.heard()
    assert told[0] == {"WATCHDOG": "1"}
    assert [message.get("READY") for message in told[1:]].count("1") == 1
    steps.turn(1.5)
    assert not [message for message in manager.heard() if "READY" in message]


def test_a_reload_that_finds_the_managers_queue_full_is_told_in_order(
    manager: Manager, notifier: SystemdNotifier
) -> None:
    steps = Steps(notifier)
    while notifier.notify(STATUS="of another"):
        pass
    for error in ("", "found 'x'"):
        steps.supervision.on_reload_begin(steps.daemon)
        steps.supervision.on_reload_end(steps.daemon, error)
    assert all(message == {"STATUS": "of another"} for message in manager.heard())
    steps.turn(0.01)
    told = manager.heard()
    assert ["RELOADING" in message for message in told] == [True, False, True, False]
    assert [message.get("READY") for message in told] == [None, "1", None, "1"]
    steps.turn(0.01)
    assert not manager.heard()


def test_no_status_overtakes_an_answer_that_is_owed(manager: Manager, notifier: SystemdNotifier) -> None:
    class Full(SystemdNotifier):
        """A queue that has room for what is short."""

        full = True

        def notify(self, **fields: str | int) -> bool:
            return not (self.full and fields.keys() - {"STATUS", "WATCHDOG"}) and notifier.notify(**fields)

    full = Full()
    steps = Steps(full)
    steps.supervision.on_reload_begin(steps.daemon)
    steps.supervision.on_reload_end(steps.daemon, "found 'x'")
    steps.turn(1.5)
    assert not manager.heard()
    full.full = False
    steps.turn(0.01)
    *_, ready, status = manager.heard()
    assert (ready["READY"], ready["STATUS"].endswith("reload refused: found 'x'")) == ("1", True)
    assert status.keys() == {"STATUS"}


def test_a_missing_bus_does_not_hold_ready_back_but_is_told(manager: Manager, notifier: SystemdNotifier) -> None:
    steps = Steps(notifier)
    steps.supervision.on_start(steps.daemon)  # whose buses nobody has opened
    assert manager.heard()[0]["STATUS"].endswith("0 lost; down: radar, ins, obstacles")


def test_the_watchdog_is_fed_by_turns_at_half_its_period(manager: Manager, notifier: SystemdNotifier) -> None:
    steps = Steps(notifier)
    for _ in range(1000):
        steps.turn(0.01)
    fed = [message for message in manager.heard() if "WATCHDOG" in message]
    assert 9 <= len(fed) <= 10
    steps.now_s += 100.0  # the loop hangs
    assert not [message for message in manager.heard() if "WATCHDOG" in message]


def test_the_status_is_told_once_until_it_changes(manager: Manager, notifier: SystemdNotifier) -> None:
    steps = Steps(notifier)
    for _ in range(1000):
        steps.turn(0.01)
    assert len([message for message in manager.heard() if "STATUS" in message]) == 1


@pytest.mark.parametrize("refused", [False, True])
def test_a_reload_is_told_from_its_begin_to_its_end(manager: Manager, notifier: SystemdNotifier, refused: bool) -> None:
    def load() -> Binding:
        if refused:
            raise ConfigError("found 'x', expected a number", file="my.yaml", line=7)
        return binding("demo")

    class StopReloaded(Observer):
        def on_reload_end(self, daemon: DaemonView, error: str) -> None:  # noqa: ARG002  # the hook's signature
            daemon.stop()

    supervision = SystemdObserver(notifier, ServiceMonitor(MetricsSettings()))
    daemon = Daemon(binding("demo"), observers=[supervision, StopReloaded()], reloader=Reloader(load))
    with daemon:
        daemon.reload()
        daemon.run()
    told = [message for message in manager.heard() if {"RELOADING", "READY", "STOPPING"} & message.keys()]
    assert ["RELOADING" in message for message in told] == [False, True, False, False]
    assert int(told[1]["MONOTONIC_USEC"]) > 0
    assert told[2]["READY"] == "1"
    refusal = "reload refused: my.yaml:7: found 'x', expected a number"
    assert told[2]["STATUS"].endswith(refusal) == refused
