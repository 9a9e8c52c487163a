"""`candaemon simulate`: the frames of a scenario through the sensors of a configuration."""

from __future__ import annotations

import argparse

from candaemon.binding.bind import bind
from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, LOG_FORMATS, SCENARIO, input_path, output_path, seed
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config, find_scenario
from candaemon.files.outputs import Outputs
from candaemon.simulation.drive_files import record
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("scenario", type=input_path, metavar="SCENARIO", help=SCENARIO)
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument("-o", "--output", type=output_path, required=True, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--truth", type=output_path, metavar="CSV", help="table of the truth")
    parser.add_argument(
        "--origins", type=output_path, metavar="CSV", help="table of what each reported object is in the truth"
    )
    parser.add_argument("--seed", type=seed, metavar="N", help="of all random numbers; default: the scenario's")


def execute(arguments: argparse.Namespace) -> None:
    """Write the frames, and the truth and the objects' origins if requested."""
    path = find_scenario(arguments.scenario)
    scenario = load_scenario(path)
    binding = bind(load_config(find_config(arguments.config)))
    with Outputs([path, *binding.files]) as outputs:
        simulation = simulate(scenario, binding, arguments.seed)
        frames = record(simulation, binding, arguments.output, arguments.truth, outputs, origins=arguments.origins)
    console.print_figures(arguments.output.name, {"frames": frames, "seconds": scenario.duration})
