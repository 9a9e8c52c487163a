"""`candaemon simulate`: the frames of a scenario through the sensors of a configuration."""

from __future__ import annotations

import argparse
from pathlib import Path

from candaemon.binding.bind import bind
from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, LOG_FORMATS, SCENARIO
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config, find_scenario
from candaemon.simulation.drive_files import record
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help=SCENARIO)
    parser.add_argument("config", type=Path, metavar="CONFIG", help=CONFIG)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--truth", type=Path, metavar="CSV", help="table of the truth")
    parser.add_argument("--seed", type=int, metavar="N", help="of all random numbers; default: the scenario's")


def execute(arguments: argparse.Namespace) -> None:
    """Write the frames, and the truth if requested."""
    scenario = load_scenario(find_scenario(arguments.scenario))
    binding = bind(load_config(find_config(arguments.config)))
    frames = record(simulate(scenario, binding, arguments.seed), binding, arguments.output, arguments.truth)
    console.print_figures(arguments.output.name, {"frames": frames, "seconds": scenario.duration})
