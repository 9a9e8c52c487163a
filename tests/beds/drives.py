"""Simulated drives, played onto real interfaces."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from candaemon.frames.frame import EXTENDED
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.paths import ROOT

from .can_utils import background


def write_drive(
    path: Path, config: str, channels: Mapping[str, str], seconds: float, buses: Collection[str] | None = None
) -> Path:
    """Write a highway drive as a candump log.

    Args:
        path: of the log.
        config: name of a configuration of the project, whose sensors see the drive.
        channels: interface by bus.
        seconds: length of the drive, s.
        buses: whose frames are written; None: those of all.

    Returns:
        The path.
    """
    bound = binding(config)
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    with path.open("w", encoding="ascii") as log:
        for frame in simulate(scenario.model_copy(update={"duration": seconds}), bound, 5).frames():
            bus = bound.buses[frame.bus].name
            if buses is None or bus in buses:
                microseconds = frame.time_ns // 1000
                digits = 8 if frame.can_id & EXTENDED else 3
                log.write(
                    f"({microseconds // 1_000_000}.{microseconds % 1_000_000:06d}) {channels[bus]} "
                    f"{frame.can_id & ~EXTENDED:0{digits}X}#{frame.data.hex()}\n"
                )
    return path


class Drive:
    """The traffic of several buses, each played again and again until it is stopped.

    Args:
        logs: of the buses, by name.
    """

    def __init__(self, logs: Mapping[str, Path]) -> None:
        self._logs = logs
        self._playing: dict[str, ExitStack] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(*self._playing)

    def play(self, *buses: str) -> None:
        """Begin to play the traffic of some buses, from its beginning."""
        for bus in buses:
            self._playing[bus] = ExitStack()
            self._playing[bus].enter_context(background("canplayer", "-l", "i", "-I", str(self._logs[bus])))

    def stop(self, *buses: str) -> None:
        """Let some buses be silent."""
        for bus in buses:
            self._playing.pop(bus).close()
