"""`candaemon run`: the service in the foreground, as systemd starts it."""

from __future__ import annotations

import argparse
import gc
from importlib import import_module
from typing import Final

from candaemon.cli.arguments import CONFIG, input_path, number, output_folder
from candaemon.config.shipped import find_config

LONGEST_STATUS_INTERVAL: Final = 86_400.0
"""Longest time between two status lines, s."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "--record",
        type=output_folder,
        metavar="DIR",
        help="folder for the ring of what came last, see docs/operating.md",
    )
    parser.add_argument(
        "--status",
        type=number(0.0, LONGEST_STATUS_INTERVAL, "s"),
        metavar="S",
        help="s between status lines; 0: none; default: the configuration's",
    )
    parser.add_argument("--log", choices=("text", "json"), help="form of the log's lines; default: the configuration's")
    parser.add_argument(
        "--shadow", action="store_true", help="track and record, and send nothing: beside what drives, for comparison"
    )


def execute(arguments: argparse.Namespace) -> None:
    """Serve the configured buses."""
    gc.disable()  # until it serves: what is loaded until then stays
    try:
        service = import_module("candaemon.cli.serve")  # takes a second, in which a signal may come
        request = service.ServeRequest(
            find_config(arguments.config), arguments.record, arguments.status, arguments.log, arguments.shadow
        )
        service.serve(request, arguments.signals)
    finally:
        gc.enable()
