"""`candaemon radars`: the configurations that come with candaemon, and what each shows of the format."""

from __future__ import annotations

import argparse

from candaemon.cli.console import Sheet, print_sheets
from candaemon.cli.standard_streams import use_utf8
from candaemon.config.load import load_config
from candaemon.config.shipped import shared_folder


def add_arguments(_parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command has no arguments."""


def execute(_arguments: argparse.Namespace) -> None:
    """Print name, title and description of each configuration, in the order of their names."""
    use_utf8()
    folder = shared_folder() / "config"
    rows = []
    for path in sorted(folder.glob("*.yaml")):
        config = load_config(path).config
        rows += [(path.stem, config.name), ("", config.description)]
    print_sheets([Sheet(f"configurations, in {folder}", tuple(rows))])
