"""Status and metrics of the shipped unit: open to every user of the machine, through the sandbox it runs in."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from tests.beds.service import config_on
from tests.beds.waiting import wait_until
from tests.support.paths import ROOT

from .units import INSTALLED, PROJECT, Unit, output

TEMPLATE = "candaemon@.service"
PORT = 9464
SOCKET = Path("/run/candaemon/van/status.sock")


@pytest.fixture
def van(install: Callable[[str, str], None], unit: Callable[[str], Unit]) -> Iterator[Unit]:
    """Start the shipped unit for a configuration with an endpoint for Prometheus, its interfaces missing."""

    def with_metrics(settings: dict[str, Any]) -> None:
        settings["service"] = {"metrics": {"port": PORT}}

    folder = Path("/etc/candaemon")
    folder.mkdir(exist_ok=True)
    channels = {"radar": "vcan0", "ins": "vcan1", "obstacles": "vcan2"}
    config = config_on("esr_ins", folder, channels, change=with_metrics, project=PROJECT).rename(folder / "van.yaml")
    install(TEMPLATE, (ROOT / "config" / "systemd" / TEMPLATE).read_text(encoding="utf-8"))
    van = unit("candaemon@van.service")
    van.ask("start")
    yield van
    van.ask("stop")
    config.unlink()


def told_to_nobody(*options: str) -> str:
    """Return what `candaemon status` tells a user without any rights."""
    return output(
        "systemd-run", "--quiet", "--wait", "--pipe", "--property=User=nobody",
        str(INSTALLED / "candaemon"), "status", *options,
    )  # fmt: skip


def test_every_user_is_told_and_a_killed_service_tells_again(van: Unit) -> None:
    pid = van.show("MainPID")
    plain = told_to_nobody("van", "--once")
    assert re.search(r"^  radar +down: .*vcan0", plain, re.MULTILINE)
    figures = json.loads(told_to_nobody("--json"))
    assert figures["service"]["instance"] == "van"
    assert figures["service"]["config"] == "/etc/candaemon/van.yaml"
    assert figures["service"]["memory"] > 10e6
    output("systemctl", "kill", "--signal=SIGKILL", van.name)
    wait_until(lambda: van.show("MainPID") not in {pid, "0"} and van.show("ActiveState") == "active", 60.0, van.journal)
    assert json.loads(told_to_nobody("van", "--json"))["service"]["pid"] == int(van.show("MainPID"))
    van.ask("stop")
    assert not SOCKET.exists()
    assert "Traceback" not in van.journal()


def test_metrics_are_scraped_on_the_loopback(van: Unit) -> None:
    with urlopen(f"http://127.0.0.1:{PORT}/metrics", timeout=30.0) as answer:
        metrics = answer.read().decode()
    assert 'candaemon_bus_up{bus="radar"} 0.0' in metrics
    assert re.search(r"^process_resident_memory_bytes [1-9]", metrics, re.MULTILINE)
    van.ask("stop")
    assert "Traceback" not in van.journal()
