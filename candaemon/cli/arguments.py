"""Common to several commands: help texts, and argument types for numbers and for what is read and written."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Final

from candaemon.can_io.logs.stream import STANDARD_INPUT
from candaemon.can_io.time_range import DriveMoment, TimeRange, moment
from candaemon.cli.standard_streams import input_ended_by_interrupt
from candaemon.errors import ConfigError
from candaemon.printable import printable

CONFIG: Final = "configuration (YAML), or the name of one that comes with candaemon"
SCENARIO: Final = "scenario (YAML), or the name of one that comes with candaemon"
LOG_FORMATS: Final = (
    ".log (candump), .asc, .blf, .csv, .mf4, .pcap, .pcapng, .trc, by its suffix; .gz, .xz or .zst after it too"
)

LARGEST_SEED: Final = 2**64 - 1
"""Largest seed of random numbers."""
SLOWEST: Final = 0.001
"""Least multiple of real time."""
FASTEST: Final = 1_000_000.0
"""Largest multiple of real time."""

STANDARD_OUTPUT: Final = Path("/dev/stdout")
"""The file that goes to standard output."""

_LONGEST_QUOTED = 60  # characters


def input_path(text: str) -> Path:
    """Read the path of what a command reads."""
    return _path(text)


def output_path(text: str) -> Path:
    """Read the path of a file that a command writes; `-` is standard output."""
    return STANDARD_OUTPUT if text == "-" else _path(text)


def output_folder(text: str) -> Path:
    """Read the path of a folder that a command writes to."""
    return _path(text)


def log_path(text: str) -> Path:
    """Read the path of a log; `-` is standard input."""
    return STANDARD_INPUT if text == "-" else _path(text)


def logs_name(logs: Sequence[Path]) -> str:
    """Return what logs that are read together are called."""
    name = "standard input" if logs[0] == STANDARD_INPUT else logs[0].name
    return name if len(logs) == 1 else f"{name} and {len(logs) - 1} more"


def ended_input(logs: Sequence[Path]) -> AbstractContextManager[None]:
    """Let Ctrl-C end what comes through standard input, where that is read; its results stay."""
    return input_ended_by_interrupt() if STANDARD_INPUT in logs else nullcontext()


def add_logs(parser: argparse.ArgumentParser, metavar: str = "LOG") -> None:
    """Add the argument of the logs of a drive."""
    parser.add_argument(
        "log",
        type=log_path,
        nargs="+",
        metavar=metavar,
        help=f"{LOG_FORMATS}; several are one drive; - for standard input; or the folder of a recording",
    )


def add_channel_map(parser: argparse.ArgumentParser) -> None:
    """Add the argument of which channel of a log is which bus."""
    parser.add_argument(
        "--map",
        type=channel_of_bus,
        action="append",
        default=[],
        metavar="CHANNEL=BUS",
        help="the log's CHANNEL is the configuration's BUS; repeatable",
    )


def channel_of_bus(text: str) -> tuple[str, str]:
    """Read CHANNEL=BUS."""
    channel, sign, bus = text.rpartition("=")  # no bus has that sign in its name
    if not (channel and sign and bus):
        raise refused(text, "CHANNEL=BUS, such as can1=radar")
    return channel, bus


def add_time_range(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a range of time."""
    what = "s from the drive's beginning, @ s since 1970, or a date and time such as 2018-08-02T16:14:48Z"
    parser.add_argument("--from", dest="begin", type=drive_moment, metavar="TIME", help=f"begin there: {what}")
    parser.add_argument("--to", dest="end", type=drive_moment, metavar="TIME", help="end before that, likewise")


def time_range(arguments: argparse.Namespace) -> TimeRange:
    """Return the range of time that the arguments ask for.

    Raises:
        ConfigError: it ends before it begins.
    """
    begin, end = arguments.begin, arguments.end
    if begin and end and begin.since_begin == end.since_begin and end.time_ns <= begin.time_ns:
        raise ConfigError("--to is not after --from: nothing lies between them")
    return TimeRange(begin, end)


def drive_moment(text: str) -> DriveMoment:
    """Read a moment of a drive."""
    try:
        return moment(text)
    except ValueError:
        raise refused(text, "s such as 12.5, @1533226488.5, or 2018-08-02T16:14:48Z") from None


def _path(text: str) -> Path:
    if not text:
        raise refused(text, "a path")
    return Path(text)


def refused(text: str, expected: str) -> argparse.ArgumentTypeError:
    """Return the error of an argument that is not what is expected."""
    return argparse.ArgumentTypeError(f"found '{printable(text, _LONGEST_QUOTED)}', expected {expected}")


def number(least: float, most: float, unit: str = "") -> Callable[[str], float]:
    """Return a reader of numbers within bounds, both included."""
    expected = f"a number from {least:.12g} to {most:.12g} {unit}".rstrip()

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise refused(text, expected)
        return value

    return read


def whole_number(least: int, most: int) -> Callable[[str], int]:
    """Return a reader of whole numbers within bounds, both included."""
    expected = f"a whole number from {least} to {most}"

    def read(text: str) -> int:
        digits = text.isascii() and text.isdigit() and len(text) <= len(str(most))
        if not (digits and least <= int(text) <= most):
            raise refused(text, expected)
        return int(text)

    return read


seed = whole_number(0, LARGEST_SEED)
"""Reads the seed of random numbers."""
speed = number(SLOWEST, FASTEST)
"""Reads a multiple of real time."""
