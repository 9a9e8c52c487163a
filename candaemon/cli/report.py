"""`candaemon report`: a recorded drive as one page."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.stream import STANDARD_INPUT
from candaemon.cli import console
from candaemon.cli.arguments import (
    CONFIG,
    STANDARD_OUTPUT,
    add_channel_map,
    add_logs,
    add_time_range,
    ended_input,
    input_path,
    logs_name,
    output_path,
    time_range,
)
from candaemon.cli.replay import check_request
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.config.yaml_file import LARGEST_FILE
from candaemon.evaluation.metrics import evaluate
from candaemon.files.bounded import read_bounded
from candaemon.files.outputs import Outputs
from candaemon.playback.recording_files import files_of
from candaemon.playback.replay import HORIZONS, ReplayRequest, replay
from candaemon.playback.summary import doubts, require_used, summarise
from candaemon.report.drive_page import ReportedDrive, page
from candaemon.report.drive_record import DriveRecord

DEFAULT: Final = Path("report.html")
"""Where the report is written unless told otherwise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    add_logs(parser)
    parser.add_argument(
        "-o", "--output", type=output_path, default=DEFAULT, metavar="HTML", help=f"the report; default: {DEFAULT}"
    )
    parser.add_argument("--truth", type=input_path, metavar="CSV", help="table that simulate --truth wrote: errors too")
    parser.add_argument("--summary", type=output_path, metavar="JSON", help="the figures, for programs")
    add_time_range(parser)
    add_channel_map(parser)


def execute(arguments: argparse.Namespace) -> None:
    """Replay the drive and write the page."""
    binding = bind(load_config(find_config(arguments.config)))
    console.warn(binding.warnings)
    truth = [] if arguments.truth is None else [arguments.truth]
    with TemporaryDirectory() as folder, Outputs([*binding.files, *files_of(*arguments.log), *truth]) as outputs:
        request = ReplayRequest(
            arguments.log[0],
            tracks=None if arguments.truth is None else Path(folder) / "tracks.csv",
            channels=dict(arguments.map),
            further=tuple(arguments.log[1:]),
            time_range=time_range(arguments),
        )
        check_request(request, binding)
        whole = outputs.open(arguments.output)
        summary = None if arguments.summary is None else outputs.open(arguments.summary)
        record = DriveRecord(tuple(sensor.name for sensor in binding.sensors))
        name = logs_name(request.logs)
        with console.log_progress(name) as progress, ended_input(request.logs), Outputs([]) as passing:
            replayed = replay(binding, request, progress, passing, sinks=[record])
        figures = summarise(replayed)
        require_used(request.log, figures)
        errors: dict[str, Any] | None = None
        if request.tracks is not None:
            errors = json.loads(evaluate(request.tracks, arguments.truth).to_json())
        text = read_bounded(binding.loaded.path, LARGEST_FILE, special=True).decode(errors="replace")
        drive = ReportedDrive(binding, name, _view(binding, request), figures, record, HORIZONS, text, errors)
        whole.stream.write(page(drive).encode())
        if summary is not None:
            summary.stream.write(f"{json.dumps(figures, indent=2, allow_nan=False)}\n".encode())
    console.warn_of_log(doubts(figures))
    if arguments.output != STANDARD_OUTPUT:
        console.say(f"{arguments.output} is the report; open it in a browser")


def _view(binding: Binding, request: ReplayRequest) -> str:
    """Return the command that shows the same drive; none where it is gone, or its times count from elsewhere."""
    if STANDARD_INPUT in request.logs or not request.time_range.is_all:
        return ""
    maps = (f" --map {channel}={bus}" for channel, bus in request.channels.items())
    return f"candaemon view {binding.loaded.path} {' '.join(map(str, request.logs))}{''.join(maps)}"
