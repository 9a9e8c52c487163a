"""The bed is what the other tests take it for: a real vcan, and tools that work on it."""

from __future__ import annotations

import time
from pathlib import Path

import can
import pytest

from tests.beds.can_utils import candump, cangen, canplayer, cansend
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.own_kernel import OwnClock, Sysctl
from tests.beds.service import config_on


def test_a_sent_frame_is_received(vcan0: Link) -> None:
    with can.Bus(interface="socketcan", channel=vcan0.name, ignore_config=True) as bus:
        cansend(vcan0.name, "123#0102AB")
        message = bus.recv(5.0)
    assert message is not None
    assert (message.arbitration_id, bytes(message.data)) == (0x123, b"\x01\x02\xab")
    assert abs(message.timestamp - time.time()) < 60.0


def test_what_is_played_is_captured(vcan0: Link, vcan1: Link, tmp_path: Path) -> None:
    frames = [f"{0x100 + number:03X}#{number:02X}" for number in range(50)]
    log = tmp_path / "played.log"
    log.write_text(
        "".join(f"({1e9 + number / 200:.6f}) can{number % 2} {frame}\n" for number, frame in enumerate(frames))
    )
    with candump(tmp_path / "heard.log", vcan0.name, vcan1.name) as capture:
        began = time.monotonic()
        canplayer(log, {"can0": vcan0.name, "can1": vcan1.name})
        took = time.monotonic() - began
        capture.wait_for(len(frames))
    assert [line.frame for line in capture.lines(vcan0.name)] == frames[::2]
    assert [line.frame for line in capture.lines(vcan1.name)] == frames[1::2]
    assert took > 0.2


def test_a_full_transmit_queue_refuses_frames(vcan0: Link) -> None:
    vcan0.queue("tbf", "rate", "1kbit", "burst", "100", "limit", "300")
    cangen(vcan0.name, "-g", "0", "-i", "-n", "100")
    assert vcan0.statistic("tx_packets") < 50
    vcan0.no_queue()
    before = vcan0.statistic("tx_packets")
    cangen(vcan0.name, "-g", "0", "-n", "100")
    assert vcan0.statistic("tx_packets") == before + 100


def test_an_interface_goes_and_comes_back(vcan0: Link) -> None:
    with can.Bus(interface="socketcan", channel=vcan0.name, ignore_config=True) as bus:
        vcan0.down()
        with pytest.raises(can.CanError):
            bus.recv(5.0)
        vcan0.delete()
        assert not vcan0.exists
    vcan0.add(fd=True)
    with can.Bus(interface="socketcan", channel=vcan0.name, fd=True, ignore_config=True) as bus:
        cansend(vcan0.name, "123##0" + "11" * 64)
        message = bus.recv(5.0)
    assert message is not None
    assert len(message.data) == 64


def test_the_clock_and_the_limits_are_the_beds_own(own_clock: OwnClock, sysctl: Sysctl) -> None:
    before, beginning = time.time(), time.monotonic()
    own_clock.step(-3600.0)
    assert time.time() < before - 3590.0
    own_clock.restore()
    assert time.time() - before == pytest.approx(time.monotonic() - beginning, abs=1.0)
    limit = Path("/proc/sys/net/core/rmem_max")
    was = int(limit.read_text())
    sysctl.set("net.core.rmem_max", was + 4096)
    assert int(limit.read_text()) == was + 4096
    sysctl.restore()
    assert int(limit.read_text()) == was


def test_a_service_starts_and_stops(vcan0: Link, vcan1: Link, vcan2: Link, start: Start, tmp_path: Path) -> None:
    config = config_on("esr_ins", tmp_path, {"radar": vcan0.name, "ins": vcan1.name, "obstacles": vcan2.name})
    service = start(config, "--status", "0.2")
    service.wait_for("frames/s")
    cansend(vcan0.name, "500#0000000000000000")
    service.wait_for("frames/s", times=3)
    status, _ = service.stop()
    assert status == 0
