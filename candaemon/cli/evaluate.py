"""`candaemon evaluate`: tracks compared with the truth."""

from __future__ import annotations

import argparse

from candaemon.cli import console
from candaemon.cli.arguments import input_path, output_path
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.printing import print_evaluation
from candaemon.files.outputs import Outputs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("tracks", type=input_path, metavar="TRACKS", help="table in CSV that replay --tracks wrote")
    parser.add_argument("truth", type=input_path, metavar="TRUTH", help="table that simulate --truth wrote")
    parser.add_argument("--json", type=output_path, metavar="JSON", help="the figures, for programs")


def execute(arguments: argparse.Namespace) -> None:
    """Compare and print."""
    with Outputs([arguments.tracks, arguments.truth]) as outputs:
        figures = None if arguments.json is None else outputs.open(arguments.json)
        evaluation = evaluate(arguments.tracks, arguments.truth)
        if figures is not None:
            figures.stream.write(evaluation.to_json().encode())
    print_evaluation(console.console(), evaluation)
