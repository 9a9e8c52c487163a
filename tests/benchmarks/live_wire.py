"""The buses of a live benchmark: three multicast groups, and a configuration that runs on them."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from candaemon.can_io.receive_buffer import FRAME_BITS

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
ESR_DBC, INS_DBC = ROOT / "dbc/esr.dbc", ROOT / "dbc/oxts.dbc"
GROUPS = ("239.74.163.2", "239.74.163.3", "239.74.163.4")
BITRATES = (500_000, 1_000_000, 10_000_000)
SLOTS = 64
FRAMES_A_CYCLE = 80
"""The radar's targets, and four times the four messages of the INS."""
OWN_MOTION_SHARE = 1 / 20
"""Samples of the INS to all frames."""


@dataclass(frozen=True, slots=True)
class Wire:
    """UDP ports of the buses; their order and names are those of the configurations.

    Each has a port as well as a group of its own: a socket hears every group that the machine has joined.
    """

    radar: int
    ins: int
    obstacles: int

    def addresses(self) -> list[tuple[str, int]]:
        """Return group and port of each bus."""
        return list(zip(GROUPS, (self.radar, self.ins, self.obstacles), strict=True))


def free_wire() -> Wire:
    """Return ports that nobody uses."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as a,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as b,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as c,
    ):
        for each in (a, b, c):
            each.bind(("", 0))
        return Wire(*(each.getsockname()[1] for each in (a, b, c)))


def cycle_time(rate: float) -> float:
    """Return the radar's cycle in s at which radar and INS together send `rate` frames/s."""
    return FRAMES_A_CYCLE / rate


def on_wire(config: Path, wire: Wire, rate: float, folder: Path) -> Path:
    """Write a configuration of this project with its buses on the wire, its radar as quick as the rate asks."""
    settings: dict[str, Any] = yaml.safe_load(config.read_text(encoding="utf-8"))
    bitrate = next(each for each in BITRATES if rate * FRAME_BITS <= each)
    for bus, (group, port) in zip(settings["buses"].values(), wire.addresses(), strict=True):
        bus |= {"interface": "udp_multicast", "channel": group, "options": {"port": port}, "bitrate": bitrate}
    settings["sensors"]["front"]["cycle_time"] = cycle_time(rate)
    for part in (settings["ego"], settings["sensors"]["front"], settings["output"]):
        part["dbc"] = str((config.parent / part["dbc"]).resolve())
    path = folder / f"live-{config.name}"
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    return path
