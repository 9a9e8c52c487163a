"""Output on a terminal or into a pipe: results on standard output, messages on standard error."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from candaemon.log_lines import LineFormatter
from candaemon.printable import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from candaemon.can_io.logs.stream import LogCounts

_WARNINGS = 5
"""Number of a configuration's warnings shown before each run; `check` shows all."""

_NUMBER = re.compile(r"[-+]?[\d.,]+(e[-+]?\d+)?%?|-")


def log_to_stderr(level: int = logging.WARNING) -> None:
    """Send log records to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(LineFormatter("candaemon: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler], force=True)


def say(text: str) -> None:
    """Write a message to standard error."""
    with suppress(OSError):  # a message that nobody takes is no failure
        print(f"candaemon: {printable(text)}", file=sys.stderr)


def warn(warnings: Sequence[str]) -> None:
    """Show the first few warnings of a configuration."""
    warn_of_log(warnings[:_WARNINGS])
    if len(warnings) > _WARNINGS:
        say(f"warning: and {len(warnings) - _WARNINGS} more, which `candaemon check` shows")


def warn_of_log(warnings: Sequence[str]) -> None:
    """Show the warnings of what was read from a log."""
    for warning in warnings:
        say(f"warning: {warning}")


@dataclass(frozen=True, slots=True)
class Sheet:
    """A small table of texts, each made safe to print: names in it may come from anywhere.

    Attributes:
        title: heading.
        rows: the cells.
        header: names of the columns; empty for a table without header.
    """

    title: str
    rows: tuple[tuple[str, ...], ...]
    header: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", printable(self.title))
        object.__setattr__(self, "rows", tuple(tuple(map(printable, row)) for row in self.rows))
        object.__setattr__(self, "header", tuple(map(printable, self.header)))

    def turned(self) -> Sheet:
        """Return it with a row for each column; the first column, where it names rows, becomes the header."""
        first, *rest = zip(self.header, *self.rows, strict=True)
        return Sheet(self.title, (first, *rest)) if first[0] else Sheet(self.title, tuple(rest), first)

    def table(self) -> Table:
        """Return it as a table of rich."""
        from rich.table import Table  # noqa: PLC0415 - a slow import that a pipe does not need

        table = Table(title=self.title, title_justify="left", title_style="bold", show_header=bool(self.header))
        for k, cells in enumerate(zip(*self.rows, strict=True)):
            table.add_column(self.header[k] if self.header else "", justify="right" if _numeric(cells) else "left")
        for row in self.rows:
            table.add_row(*row)
        return table


def console(*, stderr: bool = False) -> Console:
    """Return rich's console, which shows text as it is: brackets in a name are no markup, colons no emoji.

    Args:
        stderr: on standard error; default: on standard output.
    """
    from rich.console import Console  # noqa: PLC0415 - a slow import that the service does not need

    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


def can_redraw() -> bool:
    """Return whether standard output is a terminal that can draw over what it shows; a dumb one cannot."""
    return sys.stdout.isatty() and not console().is_dumb_terminal


def print_sheets(sheets: Iterable[Sheet]) -> None:
    """Print sheets: tables on a terminal, plain lines with columns aligned by blanks elsewhere.

    A table of few rows that is too wide for the terminal is turned, if it fits then.
    """
    if not sys.stdout.isatty():
        for sheet in sheets:
            print("\n".join(_lines(sheet)))
        return
    from candaemon.evaluation.fitted_table import FittedTable  # noqa: PLC0415 - it imports rich, which is slow

    shown = console()
    for sheet in sheets:
        fitted = FittedTable(sheet.table())
        if len(sheet.rows) < len(sheet.header) and not fitted.fits(shown):
            turned = FittedTable(sheet.turned().table())
            fitted = turned if turned.fits(shown) else fitted
        shown.print(fitted)


def _lines(sheet: Sheet) -> Iterator[str]:
    """Yield a sheet as plain lines."""
    yield sheet.title
    rows = (sheet.header, *sheet.rows) if sheet.header else sheet.rows
    columns = list(zip(*rows, strict=True))
    widths = [max(map(len, cells)) for cells in columns]
    right = [_numeric(cells) for cells in zip(*sheet.rows, strict=True)]
    for row in rows:
        cells = (
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(row, widths, right, strict=True)
        )
        yield ("  " + "  ".join(cells)).rstrip()


def _numeric(cells: Iterable[str]) -> bool:
    """Return whether a column holds only numbers, possibly with a percent sign."""
    return all(_NUMBER.fullmatch(cell) for cell in cells)


def print_figures(title: str, figures: Mapping[str, Any]) -> None:
    """Print a tree of figures: one table per branch on a terminal, `key: value` lines elsewhere."""
    if sys.stdout.isatty():
        print_sheets(_branches(title, figures))
    else:
        print("\n".join(printable(f"{key}: {value}") for key, value in flattened(figures)))


def _branches(title: str, figures: Mapping[str, Any]) -> Iterator[Sheet]:
    """Yield a sheet for each branch of a tree, and last one for its leaves."""
    leaves = {}
    for key, branch in figures.items():
        match branch:
            case Mapping() if branch and all(isinstance(each, Mapping) for each in branch.values()):
                first = next(iter(branch.values()))
                yield Sheet(
                    key, tuple((name, *map(_text, each.values())) for name, each in branch.items()), ("", *first)
                )
            case list() if branch and all(isinstance(each, Mapping) for each in branch):
                yield Sheet(key, tuple(tuple(map(_text, each.values())) for each in branch), tuple(branch[0]))
            case Mapping() if branch:
                yield Sheet(key, (tuple(map(_text, branch.values())),), tuple(branch))
            case _:
                leaves[key] = _text(branch)
    if leaves:
        yield Sheet(title, (tuple(leaves.values()),), tuple(leaves))


def flattened(figures: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield each figure of a tree as a dotted key and text."""
    for key, value in figures.items():
        match value:
            case Mapping():
                yield from flattened(value, f"{prefix}{key}.")
            case list() if value and all(isinstance(each, Mapping) for each in value):
                yield from flattened({str(k): each for k, each in enumerate(value)}, f"{prefix}{key}.")
            case _:
                yield f"{prefix}{key}", _text(value)


