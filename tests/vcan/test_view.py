"""The view beside a service on a real vcan: it draws what the service sends, and costs it no frame."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from aiohttp import ClientSession, WSMsgType

from tests.beds.drives import Drive, write_drive
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.own_kernel import Sysctl
from tests.beds.service import config_on
from tests.beds.waiting import wait_until

from .telling import Telling
from .test_daemon_load import RECEIVE_BUFFER, patient

CONFIG = "toyota_rav4_ins"
CHANNELS = {"car": "vcan3", "radar": "vcan0", "ins": "vcan1", "obstacles": "vcan2"}
DRIVE_S = 4.0
BROWSERS = 10
PICTURES = 30
CONFIRM_S = 10.0


@contextmanager
def viewing(config: Path, folder: Path) -> Iterator[str]:
    """Run `candaemon view` beside; give its address."""
    command = [sys.executable, "-m", "candaemon", "view", str(config), "--port", "0"]
    said = folder / "view.log"
    environment = os.environ | {"XDG_RUNTIME_DIR": str(folder)}
    with said.open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, env=environment)
    try:
        wait_until(lambda: "http://" in said.read_text(), 60.0, lambda: f"an address in {said.read_text()}")
        yield next(line for line in said.read_text().splitlines() if line.startswith("http://"))
        assert process.poll() is None, said.read_text()
    finally:
        process.terminate()
        process.wait(30)


async def looked(url: str) -> list[int]:
    """Look with so many browsers at once, and one that reads nothing; return how many pictures showed obstacles."""
    async with ClientSession() as session:
        silent = await session.ws_connect(f"{url}live")
        found = await asyncio.gather(*(browsed(session, url) for _ in range(BROWSERS)))
        told = 0
        async with asyncio.timeout(6 * CONFIRM_S):
            async for message in silent:  # it confirms nothing: it gets what fits on the way, and is hung up on
                told += message.type is WSMsgType.TEXT
        assert told <= 3
        return found


async def browsed(session: ClientSession, url: str) -> int:
    """Look as a browser does until so many pictures showed obstacles of the bus, or too long; return how many did.

    One picture alone tells nothing: where the bed is starved, scans come in bursts, and obstacles are born anew.
    """
    seen = 0
    async with session.ws_connect(f"{url}live") as socket:
        with suppress(TimeoutError):
            async with asyncio.timeout(120):
                while seen < PICTURES:
                    message = json.loads((await socket.receive()).data)
                    if "n" in message:
                        await socket.send_json({"do": "shown", "n": message["n"]})
                    pictures = message.get("pictures", ())
                    seen += sum(picture["heard"] and len(picture["obstacles"]["id"]) > 0 for picture in pictures)
    return seen


@pytest.mark.limit(300)
def test_ten_browsers_cost_the_service_no_frame(
    start: Start,
    sysctl: Sysctl,
    make_link: Callable[..., Link],
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    links = {bus: make_link(channel) for bus, channel in CHANNELS.items()}
    logs = {
        bus: write_drive(tmp_path / f"{bus}.log", CONFIG, CHANNELS, DRIVE_S, buses={bus}) for bus in ("radar", "ins")
    }
    sysctl.set("net.core.rmem_max", RECEIVE_BUFFER)
    config = config_on(CONFIG, tmp_path, CHANNELS, patient)
    service = Telling(start(config, RUNTIME_DIRECTORY=str(tmp_path)), tmp_path)
    service.wait_until_open()
    with Drive(logs) as drive:
        drive.play("radar", "ins")
        alone = service.wait_until_told(lambda told: told["cycles"]["told"] > 100, "a hundred cycles")
        with viewing(config, tmp_path) as url:
            seen = asyncio.run(looked(url))
        assert min(seen) >= PICTURES
        drive.stop("radar", "ins")
        status = service.settled()
    sent = {bus: links[bus].statistic("tx_packets") for bus in ("radar", "ins")}
    assert {bus: status["buses"][bus]["received"] for bus in sent} == sent
    assert all(status["buses"][bus]["dropped"]["kernel_lost"] == 0 for bus in sent)
    both = {name: told["cycle_time"]["p50"] * 1e3 for name, told in (("alone", alone), ("with ten browsers", status))}
    record_property("benchmark", f"service on a vcan, cycle time p50: {both} ms")
