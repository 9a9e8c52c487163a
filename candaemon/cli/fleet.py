"""`candaemon fleet`: many drives computed, reported and compared."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, add_channel_map, input_path, number, output_path, refused, whole_number
from candaemon.cli.replay import LONGEST_LAG, SHORTEST_LAG
from candaemon.cli.report import DEFAULT
from candaemon.config.shipped import find_config
from candaemon.errors import ConfigError, InputError
from candaemon.exports.extras import import_extra
from candaemon.files.outputs import Outputs
from candaemon.fleet.comparison import (
    LEAST_CHANGE,
    TOLERANCE,
    Comparison,
    change_text,
    compare,
    markdown,
    sentences,
    value_text,
)
from candaemon.fleet.dataset import ReplayOptions
from candaemon.fleet.drive_list import drives_of
from candaemon.fleet.drive_task import DriveOrder, DriveOutcome
from candaemon.fleet.fleet_figures import FleetFigures, files_read, load_figures
from candaemon.fleet.fleet_page import page as fleet_page
from candaemon.fleet.fleet_page import report_of
from candaemon.fleet.fleet_run import FleetResult, configurations_of, orders_of, run_fleet
from candaemon.fleet.locations import is_local, local_path
from candaemon.fleet.result_store import store_at
from candaemon.fleet.workers import PATIENCE_S, Workers
from candaemon.printable import printable
from candaemon.report.drive_page import printable_lines
from candaemon.similar_names import listed_names

MOST_WORKERS: Final = 1024
"""Most processes of this machine."""
MOST_PERCENT: Final = 1000.0
"""Largest change that a limit of a comparison may be."""
_FAILED_NAMED: Final = 20
"""Drives that failed, or are worse, that are told on a terminal; all are in the files."""

FAIL_ON: Final[Mapping[str, Callable[[Comparison], bool]]] = {
    "regression": lambda found: bool(found.regressions),
    "drive": lambda found: bool(found.worse_drives),
    "difference": lambda found: any(each.verdict != "no difference" for each in found.figures),
    "bytes": lambda found: bool(found.same_figures or found.changed),
    "missing": lambda found: bool(found.missing or found.other_logs),
}
"""What a comparison may be asked to fail on: a figure that is worse over all drives, a drive that is worse by more than
the tolerance, any figure that differs, a byte that differs, a drive that is missing or has another log."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    about = "Replay many drives, on all cores or on a Dask cluster, into one dataset."
    _add_run(commands.add_parser("run", help=about, description=about))
    about = "Write a page about all drives of a run."
    _add_report(commands.add_parser("report", help=about, description=about))
    about = "Compare two runs drive by drive: regressions first."
    _add_compare(commands.add_parser("compare", help=about, description=about))


def execute(arguments: argparse.Namespace) -> None:
    """Execute one of the commands."""
    arguments.execute_fleet(arguments)


def location(text: str) -> str:
    """Read a path or URL."""
    if not text:
        raise refused(text, "a path or URL")
    return text


def _add_run(parser: argparse.ArgumentParser) -> None:
    where = "or a location of fsspec, such as s3://bucket/folder"
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "log", type=location, nargs="*", metavar="LOG", help=f"logs, patterns, folders of logs or recordings; {where}"
    )
    parser.add_argument("-o", "--output", type=location, required=True, metavar="DIR", help=f"the results; {where}")
    parser.add_argument(
        "--manifest",
        type=location,
        action="append",
        default=[],
        metavar="FILE",
        help="CSV or Parquet with a row a drive: log, drive, configuration, tags; repeatable",
    )
    parser.add_argument(
        "--scheduler", type=location, metavar="ADDRESS", help="of Dask, such as tcp://host:8786; default: this machine"
    )
    parser.add_argument(
        "--workers", type=whole_number(1, MOST_WORKERS), metavar="N", help="processes here; default: one a core"
    )
    parser.add_argument("--memory", metavar="SIZE", help="of each, such as 4GiB; default: equal shares")
    add_channel_map(parser)
    parser.add_argument(
        "--smooth", type=number(SHORTEST_LAG, LONGEST_LAG, "s"), metavar="S", help="as of replay: smooth the tracks"
    )
    parser.add_argument("--verify", action="store_true", help="hash logs too that seem unchanged since the last run")
    parser.set_defaults(execute_fleet=run)


