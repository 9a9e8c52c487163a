"""`candaemon status`: shows the status snapshot of a running service, from its status socket."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

from candaemon._version import __version__
from candaemon.cli import console
from candaemon.cli.arguments import input_path
from candaemon.cli.console import Sheet
from candaemon.errors import InputError
from candaemon.status.socket_paths import running_instances
from candaemon.status.status_client import snapshots

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

    from candaemon.evaluation.fitted_table import FittedTable

Tree: TypeAlias = Mapping[str, Any]
"""What `candaemon.status.snapshot.Figures.tree` gives."""

_DAY_S, _HOUR_S, _MINUTE_S = 86_400, 3600, 60


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "instance", nargs="?", metavar="NAME", help="of candaemon@NAME; default: the only one that runs"
    )
    parser.add_argument("--socket", type=input_path, metavar="PATH", help="the instance's socket, if it is elsewhere")
    parser.add_argument("--once", action="store_true", help="show it once and end; default where no terminal is")
    parser.add_argument("--json", action="store_true", help="the figures once, for programs")


def execute(arguments: argparse.Namespace) -> None:
    """Show the figures, live on a terminal."""
    watch(arguments.instance, arguments.socket, once=arguments.once, as_json=arguments.json)


def sheets(figures: Tree) -> list[Sheet]:
    """Return the figures as sheets, those first that tell what is wrong: the last ones may find no room."""
    return [
        _service(figures),
        _obstacles(figures),
        _sensors(figures),
        *_rare(figures),
        _buses(figures),
        _times(figures),
        *_calibration(figures),
    ]


class LiveView:
    """Shows the sheets on a terminal and redraws them with each status snapshot. A context manager.

    Args:
        screen: to draw on; default: standard output.
    """

    def __init__(self, screen: Console | None = None) -> None:
        from rich.live import Live  # noqa: PLC0415 - a slow import that a pipe does not need

        self._live = Live(console=screen or console.console(), auto_refresh=False)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show(self, figures: Tree) -> None:
        """Draw a status snapshot."""
        self._live.update(_Screenful([_table(sheet) for sheet in sheets(figures)]), refresh=True)


@dataclass(frozen=True, slots=True)
class _Screenful:
    """Tables as far as the terminal has lines for them: without columns where it is low, and last how much is hidden.

    Attributes:
        tables: the first ones are seen on any terminal.
    """

    tables: Sequence[FittedTable]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the lines that have room."""
        from rich.console import Group  # noqa: PLC0415 - as above
        from rich.segment import Segment  # noqa: PLC0415 - as above

        height = options.size.height
        lines = console.render_lines(Group(*self.tables), options, pad=False)
        if len(lines) > height:
            low = (replace(table, in_columns=False) for table in self.tables)
            lines = console.render_lines(Group(*low), options, pad=False)
        if len(lines) > height:
            hidden = len(lines) - height + 1
            lines[height - 1 :] = [[Segment(f"… {hidden} more lines: --once shows all")]]
        for line in lines:
            yield from line
            yield Segment.line()


def _table(sheet: Sheet) -> FittedTable:
    """Return a sheet as a table without lines, which takes less space."""
    from rich import box  # noqa: PLC0415 - as above

    from candaemon.evaluation.fitted_table import FittedTable  # noqa: PLC0415 - as above

    table = sheet.table()
    table.box, table.pad_edge = box.SIMPLE_HEAD, False
    return FittedTable(table)


def _service(figures: Tree) -> Sheet:
    service = figures["service"]
    memory = "-" if service["memory"] is None else f"{service['memory'] / 1e6:.0f} MB"
    load = 100 * service["cpu"] / max(service["uptime"], 1e-3)
    row = (
        f"{service['pid']}",
        service["version"],
        _span(service["uptime"]),
        f"{load:.1f} %",
        memory,
        service["config"],
    )
    return Sheet(service["name"], (row,), ("pid", "version", "up", "cpu", "memory", "configuration"))


