"""Tables for a terminal of any width: words fold, a number is never cut."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

_LONGEST_WHOLE: Final = 12
"""Characters of a cell up to which it stays on one line, and of a word up to which it does not fold."""
_NUMBER: Final = re.compile(r"[^\w\s]*\d")
"""How a word begins that is a number: there may be a sign or a bracket before it."""
_BETWEEN: Final = " · "


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A table with its words folded as far as is needed, and where that is not enough, without lines between columns.

    Where that is too wide as well there are no columns: a row is `name: cell` after `name: cell`.

    Attributes:
        table: its cells are texts.
        in_columns: whether it may have columns.
    """

    table: Table
    in_columns: bool = True

    def fits(self, console: Console) -> bool:
        """Return whether a console is wide enough for columns and lines."""
        return _folded(self.table, console, console.width) is not None

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield what fits."""
        forms = (self.table, _without_lines(self.table)) if self.in_columns else ()
        for form in forms:
            if (folded := _folded(form, console, options.max_width)) is not None:
                yield folded
                return
        if self.table.title:
            yield Text(str(self.table.title), style=self.table.title_style or "")
        for line in _without_columns(self.table, options.max_width):
            yield Text(line)


def _folded(table: Table, console: Console, width: int) -> Table | None:
    """Return a table as wide as there is room; None where a number, or a name of a column, would be cut."""
    least = [_least(column, table) for column in table.columns]
    widest = [max(low, *map(cell_len, _texts(column, table))) for low, column in zip(least, table.columns, strict=True)]
    natural = console.measure(table, options=console.options.update(width=sum(widest) + 10 * len(widest))).maximum
    if natural <= width:
        return table
    spare = width - (natural - sum(widest)) - sum(least)
    if spare < 0:
        return None
    given = _shared(spare, [high - low for low, high in zip(least, widest, strict=True)])
    folded = copy(table)
    folded.columns = [
        replace(column, width=low + more, overflow="fold")
        for column, low, more in zip(table.columns, least, given, strict=True)
    ]
    return folded


def _shared(spare: int, wanted: Sequence[int]) -> list[int]:
    """Return what each gets of what there is to spare: those that want least are served whole, as far as it goes."""
    given = [0] * len(wanted)
    for served, k in enumerate(sorted(range(len(wanted)), key=wanted.__getitem__)):
        given[k] = min(wanted[k], (spare - sum(given)) // (len(wanted) - served))
    return given


def _least(column: Column, table: Table) -> int:
    """Return the width to which a column can be folded."""
    names = map(cell_len, str(column.header).split() if table.show_header else ())
    return max([column.min_width or 0, *names, *(_least_of(_plain(cell)) for cell in column.cells)])


def _least_of(cell: str) -> int:
    """Return the width to which a cell can be folded."""
    if cell_len(cell) <= _LONGEST_WHOLE:
        return cell_len(cell)
    words = cell.split()
    return max(
        (cell_len(word) if _NUMBER.match(word) else min(cell_len(word), _LONGEST_WHOLE) for word in words), default=0
    )


def _texts(column: Column, table: Table) -> list[str]:
    """Return a column's cells, with its name if it is shown."""
    return [str(column.header) if table.show_header else "", *map(_plain, column.cells)]


def _plain(cell: object) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _without_lines(table: Table) -> Table:
    """Return a table that takes less room: one blank between columns, and a line below their names."""
    bare = copy(table)
    bare.box, bare.show_edge, bare.pad_edge, bare.padding = box.SIMPLE_HEAD, False, False, (0, 0)
    return bare


def _without_columns(table: Table, width: int) -> Iterator[str]:
    """Yield the rows of a table as lines, each as full as it can be."""
    names = [str(column.header) if table.show_header else "" for column in table.columns]
    for cells in zip(*(map(_plain, column.cells) for column in table.columns), strict=True):
        told = [f"{name}: {cell}" if name else cell for name, cell in zip(names, cells, strict=True) if cell]
        yield from _flowed(told, width)


def _flowed(parts: Sequence[str], width: int) -> Iterator[str]:
    """Yield parts on as few lines as hold them, the first of these less indented."""
    line = ""
    for part in parts:
        longer = f"{line}{_BETWEEN}{part}" if line else f"  {part}"
        if line and cell_len(longer) > width:
            yield line
            longer = f"    {part}"
        line = longer
    if line:
        yield line