def run(arguments: argparse.Namespace) -> None:
    """Compute what is not there yet; fail where a drive did."""
    if arguments.scheduler is not None and (arguments.workers is not None or arguments.memory is not None):
        raise ConfigError("--workers and --memory are for processes of this machine; leave them out with --scheduler")
    import_extra("pyarrow", "fleet", "a run of a fleet")
    options = ReplayOptions(dict(arguments.map), arguments.smooth)
    drives = drives_of(arguments.log, arguments.manifest, find_config(arguments.config))
    configurations = configurations_of(drives, options)
    console.warn([warning for each in configurations.values() for warning in each.warnings])
    store, result, began = store_at(arguments.output), FleetResult(), time.monotonic()
    with store.exclusive():
        orders = orders_of(drives, configurations, store, options, result, verify=arguments.verify)
        if orders:
            for configuration in configurations.values():
                configuration.keep(store)
            cores = len(os.sched_getaffinity(0))
            count = arguments.workers or max(min(cores, len(orders)), 1)
            with Workers(arguments.scheduler, count, arguments.memory) as workers:
                if not workers.count:
                    console.say(f"{arguments.scheduler} has no worker; waiting up to {PATIENCE_S / 60:g} min for one")
                workers.await_worker()
                workers.require_same()
                console.say(f"{len(orders):,} drives on {workers.count} workers; dashboard: {workers.dashboard}")
                with _progress(orders) as ended:
                    run_fleet(orders, workers, store, result, ended)
    _tell(result, time.monotonic() - began, arguments.output)


@contextmanager
def _progress(orders: list[DriveOrder]) -> Iterator[Callable[[DriveOrder, DriveOutcome], None] | None]:
    """Show how far a run is, on standard error where that is a terminal: drives, failures, rate, time left."""
    weight = sum(order.weight + 1 for order in orders)
    done, failed, began = 0, 0, time.monotonic()
    with console.counted_progress("fleet", weight) as show:
        if show is None:
            yield None
            return

        def ended(order: DriveOrder, outcome: DriveOutcome) -> None:
            nonlocal done, failed
            done, failed = done + 1, failed + bool(outcome.reason)
            rate = done / max(time.monotonic() - began, 1e-9) * 60
            said = f"{done:,} of {len(orders):,} drives, {rate:,.1f} a minute"
            show(order.weight + 1, f"{said}, {failed:,} failed" if failed else said)

        yield ended


def _tell(result: FleetResult, seconds: float, output: str) -> None:
    """Print what a run did; raise where drives failed."""
    hours, effort = result.duration / 3600, result.effort / 3600
    figures = {
        "drives": result.drives,
        "computed": result.computed,
        "kept": result.kept,
        "failed": len(result.failed),
        "hours_computed": round(hours, 4),
        "core_hours": round(effort, 4),
        "seconds": round(seconds, 1),
    }
    console.print_figures(output, figures)
    if result.others:
        warning = (
            f"{output} holds drives of former runs too, which reports and comparisons count: "
            f"{listed_names(result.others)}; to be rid of one, remove records/NAME.json, failed/NAME.json and "
            "*/drive=NAME there, or run into another folder"
        )
        console.warn([warning])
    if result.failed:
        told = [f"{name}: {reason}" for name, reason in sorted(result.failed.items())]
        more = f"\nand {len(told) - _FAILED_NAMED:,} more" if len(told) > _FAILED_NAMED else ""
        for line in told[:_FAILED_NAMED]:
            console.say(f"failed: {line}")
        raise InputError(
            f"{len(told):,} of {result.drives:,} drives failed{more}; the others are complete; the reasons are in "
            f"{output}/failed; mend them and run the command again"
        )


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("results", type=location, metavar="DIR", help="folder of a run, or a location of fsspec")
    parser.add_argument(
        "-o", "--output", type=output_path, default=DEFAULT, metavar="HTML", help=f"the report; default: {DEFAULT}"
    )
    parser.add_argument("--json", type=output_path, metavar="FILE", help="all figures, for programs and for compare")
    parser.set_defaults(execute_fleet=write_report)


def _loaded(location: str) -> FleetFigures:
    """Load the figures of a run; warn of drives that lack tables, and of those that count twice."""
    found = load_figures(location)
    if found.incomplete:
        warning = (
            f"drives {listed_names(found.incomplete)} of {location} count as failed: tables of theirs are missing or "
            "damaged; run the same 'fleet run' again"
        )
        console.warn([warning])
    console.warn(
        [
            f"drives {listed_names(names)} of {location} are the same logs and count each: a run over other logs named "
            "one of them otherwise; run all again into a new folder"
            for names in found.twice
        ]
    )
    return found


