"""`candaemon papers`: the five papers' experiments run again, beside their printed tables."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from candaemon.cli import console
from candaemon.cli.arguments import output_folder, output_path, seed, whole_number
from candaemon.files.outputs import Outputs, make_folder, write_file
from candaemon.papers.experiment import Experiment, Result
from candaemon.papers.json import to_json
from candaemon.papers.registry import choose
from candaemon.papers.text import print_result

MOST_RUNS: Final = 1000
"""Most Monte Carlo runs of an experiment: all are held in memory at once."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="paper (000 to 004, or its first author: han, avatirak, kim-hong, zhang, gao) or experiment (000-table-1; "
        "--list tells them); default: all",
    )
    parser.add_argument(
        "--runs",
        type=whole_number(1, MOST_RUNS),
        default=100,
        metavar="N",
        help="Monte Carlo runs of each; default: 100",
    )
    parser.add_argument("--seed", type=seed, default=1, metavar="N", help="of all random numbers; default: 1")
    parser.add_argument("--json", type=output_path, metavar="JSON", help="the figures, for programs")
    parser.add_argument("--plots", type=output_folder, metavar="DIR", help="folder for the drawings, as PNG and SVG")
    parser.add_argument("--list", action="store_true", help="tell which experiments there are, and run none")


def execute(arguments: argparse.Namespace) -> None:
    """Run the experiments one after another; each is printed and written as soon as it is done."""
    experiments = choose(arguments.names)
    if arguments.list:
        listed = tuple((experiment.name, experiment.title) for experiment in experiments)
        console.print_sheets([console.Sheet("experiments", listed, ("name", "what is compared"))])
        return
    draw = None if arguments.plots is None else _drawing(arguments.plots)
    done: list[tuple[Experiment, Result]] = []
    lost: OSError | None = None
    with Outputs() as outputs:
        figures = None if arguments.json is None else outputs.open(arguments.json)
        try:
            for number, experiment in enumerate(experiments, start=1):
                with console.share_progress(f"{experiment.name} ({number} of {len(experiments)})") as advance:
                    result = experiment.run(arguments.runs, arguments.seed, advance)
                done.append((experiment, result))
                if draw is not None:
                    draw(result)
                # printed and drawn at once, so that an interruption loses no finished result
                try:
                    print_result(console.console(), experiment, result, arguments.runs, arguments.seed)
                except OSError as error:
                    if figures is None and draw is None:
                        raise
                    lost = error  # the files are wanted still
        finally:
            if figures is not None and done:
                figures.stream.write(to_json(done, arguments.runs, arguments.seed).encode())
    if lost is not None:
        raise lost


def _drawing(folder: Path) -> Callable[[Result], None]:
    """Return what writes the drawings of an experiment into a folder, which is made."""
    from candaemon.papers.plots import draw  # noqa: PLC0415 - a slow import

    make_folder(folder)

    def write(result: Result) -> None:
        for figure in result.figures:
            for name, content in draw(figure).items():
                write_file(folder / name, content)

    return write
