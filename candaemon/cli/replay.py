"""`candaemon replay`: a recorded drive through the pipeline."""

from __future__ import annotations

import argparse
import gc
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.cli import console
from candaemon.cli.arguments import (
    CONFIG,
    add_channel_map,
    add_logs,
    add_time_range,
    ended_input,
    input_path,
    logs_name,
    number,
    output_folder,
    output_path,
    refused,
    speed,
    time_range,
)
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.errors import ConfigError, InputError
from candaemon.exports.drive_tables import SUMMARIES, summary_rows
from candaemon.exports.foxglove_layout import layout
from candaemon.exports.parquet import SUFFIX, ParquetTable
from candaemon.files.outputs import Outputs
from candaemon.playback.recording_files import files_of
from candaemon.playback.replay import HORIZONS, ReplayRequest, replay
from candaemon.playback.stage_times import StageTimes, rows
from candaemon.playback.summary import doubts, require_used, summarise

LONGEST_LAG: Final = 10.0
"""Longest lag of smoothing, s: later measurements hardly change the estimate, and the effort grows with the lag."""
SHORTEST_LAG: Final = 0.001
"""Shortest lag of smoothing, s."""
SHORTEST_HORIZON: Final = 0.001
"""Shortest horizon of a prediction, s."""
LONGEST_HORIZON: Final = 60.0
"""Longest horizon of a prediction, s: a prediction is held in memory until it is due."""
MOST_HORIZONS: Final = 20
"""Most horizons of one replay."""
_NEW_OBJECTS: Final = 10_000
"""Objects made, less those freed, between two looks for unreachable ones. A look passes over the lists of a log's
block, which takes as long as two cycles; the cycles that wait to be written are some hundreds of objects."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    add_logs(parser)
    parser.add_argument("-o", "--output", type=output_path, metavar="OUT", help="log of the obstacles' frames")
    parser.add_argument(
        "--tracks", type=output_path, metavar="CSV", help="table of the obstacles, a row a cycle; or a .parquet"
    )
    parser.add_argument("--mcap", type=output_path, metavar="MCAP", help="the drive with its frames, for Foxglove")
    parser.add_argument("--layout", type=output_path, metavar="JSON", help="layout of Foxglove for such a drive")
    parser.add_argument(
        "--parquet", type=output_folder, metavar="DIR", help="folder for tracks, detections, cycles and summaries"
    )
    parser.add_argument(
        "--detections", type=output_path, metavar="CSV", help="table of what the sensors said and what became of it"
    )
    parser.add_argument(
        "--predictions", type=output_path, metavar="CSV", help="table of where each detection is expected"
    )
    parser.add_argument(
        "--horizons", type=horizons, default=HORIZONS, metavar="S,S", help="of the predictions; default: 0.5,1.0"
    )
    parser.add_argument(
        "--summary",
        type=output_path,
        metavar="JSON",
        help="figures of the drive, for programs, scores of the tracks among them",
    )
    parser.add_argument("--speed", type=speed, metavar="X", help="times real time; default: as fast as it goes")
    parser.add_argument(
        "--smooth",
        type=number(SHORTEST_LAG, LONGEST_LAG, "s"),
        metavar="S",
        help="smooth the tracks in the tables with so many s of what comes, such as 1; what is sent stays as it is",
    )
    parser.add_argument("--profile", action="store_true", help="tell where the time goes, by stage")
    add_time_range(parser)
    parser.add_argument(
        "--fresh", action="store_true", help="begin with nothing, even where a recording says what the service knew"
    )
    add_channel_map(parser)


def execute(arguments: argparse.Namespace) -> None:
    """Replay, print the summary, and warn of sensors without a usable frame."""
    binding = bind(load_config(find_config(arguments.config)))
    console.warn(binding.warnings)
    channels = [channel for channel, _ in arguments.map]
    twice = sorted({channel for channel in channels if channels.count(channel) > 1})
    if twice:
        raise ConfigError(f"--map gives {', '.join(twice)} to several buses; a channel has one")
    request = ReplayRequest(
        arguments.log[0],
        arguments.output,
        arguments.tracks,
        arguments.predictions,
        arguments.horizons,
        arguments.speed,
        dict(arguments.map),
        arguments.smooth,
        arguments.fresh,
        arguments.parquet,
        arguments.mcap,
        tuple(arguments.log[1:]),
        time_range(arguments),
        arguments.detections,
        scored=arguments.summary is not None or arguments.parquet is not None,
    )
    name = logs_name(request.logs)
    check_request(request, binding)
    times = StageTimes() if arguments.profile else None
    with Outputs([*binding.files, *files_of(*request.logs)]) as outputs:
        summary = None if arguments.summary is None else outputs.open(arguments.summary)
        with console.log_progress(name) as progress, ended_input(request.logs), _seldom_collected():
            replayed = replay(binding, request, progress, outputs, times=times)
        figures = summarise(replayed)
        if arguments.layout is not None:
            outputs.open(arguments.layout).stream.write(layout(binding).encode())
        if request.parquet is not None:
            with ParquetTable(outputs.open(request.parquet / f"{SUMMARIES.name}{SUFFIX}"), SUMMARIES) as table:
                table.add(*summary_rows(figures))
        if summary is not None:
            summary.stream.write(f"{json.dumps(figures, indent=2, allow_nan=False)}\n".encode())
        try:
            require_used(request.log, figures)
        except InputError:
            console.print_figures(name, figures)
            raise
    console.print_figures(name, figures)
    if times is not None:
        cells = rows(times.seconds(), replayed.pipeline.counts.cycles)
        console.print_sheets([console.Sheet("processor time", cells, ("stage", "s", "share", "µs/cycle"))])
    console.say(f"replayed in {replayed.seconds:.2f} s, {replayed.log.frames / replayed.seconds:,.0f} frames/s")
    console.warn_of_log(doubts(figures))


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Look for unreachable objects seldom: a replay makes none but some hundred at its start."""
    usual = gc.get_threshold()
    gc.set_threshold(_NEW_OBJECTS, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def check_request(request: ReplayRequest, binding: Binding) -> None:
    """Refuse what can be checked before the log is read."""
    buses = {bus.name for bus in binding.buses}
    for channel, bus in request.channels.items():
        if bus not in buses:
            raise ConfigError(f"--map {channel}={bus}: no bus '{bus}'; expected one of {', '.join(sorted(buses))}")
    if request.output is not None and binding.output is None:
        raise ConfigError(
            f"-o {request.output}: the configuration has no 'output', so there are no frames to write; add one",
            file=binding.loaded.path,
        )
    if request.smooth is not None and request.tracks is None and request.parquet is None:
        raise ConfigError("--smooth is for the table of obstacles; name it with --tracks or --parquet")


def horizons(text: str) -> tuple[float, ...]:
    """Read times in s with commas between; return them in order, without repetition."""
    found = tuple(sorted({_horizon(part) for part in text.split(",")}))
    if len(found) > MOST_HORIZONS:
        raise refused(text, f"{MOST_HORIZONS} times at most")
    return found


_horizon = number(SHORTEST_HORIZON, LONGEST_HORIZON, "s")
