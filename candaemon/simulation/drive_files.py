"""Writes a simulation to files: a log of its frames, a table of its truth."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.write import open_log_writer
from candaemon.evaluation.tables import TrackWriter
from candaemon.simulation.simulate import Simulation

_CHUNK = 4096


def record(simulation: Simulation, binding: Binding, log: Path, truth: Path | None = None) -> int:
    """Write a simulated drive.

    Args:
        simulation: the drive.
        binding: the configuration it was made with.
        log: path of the log; its suffix determines the format.
        truth: path of the table of truth; None: it is not written.

    Returns:
        The number of frames.

    Raises:
        InputError: a file cannot be written.
    """
    count = 0
    frames = simulation.frames()
    with open_log_writer(log, log_channels(binding)) as writer:
        while chunk := list(islice(frames, _CHUNK)):
            writer.write(chunk)
            count += len(chunk)
    if truth is not None:
        write_truth(simulation, truth)
    return count


def write_truth(simulation: Simulation, path: Path) -> None:
    """Write a simulation's table of truth."""
    with TrackWriter(path) as table:
        for cycle in simulation.truth():
            table.write_cycle(cycle.time_ns, cycle.columns)


def log_channels(binding: Binding) -> list[str]:
    """Return each bus's channel name in logs."""
    return [bus.settings.log_channel or bus.settings.channel for bus in binding.buses]
