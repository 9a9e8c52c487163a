"""`candaemon watch`: the obstacles of live buses in a terminal, as a table and a small radar made of characters."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Mapping
from textwrap import shorten
from threading import Event, Timer
from typing import TYPE_CHECKING, Any, Final

from candaemon.binding.bind import bind
from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, input_path, number
from candaemon.cli.view import LONGEST_VIEW
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.tracking.obstacles import CLASS_NAMES, STATE_NAMES
from candaemon.view.character_radar import drawn
from candaemon.view.live_pictures import LiveListener
from candaemon.view.picture import Picture

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

FARTHEST_AHEAD: Final = 1000.0
"""Farthest that the radar of characters shows, m."""
_REFRESH_S: Final = 0.1
_LINES_S: Final = 1.0
_NICENESS: Final = 5
_NARROWEST: Final = 100
"""Columns of a terminal from which on radar and table are side by side."""
_NARROWEST_RADAR: Final = 40
_APART: Final = 2
"""Columns between radar and table."""
_NUMBERS: Final = (("x", "m"), ("y", "m"), ("vx", "m/s"), ("vy", "m/s"))
_LEAST: Final = {"id": 4, "state": 9, "x m": 6, "y m": 6, "vx m/s": 6, "vy m/s": 6, "class": 10}
"""Width of each column of the table at least, so that it does not sway with what is in it."""
_BETWEEN: Final = 2
"""Columns between two of the table."""
_LEAST_MISSED: Final = ("class", "state", "vy m/s", "vx m/s")
"""Columns of the table that are left out where it is too wide, the first one first."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "--ahead", type=number(5.0, FARTHEST_AHEAD, "m"), default=100.0, metavar="M", help="m that are drawn ahead"
    )
    parser.add_argument(
        "--duration", type=number(0.001, LONGEST_VIEW, "s"), metavar="S", help="s after which it ends; default: never"
    )


def execute(arguments: argparse.Namespace) -> None:
    """Watch until Ctrl-C."""
    binding = bind(load_config(find_config(arguments.config)))
    console.warn(binding.warnings)
    listener = LiveListener(binding)
    os.nice(_NICENESS)
    stopping = Event()
    if arguments.duration is not None:
        timer = Timer(arguments.duration, stopping.set)
        timer.daemon = True
        timer.start()
    pictures = listener.pictures(stopping)
    if console.can_redraw():
        show_live(pictures, arguments.ahead)
    else:
        print_lines(pictures)


def print_lines(pictures: Iterable[Picture]) -> None:
    """Print a line when an obstacle comes or goes, and one an obstacle each second.

    A line tells where obstacles are from: those of the bus and those tracked here have ids of their own.
    """
    known: set[int] = set()
    heard: bool | None = None
    next_s = 0.0
    for picture in pictures:
        if picture.heard != heard:
            heard = picture.heard
            known.clear()
            print(f"{picture.time:.3f} obstacles {_origin(picture)}", flush=True)
        rows = {row["id"]: row for row in picture.rows() if row["state"] != 0}
        for identity in sorted(rows.keys() - known):
            print(f"{picture.time:.3f} obstacle {identity} came {_line(rows[identity])}", flush=True)
        for identity in sorted(known - rows.keys()):
            print(f"{picture.time:.3f} obstacle {identity} gone", flush=True)
        known = set(rows)
        if picture.time >= next_s or picture.time < next_s - 2 * _LINES_S:
            next_s = picture.time + _LINES_S
            for identity, row in sorted(rows.items()):
                print(f"{picture.time:.3f} obstacle {identity} {_line(row)}", flush=True)


def _origin(picture: Picture) -> str:
    return "from the bus" if picture.heard else "tracked here"


def _line(row: dict[str, Any]) -> str:
    speed = (row["vx"] ** 2 + row["vy"] ** 2) ** 0.5
    place = f"x={row['x']:.2f} y={row['y']:.2f}"
    return f"{STATE_NAMES[row['state']]} {place} vx={row['vx']:.2f} vy={row['vy']:.2f} speed={speed:.2f}"


