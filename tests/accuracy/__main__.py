"""Measures how accurate the tracker is, beside two references: `python -m tests.accuracy --help`."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from candaemon.cli.console import console
from candaemon.config.load import load_config
from candaemon.errors import CandaemonError
from candaemon.evaluation.printing import print_sections
from tests.accuracy.measured import measured, to_stderr
from tests.accuracy.score_tables import as_json, notes, sections
from tests.accuracy.simulated_runs import Job, bound, scenario_of
from tests.support.paths import ROOT

FALLBACK = ("highway", "stop_and_go", "intersection", "guard_rail", "turning_ego")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    shown = argparse.ArgumentParser(prog="python -m tests.accuracy", description=__doc__)
    shown.add_argument("--scenarios", nargs="+", metavar="NAME", help="of config/scenarios, or paths; all of traffic_*")
    shown.add_argument("--configs", nargs="+", metavar="NAME", help="of config, or paths; default: one of each radar")
    shown.add_argument("--seeds", type=int, default=10, metavar="N", help="runs of each, seeds 1 to N; default: 10")
    shown.add_argument(
        "--tracker",
        nargs="+",
        default=(),
        metavar="KEY=VALUE",
        help="settings of the tracker, such as lifecycle.confirm=4; the word default drops those of the YAML",
    )
    shown.add_argument("--estimator", metavar="KIND", help="short for --tracker estimator.kind=KIND")
    shown.add_argument("--processes", type=int, default=os.cpu_count() or 1, metavar="N", help="default: one a core")
    shown.add_argument("--json", type=Path, metavar="FILE", help="all figures, for programs")
    return shown


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print; return the exit code."""
    shown = parser()
    arguments = shown.parse_args(words)
    scenarios = _scenarios(arguments.scenarios)
    configs = configurations(arguments.configs)
    tracker = tuple(_setting(shown, word) for word in arguments.tracker)
    if arguments.estimator is not None:
        tracker = (("estimator.kind", arguments.estimator), *tracker)
    try:
        for path in configs:
            bound(path, tracker)
        for path in scenarios:
            scenario_of(path)
    except (CandaemonError, ValidationError) as error:
        shown.error(str(error))
    jobs = [
        Job(config, scenario, seed, tracker)
        for seed in range(1, arguments.seeds + 1)
        for scenario in scenarios
        for config in configs
    ]
    result = measured(jobs, arguments.processes, to_stderr)
    if not result.scores:
        shown.error("; ".join(sorted(set(result.refused.values()))))
    shown_on = console()
    print_sections(shown_on, sections(result))
    for line in notes(result):
        shown_on.out(line)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(as_json(result), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return 0


def _scenarios(names: Sequence[str] | None) -> list[Path]:
    """Return the scenarios' files."""
    folder = ROOT / "config" / "scenarios"
    if names is None:
        traffic = sorted(folder.glob("traffic_*.yaml"))
        return traffic or [folder / f"{name}.yaml" for name in FALLBACK]
    return [_file(folder, name) for name in names]


def configurations(names: Sequence[str] | None) -> list[Path]:
    """Return the configurations' files: those given, or one of each radar that is shipped on a vehicle that moves."""
    folder = ROOT / "config"
    if names is not None:
        return [_file(folder, name) for name in names]
    found: dict[str, Path] = {}
    # the demonstration has a radar that others have too
    for path in sorted(folder.glob("*.yaml"), key=lambda path: (path.stem == "demo", path.stem)):
        config = load_config(path).config
        if config.ego.kind != "static":
            radars = [each.model_dump(exclude={"bus", "dbc"}) for each in config.sensors.values()]
            found.setdefault(repr((radars, config.ego.kind)), path)
    return list(found.values())


def _file(folder: Path, name: str) -> Path:
    """Return a file by its name in a folder, or by its path."""
    return Path(name) if name.endswith(".yaml") else folder / f"{name}.yaml"


def _setting(shown: argparse.ArgumentParser, word: str) -> tuple[str, Any]:
    """Return a setting of the tracker from the command line."""
    key, equals, value = word.partition("=")
    if key == "default":
        return key, None
    if not equals:
        shown.error(f"argument --tracker: found {word!r}, expected KEY=VALUE, such as lifecycle.confirm=4")
    return key, yaml.safe_load(value)


if __name__ == "__main__":
    raise SystemExit(main())
