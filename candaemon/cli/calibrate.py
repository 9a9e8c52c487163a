"""`candaemon calibrate`: what recorded drives say of the latency, the yaw and the noise of each sensor."""

from __future__ import annotations

import argparse

import yaml

from candaemon.binding.bind import bind
from candaemon.calibration.proposals import Finding, patch, proposals
from candaemon.calibration.window import LEAST_SPEED
from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, LOG_FORMATS, add_channel_map, input_path, output_path
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.errors import ConfigError
from candaemon.files.outputs import Outputs
from candaemon.playback.calibrating import calibrate
from candaemon.playback.recording_files import files_of

_NOT_ENOUGH = "not enough"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "logs", type=input_path, nargs="+", metavar="LOG", help=f"{LOG_FORMATS}; or a recording's folder"
    )
    parser.add_argument(
        "-o", "--output", type=output_path, metavar="PATCH", help="YAML of the settings that should change"
    )
    add_channel_map(parser)


def execute(arguments: argparse.Namespace) -> None:
    """Replay the drives, print what they say, and write the settings that follow."""
    binding = bind(load_config(find_config(arguments.config)))
    console.warn(binding.warnings)
    if binding.ego is None:
        raise ConfigError(
            "the configuration's ego is static: what stands still says nothing of a sensor that does, too; "
            "give an ego of kind ins or odometry",
            file=binding.loaded.path,
            line=binding.loaded.line_of(("ego",)),
        )
    read = [path for log in arguments.logs for path in files_of(log)]
    with Outputs([*binding.files, *read]) as outputs:
        written = None if arguments.output is None else outputs.open(arguments.output)
        with console.log_progress("drives") as progress:
            found = calibrate(binding, arguments.logs, dict(arguments.map), progress)
        rows = proposals(binding, found)
        changes = patch(rows)
        if written is not None:
            written.stream.write(_text(changes, rows).encode())
    seconds = ", ".join(f"{name} {each.windows}" for name, each in found.items())
    header = ("", "unit", "configured", "found", "±", "proposed", "")
    console.print_sheets([console.Sheet(f"seconds of standing returns: {seconds}", tuple(map(_cells, rows)), header)])
    if all(row.found is None for row in rows):
        console.say(
            f"nothing can be told: a minute or more of returns that stand is needed, while the vehicle drives at "
            f"{LEAST_SPEED:g} m/s at least"
        )
    elif not changes:
        console.say("nothing to change")


def _cells(row: Finding) -> tuple[str, ...]:
    found = _NOT_ENOUGH if row.found is None else f"{row.found:g}"
    return (
        row.what,
        row.unit,
        "-" if row.configured is None else f"{row.configured:g}",
        found,
        "-" if row.uncertainty is None else f"{row.uncertainty:.2g}",
        "-" if row.proposed is None else f"{row.proposed:g}",
        row.remark,
    )


def _text(changes: dict[str, object], rows: list[Finding]) -> str:
    """Return the patch: the settings that change, as they stand in a configuration, and what is uncertain of them."""
    about = [f"# {row.what}: {row.configured:g} → {row.proposed:g} ± {row.uncertainty:.2g} {row.unit}" for row in rows
             if row.proposed is not None and row.configured is not None]  # fmt: skip
    body = yaml.safe_dump(changes, sort_keys=False, allow_unicode=True) if changes else "{}\n"
    return "\n".join(["# settings in place of those of the same names; all others stay", *about, body])
