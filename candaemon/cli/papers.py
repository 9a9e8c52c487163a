"""`candaemon papers`: the five papers' experiments run again, beside their printed tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from candaemon.cli import console
from candaemon.files.atomic import atomic_write, check_writable, make_folder
from candaemon.papers.experiment import Experiment, Result
from candaemon.papers.json import to_json
from candaemon.papers.registry import choose
from candaemon.papers.text import print_result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="paper (000 to 004, or its first author: han, avatirak, kim-hong, zhang, gao) or experiment (000-table-1; "
        "--list tells them); default: all",
    )
    parser.add_argument("--runs", type=count, default=100, metavar="N", help="Monte Carlo runs of each; default: 100")
    parser.add_argument("--seed", type=whole, default=1, metavar="N", help="of all random numbers; default: 1")
    parser.add_argument("--json", type=Path, metavar="JSON", help="the figures, for programs")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="folder for the drawings, as PNG and SVG")
    parser.add_argument("--list", action="store_true", help="tell which experiments there are, and run none")


def execute(arguments: argparse.Namespace) -> None:
    """Run the experiments one after another; each is printed and written as soon as it is done."""
    experiments = choose(arguments.names)
    if arguments.list:
        listed = tuple((experiment.name, experiment.title) for experiment in experiments)
        console.print_sheets([console.Sheet("experiments", listed, ("name", "what is compared"))])
        return
    if arguments.json is not None:
        check_writable(arguments.json)
    if arguments.plots is not None:
        make_folder(arguments.plots)
    done: list[tuple[Experiment, Result]] = []
    for number, experiment in enumerate(experiments, start=1):
        with console.share_progress(f"{experiment.name} ({number} of {len(experiments)})") as advance:
            result = experiment.run(arguments.runs, arguments.seed, advance)
        # printed at once, so that an interruption loses no finished result
        print_result(console.console(), experiment, result, arguments.runs, arguments.seed)
        done.append((experiment, result))
        if arguments.json is not None:
            atomic_write(arguments.json, to_json(done, arguments.runs, arguments.seed))
        if arguments.plots is not None:
            _plot(result, arguments.plots)


def _plot(result: Result, folder: Path) -> None:
    """Write the drawings of an experiment."""
    from candaemon.papers.plots import draw  # noqa: PLC0415 - matplotlib is an extra

    for figure in result.figures:
        for name, content in draw(figure).items():
            atomic_write(folder / name, content)


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
