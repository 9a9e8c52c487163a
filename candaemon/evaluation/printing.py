"""Prints an evaluation: tables on a terminal, plain aligned lines in a pipe."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from candaemon.evaluation.fitted_table import FittedTable
from candaemon.evaluation.results import ActorResult, BoxErrors, Evaluation, GroupErrors


@dataclass(frozen=True, slots=True)
class Section:
    """One table of a report.

    Attributes:
        title: heading.
        header: the columns' names.
        rows: cells as text; the first is the row's name.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def print_evaluation(console: Console, evaluation: Evaluation) -> None:
    """Print an evaluation: tables where the console is a terminal, plain lines elsewhere."""
    print_sections(console, sections(evaluation))


def print_sections(console: Console, parts: Iterator[Section] | Sequence[Section]) -> None:
    """Print sections as tables where the console is a terminal, as plain aligned lines elsewhere."""
    for section in parts:
        if console.is_terminal:
            console.print(_table(section))
        else:
            console.file.write("\n".join(_lines(section)) + "\n")


def sections(evaluation: Evaluation) -> Iterator[Section]:
    """Yield an evaluation's sections."""
    one = evaluation
    errors = one.errors
    yield Section(
        f"errors (RMSE, {errors.samples} samples, {one.options.settle:g} s after confirmation and later)",
        ("", "plane", "x", "y"),
        (
            ("position (m)", *_numbers(errors.position, errors.x, errors.y)),
            ("velocity (m/s)", *_numbers(errors.velocity, errors.vx, errors.vy)),
            ("acceleration (m/s²)", *_numbers(errors.acceleration, errors.ax, errors.ay)),
        ),
    )
    yield _groups(one.groups)
    score = one.gospa
    yield Section(
        f"GOSPA (c = {score.cutoff:g} m, p = {score.order:g}, α = {score.alpha:g})",
        ("", "value"),
        (
            ("mean (m)", _number(score.mean)),
            (f"mean of its power (m^{score.order:g})", _number(score.power_mean)),
            ("  localisation", _number(score.localisation)),
            ("  missed", _number(score.missed)),
            ("  false", _number(score.false)),
        ),
    )
    yield _consistency(one)
    box = one.groups[0].box
    if any(not math.isnan(value) for value in (box.heading, box.length, box.width, box.center)):
        yield _box(box)
    delay, false, alike = one.time_to_confirm, one.false_tracks, one.duplicates
    yield Section(
        "tracks",
        ("", "value"),
        (
            ("cycles", _with(one.cycles, one.skipped, "more without truth")),
            ("confirmed", f"{one.confirmed_ids} ({one.confirmed_samples} samples)"),
            (
                f"false (> {one.options.gate:g} m from all)",
                f"{false.ids} ({false.samples} samples, {_percent(false.share)})",
            ),
            ("duplicates", f"{alike.ids} ({alike.samples} samples, {_percent(alike.share)})"),
            (
                "surplus (its actor has another)",
                f"{one.surplus.ids} ({one.surplus.samples} samples, {_percent(one.surplus.share)})",
            ),
            (
                f"missed (visible for {one.options.patience:g} s)",
                f"{one.missed.samples} of {one.missed.awaited} samples, {_percent(one.missed.share)}",
            ),
            ("id switches", str(one.id_switches)),
            ("fragments", str(one.fragments)),
            ("time to confirm (s)", f"mean {_number(delay.mean)}, max {_number(delay.max)}"),
            ("actors never confirmed", f"{delay.unconfirmed} of {len(one.actors)}"),
        ),
    )
    yield Section(
        "actors",
        ("id", "visible", "tracked", "confirmed after (s)", "switches", "fragments", "position (m)", "velocity (m/s)"),
        tuple(_actor(actor) for actor in one.actors),
    )


def _groups(groups: Sequence[GroupErrors]) -> Section:
    """Return the errors of each group of pairs, to see what is worst."""
    of_position, of_velocity = (
        ("position (m)", "along (m)", "across (m)"),
        ("velocity (m/s)", "along (m/s)", "across (m/s)"),
    )
    header = ("samples", *of_position, *of_velocity, "NEES", "within 95 %")
    rows = (
        (
            one.by if one.by == one.group else f"{one.by}: {one.group}",
            str(one.samples),
            *_numbers(one.position, one.along, one.across),
            *_numbers(one.velocity, one.velocity_along, one.velocity_across),
            _number(one.nees),
            _percent(one.coverage),
        )
        for one in groups
    )
    return Section("errors by group (RMSE; along and across the actor's course)", ("", *header), tuple(rows))


def _consistency(evaluation: Evaluation) -> Section:
    """Return the NEES of the state and of each of its quantities."""
    every = {"x, y, vx, vy": evaluation.nees, **evaluation.nees_of}
    return Section(
        f"NEES (covariance's diagonal; {evaluation.nees.samples} samples)",
        ("", "mean", "expected", "within 95 %"),
        tuple(
            (
                name,
                _number(nees.mean),
                f"{nees.expected:g} ({_number(nees.lower)} to {_number(nees.upper)})",
                _percent(nees.coverage),
            )
            for name, nees in every.items()
        ),
    )


def _box(box: BoxErrors) -> Section:
    """Return the errors of the body."""
    return Section(
        "box (RMSE)",
        ("", "value", "share"),
        (
            ("heading of what moves (deg; share that has one)", _number(box.heading), _percent(box.heading_known)),
            ("yaw rate (rad/s)", _number(box.yaw_rate), ""),
            ("length (share of it; share within a quarter)", _percent(box.length), _percent(box.length_right)),
            ("width (share of it; share within a quarter)", _percent(box.width), _percent(box.width_right)),
            ("centre (m)", _number(box.center), ""),
        ),
    )


def _actor(actor: ActorResult) -> tuple[str, ...]:
    """Return an actor's row."""
    delay = actor.time_to_confirm
    return (
        str(actor.id),
        str(actor.visible),
        _percent(actor.tracked),
        "never" if delay is None else _number(delay),
        str(actor.id_switches),
        str(actor.fragments),
        *_numbers(actor.errors.position, actor.errors.velocity),
    )


def _number(value: float) -> str:
    """Return three decimals, or a dash where there are no samples."""
    return "-" if math.isnan(value) else f"{value:.3f}"


def _numbers(*values: float) -> tuple[str, ...]:
    """Return each with three decimals."""
    return tuple(_number(value) for value in values)


def _percent(value: float) -> str:
    """Return a share in percent, or a dash where there are no samples."""
    return "-" if math.isnan(value) else f"{100 * value:.1f} %"


def _with(count: int, more: int, what: str) -> str:
    """Return a count, and in brackets how many more there are of another sort, if any."""
    return f"{count} ({more} {what})" if more else str(count)


def _table(section: Section) -> FittedTable:
    """Return a section as a table for a terminal."""
    table = Table(title=section.title, title_justify="left", title_style="bold")
    for k, name in enumerate(section.header):
        table.add_column(name, justify="right" if k else "left")
    for row in section.rows:
        table.add_row(*row)
    return FittedTable(table)


def _lines(section: Section) -> Iterator[str]:
    """Yield a section as plain lines, columns aligned by blanks."""
    rows = (section.header, *section.rows)
    widths = [max(len(row[k]) for row in rows) for k in range(len(section.header))]
    yield section.title
    for first, *rest in rows:
        cells = (cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))
        yield "  ".join(("  " + first.ljust(widths[0]), *cells)).rstrip()