def show_live(pictures: Iterable[Picture], ahead: float) -> None:
    """Draw a table and a radar of characters, several times a second.

    Args:
        pictures: of the buses.
        ahead: m that the radar shows ahead.
    """
    from rich.live import Live  # noqa: PLC0415 - a slow import that a pipe does not need

    health: dict[str, Any] = {}
    next_s = 0.0
    with Live(console=console.console(), auto_refresh=False, screen=True) as live:
        for picture in pictures:
            health = picture.health or health
            now_s = live.console.get_time()
            if now_s >= next_s:
                next_s = now_s + _REFRESH_S
                live.update(layout(picture, health, live.console.size, ahead), refresh=True)


def layout(picture: Picture, health: dict[str, Any], size: tuple[int, int], ahead: float) -> RenderableType:
    """Return a picture for a terminal: radar and table side by side, or one below the other where it is narrow.

    Args:
        picture: of the cycle.
        health: of sensors and buses.
        size: columns and rows of the terminal.
        ahead: m that the radar shows ahead.
    """
    from rich.console import Group  # noqa: PLC0415 - as above
    from rich.table import Table  # noqa: PLC0415 - as above
    from rich.text import Text  # noqa: PLC0415 - as above

    columns, rows = size
    wide = columns >= _NARROWEST
    radar_rows = max(rows - 3 if wide else rows // 2, 5)
    most = rows - 5 if wide else max(rows - radar_rows - 4, 1)
    table, table_columns = _table(picture, most, columns - _NARROWEST_RADAR if wide else columns)
    radar_columns = columns - table_columns - _APART if wide else columns
    head = (
        f"{len(picture)} obstacles {_origin(picture)} · own motion {health.get('own_motion', '-')} · {_rates(health)}"
    )
    shown = Text(shorten(head, columns, placeholder=" …"))
    radar = Text("\n".join(drawn(picture, radar_columns, radar_rows, ahead=ahead)), no_wrap=True)
    if not wide:
        return Group(shown, radar, table)
    beside = Table.grid(padding=(0, _APART))
    beside.add_column(width=radar_columns)
    beside.add_row(radar, table)
    return Group(shown, beside)


def _rates(health: dict[str, Any]) -> str:
    sensors = health.get("sensors", {})
    return ", ".join(f"{name} {each['rate']:.0f} scans/s" for name, each in sensors.items()) or "no scans yet"


def _table(picture: Picture, most: int, width: int) -> tuple[Table, int]:
    """Return the nearest obstacles as a table, and its width.

    Args:
        picture: of the cycle.
        most: rows.
        width: columns of the terminal that it may take; what is least missed is left out where they are few.
    """
    from rich import box  # noqa: PLC0415 - as above
    from rich.table import Table  # noqa: PLC0415 - as above

    found = sorted(picture.rows(), key=lambda row: (row["x"] ** 2 + row["y"] ** 2, row["id"]))[:most]
    columns = {
        "id": [str(row["id"]) for row in found],
        "state": [STATE_NAMES[row["state"]] for row in found],
        **{f"{name} {unit}": [f"{row[name]:.1f}" for row in found] for name, unit in _NUMBERS},
        "class": [CLASS_NAMES[row.get("class") or 0] for row in found],
    }
    widths = {name: max(map(len, (name, *cells))) for name, cells in columns.items()}
    widths = {name: max(least, widths[name]) for name, least in _LEAST.items()}
    for name in _LEAST_MISSED:
        if _whole(widths) > width:
            del widths[name]
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for name, each in widths.items():
        table.add_column(name, justify="left" if name in {"state", "class"} else "right", width=each, no_wrap=True)
    for cells in zip(*(columns[name] for name in widths), strict=True):
        table.add_row(*cells)
    return table, _whole(widths)


def _whole(widths: Mapping[str, int]) -> int:
    """Return the width of a table."""
    return sum(widths.values()) + _BETWEEN * (len(widths) - 1)