def _text(value: Any) -> str:
    """Return a figure as text; `-` for None and empty collections."""
    match value:
        case None:
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:g}"
        case Mapping():
            return ", ".join(f"{key} {_text(each)}" for key, each in value.items()) or "-"
        case list():
            return "; ".join(map(_text, value)) or "-"
        case _:
            return str(value)


@contextmanager
def log_progress(name: str) -> Iterator[Callable[[LogCounts], None] | None]:
    """Show how much of a log has been read, on standard error where that is a terminal.

    Args:
        name: of the log.

    Yields:
        A function to call with the reader's counts; None where nothing is shown.
    """
    if not sys.stderr.isatty():
        yield None
        return
    with _bar("{task.fields[frames]:,} frames") as bar:
        task = bar.add_task(printable(name), total=None, frames=0)

        def show(counts: LogCounts) -> None:
            bar.update(task, total=counts.bytes_total or None, completed=counts.bytes_read, frames=counts.frames)

        yield show


@contextmanager
def share_progress(name: str) -> Iterator[Callable[[float], None]]:
    """Show the progress of a task, on standard error where that is a terminal.

    Args:
        name: of the work.

    Yields:
        A function to call with the share done since the last call; the shares sum to one.
    """
    if not sys.stderr.isatty():
        yield lambda _share: None
        return
    with _bar() as bar:
        task = bar.add_task(printable(name), total=1.0)
        yield lambda share: bar.advance(task, share)


@contextmanager
def counted_progress(name: str, total: float) -> Iterator[Callable[[float, str], None] | None]:
    """Show the progress of a task of known size with a text beside it, on standard error where that is a terminal.

    Args:
        name: of the work.
        total: its size, in any unit.

    Yields:
        A function to call with how much was done since the last call, and the text; None where nothing is shown.
    """
    if not sys.stderr.isatty():
        yield None
        return
    with _bar("{task.fields[said]}") as bar:
        task = bar.add_task(printable(name), total=total, said="")
        yield lambda done, said: bar.update(task, advance=done, said=printable(said))


def _bar(*told: str) -> Progress:
    """Return a bar on standard error, with texts of the task between its share and the time left."""
    # a slow import that a pipe does not need
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        *(TextColumn(text, markup=False) for text in told),
        TimeRemainingColumn(),
        console=console(stderr=True),
        transient=True,
    )
