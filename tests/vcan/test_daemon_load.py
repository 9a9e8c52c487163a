"""A whole service under load: nothing is lost at the rates it is made for, and beyond them every loss is known."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from candaemon.binding.bind import bind
from candaemon.can_io.logs.candump import candump_text
from candaemon.config.load import load_config
from tests.beds.can_utils import cangen, canplayer, cansend
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.own_kernel import Sysctl
from tests.beds.service import config_on

from .conftest import Drive
from .drives import LAP_S, lap
from .telling import Telling
from .whole import PLACES

CHANNELS = ["vcan0", "vcan1", "vcan2"]
SECONDS = 30.0
OWN_RATE = 180.0
"""Samples/s of four frames each: with the 1280 frames/s of the radar 2,000."""
FLOOD = 50_000
RECEIVE_BUFFER = 32 << 20
"""Bytes that the kernel grants at most."""


def patient(settings: dict[str, Any]) -> None:
    """Let the kernel keep ten seconds: a busy machine may leave user-mode Linux no time for as long."""
    for bus in settings["buses"].values():
        bus["receive_buffer"] = 10.0


@pytest.mark.limit(300)
def test_two_thousand_frames_a_second_are_all_taken(
    start: Start, sysctl: Sysctl, vcan0: Link, vcan1: Link, vcan2: Link, tmp_path: Path
) -> None:
    sysctl.set("net.core.rmem_max", RECEIVE_BUFFER)
    channels = dict(zip(("radar", "ins", "obstacles"), CHANNELS, strict=True))
    config = config_on("esr_ins", tmp_path, channels, patient)
    frames = lap(bind(load_config(config)), PLACES, own_rate=OWN_RATE)
    assert len(frames) == pytest.approx(2000 * LAP_S, rel=0.02)
    laps = round(SECONDS / LAP_S)
    log = tmp_path / "laps.log"
    lap_ns = round(LAP_S * 1e9)
    log.write_bytes(
        candump_text(
            [each._replace(time_ns=each.time_ns + k * lap_ns) for k in range(laps) for each in frames], CHANNELS
        )
    )
    service = Telling(start(config, RUNTIME_DIRECTORY=str(tmp_path)), tmp_path)
    service.wait_until_open()
    canplayer(log, {each: each for each in CHANNELS[:2]})
    status = service.settled()
    buses = status["buses"]
    sent = {"radar": vcan0.statistic("tx_packets"), "ins": vcan1.statistic("tx_packets")}
    assert sum(sent.values()) == laps * len(frames)
    lost = {name: buses[name]["dropped"]["kernel_lost"] for name in sent}
    assert {name: buses[name]["received"] + lost[name] for name in sent} == sent
    assert lost == dict.fromkeys(sent, 0)
    assert {name: buses[name]["taken"]["used"] for name in sent} == sent
    assert buses["obstacles"]["sent"] == status["cycles"]["frames"] <= vcan2.statistic("tx_packets")
    assert status["sensors"]["front"]["counts"]["scans"] == pytest.approx(SECONDS * 20, abs=2)
    assert status["tracks"]["confirmed"] + status["tracks"]["coasting"] == len(PLACES)


@pytest.mark.limit(300)
def test_a_flood_is_counted_to_the_last_frame(drive: Drive, vcan0: Link) -> None:
    whole = drive()
    before, sent = whole.pause(), vcan0.statistic("tx_packets")
    cangen(vcan0.name, "-g", "0", "-I", "501", "-L", "8", "-n", str(FLOOD))
    whole.service.signal(signal.SIGSTOP)  # a service that keeps up with a slow `cangen` loses nothing
    cangen(vcan0.name, "-g", "0", "-I", "501", "-L", "8", "-n", str(FLOOD))
    whole.service.signal(signal.SIGCONT)
    whole.pause()
    cansend(vcan0.name, "501#0000000000000000")  # with it the kernel tells what it has dropped
    after = whole.pause()
    assert vcan0.statistic("tx_packets") - sent == 2 * FLOOD + 1
    received, lost = (_gained(before, after, *path) for path in (("received",), ("dropped", "kernel_lost")))
    assert received + lost == 2 * FLOOD + 1
    assert lost > 0
    assert _gained(before, after, "taken", "used") == received
    whole.traffic.silent.clear()
    whole.track()


def _gained(before: dict[str, Any], after: dict[str, Any], *path: str) -> int:
    """Return by how much a count of the radar's bus has grown."""
    was, now = before["buses"]["radar"], after["buses"]["radar"]
    for name in path:
        was, now = was[name], now[name]
    return int(now) - int(was)
