"""The command line: which commands there are and what each takes."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeAlias

from candaemon._version import __version__

Command: TypeAlias = Callable[[argparse.Namespace], None]

_CONFIG = "configuration (YAML), or the name of one that comes with candaemon"
_SCENARIO = "scenario (YAML), or the name of one that comes with candaemon"
LONGEST_LAG = 10.0
"""Longest lag of smoothing, s: what comes later tells nothing of a manoeuvre, and the work grows with it."""
_LOG_FORMATS = ".log (candump), .asc, .blf, .csv, .trc, by its suffix; .gz after it too"


def parse(commands: Mapping[str, Command], argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line.

    Args:
        commands: the function of each command; its docstring's first line is the help.
        argv: the arguments; None: the process's own.

    Returns:
        The arguments; `command` is the function.
    """
    parser = argparse.ArgumentParser(
        prog="candaemon",
        description="Radar objects on a CAN bus in, obstacles with a lasting identity out.",
        epilog="Exit code: 0 done, 1 failed, 2 wrong usage or configuration.",
    )
    parser.add_argument("--version", action="version", version=f"candaemon {__version__}")
    adders = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in commands.items():
        about = (command.__doc__ or "").strip().splitlines()[0]
        adder = adders.add_parser(name, help=about, description=about)
        adder.set_defaults(command=command)
        _ARGUMENTS[name](adder)
    return parser.parse_args(argv)


def _demo(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenario", type=Path, default=Path("highway"), help=f"{_SCENARIO}; default: highway")
    parser.add_argument("--duration", type=positive, default=20.0, metavar="S", help="s of the drive; default: 20")
    parser.add_argument("--seed", type=int, default=1, help="of all random numbers; default: 1")
    parser.add_argument(
        "--speed", type=positive, help="times real time; default: 4 on a terminal, elsewhere as fast as it goes"
    )


def _run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG", help=_CONFIG)
    parser.add_argument(
        "--record", type=Path, metavar="DIR", help="folder for the ring of what came last, see the README"
    )
    parser.add_argument(
        "--status", type=not_negative, metavar="S", help="s between status lines; 0: none; default: the configuration's"
    )
    parser.add_argument("--log", choices=("text", "json"), help="form of the log's lines; default: the configuration's")


def _status(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "instance", nargs="?", metavar="NAME", help="of candaemon@NAME; default: the only one that runs"
    )
    parser.add_argument("--socket", type=Path, metavar="PATH", help="the instance's socket, if it is elsewhere")
    parser.add_argument("--once", action="store_true", help="show it once and end; default where no terminal is")
    parser.add_argument("--json", action="store_true", help="the figures once, for programs")


def _install_service(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG", help=_CONFIG)
    parser.add_argument("--print", action="store_true", help="write the unit to standard output, and nothing else")


def _replay(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG", help=_CONFIG)
    parser.add_argument("log", type=Path, metavar="LOG", help=f"{_LOG_FORMATS}; or the folder of a recording")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT", help="log of the obstacles' frames")
    parser.add_argument("--tracks", type=Path, metavar="CSV", help="table of the obstacles, a row a cycle")
    parser.add_argument("--predictions", type=Path, metavar="CSV", help="table of where each detection is expected")
    parser.add_argument(
        "--horizons", type=horizons, default=(0.5, 1.0), metavar="S,S", help="of the predictions; default: 0.5,1.0"
    )
    parser.add_argument("--summary", type=Path, metavar="JSON", help="figures of the drive, for programs")
    parser.add_argument("--speed", type=positive, metavar="X", help="times real time; default: as fast as it goes")
    parser.add_argument(
        "--smooth",
        type=lag,
        metavar="S",
        help="smooth the table of --tracks with so many s of what comes, such as 1; what is sent stays as it is",
    )
    parser.add_argument(
        "--fresh", action="store_true", help="begin with nothing, even where a recording says what the service knew"
    )
    parser.add_argument(
        "--map",
        type=channel_of_bus,
        action="append",
        default=[],
        metavar="CHANNEL=BUS",
        help="the log's CHANNEL is the configuration's BUS; repeatable",
    )


def _check(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG", help=_CONFIG)


def _simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help=_SCENARIO)
    parser.add_argument("config", type=Path, metavar="CONFIG", help=_CONFIG)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="LOG", help=_LOG_FORMATS)
    parser.add_argument("--truth", type=Path, metavar="CSV", help="table of the truth")
    parser.add_argument("--seed", type=int, metavar="N", help="of all random numbers; default: the scenario's")


def _evaluate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("tracks", type=Path, metavar="TRACKS", help="table that replay --tracks wrote")
    parser.add_argument("truth", type=Path, metavar="TRUTH", help="table that simulate --truth wrote")
    parser.add_argument("--json", type=Path, metavar="JSON", help="the figures, for programs")


def _papers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="paper (000 to 004) or experiment (000-table-1; --list tells them); default: all",
    )
    parser.add_argument("--runs", type=count, default=100, metavar="N", help="Monte Carlo runs of each; default: 100")
    parser.add_argument("--seed", type=whole, default=1, metavar="N", help="of all random numbers; default: 1")
    parser.add_argument("--json", type=Path, metavar="JSON", help="the figures, for programs")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="folder for the drawings, as PNG and SVG")
    parser.add_argument("--list", action="store_true", help="tell which experiments there are, and run none")


def _schema(_parser: argparse.ArgumentParser) -> None:
    """Add nothing: it takes no arguments."""


_ARGUMENTS: dict[str, Callable[[argparse.ArgumentParser], None]] = {
    "demo": _demo,
    "run": _run,
    "status": _status,
    "install-service": _install_service,
    "replay": _replay,
    "check": _check,
    "simulate": _simulate,
    "evaluate": _evaluate,
    "papers": _papers,
    "schema": _schema,
}


def positive(text: str) -> float:
    """Read a finite number over 0."""
    value = not_negative(text)
    if value == 0.0:
        raise argparse.ArgumentTypeError(f"found {text}, expected a number over 0")
    return value


def not_negative(text: str) -> float:
    """Read a finite number, 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"found '{text}', expected a number, 0 or more")
    return value


def count(text: str) -> int:
    """Read a whole number over 0."""
    value = whole(text)
    if value == 0:
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number over 0")
    return value


def whole(text: str) -> int:
    """Read a whole number, 0 or more."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"found '{text}', expected a whole number, 0 or more")
    return int(text)


def lag(text: str) -> float:
    """Read s over 0 and at most `LONGEST_LAG`."""
    value = positive(text)
    if value > LONGEST_LAG:
        raise argparse.ArgumentTypeError(f"found {text}, expected {LONGEST_LAG:g} s at most")
    return value


def horizons(text: str) -> tuple[float, ...]:
    """Read times in s with commas between; returns them in order, each once."""
    return tuple(sorted({positive(part) for part in text.split(",")}))


def channel_of_bus(text: str) -> tuple[str, str]:
    """Read CHANNEL=BUS."""
    channel, sign, bus = text.partition("=")
    if not (channel and sign and bus):
        raise argparse.ArgumentTypeError(f"found '{text}', expected CHANNEL=BUS, such as can1=radar")
    return channel, bus
