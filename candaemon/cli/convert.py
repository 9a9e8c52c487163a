"""`candaemon convert`: logs of a drive as one log of another format."""

from __future__ import annotations

import argparse

from candaemon.cli import console
from candaemon.cli.arguments import add_logs, add_time_range, ended_input, logs_name, output_path, time_range
from candaemon.playback.convert import convert
from candaemon.playback.recording_files import unfolded


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_logs(parser, "IN")
    parser.add_argument("output", type=output_path, metavar="OUT", help="the log to write; its name says the format")
    add_time_range(parser)


def execute(arguments: argparse.Namespace) -> None:
    """Convert, and print what was written."""
    name = logs_name(arguments.log)
    with console.log_progress(name) as progress, ended_input(arguments.log):
        converted = convert(unfolded(arguments.log), arguments.output, time_range(arguments), progress)
    console.print_figures(
        arguments.output.name,
        {"frames": sum(converted.frames.values()), "channels": converted.frames, "lines": converted.log.lines},
    )
    if converted.lost:
        console.say(f"not written: {'; '.join(converted.lost)}")