def _obstacles(figures: Tree) -> Sheet:
    tracks, cycles = figures["tracks"], figures["cycles"]
    row = (
        *(f"{count}" for count in tracks.values()),
        figures["own_motion"]["status"],
        f"{cycles['rate']:.1f}",
        f"{cycles['told']}",
        f"{cycles['coasting']}",
        f"{cycles['without_ego']}",
    )
    return Sheet("obstacles", (row,), (*tracks, "own motion", "cycles/s", "cycles", "coasting cycles", "without ego"))


def _times(figures: Tree) -> Sheet:
    rows = tuple(
        (title, *(_milliseconds(figures[key][name]) for name in ("p50", "p90", "p99", "max")))
        for title, key in (("cycle", "cycle_time"), ("latency", "latency"))
    )
    return Sheet("times in ms", rows, ("", "p50", "p90", "p99", "max"))


_OF_BUSES = ("", "state", "frames/s", "received", "used", "spare", "unknown", "sent", "dropped", "unsent", "events")


def _buses(figures: Tree) -> Sheet:
    rows = tuple(
        (
            name,
            _bus_state(bus),
            f"{bus['rate']:.0f}",
            f"{bus['received']}",
            f"{bus['taken']['used']}",
            f"{bus['taken']['spare']}",
            f"{bus['taken']['unknown']}",
            f"{bus['sent']}",
            _causes(bus["dropped"]),
            _causes(bus["unsent"]),
            _causes(bus["events"]),
        )
        for name, bus in figures["buses"].items()
    )
    return Sheet("buses", rows, _OF_BUSES)


def _bus_state(bus: Tree) -> str:
    """Return the state of a bus as text, with its error if running is one."""
    if not bus["up"]:
        return f"down: {bus['error']}"
    return "up" if bus["controller"] == "active" else f"up, {bus['controller']}"


def _sensors(figures: Tree) -> Sheet:
    rows = tuple(
        (
            name,
            _condition_of(sensor),
            f"{sensor['rate']:.1f}",
            _number(sensor["age"], 2),
            f"{sensor['frames']['used']}",
            f"{sensor['counts']['missing']}",
            _causes({fate: count for fate, count in sensor["frames"].items() if fate != "used"}),
            _number(sensor["trust"], 2),
            _number(sensor["nis"]["ratio"], 2),
        )
        for name, sensor in figures["sensors"].items()
    )
    return Sheet(
        "sensors", rows, ("", "state", "scans/s", "age s", "used", "missing", "dropped", "trust", "NIS/freedom")
    )


def _calibration(figures: Tree) -> Iterator[Sheet]:
    """Yield a sheet on what is estimated of the sensors, once anything is known."""
    rows = tuple(
        (
            name,
            f"{1e3 * of['latency']:.1f} ± {1e3 * of['latency_sd']:.1f}",
            f"{1e3 * of['latency_applied']:.1f}",
            f"{of['yaw_deg']:.2f} ± {of['yaw_sd_deg']:.2f}",
            f"{of['yaw_applied_deg']:.2f}",
        )
        for name, sensor in figures["sensors"].items()
        if (of := sensor.get("calibration")) and of["latency"] is not None
    )
    if rows:
        header = ("", "latency ms", "applied ms", "yaw deg", "applied deg")
        yield Sheet("beyond what is configured", rows, header)


def _condition_of(sensor: Tree) -> str:
    """Return what is wrong with a sensor, or that nothing is, as text."""
    if sensor["lost"]:
        return "lost"
    return "ok" if sensor["fault"] == "none" else str(sensor["fault"])


