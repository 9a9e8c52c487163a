"""`candaemon install-service`: the systemd unit that runs a configuration."""

from __future__ import annotations

import argparse

from candaemon.cli.arguments import CONFIG, input_path
from candaemon.cli.standard_streams import use_utf8
from candaemon.config.shipped import find_config
from candaemon.daemon.systemd_unit import install


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument("--print", action="store_true", help="write the unit to standard output, and nothing else")


def execute(arguments: argparse.Namespace) -> None:
    """Write the unit."""
    if arguments.print:
        use_utf8()  # as systemd reads units
    install(find_config(arguments.config), show=arguments.print)
