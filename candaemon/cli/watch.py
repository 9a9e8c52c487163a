"""`candaemon watch`: the obstacles of live buses in a terminal, as a table and a small radar made of characters."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable
from threading import Event, Timer
from typing import TYPE_CHECKING, Any, Final

from candaemon.binding.bind import bind
from candaemon.cli import console
from candaemon.cli.arguments import CONFIG, input_path, number
from candaemon.cli.console import Sheet
from candaemon.cli.view import LONGEST_VIEW
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.tracking.obstacles import CLASS_NAMES, STATE_NAMES
from candaemon.view.character_radar import drawn
from candaemon.view.live_pictures import LiveListener
from candaemon.view.picture import Picture

if TYPE_CHECKING:
    from rich.console import RenderableType

FARTHEST_AHEAD: Final = 1000.0
"""Farthest that the radar of characters shows, m."""
_REFRESH_S: Final = 0.1
_LINES_S: Final = 1.0
_NICENESS: Final = 5
_NARROWEST: Final = 100


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
    if sys.stdout.isatty():
        show_live(pictures, arguments.ahead)
    else:
        print_lines(pictures)


def print_lines(pictures: Iterable[Picture]) -> None:
    """Print a line when an obstacle comes or goes, and one an obstacle each second."""
    known: set[int] = set()
    next_s = 0.0
    for picture in pictures:
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
    from rich.columns import Columns  # noqa: PLC0415 - as above
    from rich.console import Group  # noqa: PLC0415 - as above
    from rich.text import Text  # noqa: PLC0415 - as above

    columns, rows = size
    wide = columns >= _NARROWEST
    radar_columns = columns // 2 - 2 if wide else columns
    radar_rows = max(rows - 3 if wide else rows // 2, 5)
    origin = "from the bus" if picture.heard else "tracked here"
    head = Text(f"{len(picture)} obstacles {origin} · own motion {health.get('own_motion', '-')} · {_rates(health)}")
    head.truncate(columns)
    radar = Text("\n".join(drawn(picture, radar_columns, radar_rows, ahead=ahead)), no_wrap=True)
    table = _table(picture, rows - 5 if wide else max(rows - radar_rows - 4, 1))
    return Group(head, Columns([radar, table], padding=(0, 2)) if wide else Group(radar, table))


def _rates(health: dict[str, Any]) -> str:
    sensors = health.get("sensors", {})
    return ", ".join(f"{name} {each['rate']:.0f} scans/s" for name, each in sensors.items()) or "no scans yet"


def _table(picture: Picture, most: int) -> RenderableType:
    """Return the nearest obstacles as a table."""
    from rich import box  # noqa: PLC0415 - as above
    from rich.table import Table  # noqa: PLC0415 - as above

    found = sorted(picture.rows(), key=lambda row: (row["x"] ** 2 + row["y"] ** 2, row["id"]))
    cells = tuple(
        (
            str(row["id"]),
            STATE_NAMES[row["state"]],
            f"{row['x']:.1f}",
            f"{row['y']:.1f}",
            f"{row['vx']:.1f}",
            f"{row['vy']:.1f}",
            CLASS_NAMES[row.get("class") or 0],
        )
        for row in found[:most]
    )
    sheet = Sheet("", cells, ("id", "state", "x m", "y m", "vx m/s", "vy m/s", "class"))
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(sheet.header):
        table.add_column(name, justify="left" if k in {1, 6} else "right", no_wrap=True)
    for each in sheet.rows:
        table.add_row(*each)
    return table
