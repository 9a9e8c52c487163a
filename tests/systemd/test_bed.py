"""The bed is what the other tests take it for: a systemd that runs units of this project, and knows CAN interfaces."""

from __future__ import annotations

from collections.abc import Callable

from tests.beds.links import Link

from .units import INSTALLED, PROJECT, Unit, output

NOTIFY = """\
import os, socket, time
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as way:
    way.sendto(b"READY=1\\nSTATUS=as it should be", os.environ["NOTIFY_SOCKET"])
print("here", flush=True)
time.sleep(600)
"""

UNIT = f"""\
[Service]
Type=notify
ExecStart={INSTALLED}/python -c {NOTIFY!r}
"""

SANDBOX = ("DynamicUser=yes", "ProtectHome=yes", "PrivateTmp=yes", "ProtectSystem=strict")


def test_systemd_runs(booted: None) -> None:
    assert output("systemctl", "is-system-running") == "running"
    assert output("ps", "-p", "1", "-o", "comm=") == "systemd"


def test_a_unit_tells_its_status(install: Callable[[str, str], None], unit: Callable[[str], Unit]) -> None:
    install("told.service", UNIT)
    told = unit("told.service")
    told.ask("start")
    assert told.show("StatusText") == "as it should be"
    assert "here" in told.journal().splitlines()
    told.ask("stop")
    told.wait_for("ActiveState", "inactive")


def test_an_interface_is_a_device(booted: None, vcan0: Link) -> None:
    device = Unit("sys-subsystem-net-devices-vcan0.device")
    device.wait_for("SubState", "plugged")
    vcan0.delete()
    device.wait_for("SubState", "dead")


def test_the_installation_works_in_a_sandbox(booted: None) -> None:
    words = [word for each in SANDBOX for word in ("-p", each)]
    version = output("systemd-run", "--quiet", "--wait", "--pipe", *words, str(INSTALLED / "candaemon"), "--version")
    assert version.startswith("candaemon ")
    output("systemd-run", "--wait", *words, str(INSTALLED / "candaemon"), "check", str(PROJECT / "config/esr_ins.yaml"))