def _rare(figures: Tree) -> Iterator[Sheet]:
    """Yield sheets on events that are shown only after they have occurred."""
    clock, service = figures["clock"], figures["service"]
    steps = clock["backward_steps"] + clock["forward_steps"]
    if steps:
        row = (f"{clock['backward_steps']}", f"{clock['forward_steps']}", f"{clock['offset']:.3f}")
        yield Sheet("steps of the clock", (row,), ("back", "ahead", "made up for, s"))
    samples = figures["own_motion"]["samples"]
    if samples.get("direction_assumed"):
        told = (f"{samples['samples']}", f"{samples['direction_assumed']}")
        yield Sheet("own motion's signal of reverse", (told,), ("samples", "of them taken for ahead, it being silent"))
    found = {name: count for name, count in figures.get("losses", {}).items() if count}
    if found:
        yield Sheet(
            "lost since the start", tuple((name.replace("_", " "), f"{count}") for name, count in found.items())
        )
    if service["reloads"] or service["refused"]:
        row = (f"{service['reloads']}", f"{service['refused']}", service["reload_error"] or "-")
        yield Sheet("reloads", (row,), ("applied", "refused", "last error"))
    if figures["recording"]:
        recording = {name: f"{value}" for name, value in figures["recording"].items()}
        yield Sheet("recording", (tuple(recording.values()),), tuple(recording))


def _causes(counts: Mapping[str, int]) -> str:
    """Return a sum with its causes, those of 0 left out."""
    found = ", ".join(f"{cause.replace('_', ' ')} {count}" for cause, count in counts.items() if count)
    return found or "0"


def _milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.2f}"


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _span(seconds: float) -> str:
    """Return a time span as days, hours, minutes and seconds, the two largest units that are not 0."""
    days, rest = divmod(int(seconds), _DAY_S)
    hours, rest = divmod(rest, _HOUR_S)
    minutes, left = divmod(rest, _MINUTE_S)
    parts = [f"{count} {unit}" for count, unit in ((days, "d"), (hours, "h"), (minutes, "min"), (left, "s")) if count]
    return " ".join(parts[:2]) or "0 s"


def watch(instance: str | None, path: Path | None, *, once: bool, as_json: bool) -> None:
    """Show what an instance does: live on a terminal until it ends, else once.

    Args:
        instance: NAME of candaemon@NAME, or stem of the configuration's file; None: the only one that runs.
        path: the instance's status socket, if it is elsewhere.
        once: show it once and end.
        as_json: print the figures as a line of JSON, once.

    Raises:
        InputError: no such instance runs, several do and none is named; it has ended, hangs, or sends something else.
    """
    where = _socket_of(instance) if path is None else path
    with closing(snapshots(where)) as figures:
        if as_json:
            print(json.dumps(next(figures), separators=(",", ":")))
            return
        with _figures_of(where):
            if once or not console.can_redraw():
                console.print_sheets(sheets(next(figures)))
                return
            with LiveView() as view:
                for each in figures:
                    view.show(each)


def _socket_of(instance: str | None) -> Path:
    """Return the socket of a running instance."""
    running = running_instances()
    listed = ", ".join(sorted(running)) or "none"
    start = "start one with `systemctl start candaemon@NAME` or `candaemon run CONFIG`"
    if not os.environ.get("XDG_RUNTIME_DIR"):
        start += ", with XDG_RUNTIME_DIR set there and here, or its own are not found"
    if instance is not None:
        if instance not in running:
            raise InputError(f"no instance '{instance}' runs; running: {listed}; {start}, or give --socket PATH")
        return running[instance]
    match list(running.values()):
        case [only]:
            return only
        case []:
            raise InputError(f"no instance runs; {start}, or give --socket PATH")
        case _:
            raise InputError(f"several instances run: {listed}; name one: candaemon status NAME")


@contextmanager
def _figures_of(path: Path) -> Iterator[None]:
    """Say of figures that this version cannot show that they are such.

    Raises:
        InputError: they were.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"the figures are not those of candaemon {__version__}: {error!r}; `candaemon status --json` prints them",
            file=path,
        ) from error
