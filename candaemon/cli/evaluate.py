"""`candaemon evaluate`: tracks compared with the truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from candaemon.cli import console
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.printing import print_evaluation
from candaemon.files.atomic import atomic_write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("tracks", type=Path, metavar="TRACKS", help="table that replay --tracks wrote")
    parser.add_argument("truth", type=Path, metavar="TRUTH", help="table that simulate --truth wrote")
    parser.add_argument("--json", type=Path, metavar="JSON", help="the figures, for programs")


def execute(arguments: argparse.Namespace) -> None:
    """Compare and print."""
    evaluation = evaluate(arguments.tracks, arguments.truth)
    if arguments.json is not None:
        atomic_write(arguments.json, evaluation.to_json())
    print_evaluation(console.console(), evaluation)