def write_report(arguments: argparse.Namespace) -> None:
    """Write the page, and the figures where they are asked for."""
    if is_local(arguments.results) and local_path(arguments.results).is_file():
        raise InputError(
            "it is a file, and a report is made of tables; give the folder of the 'fleet run'", file=arguments.results
        )
    with Outputs(files_read(arguments.results)) as outputs:
        page = outputs.open(arguments.output)
        figures = None if arguments.json is None else outputs.open(arguments.json)
        found = report_of(_loaded(arguments.results), store_at(arguments.results))
        page.stream.write(fleet_page(found, f"Fleet · {arguments.results}").encode())
        if figures is not None:
            content = json.dumps(found.to_json(), indent=1, allow_nan=False, ensure_ascii=False)
            figures.stream.write(f"{content}\n".encode())
    console.say(f"{arguments.output} is the report; open it in a browser")


def _add_compare(parser: argparse.ArgumentParser) -> None:
    what = "folder of a run, or figures that report --json wrote"
    parser.add_argument("before", type=location, metavar="A", help=what)
    parser.add_argument("after", type=location, metavar="B", help=what)
    parser.add_argument(
        "--fail-on",
        type=conditions,
        default=(),
        metavar="WHAT,WHAT",
        help=f"exit with 1 on any of these: {', '.join(FAIL_ON)}",
    )
    percent = number(0, MOST_PERCENT, "%")
    parser.add_argument(
        "--least",
        type=percent,
        default=100 * LEAST_CHANGE,
        metavar="PERCENT",
        help=f"change of a mean below which it counts as the same; default: {100 * LEAST_CHANGE:g}",
    )
    parser.add_argument(
        "--tolerance",
        type=percent,
        default=100 * TOLERANCE,
        metavar="PERCENT",
        help=f"by which a single drive may be worse; default: {100 * TOLERANCE:g}",
    )
    parser.add_argument("--markdown", action="store_true", help="for a pull request")
    parser.add_argument("--json", type=output_path, metavar="FILE", help="all of it, for programs")
    parser.set_defaults(execute_fleet=compare_runs)


def conditions(text: str) -> tuple[str, ...]:
    """Read names of conditions with commas between."""
    found = tuple(part.strip() for part in text.split(","))
    for each in found:
        if each not in FAIL_ON:
            raise refused(text, f"one or more of {', '.join(FAIL_ON)}, with commas between")
    return found


def compare_runs(arguments: argparse.Namespace) -> None:
    """Compare two runs; fail where a condition holds."""
    with Outputs([*files_read(arguments.before), *files_read(arguments.after)]) as outputs:
        figures = None if arguments.json is None else outputs.open(arguments.json)
        before, after = _loaded(arguments.before), _loaded(arguments.after)
        found = compare(before, after, least=arguments.least / 100, tolerance=arguments.tolerance / 100)
        if figures is not None:
            content = json.dumps(found.to_json(), indent=1, allow_nan=False, ensure_ascii=False)
            figures.stream.write(f"{content}\n".encode())
    if arguments.markdown:
        print(printable_lines(markdown(found, arguments.before, arguments.after)))
    else:
        print("\n".join(map(printable, sentences(found))))
        console.print_sheets(_sheets(found))
    holds = [each for each in arguments.fail_on if FAIL_ON[each](found)]
    if holds:
        raise InputError(f"--fail-on: found {', '.join(holds)}", file=arguments.after)


def _sheets(found: Comparison) -> Iterator[console.Sheet]:
    """Yield the figures and the drives of a comparison as tables."""
    head = ("figure", "drives", "before", "after", "change", "95 % from", "to", "p", "")
    rows = tuple(
        (
            f"{each.name}, {each.unit}" if each.unit else each.name,
            str(each.drives),
            f"{each.before:.4g}",
            value_text(each.after),
            change_text(each.change),
            change_text(each.low),
            change_text(each.high),
            f"{each.p:.2g}",
            each.verdict,
        )
        for each in found.figures
    )
    if rows:
        yield console.Sheet("figures", rows, head)
    drives = tuple(
        (each.drive, each.name, f"{each.before:.4g}", value_text(each.after), change_text(each.change))
        for each in found.worse_drives[:_FAILED_NAMED]
    )
    if drives:
        yield console.Sheet("worse drives", drives, ("drive", "figure", "before", "after", "change"))
