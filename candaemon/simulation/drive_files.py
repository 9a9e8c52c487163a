"""Writes a simulation to files: a log of its frames, tables of its truth and of its objects' origins."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import islice
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.write import open_log_writer
from candaemon.evaluation.tables import TRUTH_COLUMNS, OriginWriter, TrackWriter
from candaemon.files.outputs import Outputs
from candaemon.simulation.simulate import Simulation

_CHUNK = 4096


def record(
    simulation: Simulation,
    binding: Binding,
    log: Path,
    truth: Path | None = None,
    outputs: Outputs | None = None,
    *,
    origins: Path | None = None,
) -> int:
    """Write a simulated drive.

    Args:
        simulation: the drive.
        binding: the configuration it was made with.
        log: path of the log; its suffix determines the format.
        truth: path of the table of truth; None: it is not written.
        outputs: where the files are written among others, made with all that is read; None: they are all.
        origins: path of the table of what the sensors' objects are; None: it is not written.

    Returns:
        The number of frames.

    Raises:
        ConfigError: a file would be written over one that is read.
        InputError: a file cannot be written.
    """
    count = 0
    frames = simulation.frames()
    with ExitStack() as files:
        outputs = outputs or files.enter_context(Outputs(binding.files))
        writer = files.enter_context(open_log_writer(outputs.open(log), log_channels(binding)))
        table = files.enter_context(TrackWriter(outputs.open(truth), TRUTH_COLUMNS)) if truth is not None else None
        sources = files.enter_context(OriginWriter(outputs.open(origins))) if origins is not None else None
        while chunk := list(islice(frames, _CHUNK)):
            writer.write(chunk)
            count += len(chunk)
        if table is not None:
            write_truth(simulation, table)
        if sources is not None:
            names = [sensor.name for sensor in binding.sensors]
            for scan in simulation.origins():
                sources.write_scan(scan.time_ns, scan.measured_ns, names[scan.sensor], scan.object_id, scan.source)
    return count


def write_truth(simulation: Simulation, table: TrackWriter) -> None:
    """Write the truth of a simulation to a table."""
    for cycle in simulation.truth():
        table.write_cycle(cycle.time_ns, cycle.columns)


def log_channels(binding: Binding) -> list[str]:
    """Return each bus's channel name in logs."""
    return [bus.settings.log_channel or bus.settings.channel for bus in binding.buses]
