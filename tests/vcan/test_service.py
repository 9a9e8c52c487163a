"""The service on a real vcan as a process: its log while a link flaps, its end, a reload amidst traffic."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.beds.drives import Drive, write_drive
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.service import Service, config_on
from tests.beds.waiting import wait_until

CONFIG: Final = "toyota_rav4_ins"
CHANNELS = {"car": "vcan3", "radar": "vcan0", "ins": "vcan1", "obstacles": "vcan2"}
DRIVE_S = 4.0
TRACKING = r"[1-9]\d* obstacles, own motion ok"


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("drive")
    return {bus: write_drive(folder / f"{bus}.log", CONFIG, CHANNELS, DRIVE_S, buses={bus}) for bus in ("radar", "ins")}


@pytest.fixture
def drive(logs: dict[str, Path], make_link: Callable[..., Link]) -> Iterator[Drive]:
    for channel in CHANNELS.values():
        make_link(channel)
    with Drive(logs) as drive:
        drive.play("radar", "ins")
        yield drive


@pytest.fixture
def service(drive: Drive, start: Start, tmp_path: Path) -> Service:
    """Start a service that tracks."""
    service = start(config_on(CONFIG, tmp_path, CHANNELS), "--status", "0.5")
    wait_for_status(service, TRACKING)
    return service


def last_status(service: Service) -> str:
    lines = [line for line in service.said.splitlines() if "frames/s" in line]
    return lines[-1] if lines else ""


def wait_for_status(service: Service, pattern: str, timeout_s: float = 40.0) -> None:
    """Return as soon as a status line that comes from here on says something."""
    before = service.said.count("frames/s")

    def there() -> bool:
        return service.said.count("frames/s") > before and re.search(pattern, last_status(service)) is not None

    wait_until(there, timeout_s, lambda: f"{pattern!r}; it said\n{service.said}")


def test_a_link_that_flaps_neither_ends_the_service_nor_floods_the_log(service: Service, drive: Drive) -> None:
    pid, link = service.pid, Link("vcan0")
    drive.stop("radar")  # canplayer ends when its interface is down
    for _ in range(20):
        link.down()
        time.sleep(0.05)
        link.up()
        time.sleep(0.05)
    drive.play("radar")
    wait_for_status(service, TRACKING)
    assert service.pid == pid
    assert len([line for line in service.said.splitlines() if "bus 'radar' is" in line]) <= 10


def test_the_service_stops_soon(service: Service, record_property: Callable[[str, object], None]) -> None:
    status, seconds = service.stop()
    record_property("benchmark", f"service on a vcan stopped after {seconds:.2f} s; goal 1 s")
    assert status == 0
    assert "Traceback" not in service.said


def test_a_reload_amidst_traffic_keeps_the_obstacles(service: Service, tmp_path: Path) -> None:
    path = tmp_path / f"{CONFIG}.yaml"
    path.write_text(path.read_text(encoding="utf-8") + "ordering_window: 0.01\n", encoding="utf-8")
    service.signal(signal.SIGHUP)
    line = service.wait_for("reloaded: unchanged: front, own motion, output")
    assert re.search(r"; [1-9]\d* obstacles kept", line)
    wait_for_status(service, TRACKING)
