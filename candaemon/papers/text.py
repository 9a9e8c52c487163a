"""Results of experiments for people: tables on a terminal, plain aligned lines in a pipe."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from candaemon.evaluation.fitted_table import FittedTable
from candaemon.papers.experiment import Experiment, Result, Row

_TEXTS = ("case", "quantity (unit)", "method")
_NUMBERS = ("printed", "here", "the default estimator", "bound")
_DIGITS = 3


def print_result(console: Console, experiment: Experiment, result: Result, runs: int, seed: int) -> None:
    """Print an experiment's table and below it the choices.

    The methods stand one below another for each quantity of a case, whatever the order of the rows.
    On a terminal, the smaller of *printed* and *here* is bold if they are errors. In a pipe every line begins with the
    experiment's name, and columns are two blanks or more apart, which no cell has inside.

    Args:
        console: where to.
        experiment: what was run.
        result: what it found.
        runs: how many Monte Carlo runs.
        seed: of all random numbers.
    """
    title = f"{experiment.title} ({runs} {'run' if runs == 1 else 'runs'}, seed {seed})"
    rows = _grouped(result.rows)
    if not console.is_terminal:
        lines = (title, *_aligned(rows), *(f"choice: {choice}" for choice in experiment.choices))
        console.file.write("".join(f"{experiment.name}  {line}\n" for line in lines))
        console.file.flush()  # whoever reads has each table as soon as it is there
        return
    console.print(_table(f"{experiment.name}: {title}", rows))
    choices = Table.grid(padding=(0, 1))
    for choice in experiment.choices:
        choices.add_row(" •", Text(choice, style="dim"))
    console.print(choices)
    console.print()


def significant(value: float | None) -> str:
    """Return a number with three significant digits; `-` stands for one that there is none of."""
    if value is None:
        return "-"
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    rounded = float(f"{value:.{_DIGITS - 1}e}")  # 0.9996 has its first digit elsewhere once it is 1.00
    exponent = math.floor(math.log10(abs(rounded)))
    if exponent < -_DIGITS or exponent > 2 * _DIGITS:
        return f"{value:.{_DIGITS - 1}e}"
    return f"{rounded:.{max(_DIGITS - 1 - exponent, 0)}f}"


def _grouped(rows: Sequence[Row]) -> list[Row]:
    """Return rows by case, and within one by quantity, each in the order in which it first appears."""
    cases = list(dict.fromkeys(row.case for row in rows))
    quantities = list(dict.fromkeys(row.quantity for row in rows))
    return sorted(rows, key=lambda row: (cases.index(row.case), quantities.index(row.quantity)))


def _texts(row: Row) -> tuple[str, str, str]:
    """Return what a row is about."""
    return row.case, f"{row.quantity} ({row.unit})" if row.unit else row.quantity, row.method


def _numbers(row: Row) -> tuple[str, str, str, str]:
    """Return a row's figures."""
    return significant(row.printed), significant(row.here), significant(row.default), significant(row.bound)


def _table(title: str, rows: Sequence[Row]) -> FittedTable:
    """Return rows as a table for a terminal, in which a case, and each quantity of it, is named once."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for name in _TEXTS:
        table.add_column(name)
    for name in _NUMBERS:
        table.add_column(name, justify="right")
    before = ("", "", "")
    for row in rows:
        texts = case, quantity, method = _texts(row)
        if case != before[0]:
            table.add_section()
            table.add_row(*texts, *_marked(row))
        else:
            table.add_row("", "" if quantity == before[1] else quantity, method, *_marked(row))
        before = texts
    return FittedTable(table)


def _marked(row: Row) -> tuple[Text, ...]:
    """Return a row's figures; of errors, the smaller of the paper's and ours in bold, both where they read alike."""
    printed, here, default, bound = map(Text, _numbers(row))
    if row.error and row.printed is not None:
        best = min(row.printed, row.here)
        for cell, value in ((printed, row.printed), (here, row.here)):
            if significant(value) == significant(best):
                cell.stylize("bold")
    return printed, here, default, bound


def _aligned(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the columns' names and the rows as plain lines, columns aligned by blanks."""
    table = ((*_TEXTS, *_NUMBERS), *((*_texts(row), *_numbers(row)) for row in rows))
    widths = [max(map(len, cells)) for cells in zip(*table, strict=True)]
    for cells in table:
        texts = (cell.ljust(width) for cell, width in zip(cells, widths[: len(_TEXTS)], strict=False))
        numbers = (cell.rjust(width) for cell, width in zip(cells[len(_TEXTS) :], widths[len(_TEXTS) :], strict=True))
        yield "  ".join((*texts, *numbers))
