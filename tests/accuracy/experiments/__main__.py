"""Runs experiments on the tracker, and tells which bounds it meets: `python -m tests.accuracy.experiments --help`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from candaemon.cli.console import console
from candaemon.errors import CandaemonError
from candaemon.evaluation.printing import Section, print_sections
from tests.accuracy.experiments.finding import Effort, Experiment
from tests.accuracy.experiments.on_cost import COST
from tests.accuracy.experiments.on_failing_sensor import FAILING_SENSOR
from tests.accuracy.experiments.on_late_and_turned import LATE_AND_TURNED
from tests.accuracy.experiments.on_lidar_and_radar import LIDAR_AND_RADAR
from tests.accuracy.experiments.on_own_filters import OWN_FILTERS
from tests.accuracy.experiments.on_recorded_drive import RECORDED_DRIVE
from tests.accuracy.experiments.on_ring import RING
from tests.accuracy.experiments.on_unidentified import UNIDENTIFIED

EXPERIMENTS: Mapping[str, Experiment] = {
    "drive": RECORDED_DRIVE,
    "fusion": LIDAR_AND_RADAR,
    "failing": FAILING_SENSOR,
    "late": LATE_AND_TURNED,
    "ring": RING,
    "filtered": OWN_FILTERS,
    "identity": UNIDENTIFIED,
    "cost": COST,
}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    shown = argparse.ArgumentParser(
        prog="python -m tests.accuracy.experiments",
        description=__doc__,
        epilog="; ".join(f"{name}: {each.question}" for name, each in EXPERIMENTS.items()),
    )
    shown.add_argument("names", nargs="+", metavar="NAME", choices=[*EXPERIMENTS, "all"], help="of experiments, or all")
    shown.add_argument("--seeds", type=int, metavar="N", help="runs of each, seeds 1 to N; default: the experiment's")
    shown.add_argument("--tracker", nargs="+", default=(), metavar="KEY=VALUE", help="settings in place of defaults")
    shown.add_argument("--estimator", metavar="KIND", help="short for --tracker estimator.kind=KIND")
    shown.add_argument("--json", type=Path, metavar="FILE", help="all figures, for programs")
    return shown


def main(words: Sequence[str] | None = None) -> int:
    """Run and print; return the exit code."""
    shown = parser()
    arguments = shown.parse_args(words)
    tracker: tuple[tuple[str, Any], ...] = tuple(_setting(shown, word) for word in arguments.tracker)
    if arguments.estimator is not None:
        tracker = (("estimator.kind", arguments.estimator), *tracker)
    told: dict[str, Any] = {}
    for name in EXPERIMENTS if "all" in arguments.names else arguments.names:
        experiment = EXPERIMENTS[name]
        effort = Effort(tuple(range(1, (arguments.seeds or experiment.seeds) + 1)), tracker)
        try:
            findings = tuple(experiment.run(effort))
        except (CandaemonError, ValidationError) as error:
            shown.error(f"{name}: {error}")
        print_sections(console(), (experiment.section(name, findings), Section("legend", ("", ""), experiment.legend)))
        sys.stdout.flush()
        told[name] = [one.as_json() for one in findings]
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(told, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return 0


def _setting(shown: argparse.ArgumentParser, word: str) -> tuple[str, Any]:
    """Return a setting of the tracker from the command line."""
    key, equals, value = word.partition("=")
    if not equals:
        shown.error(f"argument --tracker: found {word!r}, expected KEY=VALUE, such as lifecycle.confirm=4")
    return key, yaml.safe_load(value)


if __name__ == "__main__":
    raise SystemExit(main())
